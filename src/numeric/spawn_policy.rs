//! Ray-offset policies: the error bound that is correct, and fixed offsets to compare it with.

use std::fmt;
use std::str::FromStr;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// Rule for the origin of a ray that leaves a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum SpawnPolicy {
    /// Offset by a bound on the rounding error, as [`spawn_point`](super::spawn_point) computes it.
    #[default]
    Bounded,
    /// Offset by this fraction of the scene's size, above 0 and at most 1, everywhere.
    Fixed(f64),
    /// No offset: the hit point, rounded to f32.
    None,
}

impl SpawnPolicy {
    /// Returns the offset along the surface normal in a scene whose bounding box has a diagonal of `size`; `None` for
    /// the bound, which differs from point to point.
    pub fn offset(self, size: f64) -> Option<f64> {
        match self {
            SpawnPolicy::Bounded => None,
            SpawnPolicy::Fixed(part) => Some(part * size),
            SpawnPolicy::None => Some(0.0),
        }
    }
}

impl fmt::Display for SpawnPolicy {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            SpawnPolicy::Bounded => f.write_str("bounded"),
            SpawnPolicy::Fixed(part) => write!(f, "fixed:{part}"),
            SpawnPolicy::None => f.write_str("none"),
        }
    }
}

impl FromStr for SpawnPolicy {
    type Err = String;

    fn from_str(text: &str) -> Result<SpawnPolicy, String> {
        // Parse the fraction of a fixed offset
        let part = |digits: &str| {
            let part: f64 = digits.parse().ok()?;
            (part > 0.0 && part <= 1.0).then_some(SpawnPolicy::Fixed(part))
        };
        let policy = match text {
            "bounded" => Some(SpawnPolicy::Bounded),
            "none" => Some(SpawnPolicy::None),
            _ => text.strip_prefix("fixed:").and_then(part),
        };
        policy.ok_or_else(|| {
            "give `bounded`, `none` or `fixed:` and a part of the scene's size above 0 and at most 1, as in fixed:0.0001"
                .into()
        })
    }
}

impl From<SpawnPolicy> for String {
    fn from(policy: SpawnPolicy) -> String {
        policy.to_string()
    }
}

impl TryFrom<String> for SpawnPolicy {
    type Error = String;

    fn try_from(text: String) -> Result<SpawnPolicy, String> {
        text.parse()
    }
}

/// Returns the f32 origin of a ray that leaves `p` by `offset` along `normal`, rounded to nearest.
#[inline(always)]
pub(crate) fn offset_point(p: DVec3, normal: DVec3, offset: f64) -> Vec3 {
    (p + normal * offset).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spawn_policy_round_trips_as_text() {
        for policy in [
            SpawnPolicy::Bounded,
            SpawnPolicy::None,
            SpawnPolicy::Fixed(0.001),
            SpawnPolicy::Fixed(1e-7),
        ] {
            assert_eq!(policy.to_string().parse(), Ok(policy));
        }
        for text in [
            "",
            "fixed",
            "fixed:",
            "fixed:0",
            "fixed:2",
            "fixed:nan",
            "0.1",
            "Bounded",
        ] {
            assert!(
                text.parse::<SpawnPolicy>().unwrap_err().contains("fixed:0.0001"),
                "{text}"
            );
        }
    }

    #[test]
    fn fixed_offset_scales_with_the_scene_and_bounded_does_not() {
        assert_eq!(SpawnPolicy::Fixed(0.01).offset(200.0), Some(2.0));
        assert_eq!(SpawnPolicy::None.offset(200.0), Some(0.0));
        assert_eq!(SpawnPolicy::Bounded.offset(200.0), None);
        assert_eq!(offset_point(DVec3::ONE, DVec3::Z, 0.5), Vec3::new(1.0, 1.0, 1.5));
    }
}
