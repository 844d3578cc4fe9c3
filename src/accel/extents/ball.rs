//! Enclosing balls of points: around the centroid, and the smallest one.
//!
//! The smallest ball is found by pivoting (Gärtner, "Fast and robust smallest enclosing balls", ESA 1999): the ball of
//! a few points is replaced by that of these and the farthest point outside it, until none is outside. Its radius grows
//! with every step, so no set of points repeats. The ball of five points is the best of those around one to four of
//! them (Welzl 1991: the smallest ball is determined by at most four points on it), each grown until it contains all
//! five: so no tolerance decides anything. If rounding ends the search early, the ball then grows to its farthest
//! point.

use glam::{DMat3, DVec3};

/// A ball that contains the points it was made for, up to a few roundings of 2^-53 of the coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingSphere {
    /// Centre of the ball.
    pub center: DVec3,
    /// Radius of the ball.
    pub radius: f64,
}

/// Maximum number of pivot steps: about ten are needed, regardless of the number of points.
const MAX_STEPS: usize = 64;
/// Growth of the radius under which the search ends: a few roundings.
const MIN_GROWTH: f64 = 1.0 + 16.0 * f64::EPSILON;

impl BoundingSphere {
    /// Returns the ball around the mean of the points that reaches the farthest one; for no points it is empty, at the
    /// origin.
    pub fn of_centroid(points: &[DVec3]) -> BoundingSphere {
        let Some(&first) = points.first() else {
            return BoundingSphere {
                center: DVec3::ZERO,
                radius: 0.0,
            };
        };
        // Relative to a point, so that a small object far away loses no digits.
        let sum: DVec3 = points.iter().map(|&p| p - first).sum();
        BoundingSphere::around(first + sum / points.len() as f64, points)
    }

    /// Returns the smallest ball around the points.
    pub fn smallest(points: &[DVec3]) -> BoundingSphere {
        let mut best = BoundingSphere::of_centroid(points);
        let Some(&first) = points.first() else {
            return best;
        };
        let mut support = vec![first];
        let mut ball = BoundingSphere {
            center: first,
            radius: 0.0,
        };
        // Pivot on the farthest point until none is outside
        for _ in 0..MAX_STEPS {
            let farthest = farthest(ball.center, points);
            let distance = farthest.distance(ball.center);
            // Keep the best ball that reaches all points
            if distance < best.radius {
                best = BoundingSphere {
                    radius: distance,
                    ..ball
                };
            }
            if distance <= ball.radius * MIN_GROWTH {
                break;
            }
            // Replace the support by the points that determine the new ball
            support.push(farthest);
            let (next, kept) = smallest_of_few(&support);
            if next.radius <= ball.radius {
                break;
            }
            (ball, support) = (next, kept);
        }
        best
    }

    /// Returns the ball around `center` that just contains the points.
    fn around(center: DVec3, points: &[DVec3]) -> BoundingSphere {
        BoundingSphere {
            center,
            radius: farthest(center, points).distance(center),
        }
    }
}

/// Returns the point farthest from `center`; `points` is not empty.
fn farthest(center: DVec3, points: &[DVec3]) -> DVec3 {
    let (mut found, mut most) = (center, -1.0);
    for &p in points {
        let distance = p.distance_squared(center);
        if distance > most {
            (found, most) = (p, distance);
        }
    }
    found
}

/// Returns the smallest ball around at most five points, and the points that determine it.
fn smallest_of_few(points: &[DVec3]) -> (BoundingSphere, Vec<DVec3>) {
    let mut best = (
        BoundingSphere {
            center: points[0],
            radius: f64::INFINITY,
        },
        points.to_vec(),
    );
    for subset in 1u32..1 << points.len() {
        if subset.count_ones() > 4 {
            continue;
        }
        let chosen: Vec<DVec3> = (0..points.len())
            .filter(|i| subset >> i & 1 != 0)
            .map(|i| points[i])
            .collect();
        let Some(center) = circumcenter(&chosen) else {
            continue;
        };
        let ball = BoundingSphere::around(center, points);
        if ball.radius < best.0.radius {
            best = (ball, chosen);
        }
    }
    best
}

/// Returns the point at equal distance from one to four points, in the affine subspace that they span; `None` if they
/// are degenerate.
fn circumcenter(points: &[DVec3]) -> Option<DVec3> {
    let (&first, rest) = points.split_first()?;
    let edge = |i: usize| rest[i] - first;
    let half = |v: DVec3| 0.5 * v.length_squared();
    let offset = match rest.len() {
        0 => DVec3::ZERO,
        1 => 0.5 * edge(0),
        // The normal of the triangle completes the equations.
        2 => solve(
            [edge(0), edge(1), edge(0).cross(edge(1))],
            [half(edge(0)), half(edge(1)), 0.0],
        )?,
        _ => solve(
            [edge(0), edge(1), edge(2)],
            [half(edge(0)), half(edge(1)), half(edge(2))],
        )?,
    };
    Some(first + offset)
}

/// Solves `rows[i] · x = right[i]` for x; `None` if it is not finite.
fn solve(rows: [DVec3; 3], right: [f64; 3]) -> Option<DVec3> {
    let matrix = DMat3::from_cols(rows[0], rows[1], rows[2]);
    let x = (right[0] * rows[1].cross(rows[2])
        + right[1] * rows[2].cross(rows[0])
        + right[2] * rows[0].cross(rows[1]))
        / matrix.determinant();
    x.is_finite().then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Linear congruential generator of numbers in [0, 1).
    struct Random(u64);

    impl Random {
        fn unit(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn points(&mut self, count: usize) -> Vec<DVec3> {
            (0..count)
                .map(|_| DVec3::new(self.unit(), 2.0 * self.unit(), 0.1 * self.unit()) + DVec3::splat(3.0))
                .collect()
        }
    }

    /// Returns the least radius of all balls through one to four of the points.
    fn exhaustive(points: &[DVec3]) -> f64 {
        let mut least = f64::INFINITY;
        for subset in (1u32..1 << points.len()).filter(|s| s.count_ones() <= 4) {
            let chosen: Vec<DVec3> = (0..points.len())
                .filter(|i| subset >> i & 1 != 0)
                .map(|i| points[i])
                .collect();
            if let Some(center) = circumcenter(&chosen) {
                least = least.min(BoundingSphere::around(center, points).radius);
            }
        }
        least
    }

    #[test]
    fn smallest_bounding_sphere_equals_exhaustive_search() {
        let seed = 11;
        let mut random = Random(seed);
        for round in 0..300 {
            let points = random.points(1 + round % 10);
            let (found, least) = (BoundingSphere::smallest(&points), exhaustive(&points));
            // Coordinates of 5 are rounded by 2^-51, and flat triples magnify that; growing to the farthest point
            // bounds the error.
            assert!(
                found.radius <= least * (1.0 + 1e-9) && found.radius >= least * (1.0 - 1e-9),
                "seed {seed}, round {round}: {} not {least}",
                found.radius
            );
        }
    }

    #[test]
    fn smallest_sphere_contains_all_points_and_is_within_centroid_sphere() {
        let seed = 12;
        let mut random = Random(seed);
        for count in [1, 2, 3, 50, 2000] {
            let points = random.points(count);
            let (tight, centroid) = (
                BoundingSphere::smallest(&points),
                BoundingSphere::of_centroid(&points),
            );
            assert!(tight.radius <= centroid.radius, "seed {seed}");
            for ball in [tight, centroid] {
                for p in &points {
                    // These are the very distances whose maximum is the radius.
                    assert!(p.distance(ball.center) <= ball.radius, "seed {seed}");
                }
            }
        }
    }

    #[test]
    fn degenerate_point_sets_have_a_bounding_sphere() {
        let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
        let cube: Vec<DVec3> = (0..8).map(corner).collect();
        assert!((BoundingSphere::smallest(&cube).radius - 0.75f64.sqrt()).abs() < 1e-15);
        assert_eq!(BoundingSphere::smallest(&[DVec3::ONE; 7]).radius, 0.0);
        let line: Vec<DVec3> = (0..9).map(|i| f64::from(i) * DVec3::X).collect();
        assert_eq!(
            BoundingSphere::smallest(&line),
            BoundingSphere {
                center: 4.0 * DVec3::X,
                radius: 4.0
            }
        );
        assert_eq!(BoundingSphere::smallest(&[]).radius, 0.0);
    }

    #[test]
    fn obtuse_triangle_has_bounding_sphere_of_its_longest_side() {
        let ball =
            BoundingSphere::smallest(&[DVec3::ZERO, DVec3::new(10.0, 0.0, 0.0), DVec3::new(4.0, 1.0, 0.0)]);
        assert!((ball.radius - 5.0).abs() < 1e-14);
        // The centroid is at 14/3, and 16/3 from the far end, a third of a unit higher: √(16² + 1) / 3.
        let around_centroid = BoundingSphere::of_centroid(&[
            DVec3::ZERO,
            DVec3::new(10.0, 0.0, 0.0),
            DVec3::new(4.0, 1.0, 0.0),
        ]);
        assert!((around_centroid.radius - 257f64.sqrt() / 3.0).abs() < 1e-14);
    }
}
