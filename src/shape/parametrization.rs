//! Angles, tangent frames and shifted origins that several shapes use.

use std::f64::consts::TAU;

use glam::DVec3;

/// Returns the angle around the z axis from +x towards +y, as a fraction of the full circle in [0, 1]; 0 on the axis.
#[inline]
pub(super) fn unit_angle(x: f64, y: f64) -> f64 {
    if x == 0.0 && y == 0.0 {
        return 0.0;
    }
    let unit_angle = y.atan2(x) / TAU;
    if unit_angle < 0.0 {
        unit_angle + 1.0
    } else {
        unit_angle
    }
}

/// Returns the distance from the z axis and the unit vector (x, y) away from the axis, which is (1, 0) on the axis.
#[inline]
pub(super) fn polar(p: DVec3) -> (f64, f64, f64) {
    let rho = p.x.hypot(p.y);
    if rho == 0.0 {
        (0.0, 1.0, 0.0)
    } else {
        (rho, p.x / rho, p.y / rho)
    }
}

/// Returns the parameter of the line's point nearest to the origin, and that point. Computations that start from it are
/// independent of the distance of the ray's origin: only the point itself carries an error, of a few roundings of
/// `|o|`.
#[inline(always)]
pub(super) fn nearest_to_origin(o: DVec3, d: DVec3) -> (f64, DVec3) {
    let shift = -o.dot(d) / d.length_squared();
    (shift, o + shift * d)
}

/// Returns two unit tangents that form a right-handed frame with the unit vector `n` (Duff et al., "Building an
/// Orthonormal Basis, Revisited", JCGT 6(1), 2017).
#[inline]
pub(crate) fn tangents(n: DVec3) -> [DVec3; 2] {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    [
        DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        DVec3::new(b, sign + n.y * n.y * a, -n.y),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tangents_are_right_handed_for_every_octant_and_both_poles() {
        for n in [
            DVec3::Z,
            -DVec3::Z,
            DVec3::X,
            -DVec3::Y,
            DVec3::new(0.6, 0.0, -0.8),
            DVec3::new(1.0, -2.0, -2.0) / 3.0,
        ] {
            let [s, t] = tangents(n);
            assert!((s.cross(t) - n).abs().max_element() <= 4.0 * f64::EPSILON, "{n}");
        }
    }

    #[test]
    fn azimuth_starts_at_x_towards_y() {
        assert_eq!(unit_angle(1.0, 0.0), 0.0);
        assert_eq!(unit_angle(0.0, 2.0), 0.25);
        assert_eq!(unit_angle(-1.0, 0.0), 0.5);
        assert_eq!(unit_angle(0.0, -1.0), 0.75);
        assert_eq!(unit_angle(-0.0, 0.0), 0.0);
    }
}
