//! Fresnel's equations for the smooth boundary of two dielectrics.
//!
//! All differences are taken in double-double precision, as they cancel: at the critical angle, at grazing incidence,
//! at Brewster's angle, and for indices that nearly match (see `dielectric_interface`). Transmittance is computed
//! directly, not as one minus the reflectance, which would lose its digits where it is small.

use super::dielectric_interface::DielectricInterface;
use super::polarised::Polarised;

/// Reflectance and transmittance at the boundary of two dielectrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fresnel {
    /// Reflected over incident power; exactly 1 for total reflection.
    pub reflectance: Polarised,
    /// Transmitted over incident power; exactly 0 for total reflection.
    pub transmittance: Polarised,
    /// Cosine of the refracted ray with the normal; 0 for total reflection.
    pub cos_t: f64,
}

/// Evaluates Fresnel's equations for light that comes from a medium of index `eta_i` and hits one of index `eta_t`.
///
/// `cos_i` is the cosine of the ray with the normal on its own side, within [0, 1]; a rounded excess is clamped. Light
/// that runs inside the boundary (`cos_i` = 0) is reflected completely. Indices are positive and finite. Reflectances
/// and transmittances are within 8 units in the last place of the exact ones, `cos_t` within 4, and within 2 where it
/// is more than some roundings from the critical angle.
#[inline(always)]
pub fn dielectric(cos_i: f64, eta_i: f64, eta_t: f64) -> Fresnel {
    let interface = DielectricInterface::new(cos_i, eta_i, eta_t);
    Fresnel {
        reflectance: interface.reflectance(),
        transmittance: interface.transmittance(),
        cos_t: interface.cos_t(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference values cos_i, eta_i, eta_t, reflectance s and p, transmittance s and p, cos_t, computed from exactly
    /// these numbers with 60 digits. They cover grazing incidence, indices that nearly match, angles down to a rounding
    /// error from the critical one, and the textbook's air to glass.
    #[rustfmt::skip]
    const EXACT: [[f64; 8]; 34] = [
        [0.1, 1.0, 1.5, 0.6995657051236168, 0.4436193355612815, 0.3004342948763832, 0.5563806644387185, 0.7483314773547883],
        [0.001, 1.0, 1.5, 0.9964286840857008, 0.9919824609313017, 0.003571315914299195, 0.008017539068698253, 0.7453562906422673],
        [1e-06, 1.0, 1.5, 0.999996422297636, 0.999991950187681, 3.5777023640068188e-06, 8.049812319093828e-06, 0.745355992500228],
        [1e-09, 1.0, 1.5, 0.9999999964222912, 0.9999999919501553, 3.5777087575996636e-09, 8.049844686599243e-09, 0.7453559924999299],
        [1e-12, 1.0, 1.5, 0.9999999999964223, 0.9999999999919501, 3.5777087639932636e-12, 8.049844718966843e-12, 0.7453559924999299],
        [0.001, 1.5, 1.5000001, 0.000978474580363766, 0.0009784704137055197, 0.9990215254196362, 0.9990215295862945, 0.0010645812259966498],
        [1e-09, 1.5, 1.5000001, 0.9999890456090355, 0.9999890456075748, 1.09543909645386e-05, 1.0954392425116112e-05, 0.00036514835352066167],
        [0.8660254037844387, 1.0, 1.001, 4.437048007927044e-07, 1.1114790478323677e-07, 0.9999995562951992, 0.9999998888520952, 0.8663135985304349],
        [0.8660254037844387, 1.0, 1.000001, 4.4444370363167664e-13, 1.111111481296229e-13, 0.9999999999995556, 0.9999999999998889, 0.8660256924590921],
        [0.0174524064372836, 1.000001, 1.0, 2.7125401443387223e-06, 2.709247196716096e-06, 0.9999972874598556, 0.9999972907528033, 0.01739503086015049],
        [0.8660254037844387, 1.0, 1.000000001, 4.444445172507029e-19, 1.1111112953489808e-19, 1.0, 1.0, 0.8660254040731139],
        [0.0174524064372836, 1.000000001, 1.0, 2.694769710870107e-12, 2.691487559850843e-12, 0.9999999999973053, 0.9999999999973085, 0.017452349155948736],
        [0.8660254037844387, 1.0, 1.000000000001, 4.445234706961458e-25, 1.1113086767425884e-25, 1.0, 1.0, 0.8660254037847274],
        [0.0174524064372836, 1.000000000001, 1.0, 2.6952307473848453e-18, 2.6919480240762143e-18, 1.0, 1.0, 0.01745240637999727],
        [0.8081879282502527, 1.5, 1.0, 0.19571564845269085, 0.004848333091588226, 0.8042843515473092, 0.9951516669084117, 0.4686442004135226],
        [0.7460222863775203, 1.5, 1.0, 0.8444079926434479, 0.6828743830280629, 0.15559200735655213, 0.31712561697193703, 0.047284421185752504],
        [0.7453626591293286, 1.5, 1.0, 0.9832244233967391, 0.9626492567955353, 0.01677557660326085, 0.03735074320446476, 0.004728705401424792],
        [0.7453560591665929, 1.5, 1.0, 0.9983096363147608, 0.9962006983428826, 0.0016903636852392435, 0.0037993016571174036, 0.00047287080195448325],
        [0.7453559924999301, 1.5, 1.0, 0.9999999025378512, 0.9999997807101785, 9.746214884924569e-08, 2.192898215530165e-07, 2.7241500085022123e-08],
        [0.7453559924999303, 1.5, 1.0, 0.9999998620442103, 0.9999996895995, 1.3795578968283693e-07, 3.104005000229153e-07, 3.8559818112336094e-08],
        [0.8861300594730882, 2.42, 1.33, 0.24994688220806663, 0.002431796319304779, 0.7500531177919334, 0.9975682036806952, 0.5375284522611783],
        [0.8359858061221732, 2.42, 1.33, 0.8649993497171993, 0.6173861147201501, 0.13500065028280067, 0.3826138852798499, 0.05512642558104712],
        [0.835442132981192, 2.42, 1.33, 0.9855958471448573, 0.9530979919208449, 0.014404152855142694, 0.04690200807915517, 0.00551382124665142],
        [0.8354366921138688, 2.42, 1.33, 0.9985501558212395, 0.9952079501762648, 0.001449844178760443, 0.004792049823735135, 0.0005513833012197711],
        [0.8354366371551956, 2.42, 1.33, 0.9999999143309918, 0.9999997163706654, 8.56690082089574e-08, 2.836293346234383e-07, 3.25567472716498e-08],
        [0.8354366371551958, 2.42, 1.33, 0.9999998741261584, 0.9999995832622203, 1.2587384158391888e-07, 4.16737779775181e-07, 4.783576951123637e-08],
        [1.0, 1.0, 1.5, 0.04, 0.04, 0.96, 0.96, 1.0],
        [0.8660254037844387, 1.0, 1.5, 0.05779610540321308, 0.025249146548429992, 0.9422038945967869, 0.97475085345157, 0.9428090415820634],
        [std::f64::consts::FRAC_1_SQRT_2, 1.0, 1.5, 0.09201336304552439, 0.00846645897894748, 0.9079866369544756, 0.9915335410210525, 0.8819171036881969],
        [0.5000000000000001, 1.0, 1.5, 0.17657148808284046, 0.0018019375215850284, 0.8234285119171595, 0.998198062478415, 0.816496580927726],
        [0.25881904510252074, 1.0, 1.5, 0.399356027000395, 0.10676509898024437, 0.600643972999605, 0.8932349010197557, 0.7650671134272486],
        [0.08715574274765814, 1.0, 1.5, 0.7323454787108016, 0.49325381181885347, 0.2676545212891985, 0.5067461881811466, 0.747617288752562],
        [0.0174524064372836, 1.0, 1.5, 0.9394721612950072, 0.8688977382653701, 0.06052783870499274, 0.1311022617346299, 0.7454467971150522],
        [0.0017453283658982615, 1.0, 1.5, 0.9937751809095463, 0.9860485729293135, 0.006224819090453642, 0.013951427070686534, 0.7453569006921315],
    ];

    #[test]
    fn hard_cases_agree_with_sixty_digits_to_the_derived_bounds() {
        for [cos_i, eta_i, eta_t, r_s, r_p, t_s, t_p, cos_t] in EXACT {
            let found = dielectric(cos_i, eta_i, eta_t);
            // Counting roundings of u = EPSILON / 2: sums and differences are correct to 1, so is q. An amplitude has
            // 3, its square 7; t_s has 7, t_p 2 more as its sum is divided; cos_t 2.
            let check = |name, found: f64, exact: f64, roundings: f64| {
                let error = (found - exact).abs() / (0.5 * f64::EPSILON * exact);
                assert!(
                    error <= roundings,
                    "{name} off by {error} u: {cos_i} {eta_i} {eta_t}"
                );
            };
            check("r_s", found.reflectance.s, r_s, 7.0);
            check("r_p", found.reflectance.p, r_p, 7.0);
            check("t_s", found.transmittance.s, t_s, 7.0);
            check("t_p", found.transmittance.p, t_p, 9.0);
            check("cos_t", found.cos_t, cos_t, 2.0);
        }
    }

    #[test]
    fn air_to_glass_has_the_textbooks_reflectances() {
        for (degrees, s, p, mean) in [
            (0.0f64, 0.04, 0.04, 0.04),
            (30.0, 0.05779611, 0.02524915, 0.04152263),
            (45.0, 0.09201336, 0.00846646, 0.05023991),
            (56.309932, 0.14792899, 0.0, 0.07396450),
            (60.0, 0.17657149, 0.00180194, 0.08918671),
            (75.0, 0.39935603, 0.10676510, 0.25306056),
            (85.0, 0.73234548, 0.49325381, 0.61279965),
            (89.0, 0.93947216, 0.86889774, 0.90418495),
            (89.9, 0.99377518, 0.98604857, 0.98991188),
        ] {
            let found = dielectric(degrees.to_radians().cos(), 1.0, 1.5).reflectance;
            // Printed to eight decimals; the sixth decimal of Brewster's angle changes s by 1e-8.
            for (found, printed) in [(found.s, s), (found.p, p), (found.mean(), mean)] {
                assert!(
                    (found - printed).abs() < 1e-8,
                    "{degrees}: {found}, not {printed}"
                );
            }
        }
    }

    #[test]
    fn glass_to_air_has_the_textbooks_reflectances() {
        for (degrees, mean) in [
            (30.0f64, 0.05519017),
            (40.0, 0.24529120),
            (41.0, 0.37975127),
            (41.8, 0.89077192),
        ] {
            let found = dielectric(degrees.to_radians().cos(), 1.5, 1.0)
                .reflectance
                .mean();
            assert!((found - mean).abs() < 1e-8, "{degrees}: {found}");
        }
    }

    #[test]
    fn water_and_diamond_have_normal_reflectance_of_their_index() {
        assert!((dielectric(1.0, 1.0, 1.33).reflectance.mean() - 0.02005931).abs() < 5e-9);
        assert!((dielectric(1.0, 1.0, 2.42).reflectance.mean() - 0.17239492).abs() < 5e-9);
    }

    #[test]
    fn what_is_not_reflected_is_transmitted() {
        for (eta_i, eta_t) in [
            (1.0, 1.5),
            (1.5, 1.0),
            (2.42, 1.0),
            (1.33, 1.331),
            (1.0, 1.0),
            (1.0, 2.42),
        ] {
            // Test evenly spaced cosines, grazing ones, and those near the critical angle
            let critical = ((1.0f64 - eta_t / eta_i) * (1.0 + eta_t / eta_i)).max(0.0).sqrt();
            let near_critical =
                (0..60).flat_map(|k| [1.0, -1.0].map(|side| critical + side * 0.5f64.powi(k)));
            let grazing = (0..100).map(|k| 0.5f64.powi(k));
            let even = (0..=1000).map(|k| f64::from(k) / 1000.0);
            for cos_i in even
                .chain(grazing)
                .chain(near_critical)
                .filter(|c| (0.0..=1.0).contains(c))
            {
                // Check that reflectance and transmittance sum to 1
                let Fresnel {
                    reflectance: r,
                    transmittance: t,
                    ..
                } = dielectric(cos_i, eta_i, eta_t);
                // 7 roundings of each fraction and one of the sum: 4 EPSILON; two more in p: 5 EPSILON.
                assert!(
                    (r.s + t.s - 1.0).abs() <= 4.0 * f64::EPSILON,
                    "{eta_i} {eta_t} {cos_i}"
                );
                assert!(
                    (r.p + t.p - 1.0).abs() <= 5.0 * f64::EPSILON,
                    "{eta_i} {eta_t} {cos_i}"
                );
                assert!(
                    (r.mean() + t.mean() - 1.0).abs() <= 4.0 * f64::EPSILON,
                    "{eta_i} {eta_t} {cos_i}"
                );
            }
        }
    }

    #[test]
    fn transmittance_is_equal_from_either_side() {
        for step in 1..=1000 {
            let there = dielectric(f64::from(step) / 1000.0, 1.0, 1.5);
            let back = dielectric(there.cos_t, 1.5, 1.0);
            // cos_t is off by 3 u at most; on the way back cos_i is off by 2.25 cos_t / cos_i times that, and no
            // reflectance changes faster than by 4 / cos_t per unit of the cosine that it starts from.
            let bound = (10.0 + 2.25 * 3.0 * 4.0 / there.cos_t * 1000.0 / f64::from(step)) * f64::EPSILON;
            assert!(
                (there.transmittance.mean() - back.transmittance.mean()).abs() <= bound,
                "{step}"
            );
            assert!(
                (there.reflectance.mean() - back.reflectance.mean()).abs() <= bound,
                "{step}"
            );
        }
    }

    #[test]
    fn total_reflection_begins_at_the_right_bit() {
        // Largest cosines at which eta_i² (1 - cos²) >= eta_t² holds exactly, from 60 digits.
        for (eta_i, eta_t, last) in [
            (1.5, 1.0, 0.7453559924999299f64),
            (2.42, 1.33, 0.8354366371551953),
        ] {
            let total = dielectric(last, eta_i, eta_t);
            assert_eq!(total.reflectance, Polarised { s: 1.0, p: 1.0 });
            assert_eq!(total.transmittance, Polarised { s: 0.0, p: 0.0 });
            assert_eq!(total.cos_t, 0.0);
            assert!(dielectric(last.next_up(), eta_i, eta_t).transmittance.mean() > 0.0);
        }
    }

    #[test]
    fn equal_media_transmit_all_light_except_along_the_boundary() {
        for cos_i in [1.0, 0.3, 1e-12] {
            let found = dielectric(cos_i, 1.33, 1.33);
            assert_eq!(found.reflectance.mean(), 0.0);
            assert!((found.transmittance.mean() - 1.0).abs() <= 2.0 * f64::EPSILON);
        }
        assert_eq!(dielectric(0.0, 1.33, 1.33).reflectance.mean(), 1.0);
    }

    #[test]
    fn a_cosine_rounded_above_one_is_head_on() {
        assert_eq!(
            dielectric(1.0 + f64::EPSILON, 1.0, 1.5),
            dielectric(1.0, 1.0, 1.5)
        );
    }
}
