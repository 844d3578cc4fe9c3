//! Flag of the part of an image that is rendered.

use std::str::FromStr;

use whit::render::Region;

/// Rectangle of pixels by its left column, top row, width and height; within an image or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::cli) struct Crop(pub(in crate::cli) Region);

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Crop, String> {
        let numbers: Option<Vec<u32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, width, height]) if width > 0 && height > 0 => {
                Ok(Crop(Region { x, y, width, height }))
            }
            _ => Err(
                "give the left column, the top row, the width and the height in pixels, as in 0,0,64,48"
                    .into(),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crop_is_four_whole_numbers_and_not_empty() {
        let region = Region {
            x: 1,
            y: 2,
            width: 30,
            height: 4,
        };
        assert_eq!("1,2, 30,4".parse(), Ok(Crop(region)));
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "-1,2,3,4",
            "1,2,0,4",
            "1,2,3,0",
            "1.5,2,3,4",
        ] {
            assert!(bad.parse::<Crop>().is_err(), "{bad}");
        }
    }
}
