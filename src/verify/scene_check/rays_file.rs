//! Files of recorded rays (`.rays`), bit-exact, to be traced again.
//!
//! The format is lines of text. The first is `whit rays 1`. Lines that are empty or begin with `#` are ignored. Before
//! the rays come `scene` with the file's name and `holds` with the number of instances and the number of triangles and
//! parts of shapes. `answers` with the names of two backends stands before the rays whose results they are; it may come
//! again, with other backends. A ray is a line of four parts with `|` between them:
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

use super::cross_check::{Difference, RayKind};
use super::feature::MeshFeature;
use crate::numeric::Ray;
use crate::verify::harness::QueryResult;

/// First line of a file, with the version of the format.
const FIRST: &str = "whit rays 1";

/// Rays of a scene for which two structures returned different results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RaysFile {
    /// Name of the scene's file, as given by the user.
    pub scene: String,
    /// Numbers of instances, and of triangles and parts of shapes, to detect a different scene.
    pub holds: [u64; 2],
    /// Rays of each pair of backends.
    pub pairs: Vec<RaysOfPair>,
}

/// Rays for which two backends returned different results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RaysOfPair {
    /// Names of the two backends.
    pub backends: [String; 2],
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
        // Write the header
        let mut text = format!(
            "{FIRST}\n# kind, tie or wrong, feature | origin, direction, least and largest t, time | result | \
             result\nscene {}\nholds {instances} {primitives}\n",
            in_one_line(&self.scene),
        );
        for RaysOfPair { backends, rays } in &self.pairs {
            // Write the names of the backends; writing to a string cannot fail
            let [first, second] = backends.each_ref().map(|name| in_one_line(name));
            let _ = writeln!(text, "answers {first} | {second}");
            // Write one line a ray
            for difference in rays {
                let verdict = if difference.is_wrong { "wrong" } else { "tie" };
                let [first, second] = difference.query_results.map(format_query_result);
                let _ = writeln!(
                    text,
                    "{} {verdict} {} | {} | {first} | {second}",
                    difference.kind.word(),
                    difference.feature.word(),
                    bits(&difference.ray)
                );
            }
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
        let mut has_counts = false;
        // Parse one line at a time
        for (line, number) in lines {
            let at = |what: String| error(number, what);
            let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
            match word {
                "" => {}
                _ if word.starts_with('#') => {}
                "scene" => rest.trim().clone_into(&mut file.scene),
                "holds" => {
                    file.holds =
                        parse_counts(rest).ok_or_else(|| at("`holds` takes two whole numbers".into()))?;
                    has_counts = true;
                }
                "answers" => {
                    let (first, second) = rest
                        .split_once('|')
                        .ok_or_else(|| at("`answers` takes two names with `|` between them".into()))?;
                    file.pairs.push(RaysOfPair {
                        backends: [first, second].map(|name| name.trim().to_owned()),
                        rays: Vec::new(),
                    });
                }
                // Require the scene's counts and two backends before the first ray
                _ => match file.pairs.last_mut() {
                    Some(pair) if has_counts => pair.rays.push(parse_ray_line(line).map_err(at)?),
                    _ => {
                        return Err(at(
                            "`holds` with two whole numbers and the names of two backends must come before the rays".into(),
                        ));
                    }
                },
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

fn parse_counts(text: &str) -> Option<[u64; 2]> {
    let (a, b) = text.trim().split_once(' ')?;
    Some([a.parse().ok()?, b.trim().parse().ok()?])
}

fn format_query_result(query_result: QueryResult) -> String {
    match query_result {
        QueryResult::Hit {
            instance,
            primitive,
            t,
        } => format!("hit {instance} {primitive} {:08x}", t.to_bits()),
        QueryResult::Nothing => "nothing".into(),
        QueryResult::Blocked => "blocked".into(),
        QueryResult::Free => "free".into(),
    }
}

/// Parses a line into a ray with its two results, or describes the error.
fn parse_ray_line(line: &str) -> Result<Difference, String> {
    // Split the line into its four parts
    let parts: Vec<&str> = line.split('|').map(str::trim).collect();
    let [what, numbers, first, second] = parts[..] else {
        return Err("a ray has four parts with `|` between them".into());
    };
    // Parse kind, verdict and feature
    let words: Vec<&str> = what.split_whitespace().collect();
    let [kind, verdict, feature] = words[..] else {
        return Err("a ray begins with its kind, `tie` or `wrong`, and a mesh feature".into());
    };
    let kind = RayKind::ALL
        .into_iter()
        .find(|known| known.word() == kind)
        .ok_or_else(|| format!("there is no ray kind `{kind}`: use `camera`, `shadow` or `reflection`"))?;
    let is_wrong = match verdict {
        "wrong" => true,
        "tie" => false,
        _ => return Err(format!("`{verdict}` is neither `tie` nor `wrong`")),
    };
    let feature = MeshFeature::ALL
        .into_iter()
        .find(|known| known.word() == feature)
        .ok_or_else(|| format!("there is no mesh feature `{feature}`"))?;
    // Parse the numbers and the results
    Ok(Difference {
        kind,
        ray: parse_ray(numbers)?,
        query_results: [
            parse_query_result(kind, first)?,
            parse_query_result(kind, second)?,
        ],
        is_wrong,
        feature,
    })
}

fn parse_ray(text: &str) -> Result<Ray, String> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map(parse_float)
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

fn parse_float(word: &str) -> Result<f32, String> {
    let is_hex = word.len() == 8 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    u32::from_str_radix(word, 16)
        .ok()
        .filter(|_| is_hex)
        .map(f32::from_bits)
        .ok_or_else(|| format!("`{word}` is not an f32: give eight hexadecimal digits"))
}

fn parse_query_result(kind: RayKind, text: &str) -> Result<QueryResult, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |word: &str| {
        word.parse::<u32>()
            .map_err(|_| format!("`{word}` is not the number of an instance or primitive"))
    };
    match (words.as_slice(), kind) {
        (["blocked"], RayKind::Shadow) => Ok(QueryResult::Blocked),
        (["free"], RayKind::Shadow) => Ok(QueryResult::Free),
        (["nothing"], RayKind::Camera | RayKind::Reflection) => Ok(QueryResult::Nothing),
        (["hit", instance, primitive, t], RayKind::Camera | RayKind::Reflection) => Ok(QueryResult::Hit {
            instance: number(instance)?,
            primitive: number(primitive)?,
            t: parse_float(t)?,
        }),
        _ => Err(format!("`{text}` is not a result of a {} ray", kind.word())),
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
        let difference = |kind, query_results, is_wrong, feature| Difference {
            kind,
            ray,
            query_results,
            is_wrong,
            feature,
        };
        let hit = QueryResult::Hit {
            instance: 3,
            primitive: 70_073,
            t: 0.1 + 0.2,
        };
        RaysFile {
            scene: "a folder/scene <1>.glb".into(),
            holds: [4, 70_074],
            pairs: vec![
                RaysOfPair {
                    backends: ["Embree 3".into(), "native".into()],
                    rays: Vec::new(),
                },
                RaysOfPair {
                    backends: ["Embree 3".into(), "BSP".into()],
                    rays: vec![
                        difference(
                            RayKind::Camera,
                            [hit, QueryResult::Nothing],
                            true,
                            MeshFeature::Edge,
                        ),
                        difference(
                            RayKind::Shadow,
                            [QueryResult::Free, QueryResult::Blocked],
                            false,
                            MeshFeature::Nan,
                        ),
                    ],
                },
            ],
        }
    }

    #[test]
    fn written_rays_are_read_back_bit_exactly() {
        let file = file();
        let read = RaysFile::parse(&file.text()).unwrap();
        assert_eq!(read, file);
        // == does not distinguish -0 from 0.
        assert!(read.pairs[1].rays[0].ray.origin.y.is_sign_negative());
    }

    #[test]
    fn every_mesh_feature_has_a_unique_word() {
        for feature in MeshFeature::ALL {
            let named = MeshFeature::ALL
                .into_iter()
                .filter(|other| other.word() == feature.word());
            assert_eq!(named.count(), 1);
        }
    }

    #[test]
    fn malformed_line_is_reported_with_its_error() {
        // Pair each malformed text with its line and a part of the message
        let good = file().text();
        let ray = |line: &str| format!("{good}{line}\n");
        let bits = bits(&file().pairs[1].rays[0].ray);
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
            (
                format!("whit rays 1\nholds 1 2\ncamera tie edge | {bits} | nothing | nothing\n"),
                3,
                "before the rays",
            ),
            (ray("camera tie edge"), 9, "four parts"),
            (
                ray(&format!("camera tie | {bits} | nothing | nothing")),
                9,
                "begins with its kind",
            ),
            (
                ray(&format!("lamp tie edge | {bits} | nothing | nothing")),
                9,
                "ray kind `lamp`",
            ),
            (
                ray(&format!("camera right edge | {bits} | nothing | nothing")),
                9,
                "neither",
            ),
            (
                ray(&format!("camera tie moon | {bits} | nothing | nothing")),
                9,
                "no mesh feature `moon`",
            ),
            (
                ray("camera tie edge | 00000000 | nothing | nothing"),
                9,
                "nine numbers, not 1",
            ),
            (
                ray("camera tie edge | 1.5 | nothing | nothing"),
                9,
                "eight hexadecimal",
            ),
            (
                ray(&format!("camera tie edge | {bits} | blocked | nothing")),
                9,
                "not a result of a camera ray",
            ),
            (
                ray(&format!("shadow tie edge | {bits} | hit 0 0 00000000 | free")),
                9,
                "not a result of a shadow ray",
            ),
            (
                ray(&format!("camera tie edge | {bits} | hit -1 0 00000000 | nothing")),
                9,
                "not the number",
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
