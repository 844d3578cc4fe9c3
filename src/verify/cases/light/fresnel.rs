//! Snell's law and Fresnel's equations where the textbook form cancels: at the critical angle, at grazing incidence, at
//! Brewster's angle, and between media that nearly match.

use std::cmp::Ordering;

use glam::DVec3;

use crate::numeric::{DoubleDouble, SplitMix64};
use crate::verify::harness::expansion::Expansion;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, FigureAxis};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H35",
        title: "critical angle",
        construction: "angles 0.1 to 10^-9 from the critical angle and the 64 cosines next to it, on both sides",
        oracle: "exact sign of the refracted cosine's square, its root to 100 bits",
        bound: "total reflection on the right side to the bit, the refracted cosine to 4 ulp",
        unit: "ulp",
        run: |trial| Ok(trial.in_chunks(&|random, count| critical(trial, random, count))),
        ..Case::FORMULAS
    },
    Case {
        id: "H36",
        title: "Fresnel",
        construction: "angles up to 89.9999 degrees and near Brewster's angle, indices 10^-9 to 1.5 apart, in both \
            directions",
        oracle: "reflectances and transmittances to 90 bits",
        bound: "8 ulp each, near Brewster's angle of the sum of both polarisations; |R + T - 1| to 4 ulp",
        unit: "ulp",
        run: |trial| Ok(trial.in_chunks(&|random, count| fresnel(trial, random, count))),
        ..Case::FORMULAS
    },
    Case {
        id: "H37",
        title: "refraction in and out",
        construction: "rays through slabs and through 64 partial reflections inside a glass cube, up to 89.9 degrees",
        oracle: "a slab keeps the direction of a ray, a cube only mirrors its components, and no light is lost",
        bound: "directions to 10^-12, radiance to 10^-12",
        unit: "of the bound",
        run: |trial| Ok(trial.in_chunks(&|random, count| round_trips(trial, random, count))),
        ..Case::FORMULAS
    },
];

/// Largest admissible error of the refracted cosine in ulps.
const COSINE_ULPS: f64 = 4.0;
/// Largest admissible error of a reflectance or transmittance in ulps.
const SHARE_ULPS: f64 = 8.0;
const COSINE: FigureAxis = FigureAxis {
    label: "cosine of the angle of incidence",
    bound: COSINE_ULPS,
};
const SHARE: FigureAxis = FigureAxis {
    label: "cosine of the angle of incidence",
    bound: SHARE_ULPS,
};
const ROUND: FigureAxis = FigureAxis {
    label: "cosine of the angle of incidence",
    bound: 1.0,
};
/// Largest admissible error of the sum of reflectance and transmittance, which is 1.
const SUM_ERROR: f64 = 4.0 * f64::EPSILON;

/// Dielectric boundary with the cosine of incidence and both indices of refraction.
struct Boundary {
    cos_i: f64,
    eta_i: f64,
    eta_t: f64,
}

impl Boundary {
    /// Returns (eta_t cos_t)² exactly, as eta_i² cos_i² - (eta_i² - eta_t²).
    fn square(&self) -> Expansion {
        let [cos, i, t] = [self.cos_i, self.eta_i, self.eta_t].map(Expansion::of);
        let p = i.times(&cos);
        p.times(&p).minus(&i.times(&i)).plus(&t.times(&t))
    }

    fn describe(&self) -> String {
        let Boundary { cos_i, eta_i, eta_t } = self;
        format!("cos_i {cos_i:e}, eta_i {eta_i:e}, eta_t {eta_t:e}")
    }
}

/// Returns a boundary with a cosine near the critical one, at which total reflection begins.
fn near_critical(random: &mut SplitMix64) -> Boundary {
    let [eta_t, eta_i] = match random.below(3) {
        0 => [1.0, 1.5],
        1 => [1.33, 2.42],
        _ => {
            let eta = random.within(1.0, 2.0);
            [eta, eta * (1.0 + 10f64.powf(random.within(-6.0, 0.0)))]
        }
    };
    let ratio: f64 = eta_t / eta_i;
    let critical = ((1.0 - ratio) * (1.0 + ratio)).sqrt();
    // Step some ulps from the critical cosine, or a small angle from the critical angle
    let cos_i = if random.below(4) == 0 {
        let steps = random.below(129) as i64 - 64;
        f64::from_bits((critical.to_bits() as i64 + steps) as u64)
    } else {
        let off = 10f64.powf(random.within(-9.0, -1.0)) * random.choose(&[1.0, -1.0]);
        (critical.acos() + off).cos().abs()
    };
    Boundary {
        cos_i: cos_i.clamp(0.0, 1.0),
        eta_i,
        eta_t,
    }
}

fn critical(trial: &CaseRunner, random: &mut SplitMix64, count: usize) -> Counts {
    let mut tally = Counts::default();
    for _ in 0..count {
        let at = near_critical(random);
        let found = (trial.subject.formulas.dielectric)(at.cos_i, at.eta_i, at.eta_t);
        // Compare with the exact refracted cosine, or require total reflection
        let square = at.square();
        let correctness = if square.sign() == Ordering::Greater {
            let cos_t = square.to_double_double().sqrt() / DoubleDouble::of(at.eta_t);
            let off = cos_t.ulps_from(found.cos_t);
            tally.record_error_at(COSINE, at.cos_i, off);
            Correctness::wrong_if(!(off <= COSINE_ULPS))
        } else {
            Correctness::wrong_if(found.cos_t != 0.0 || found.reflectance.mean() != 1.0)
        };
        tally.count(correctness, || {
            format!("{}: cos_t {:e}", at.describe(), found.cos_t)
        });
    }
    tally
}

/// Returns a boundary with random indices and a cosine for which light is mostly transmitted.
fn any_boundary(random: &mut SplitMix64) -> Boundary {
    let eta = random.within(1.0, 1.5);
    let apart = match random.below(2) {
        0 => 10f64.powf(random.within(-9.0, -1.0)),
        _ => random.within(0.01, 1.0),
    };
    let mut pair = [eta, eta * (1.0 + apart)];
    if random.below(2) == 0 {
        pair.reverse();
    }
    let [eta_i, eta_t] = pair;
    // Choose a cosine anywhere, grazing, near normal, or near Brewster's angle
    let cos_i = match random.below(4) {
        0 => random.unit(),
        // Down to 89.9999 degrees, whose cosine is 1.7e-6
        1 => 10f64.powf(random.within(-5.76, 0.0)),
        2 => 1.0 - random.unit() * random.unit() * 1e-6,
        _ => {
            let brewster: f64 = eta_t.atan2(eta_i);
            (brewster + random.choose(&[1.0, -1.0]) * 10f64.powf(random.within(-9.0, -1.0)))
                .cos()
                .abs()
        }
    };
    Boundary { cos_i, eta_i, eta_t }
}

/// Returns reflectance and transmittance of s, then of p polarisation, where `q` is eta_t cos_t.
fn shares(at: &Boundary, q: DoubleDouble) -> [[DoubleDouble; 2]; 2] {
    let [cos_i, eta_i, eta_t] = [at.cos_i, at.eta_i, at.eta_t].map(DoubleDouble::of);
    let cos_t = q / eta_t;
    let four = DoubleDouble::of(4.0);
    let split = |a: DoubleDouble, b: DoubleDouble| {
        let (sum, difference) = (a + b, a - b);
        let amplitude = difference / sum;
        [amplitude * amplitude, four * eta_i * cos_i * q / (sum * sum)]
    };
    [split(eta_i * cos_i, q), split(eta_t * cos_i, eta_i * cos_t)]
}

fn fresnel(trial: &CaseRunner, random: &mut SplitMix64, count: usize) -> Counts {
    let mut tally = Counts::default();
    for _ in 0..count {
        let at = any_boundary(random);
        let found = (trial.subject.formulas.dielectric)(at.cos_i, at.eta_i, at.eta_t);
        let square = at.square();
        // Require total reflection where the refracted cosine is imaginary
        if square.sign() != Ordering::Greater {
            let is_total = found.reflectance.mean() == 1.0 && found.transmittance.mean() == 0.0;
            tally.count(Correctness::wrong_if(!is_total), || at.describe());
            continue;
        }
        // Compare each polarisation and the means with double-double results
        let [[r_s, t_s], [r_p, t_p]] = shares(&at, square.to_double_double().sqrt());
        let mean = DoubleDouble::of(0.5) * (r_s + r_p);
        let mut named = vec![
            ("R of s", r_s.ulps_from(found.reflectance.s)),
            ("R", mean.ulps_from(found.reflectance.mean())),
            ("T of s", t_s.ulps_from(found.transmittance.s)),
            ("T of p", t_p.ulps_from(found.transmittance.p)),
        ];
        // Near Brewster's angle R of p vanishes, and no rounding of cos_t leaves that many of its digits.
        if r_p.nearest() > 0.25 * r_s.nearest() {
            named.push(("R of p", r_p.ulps_from(found.reflectance.p)));
        }
        let off = named.iter().map(|(_, off)| *off).fold(0.0, f64::max);
        tally.record_error_at(SHARE, at.cos_i, off);
        // Check that no energy is gained or lost
        let sum = found.reflectance.mean() + found.transmittance.mean() - 1.0;
        let is_wrong = !(off <= SHARE_ULPS && sum.abs() <= SUM_ERROR);
        tally.count(Correctness::wrong_if(is_wrong), || {
            format!("{}: {named:.1?} ulp, R + T - 1 is {sum:e}", at.describe())
        });
    }
    tally
}

/// Largest admissible error of a direction, and of the total energy.
const ROUND_TRIP: f64 = 1e-12;
/// Number of reflections inside a cube.
const BOUNCES: usize = 64;

fn round_trips(trial: &CaseRunner, random: &mut SplitMix64, count: usize) -> Counts {
    let mut tally = Counts::default();
    for _ in 0..count {
        let eta = 1.0 + 10f64.powf(random.within(-6.0, 0.2));
        // Choose an angle of up to 89.9 degrees from the normal, whose cosine is 1.7e-3
        let cos = 10f64.powf(random.within(-2.76, 0.0));
        let sideways = random.direction().with_z(0.0).normalize_or_zero();
        let d = (((1.0 - cos) * (1.0 + cos)).sqrt() * sideways - cos * DVec3::Z).normalize();
        let off = through_slab(trial, d, eta).max(inside_cube(trial, d, eta)) / ROUND_TRIP;
        tally.record_error_at(ROUND, cos, off);
        tally.count(Correctness::wrong_if(!(off <= 1.0)), || {
            format!("along {d:?} into index {eta:e}: off by {off:e} of the bound")
        });
    }
    tally
}

/// Returns the error of a direction after refraction into a slab and out of it.
fn through_slab(trial: &CaseRunner, d: DVec3, eta: f64) -> f64 {
    let refract = trial.subject.formulas.refract;
    refract(d, DVec3::Z, 1.0, eta)
        .and_then(|inside| refract(inside.direction, DVec3::Z, eta, 1.0))
        .map_or(f64::INFINITY, |out| (out.direction - d).length())
}

/// Returns the error of a direction, or of the total energy if larger, after many reflections at the faces of a cube.
fn inside_cube(trial: &CaseRunner, d: DVec3, eta: f64) -> f64 {
    let formulas = &trial.subject.formulas;
    let Some(inside) = (formulas.refract)(d, DVec3::Z, 1.0, eta) else {
        return f64::INFINITY;
    };
    let start = inside.direction;
    let (mut direction, mut left, mut gone) = (start, 1.0, 0.0);
    // Reflect at the faces in turn, and add up the transmitted energy
    for bounce in 0..BOUNCES {
        let n = DVec3::AXES[bounce % 3];
        let fresnel = (formulas.dielectric)(direction.dot(n).abs(), eta, 1.0);
        gone += left * fresnel.transmittance.mean();
        left *= fresnel.reflectance.mean();
        direction = crate::optics::reflect(direction, n);
    }
    // Compare with the direction mirrored exactly
    let flips = |axis: usize| (0..BOUNCES).filter(|bounce| bounce % 3 == axis).count();
    let sign = |axis: usize| if flips(axis).is_multiple_of(2) { 1.0 } else { -1.0 };
    let expected = start * DVec3::new(sign(0), sign(1), sign(2));
    (direction - expected).length().max((left + gone - 1.0).abs())
}
