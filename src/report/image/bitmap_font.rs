//! Bitmap font of 3x5 pixels for legends in images.

/// Width of a letter in pixels.
pub(super) const WIDTH: u32 = 3;
/// Height of a letter in pixels.
pub(super) const HEIGHT: u32 = 5;

/// Bitmap rows of each letter from the top; the highest of three bits is the left column.
const LETTERS: [(char, [u8; 5]); 40] = [
    ('0', [7, 5, 5, 5, 7]),
    ('1', [2, 6, 2, 2, 7]),
    ('2', [7, 1, 7, 4, 7]),
    ('3', [7, 1, 3, 1, 7]),
    ('4', [5, 5, 7, 1, 1]),
    ('5', [7, 4, 7, 1, 7]),
    ('6', [7, 4, 7, 5, 7]),
    ('7', [7, 1, 2, 2, 2]),
    ('8', [7, 5, 7, 5, 7]),
    ('9', [7, 5, 7, 1, 7]),
    ('A', [2, 5, 7, 5, 5]),
    ('B', [6, 5, 6, 5, 6]),
    ('C', [3, 4, 4, 4, 3]),
    ('D', [6, 5, 5, 5, 6]),
    ('E', [7, 4, 6, 4, 7]),
    ('F', [7, 4, 6, 4, 4]),
    ('G', [3, 4, 5, 5, 3]),
    ('H', [5, 5, 7, 5, 5]),
    ('I', [7, 2, 2, 2, 7]),
    ('J', [1, 1, 1, 5, 2]),
    ('K', [5, 5, 6, 5, 5]),
    ('L', [4, 4, 4, 4, 7]),
    ('M', [5, 7, 7, 5, 5]),
    ('N', [6, 5, 5, 5, 5]),
    ('O', [2, 5, 5, 5, 2]),
    ('P', [6, 5, 6, 4, 4]),
    ('Q', [2, 5, 5, 6, 3]),
    ('R', [6, 5, 6, 5, 5]),
    ('S', [3, 4, 2, 1, 6]),
    ('T', [7, 2, 2, 2, 2]),
    ('U', [5, 5, 5, 5, 7]),
    ('V', [5, 5, 5, 5, 2]),
    ('W', [5, 5, 7, 7, 5]),
    ('X', [5, 5, 2, 5, 5]),
    ('Y', [5, 5, 2, 2, 2]),
    ('Z', [7, 1, 2, 4, 7]),
    (':', [0, 2, 0, 2, 0]),
    (',', [0, 0, 0, 2, 4]),
    ('(', [1, 2, 2, 2, 1]),
    (')', [4, 2, 2, 2, 4]),
];

/// Returns whether a pixel of a letter is set; lower case is drawn as upper case, and unknown letters are blank.
pub(super) fn is_set(letter: char, column: u32, row: u32) -> bool {
    let letter = letter.to_ascii_uppercase();
    let known = LETTERS.iter().find(|(name, _)| *name == letter);
    known.is_some_and(|(_, rows)| {
        column < WIDTH && row < HEIGHT && rows[row as usize] >> (WIDTH - 1 - column) & 1 == 1
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_differ_and_unknown_characters_are_blank() {
        for (number, (name, rows)) in LETTERS.iter().enumerate() {
            assert!(rows.iter().all(|&row| row < 8), "{name}");
            assert!(LETTERS[..number].iter().all(|(other, _)| other != name));
        }
        assert!(is_set('t', 0, 0) && is_set('T', 1, 4) && !is_set('T', 0, 4));
        assert!(!is_set('é', 1, 1) && !is_set('T', 3, 0) && !is_set('T', 0, 5));
    }
}
