//! Animated affine maps: interpolation over the shutter interval, and bounds of moving objects.
//!
//! A map is decomposed into a translation, a rotation and a symmetric stretch, M = Q S, by the polar decomposition (K.
//! Shoemake, T. Duff, "Matrix Animation and Polar Decomposition", Graphics Interface 1992). It does not depend on the
//! coordinate system, and Q is the rotation nearest to M. The parts are interpolated separately: translation and
//! stretch linearly, the rotation at constant speed along the shorter arc. A mirroring map has S negative definite.
//! Because definite matrices of one sign have only such matrices between them, the interpolated map is invertible at
//! every time between two invertible maps.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::{Bounds, SingularMatrix, inverse};

/// Reason why there is no motion from one map to another.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionError {
    /// Start or end that cannot be inverted.
    #[error(transparent)]
    Singular(#[from] SingularMatrix),
    /// Start or end that mirrors while the other does not, so that a map in between would be singular.
    #[error("one end of the motion mirrors the object and the other does not: mirror both or neither")]
    Mirrored,
}

/// Affine map as a function of the time s, which runs from 0 where the shutter opens to 1 where it closes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnimatedTransform {
    start: DAffine3,
    end: DAffine3,
    /// Decomposition of the linear parts; `None` if they are equal at both ends.
    decomposed: Option<DecomposedRotation>,
}

/// Rotation at the start, the relative rotation to the end, and the stretch at both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
struct DecomposedRotation {
    rotation: DQuat,
    /// Unit axis of the relative rotation, whose angle in radians is within [0, π].
    axis: DVec3,
    angle: f64,
    stretch: [DMat3; 2],
}

impl AnimatedTransform {
    /// Creates the motion from `start` to `end`, both of which must be invertible.
    pub fn new(start: DAffine3, end: DAffine3) -> Result<AnimatedTransform, MotionError> {
        inverse(&start)?;
        inverse(&end)?;
        let decomposed = (start.matrix3 != end.matrix3)
            .then(|| DecomposedRotation::new(start.matrix3, end.matrix3))
            .transpose()?;
        Ok(AnimatedTransform {
            start,
            end,
            decomposed,
        })
    }

    /// Returns whether start and end are equal.
    pub fn is_still(&self) -> bool {
        self.start == self.end
    }

    /// Returns the maps at the start and the end.
    pub fn ends(&self) -> [DAffine3; 2] {
        [self.start, self.end]
    }

    /// Returns the map at time `s`; at 0 and 1, and beyond them, bit-identical to the ends.
    pub fn at(&self, s: f64) -> DAffine3 {
        if s <= 0.0 || self.is_still() {
            return self.start;
        }
        if s >= 1.0 {
            return self.end;
        }
        // Interpolate rotation and stretch, and the translation
        DAffine3 {
            matrix3: self
                .decomposed
                .as_ref()
                .map_or(self.start.matrix3, |decomposed| decomposed.at(s)),
            translation: (1.0 - s) * self.start.translation + s * self.end.translation,
        }
    }

    /// Returns a box in the target space that contains all of `bounds` at all times.
    pub fn bounds(&self, bounds: &Bounds) -> Bounds {
        self.bounds_of(bounds, |map| bounds.transformed(map))
    }

    /// Returns a box in the target space that contains the object within `bounds` at all times; `boxed` returns a box
    /// of the object under a map.
    pub fn bounds_of(&self, bounds: &Bounds, boxed: impl Fn(&DAffine3) -> Bounds) -> Bounds {
        let steps = self.step_count();
        (0..=steps)
            .map(|step| self.step_bounds(bounds, [step, steps], &boxed))
            .fold(Bounds::EMPTY, Bounds::union)
    }

    /// Returns the number of steps at which [`AnimatedTransform::bounds`] takes the boxes.
    pub(crate) fn step_count(&self) -> u32 {
        if self.decomposed.is_some() {
            ROTATION_STEPS
        } else {
            1
        }
    }

    /// Returns a box after `step` of `steps` equal steps such that linear interpolation between it and that of the next
    /// step contains the object within `bounds` at every time; `boxed` as in [`AnimatedTransform::bounds_of`].
    ///
    /// A point p moves along x(s) = Q(s) y(s) + T(s) with y(s) = S(s) p, where T and y are linear. As Q rotates at the
    /// rate ω, |x''| <= ω² |y| + 2 ω |y'|, and over a step δ no curve deviates from its chord by more than δ²/8 of
    /// that. The chord lies within the interpolated boxes, as its ends lie within the boxes at both ends of the step,
    /// and so the curve lies within them if they are padded by that deviation.
    pub fn step_bounds(
        &self,
        bounds: &Bounds,
        [step, steps]: [u32; 2],
        boxed: impl Fn(&DAffine3) -> Bounds,
    ) -> Bounds {
        if bounds.is_empty() {
            return Bounds::EMPTY;
        }
        if !(bounds.min.is_finite() && bounds.max.is_finite()) {
            return EVERYWHERE;
        }
        // Bound the object exactly at the time of the step
        let exact = boxed(&self.at(f64::from(step) / f64::from(steps)));
        if self.is_still() {
            return exact;
        }
        // Pad the box by the curve's deviation from its chord, and by rounding
        let radius = bounds.min.abs().max(bounds.max.abs()).length();
        let sag = self.decomposed.as_ref().map_or(0.0, |decomposed| {
            let step = f64::from(steps).recip();
            step * step / 8.0 * decomposed.acceleration(radius)
        });
        let pad = DVec3::splat(sag + self.rounding(radius));
        Bounds {
            min: exact.min - pad,
            max: exact.max + pad,
        }
    }

    /// Returns a bound on the rounding error of a point moved by [`AnimatedTransform::at`], for points up to `radius`
    /// from the origin.
    fn rounding(&self, radius: f64) -> f64 {
        let reach = |map: &DAffine3| frobenius(&map.matrix3) * radius + map.translation.abs().max_element();
        MOTION_ROUNDINGS * f64::EPSILON * (reach(&self.start) + reach(&self.end))
    }
}

/// Box of an unbounded object under any motion.
const EVERYWHERE: Bounds = Bounds {
    min: DVec3::NEG_INFINITY,
    max: DVec3::INFINITY,
};

/// Number of steps for the bounds of a rotating motion: for a half turn the deviation is (π/16)²/8 < 0.5 % of the
/// radius.
const ROTATION_STEPS: u32 = 16;

/// Number of roundings, with a margin, between the parts of a map and a coordinate of a moved point: decomposition 16,
/// quaternion to matrix 8, two products of matrices 6, lerp and transform 8.
const MOTION_ROUNDINGS: f64 = 64.0;

impl DecomposedRotation {
    fn new(start: DMat3, end: DMat3) -> Result<DecomposedRotation, MotionError> {
        // Decompose both ends
        let [(from, stretch_from), (to, stretch_to)] = [start, end].map(|m| polar(&m));
        // The sign of a definite matrix is that of its diagonal.
        if stretch_from.x_axis.x.signum() != stretch_to.x_axis.x.signum() {
            return Err(MotionError::Mirrored);
        }
        // Compute the relative rotation along the shorter arc
        let rotation = DQuat::from_mat3(&from).normalize();
        let mut step = (DQuat::from_mat3(&to).normalize() * rotation.conjugate()).normalize();
        if step.w < 0.0 {
            step = -step;
        }
        // Use sine and cosine, as the arc cosine alone would lose small angles
        let sine = step.xyz().length();
        Ok(DecomposedRotation {
            rotation,
            axis: step.xyz().try_normalize().unwrap_or(DVec3::Z),
            angle: 2.0 * sine.atan2(step.w),
            stretch: [stretch_from, stretch_to],
        })
    }

    fn at(&self, s: f64) -> DMat3 {
        let rotation = DQuat::from_axis_angle(self.axis, s * self.angle) * self.rotation;
        DMat3::from_quat(rotation.normalize()) * (self.stretch[0] * (1.0 - s) + self.stretch[1] * s)
    }

    /// Returns a bound on |x''| of points up to `radius` from the origin; the Frobenius norm bounds the factor by which
    /// a matrix lengthens a vector.
    fn acceleration(&self, radius: f64) -> f64 {
        let [from, to] = &self.stretch;
        let reach = frobenius(from).max(frobenius(to)) * radius;
        let speed = frobenius(&(*to - *from)) * radius;
        self.angle * (self.angle * reach + 2.0 * speed)
    }
}

fn frobenius(m: &DMat3) -> f64 {
    (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt()
}

/// Returns rotation and symmetric stretch whose product is `m`, which must be invertible.
///
/// Uses Newton's iteration X ← (γ X + X⁻ᵀ / γ) / 2 (N. Higham, "Computing the polar decomposition", SIAM J. Sci. Stat.
/// Comput. 7(4), 1986), with γ² = |X⁻¹| / |X| so that it converges within a dozen steps for every condition number that
/// [`inverse`] accepts, quadratically at the end.
fn polar(m: &DMat3) -> (DMat3, DMat3) {
    /// Limit on the iterations: the scaled iteration needs 9 steps for a condition number of 10^16 (Higham, section 4).
    const MAX_STEPS: u32 = 20;
    // Scale the largest entry to 1
    let largest = m.to_cols_array().iter().fold(0.0f64, |a, &x| a.max(x.abs()));
    let mut x = *m * largest.recip();
    // Iterate to the nearest orthogonal matrix
    for _ in 0..MAX_STEPS {
        let inverse_transpose = x.inverse().transpose();
        let gamma = (frobenius(&inverse_transpose) / frobenius(&x)).sqrt();
        let next = (x * gamma + inverse_transpose * gamma.recip()) * 0.5;
        let change = frobenius(&(next - x));
        x = next;
        // The next step would change it by the square of this change.
        if change < 1e-9 {
            break;
        }
    }
    // Move the sign of a mirroring map into the stretch
    if x.determinant() < 0.0 {
        x *= -1.0;
    }
    let stretch = x.transpose() * *m;
    (x, (stretch + stretch.transpose()) * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns two maps with a relative rotation by 2.4 about a skew axis, with stretch, shear and translation.
    fn general_motion() -> (DAffine3, DAffine3) {
        let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.7, 1.0, 0.0), DVec3::new(0.0, -0.2, 1.0));
        let start = DAffine3::from_translation(DVec3::new(1.0, 2.0, -3.0))
            * DAffine3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.4)
            * DAffine3::from_scale(DVec3::new(1.0, 3.0, 0.5));
        let end = DAffine3::from_translation(DVec3::new(-4.0, 0.0, 1.0))
            * DAffine3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.8)
            * DAffine3::from_mat3(shear)
            * DAffine3::from_scale(DVec3::new(2.0, 1.0, 0.25));
        (start, end)
    }

    fn mirrored((start, end): (DAffine3, DAffine3)) -> (DAffine3, DAffine3) {
        let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        (start * mirror, end * mirror)
    }

    #[test]
    fn motion_ends_are_exact() {
        for (start, end) in [general_motion(), mirrored(general_motion())] {
            let motion = AnimatedTransform::new(start, end).unwrap();
            assert_eq!((motion.at(0.0), motion.at(1.0)), (start, end));
            assert_eq!((motion.at(-1.0), motion.at(2.0)), (start, end));
            // No jump: entries are about 10, and the time step to the ends is 1e-12.
            assert!(motion.at(1e-12).abs_diff_eq(start, 1e-10));
            assert!(motion.at(1.0 - 1e-12).abs_diff_eq(end, 1e-10));
        }
    }

    #[test]
    fn rotation_has_constant_speed_and_takes_the_short_arc() {
        let turned = |degrees: f64| DAffine3::from_rotation_y(degrees.to_radians());
        for (from, to, middle) in [
            (0.0, 120.0, 60.0),
            (-30.0, 30.0, 0.0),
            (170.0, -170.0, 180.0),
            (0.0, 1e-6, 5e-7),
        ] {
            let motion = AnimatedTransform::new(turned(from), turned(to)).unwrap();
            assert!(
                motion.at(0.5).abs_diff_eq(turned(middle), 16.0 * f64::EPSILON),
                "{from} {to}"
            );
        }
        let third = AnimatedTransform::new(turned(0.0), turned(90.0))
            .unwrap()
            .at(1.0 / 3.0);
        assert!(third.abs_diff_eq(turned(30.0), 16.0 * f64::EPSILON));
    }

    #[test]
    fn translation_and_scale_alone_are_linear() {
        let still = DAffine3::from_scale_rotation_translation(
            DVec3::new(1.0, 2.0, 3.0),
            DQuat::from_rotation_x(0.1),
            DVec3::ONE,
        );
        let moved = DAffine3 {
            translation: DVec3::new(5.0, 1.0, -1.0),
            ..still
        };
        let middle = AnimatedTransform::new(still, moved).unwrap().at(0.5);
        assert_eq!(
            (middle.matrix3, middle.translation),
            (still.matrix3, DVec3::new(3.0, 1.0, 0.0))
        );
        let grown = AnimatedTransform::new(
            DAffine3::IDENTITY,
            DAffine3::from_scale(DVec3::new(3.0, 1.0, 5.0)),
        )
        .unwrap();
        assert!(grown.at(0.5).abs_diff_eq(
            DAffine3::from_scale(DVec3::new(2.0, 1.0, 3.0)),
            16.0 * f64::EPSILON
        ));
        assert!(!grown.is_still() && AnimatedTransform::new(still, still).unwrap().is_still());
    }

    #[test]
    fn interpolated_maps_keep_their_orientation_and_stay_invertible() {
        for (pair, sign) in [(general_motion(), 1.0), (mirrored(general_motion()), -1.0)] {
            let motion = AnimatedTransform::new(pair.0, pair.1).unwrap();
            for step in 0..=100 {
                let map = motion.at(f64::from(step) / 100.0);
                assert!(map.matrix3.determinant() * sign > 0.1, "{step}");
                assert!(inverse(&map).is_ok());
            }
        }
        // Test tiny maps too, whose determinants underflow
        for size in [1.0, 1e-150] {
            let flip = DAffine3::from_scale(size * DVec3::new(1.0, -1.0, 1.0));
            let plain = DAffine3::from_scale(DVec3::splat(size));
            assert_eq!(AnimatedTransform::new(plain, flip), Err(MotionError::Mirrored));
        }
        let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
        assert!(matches!(
            AnimatedTransform::new(DAffine3::IDENTITY, flat),
            Err(MotionError::Singular(_))
        ));
    }

    #[test]
    fn polar_factors_multiply_back_for_extreme_maps() {
        for scale in [
            DVec3::ONE,
            DVec3::new(1e6, 1.0, 1e-4),
            DVec3::splat(1e-60),
            DVec3::new(-1e50, 1e49, 1e50),
        ] {
            let m = DMat3::from_rotation_x(1.1) * DMat3::from_diagonal(scale) * DMat3::from_rotation_z(0.3);
            let (rotation, stretch) = polar(&m);
            assert!((rotation.transpose() * rotation).abs_diff_eq(DMat3::IDENTITY, 32.0 * f64::EPSILON));
            assert!((rotation.determinant() - 1.0).abs() < 32.0 * f64::EPSILON);
            let error = frobenius(&(rotation * stretch - m)) / frobenius(&m);
            assert!(error < 64.0 * f64::EPSILON, "{scale}: {error}");
        }
    }

    #[test]
    fn swept_bounds_are_conservative_and_tight() {
        let object = Bounds {
            min: DVec3::new(-1.0, -2.0, 0.5),
            max: DVec3::new(1.5, 0.0, 3.0),
        };
        let half_turn = (DAffine3::IDENTITY, DAffine3::from_rotation_z(3.1));
        let slide = (
            DAffine3::IDENTITY,
            DAffine3::from_translation(DVec3::new(0.0, 7.0, 0.1)),
        );
        for (start, end) in [general_motion(), mirrored(general_motion()), half_turn, slide] {
            let motion = AnimatedTransform::new(start, end).unwrap();
            let swept = motion.bounds(&object);
            let mut exact = Bounds::EMPTY;
            // Sample the motion densely, and compare the boxes
            for step in 0..=10_007 {
                exact = exact.union(object.transformed(&motion.at(f64::from(step) / 10_007.0)));
            }
            assert!(swept.min.cmple(exact.min).all() && swept.max.cmpge(exact.max).all());
            let excess = (exact.min - swept.min).max(swept.max - exact.max).max_element();
            assert!(
                excess < 0.05 * exact.extent().max_element(),
                "{excess} of {}",
                exact.extent()
            );
        }
    }

    #[test]
    fn swept_bounds_handle_still_empty_and_infinite_boxes() {
        let (start, _) = general_motion();
        let still = AnimatedTransform::new(start, start).unwrap();
        let unit = Bounds {
            min: DVec3::ZERO,
            max: DVec3::ONE,
        };
        assert_eq!(still.bounds(&unit), unit.transformed(&start));
        assert!(still.bounds(&Bounds::EMPTY).is_empty());
        let plane = Bounds {
            min: DVec3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, 0.0),
            max: DVec3::new(f64::INFINITY, f64::INFINITY, 0.0),
        };
        assert_eq!(
            AnimatedTransform::new(start, general_motion().1)
                .unwrap()
                .bounds(&plane),
            EVERYWHERE
        );
    }
}
