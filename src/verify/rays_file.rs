//! Files of recorded rays (`.rays`), bit-exact, to be traced again.
//!
//! The format is lines of text. The first is `whit rays 1`. Lines that are empty or begin with `#` are ignored. Before
//! the rays come `scene` with the file's name, `holds` with the number of instances and the number of triangles and
//! parts of shapes, and `answers` with the names of the two backends. A ray is a line of four parts with `|` between
//! them:
//!
//! ```text
//! camera tie edge | 00000000 3f800000 40a00000 bf000000 … | hit 0 12 40b3c1a2 | nothing
//! ```
//!
//! The first part is the ray's purpose (`camera`, `shadow`, `reflection`), `tie` or `wrong`, and the mesh feature. The
//! second is nine f32 as hexadecimal bits: origin, direction, smallest and largest parameter, and time. The last two
//! are the results: `hit` with instance, primitive and the bits of the parameter, or `nothing`; for shadow rays
//! `blocked` or `free`. Coordinates are the scene's own, after its translation and scaling by a power of two.

use std::fmt::Write;

use glam::Vec3;

use super::own::{Difference, RayKind, Reply};
use super::place::Place;
use crate::numeric::Ray;

/// First line of a file, with the version of the format.
const FIRST: &str = "whit rays 1";

/// Rays of a scene for which two structures returned different results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RaysFile {
    /// Name of the scene's file, as given by the user.
    pub scene: String,
    /// Numbers of instances, and of triangles and parts of shapes, to detect a different scene.
    pub holds: [u64; 2],
    /// Names of the two backends.
    pub answers: [String; 2],
    /// Rays with the two results.
    pub rays: Vec<Difference>,
}

/// Error in reading a file of rays.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct RaysError {
    /// Line number, counted from 1.
    pub line: usize,
    /// Description of the error, with what was expected.
    pub what: String,
}

/// Formats a ray's nine numbers as hexadecimal f32 bits: origin, direction, `t_near`, `t_far`, time.
pub fn bits(ray: &Ray) -> String {
    let ([a, b, c], [d, e, f]) = (ray.origin.to_array(), ray.direction.to_array());
    [a, b, c, d, e, f, ray.t_near, ray.t_far, ray.time]
        .map(|x| format!("{:08x}", x.to_bits()))
        .join(" ")
}

impl RaysFile {
    /// Returns the text of the file.
    pub fn text(&self) -> String {
        let [instances, primitives] = self.holds;
        let [first, second] = &self.answers;
        // Write the header
        let mut text = format!(
            "{FIRST}\n# kind, tie or wrong, place | origin, direction, least and largest t, time | answer | answer\n\
             scene {}\nholds {instances} {primitives}\nanswers {} | {}\n",
            in_one_line(&self.scene),
            in_one_line(first),
            in_one_line(second)
        );
        // Write one line a ray
        for difference in &self.rays {
            let verdict = if difference.is_wrong { "wrong" } else { "tie" };
            let [first, second] = difference.replies.map(words_of);
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{} {verdict} {} | {} | {first} | {second}",
                difference.kind.word(),
                difference.place.word(),
                bits(&difference.ray)
            );
        }
        text
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    ///
    /// Returns the first line that is malformed.
    pub fn parse(text: &str) -> Result<RaysFile, RaysError> {
        let mut file = RaysFile::default();
        let mut lines = text.lines().zip(1..).map(|(line, number)| (line.trim(), number));
        // Check the version
        match lines.next() {
            Some((FIRST, _)) => {}
            _ => return Err(error(1, format!("a file of rays begins with `{FIRST}`"))),
        }
        let mut has_scene = false;
        // Parse one line at a time
        for (line, number) in lines {
            let at = |what: String| error(number, what);
            let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
            match word {
                "" => {}
                _ if word.starts_with('#') => {}
                "scene" => rest.trim().clone_into(&mut file.scene),
                "holds" => {
                    file.holds = counts(rest).ok_or_else(|| at("`holds` takes two whole numbers".into()))?;
                    has_scene = true;
                }
                "answers" => {
                    let (first, second) = rest
                        .split_once('|')
                        .ok_or_else(|| at("`answers` takes two names with `|` between them".into()))?;
                    file.answers = [first, second].map(|name| name.trim().to_owned());
                }
                // Require the scene's counts before the first ray
                _ if !has_scene => {
                    return Err(at(
                        "`holds` with two whole numbers must stand before the rays".into()
                    ));
                }
                _ => file.rays.push(ray_line(line).map_err(at)?),
            }
        }
        Ok(file)
    }
}

fn error(line: usize, what: String) -> RaysError {
    RaysError { line, what }
}

fn in_one_line(text: &str) -> String {
    text.replace(['\n', '\r', '|'], " ")
}

fn counts(text: &str) -> Option<[u64; 2]> {
    let (a, b) = text.trim().split_once(' ')?;
    Some([a.parse().ok()?, b.trim().parse().ok()?])
}

fn words_of(reply: Reply) -> String {
    match reply {
        Reply::Hit {
            instance,
            primitive,
            t,
        } => format!("hit {instance} {primitive} {:08x}", t.to_bits()),
        Reply::Nothing => "nothing".into(),
        Reply::Blocked => "blocked".into(),
        Reply::Free => "free".into(),
    }
}

/// Parses a line into a ray with its two results, or describes the error.
fn ray_line(line: &str) -> Result<Difference, String> {
    // Split the line into its four parts
    let parts: Vec<&str> = line.split('|').map(str::trim).collect();
    let [what, numbers, first, second] = parts[..] else {
        return Err("a ray has four parts with `|` between them".into());
    };
    // Parse kind, verdict and feature
    let words: Vec<&str> = what.split_whitespace().collect();
    let [kind, verdict, place] = words[..] else {
        return Err("a ray begins with its kind, `tie` or `wrong`, and a place".into());
    };
    let kind = RayKind::ALL
        .into_iter()
        .find(|known| known.word() == kind)
        .ok_or_else(|| format!("there are no rays of kind `{kind}`: camera, shadow or reflection"))?;
    let is_wrong = match verdict {
        "wrong" => true,
        "tie" => false,
        _ => return Err(format!("`{verdict}` is neither `tie` nor `wrong`")),
    };
    let place = Place::ALL
        .into_iter()
        .find(|known| known.word() == place)
        .ok_or_else(|| format!("there is no place `{place}`"))?;
    // Parse the numbers and the results
    Ok(Difference {
        kind,
        ray: ray_of(numbers)?,
        replies: [reply_of(kind, first)?, reply_of(kind, second)?],
        is_wrong,
        place,
    })
}

fn ray_of(text: &str) -> Result<Ray, String> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map(float_of)
        .collect::<Result<_, String>>()?;
    let [ox, oy, oz, dx, dy, dz, t_near, t_far, time] = numbers[..] else {
        return Err(format!("a ray has nine numbers, not {}", numbers.len()));
    };
    Ok(Ray {
        origin: Vec3::new(ox, oy, oz),
        direction: Vec3::new(dx, dy, dz),
        t_near,
        t_far,
        time,
    })
}

fn float_of(word: &str) -> Result<f32, String> {
    let is_hex = word.len() == 8 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    u32::from_str_radix(word, 16)
        .ok()
        .filter(|_| is_hex)
        .map(f32::from_bits)
        .ok_or_else(|| format!("`{word}` is no f32 as eight hexadecimal digits"))
}

fn reply_of(kind: RayKind, text: &str) -> Result<Reply, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |word: &str| {
        word.parse::<u32>()
            .map_err(|_| format!("`{word}` is no number of an instance or primitive"))
    };
    match (words.as_slice(), kind) {
        (["blocked"], RayKind::Shadow) => Ok(Reply::Blocked),
        (["free"], RayKind::Shadow) => Ok(Reply::Free),
        (["nothing"], RayKind::Camera | RayKind::Reflection) => Ok(Reply::Nothing),
        (["hit", instance, primitive, t], RayKind::Camera | RayKind::Reflection) => Ok(Reply::Hit {
            instance: number(instance)?,
            primitive: number(primitive)?,
            t: float_of(t)?,
        }),
        _ => Err(format!("`{text}` is no answer to a {} ray", kind.word())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> RaysFile {
        let ray = Ray {
            t_near: 1e-45,
            time: 0.25,
            ..Ray::new(
                Vec3::new(0.1, -0.0, 3.0e-39),
                Vec3::new(1.0 / 3.0, f32::MIN_POSITIVE, -1.0),
            )
        };
        let difference = |kind, replies, is_wrong, place| Difference {
            kind,
            ray,
            replies,
            is_wrong,
            place,
        };
        let hit = Reply::Hit {
            instance: 3,
            primitive: 70_073,
            t: 0.1 + 0.2,
        };
        RaysFile {
            scene: "a folder/scene <1>.glb".into(),
            holds: [4, 70_074],
            answers: ["Embree 3".into(), "BSP".into()],
            rays: vec![
                difference(RayKind::Camera, [hit, Reply::Nothing], true, Place::Edge),
                difference(RayKind::Shadow, [Reply::Free, Reply::Blocked], false, Place::Nan),
            ],
        }
    }

    #[test]
    fn what_is_written_is_read_to_the_bit() {
        let file = file();
        let read = RaysFile::parse(&file.text()).unwrap();
        assert_eq!(read, file);
        // == does not distinguish -0 from 0.
        assert!(read.rays[0].ray.origin.y.is_sign_negative());
    }

    #[test]
    fn every_place_has_a_word_of_its_own() {
        for place in Place::ALL {
            let named = Place::ALL
                .into_iter()
                .filter(|other| other.word() == place.word());
            assert_eq!(named.count(), 1);
        }
    }

    #[test]
    fn a_bad_line_is_named_with_what_is_wrong_with_it() {
        // Pair each malformed text with its line and a part of the message
        let good = file().text();
        let ray = |line: &str| format!("{good}{line}\n");
        let bits = bits(&file().rays[0].ray);
        let cases = [
            (String::new(), 1, "begins with"),
            ("whit rays 2\n".into(), 1, "begins with"),
            ("whit rays 1\nholds many\n".into(), 2, "two whole numbers"),
            ("whit rays 1\nanswers one\n".into(), 2, "two names"),
            (
                format!("whit rays 1\ncamera tie edge | {bits} | nothing | nothing\n"),
                2,
                "before the rays",
            ),
            (ray("camera tie edge"), 8, "four parts"),
            (
                ray(&format!("camera tie | {bits} | nothing | nothing")),
                8,
                "begins with its kind",
            ),
            (
                ray(&format!("lamp tie edge | {bits} | nothing | nothing")),
                8,
                "kind `lamp`",
            ),
            (
                ray(&format!("camera right edge | {bits} | nothing | nothing")),
                8,
                "neither",
            ),
            (
                ray(&format!("camera tie moon | {bits} | nothing | nothing")),
                8,
                "no place `moon`",
            ),
            (
                ray("camera tie edge | 00000000 | nothing | nothing"),
                8,
                "nine numbers, not 1",
            ),
            (
                ray("camera tie edge | 1.5 | nothing | nothing"),
                8,
                "eight hexadecimal",
            ),
            (
                ray(&format!("camera tie edge | {bits} | blocked | nothing")),
                8,
                "no answer to a camera ray",
            ),
            (
                ray(&format!("shadow tie edge | {bits} | hit 0 0 00000000 | free")),
                8,
                "no answer to a shadow ray",
            ),
            (
                ray(&format!("camera tie edge | {bits} | hit -1 0 00000000 | nothing")),
                8,
                "no number",
            ),
        ];
        // Check that the error gives both
        for (text, line, words) in cases {
            let error = RaysFile::parse(&text).unwrap_err();
            assert_eq!(error.line, line, "{error}");
            assert!(error.what.contains(words), "{error} lacks {words}");
        }
    }
}
