//! Transforms of objects: lists of transform steps, rows and grids of copies, and randomly scattered copies.
//!
//! Copies are identical in every run: random choices come from a hash of the seed and the copy's number.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

use super::value::{Each, Vector};
use crate::numeric;

/// One transform of a list.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Step {
    /// A translation by a vector.
    Translate(Vector),
    /// A rotation about the axis [x, y, z] by degrees, counter-clockwise seen against the axis: [x, y, z, degrees].
    Rotate([f64; 4]),
    /// A scale by one number, or one along each axis; negative ones mirror.
    Scale(Each<3>),
    /// The shortest rotation that turns the z axis into this direction.
    ZTo(Vector),
    /// Three rows of a 3 x 4 matrix; the fourth column is the translation.
    Matrix([[f64; 4]; 3]),
}

impl Step {
    /// Returns the affine map of the step, which is invertible.
    fn map(&self) -> Result<DAffine3, String> {
        // Compute the map
        let map = match self {
            Step::Translate(by) => DAffine3::from_translation(by.0),
            Step::Rotate([x, y, z, degrees]) => {
                let axis = DVec3::new(*x, *y, *z)
                    .try_normalize()
                    .ok_or("turns around an axis without length: give [x, y, z, degrees]")?;
                DAffine3::from_axis_angle(axis, degrees.to_radians())
            }
            Step::Scale(by) => DAffine3::from_scale(by.0.into()),
            Step::ZTo(direction) => {
                let direction = direction
                    .0
                    .try_normalize()
                    .ok_or("turns z into a direction without length: give another")?;
                DAffine3::from_quat(DQuat::from_rotation_arc(DVec3::Z, direction))
            }
            Step::Matrix(rows) => {
                let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
                DAffine3 {
                    matrix3: DMat3::from_cols(column(0), column(1), column(2)),
                    translation: column(3),
                }
            }
        };
        // Reject a map that cannot be inverted
        match numeric::inverse(&map) {
            Ok(_) => Ok(map),
            Err(singular) => Err(format!("{singular}: give an invertible transform")),
        }
    }
}

/// Returns the composition of all steps, the first one applied first; or the index of a faulty step and its fault.
pub(super) fn map_of<'s>(steps: impl Iterator<Item = &'s Step>) -> Result<DAffine3, (usize, String)> {
    let mut map = DAffine3::IDENTITY;
    for (number, step) in steps.enumerate() {
        map = step.map().map_err(|fault| (number, fault))? * map;
    }
    Ok(map)
}

/// A row, grid or block of copies.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Repeat {
    /// Numbers of copies along x, y and z; at least 1 each.
    count: [u32; 3],
    /// Distances between copies along x, y and z. The first copy is at the object's own position.
    step: Vector,
    /// Largest random offset of each copy.
    #[serde(default = "exact")]
    #[schemars(extend("default" = 0.0))]
    jitter: Each<3>,
    /// Axis about which each copy is rotated by a random angle.
    turn: Option<Vector>,
    /// Smallest and largest random scale of a copy.
    scale: Option<[f64; 2]>,
    /// Seed of the random choices.
    #[serde(default)]
    seed: u32,
}

fn exact() -> Each<3> {
    Each([0.0; 3])
}

/// Copies at random positions in a box.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Scatter {
    /// Number of copies; at least 1.
    count: u32,
    /// Low corner of the box, relative to the object's own position.
    min: Vector,
    /// High corner of the box.
    max: Vector,
    /// Axis about which each copy is rotated by a random angle.
    turn: Option<Vector>,
    /// Smallest and largest random scale of a copy.
    scale: Option<[f64; 2]>,
    /// Seed of the random choices.
    #[serde(default)]
    seed: u32,
}

/// Copies of an object: each is scaled and rotated, then moved, after the object's own transforms.
#[derive(Clone, Debug)]
pub(super) struct Copies {
    counts: [u32; 3],
    step: DVec3,
    /// Low corner and size of the box of random offsets.
    random: [DVec3; 2],
    axis: Option<DVec3>,
    scale: [f64; 2],
    seed: u32,
}

impl Repeat {
    pub(super) fn copies(&self) -> Result<Copies, String> {
        // Jitter is a box around each position of the grid
        let jitter = DVec3::from(self.jitter.0).abs();
        Copies {
            counts: self.count,
            step: self.step.0,
            random: [-jitter, 2.0 * jitter],
            axis: axis(self.turn)?,
            scale: self.scale.unwrap_or([1.0; 2]),
            seed: self.seed,
        }
        .checked()
    }
}

impl Scatter {
    pub(super) fn copies(&self) -> Result<Copies, String> {
        // The corners must be ordered along every axis
        if !self.min.0.cmple(self.max.0).all() {
            return Err("its `min` is not below its `max`: swap them".into());
        }
        Copies {
            counts: [self.count, 1, 1],
            step: DVec3::ZERO,
            random: [self.min.0, self.max.0 - self.min.0],
            axis: axis(self.turn)?,
            scale: self.scale.unwrap_or([1.0; 2]),
            seed: self.seed,
        }
        .checked()
    }
}

fn axis(turn: Option<Vector>) -> Result<Option<DVec3>, String> {
    let unit = |v: Vector| {
        v.0.try_normalize()
            .ok_or_else(|| "turns around an axis without length: give another `turn`".into())
    };
    turn.map(unit).transpose()
}

/// Random choices about a copy.
#[derive(Clone, Copy)]
enum RandomChoice {
    X,
    Y,
    Z,
    Turn,
    Scale,
}

impl Copies {
    fn checked(self) -> Result<Copies, String> {
        let [min_scale, max_scale] = self.scale;
        if !(0.0 < min_scale && min_scale <= max_scale && max_scale < f64::INFINITY) {
            return Err(format!(
                "scales copies by {min_scale} to {max_scale}: give positive numbers, the smaller first"
            ));
        }
        if self.counts.contains(&0) {
            return Err("makes no copy: give counts of 1 or more".into());
        }
        Ok(self)
    }

    /// Returns the number of copies.
    pub(super) fn count(&self) -> u64 {
        self.counts.iter().fold(1, |n, &c| n.saturating_mul(u64::from(c)))
    }

    /// Returns the map of copy `number`, which follows the object's own transforms.
    pub(super) fn map(&self, number: u64) -> DAffine3 {
        // Find the position in the grid and a random offset
        let [nx, ny, _] = self.counts.map(u64::from);
        let grid_position = [number % nx, number / nx % ny, number / nx / ny].map(|i| i as f64);
        let random = |choice: RandomChoice| uniform(self.seed, number, choice);
        let [low, size] = self.random;
        let offset = low
            + size
                * DVec3::new(
                    random(RandomChoice::X),
                    random(RandomChoice::Y),
                    random(RandomChoice::Z),
                );
        // Choose a random rotation and a random scale
        let rotation = self.axis.map_or(DQuat::IDENTITY, |axis| {
            DQuat::from_axis_angle(axis, std::f64::consts::TAU * random(RandomChoice::Turn))
        });
        let [min_scale, max_scale] = self.scale;
        DAffine3::from_scale_rotation_translation(
            DVec3::splat(min_scale + (max_scale - min_scale) * random(RandomChoice::Scale)),
            rotation,
            self.step * DVec3::from(grid_position) + offset,
        )
    }
}

/// Returns a number in [0, 1) for one choice about one copy: SplitMix64's finaliser (Steele, Lea and Flood, 2014) over
/// the key.
fn uniform(seed: u32, number: u64, choice: RandomChoice) -> f64 {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let mix = |z: u64| {
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    let keys = [u64::from(seed), number, choice as u64];
    let hash = keys
        .into_iter()
        .fold(0, |h: u64, key| mix(h.wrapping_add(GOLDEN) ^ key));
    // The top 53 bits fill the significand
    (hash >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;

    #[derive(Deserialize)]
    struct Placed {
        transform: Vec<Step>,
    }

    fn map(text: &str) -> Result<DAffine3, (usize, String)> {
        let placed: Placed = from_text(&format!("transform = {text}")).unwrap();
        map_of(placed.transform.iter())
    }

    #[test]
    fn transforms_apply_in_written_order() {
        // (1, 0, 0) doubled is (2, 0, 0), rotated (0, 2, 0), moved (5, 2, 0).
        let map = map("[{ scale = 2 }, { rotate = [0, 0, 1, 90] }, { translate = [5, 0, 0] }]").unwrap();
        let p = map.transform_point3(DVec3::X);
        assert!(
            (p - DVec3::new(5.0, 2.0, 0.0)).length() < 4.0 * f64::EPSILON,
            "{p}"
        );
    }

    #[test]
    fn matrix_is_row_major_and_z_turns_the_shortest_way() {
        let matrix = map("[{ matrix = [[1, 0, 0, 7], [0, 2, 0, 8], [0, 0, 3, 9]] }]").unwrap();
        assert_eq!(matrix.transform_point3(DVec3::ONE), DVec3::new(8.0, 10.0, 12.0));
        let turned = map("[{ z-to = [0, 5, 0] }]").unwrap();
        assert!((turned.transform_vector3(DVec3::Z) - DVec3::Y).length() < 4.0 * f64::EPSILON);
        assert!((turned.transform_vector3(DVec3::X) - DVec3::X).length() < 4.0 * f64::EPSILON);
    }

    #[test]
    fn singular_step_is_named() {
        let (number, fault) = map("[{ scale = 2 }, { scale = [1, 0, 1] }]").unwrap_err();
        assert_eq!(number, 1);
        assert!(fault.contains("singular"), "{fault}");
        assert!(map("[{ rotate = [0, 0, 0, 5] }]").is_err());
        assert!(map("[{ rotate = [0, 0, 1, inf] }]").is_err());
        assert!(map("[{ matrix = [[nan, 0, 0, 7], [0, 2, 0, 8], [0, 0, 3, 9]] }]").is_err());
    }

    #[test]
    fn copies_follow_their_grid_and_jitter_by_seed() {
        let copies = |text: &str| from_text::<Repeat>(text).unwrap().copies().unwrap();
        // Without random choices copies are exactly on the grid
        let grid = copies("count = [3, 1, 2]\nstep = [2, 0, 5]");
        assert_eq!(grid.count(), 6);
        assert_eq!(grid.map(5), DAffine3::from_translation(DVec3::new(4.0, 0.0, 5.0)));
        let loose = "count = [3, 1, 2]\nstep = [2, 0, 5]\njitter = 0.5\nturn = [0, 1, 0]\nscale = [0.5, 2]\n";
        // The seed decides the random choices
        let (one, other) = (copies(loose), copies(&format!("{loose}seed = 1")));
        assert_eq!(one.map(3), copies(loose).map(3));
        assert_ne!(one.map(3), other.map(3));
        for number in 0..6 {
            // Random choices stay within their limits
            let off = one.map(number).translation - grid.map(number).translation;
            assert!(off.abs().max_element() <= 0.5);
            let scale = one.map(number).matrix3.determinant().cbrt();
            assert!((0.5..=2.0).contains(&scale), "{scale}");
        }
    }
}
