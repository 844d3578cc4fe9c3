//! Reflection and refraction of packets of sixteen rays, without branches.
//!
//! The arithmetic equals that for one ray, lane by lane, hence the bits are equal. Call it from functions that are
//! compiled for several instruction sets, where the loop becomes one over vectors.

use glam::DVec3;

use super::dielectric_interface::{DielectricInterface, face_forward};
use super::snell::reflect;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Reflection and refraction of sixteen rays at the boundary of two dielectrics.
#[derive(Clone, Copy, Debug)]
pub struct DielectricLanes {
    /// Mirrored directions of travel.
    pub reflected: Lanes3<f64>,
    /// Refracted directions of travel; the mirrored one where `total`, so that every lane holds a direction.
    pub refracted: Lanes3<f64>,
    /// Reflected fraction of unpolarised light.
    pub reflectance: Lanes<f64>,
    /// Transmitted fraction of unpolarised light.
    pub transmittance: Lanes<f64>,
    /// True in lanes of total internal reflection, where nothing is transmitted.
    pub total: Lanes<bool>,
}

impl DielectricLanes {
    /// No light in any lane.
    pub const NONE: DielectricLanes = DielectricLanes {
        reflected: [[0.0; LANES]; 3],
        refracted: [[0.0; LANES]; 3],
        reflectance: [0.0; LANES],
        transmittance: [0.0; LANES],
        total: [false; LANES],
    };

    /// Recomputes the lane `l`, whose ray is very near the critical angle, in higher precision. `axes` holds direction
    /// and normal by axis, followed by the two indices.
    #[cold]
    #[inline(never)]
    fn recompute_near_critical(&mut self, l: usize, axes: [(f64, f64); 3], [eta_i, eta_t]: [f64; 2]) {
        let (d, n) = (
            DVec3::from_array(axes.map(|(d, _)| d)),
            DVec3::from_array(axes.map(|(_, n)| n)),
        );
        let (cos_i, n) = face_forward(d, n);
        let interface = DielectricInterface::new(cos_i, eta_i, eta_t);
        for axis in 0..3 {
            self.refracted[axis][l] = if interface.total {
                self.reflected[axis][l]
            } else {
                interface.refract(d, n)[axis]
            };
        }
        self.reflectance[l] = interface.reflectance().mean();
        self.transmittance[l] = interface.transmittance().mean();
        self.total[l] = interface.total;
    }
}

/// Computes reflection and refraction of rays that travel along `d` and hit surfaces of normal `n`, from index `eta_i`
/// to `eta_t`.
///
/// Each lane equals the results of [`reflect`], [`refract`](super::refract) and [`dielectric`](super::dielectric) to
/// the bit.
#[inline(always)]
pub fn dielectric_lanes(
    d: &Lanes3<f64>,
    n: &Lanes3<f64>,
    eta_i: &Lanes<f64>,
    eta_t: &Lanes<f64>,
    lanes: &mut DielectricLanes,
) {
    // Reflect and refract all lanes, noting those near the critical angle
    let (mut critical, mut any_critical) = ([0u64; LANES], 0);
    for l in 0..LANES {
        let (d, n) = (
            DVec3::new(d[0][l], d[1][l], d[2][l]),
            DVec3::new(n[0][l], n[1][l], n[2][l]),
        );
        let (cos_i, n) = face_forward(d, n);
        let (interface, is_critical) = DielectricInterface::away_from_critical(cos_i, eta_i[l], eta_t[l]);
        critical[l] = u64::from(is_critical);
        any_critical |= critical[l];
        let reflected = reflect(d, n);
        let refracted = interface.refract(d, n);
        // Store the directions; lanes of total reflection keep the mirrored one
        for axis in 0..3 {
            lanes.reflected[axis][l] = reflected[axis];
            lanes.refracted[axis][l] = if interface.total {
                reflected[axis]
            } else {
                refracted[axis]
            };
        }
        lanes.reflectance[l] = interface.reflectance().mean();
        lanes.transmittance[l] = interface.transmittance().mean();
        lanes.total[l] = interface.total;
    }
    // Recompute the rare lanes near the critical angle
    if any_critical != 0 {
        for l in (0..LANES).filter(|&l| critical[l] != 0) {
            lanes.recompute_near_critical(
                l,
                [0, 1, 2].map(|axis| (d[axis][l], n[axis][l])),
                [eta_i[l], eta_t[l]],
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use multiversion::multiversion;

    use super::*;
    use crate::optics::{dielectric, refract};

    /// Compiles the packet function for the instruction sets of the machine, as the renderer's kernels do.
    #[multiversion(targets(
        "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
        "x86_64+avx2+bmi1+bmi2+fma"
    ))]
    fn vectorised(
        d: &Lanes3<f64>,
        n: &Lanes3<f64>,
        eta_i: &Lanes<f64>,
        eta_t: &Lanes<f64>,
    ) -> DielectricLanes {
        let mut lanes = DielectricLanes::NONE;
        dielectric_lanes(d, n, eta_i, eta_t, &mut lanes);
        lanes
    }

    /// Random numbers in [0, 1) from a linear congruential generator (Knuth's MMIX).
    struct LaneNumbers(u64);

    impl LaneNumbers {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 * 0.5f64.powi(53)
        }

        fn direction(&mut self) -> DVec3 {
            let v = DVec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5);
            v.try_normalize().unwrap_or(DVec3::X)
        }
    }

    #[test]
    fn every_lane_has_the_bits_of_the_single_ray() {
        let mut numbers = LaneNumbers(1);
        for _ in 0..2000 {
            let (mut d, mut n) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
            let (mut eta_i, mut eta_t) = ([0.0; LANES], [0.0; LANES]);
            // Fill a packet with random rays and indices
            for l in 0..LANES {
                let (direction, normal) = (numbers.direction(), numbers.direction());
                for axis in 0..3 {
                    (d[axis][l], n[axis][l]) = (direction[axis], normal[axis]);
                }
                (eta_i[l], eta_t[l]) = (1.0 + numbers.next(), 1.0 + numbers.next());
                if l % 4 == 0 {
                    // Every fourth lane is at the critical angle, to a rounding or two.
                    eta_t[l] = eta_i[l] * (1.0 - direction.dot(normal).powi(2)).sqrt();
                }
            }
            assert_bits_of_single_rays(&d, &n, &eta_i, &eta_t);
        }
    }

    /// Compares each lane with the functions for one ray.
    fn assert_bits_of_single_rays(d: &Lanes3<f64>, n: &Lanes3<f64>, eta_i: &Lanes<f64>, eta_t: &Lanes<f64>) {
        let lanes = vectorised(d, n, eta_i, eta_t);
        for l in 0..LANES {
            let of = |v: &Lanes3<f64>| DVec3::new(v[0][l], v[1][l], v[2][l]);
            let (d, n) = (of(d), of(n));
            let case = format!("{d} at {n} from {} to {}", eta_i[l], eta_t[l]);
            let expected = dielectric(d.dot(n).abs(), eta_i[l], eta_t[l]);
            let refraction = refract(d, n, eta_i[l], eta_t[l]);
            assert_eq!(of(&lanes.reflected), reflect(d, n), "{case}");
            assert_eq!(lanes.total[l], refraction.is_none(), "{case}");
            let onwards = refraction.map_or(reflect(d, n), |refraction| refraction.direction);
            assert_eq!(of(&lanes.refracted), onwards, "{case}");
            assert_eq!(lanes.reflectance[l], expected.reflectance.mean(), "{case}");
            assert_eq!(lanes.transmittance[l], expected.transmittance.mean(), "{case}");
        }
    }

    #[test]
    fn hard_cases_have_the_bits_of_the_single_ray() {
        // Along the normal, at an angle, beyond the critical angle of glass, grazing, and inside the boundary
        let cosines = [1.0, 0.8, 0.6, 1e-8, 0.0];
        let indices = [[1.0, 1.5], [1.5, 1.0], [1.5, 1.5], [1.0, 1.0 + f64::EPSILON]];
        let n = [[0.0; LANES], [1.0; LANES], [0.0; LANES]];
        for (cosine, [from, to]) in cosines.into_iter().flat_map(|c| indices.map(|pair| (c, pair))) {
            // Every other lane is one that no ray uses: along the normal, within one medium
            let mut d = [[0.0; LANES], [-1.0; LANES], [0.0; LANES]];
            let (mut eta_i, mut eta_t) = ([1.0; LANES], [1.0; LANES]);
            for l in (0..LANES).step_by(2) {
                (d[0][l], d[1][l]) = ((1.0f64 - cosine * cosine).sqrt(), -cosine);
                (eta_i[l], eta_t[l]) = (from, to);
            }
            assert_bits_of_single_rays(&d, &n, &eta_i, &eta_t);
        }
    }

    #[test]
    fn a_lane_that_is_not_a_number_is_never_refracted_and_disturbs_no_other() {
        let (mut d, n) = (
            [[0.0; LANES], [-1.0; LANES], [0.0; LANES]],
            [[0.0; LANES], [1.0; LANES], [0.0; LANES]],
        );
        d[1][3] = f64::NAN;
        let lanes = vectorised(&d, &n, &[1.0; LANES], &[1.5; LANES]);
        for l in 0..LANES {
            assert_eq!(lanes.total[l], l == 3);
            assert!(l == 3 || (lanes.reflectance[l] - 0.04).abs() <= f64::EPSILON);
        }
    }
}
