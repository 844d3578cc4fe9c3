//! Homogeneous fog, whose radiance and transmittance along a segment have a closed form.

use super::composite::Composite;
use super::optical_depth::opacity;
use super::{MAX_STEPS, VolumeError};

/// Homogeneous medium that fills all space.
#[derive(Clone, Copy, Debug, PartialEq)]
/// Extinction coefficient per world unit.
pub struct Fog {
    /// Linear RGB single-scattering albedo.
    extinction: f64,
    /// Linear RGB radiance emitted per world unit.
    color: [f64; 3],
    /// Ray-marching step in world units, for fog lit by lights.
    emission: [f64; 3],
    step: f64,
}

impl Fog {
    /// Creates fog of `extinction` per world unit, with the albedo `color` and the emitted radiance `emission` per
    /// world unit. `step` is the ray-marching step where lights illuminate the fog; the closed form needs none.
    pub fn new(extinction: f64, color: [f64; 3], emission: [f64; 3], step: f64) -> Result<Fog, VolumeError> {
        let wrong = |fault| Err(VolumeError::Fog { fault });
        let in_range = |x: f64| (0.0..=f64::from(f32::MAX)).contains(&x);
        // Check ranges; beyond those of f32, products could overflow
        if !in_range(extinction) {
            return wrong("has an extinction that is negative or not finite");
        }
        if !color.into_iter().chain(emission).all(in_range) {
            return wrong("has a colour or emission that is negative or not finite");
        }
        // Reject emission without extinction: its integral to infinity diverges
        if extinction == 0.0 && emission != [0.0; 3] {
            return wrong("emits without limit where nothing absorbs light");
        }
        // Check that a march to full opacity takes at most MAX_STEPS steps
        if !(step > 0.0 && step.is_finite()) {
            return wrong("has a step that is not positive");
        }
        if extinction > 0.0 && !(extinction * step * MAX_STEPS >= 1.0) {
            return wrong("has steps too short to march through it");
        }
        Ok(Fog {
            extinction,
            color,
            emission,
            step,
        })
    }

    /// Returns the fog for lengths that are `scale`, a power of two, times as large: exact.
    #[must_use]
    pub(crate) fn rescaled(&self, scale: f64) -> Fog {
        Fog {
            extinction: self.extinction / scale,
            color: self.color,
            emission: self.emission.map(|emission| emission / scale),
            step: self.step * scale,
        }
    }

    /// Returns the fog with its step length multiplied by `factor`, or unchanged if the steps would become so short
    /// that a march hardly ends.
    #[must_use]
    pub(crate) fn with_steps(self, factor: f64) -> Fog {
        let step = factor * self.step;
        let ends = self.extinction == 0.0 || self.extinction * step * MAX_STEPS >= 1.0;
        if ends { Fog { step, ..self } } else { self }
    }

    /// Returns the extinction coefficient per world unit.
    pub fn extinction(&self) -> f64 {
        self.extinction
    }

    /// Returns the linear RGB albedo: the scattered fraction of the extinction.
    pub fn color(&self) -> [f64; 3] {
        self.color
    }

    /// Returns the emitted radiance per world unit, linear RGB.
    pub fn emission(&self) -> [f64; 3] {
        self.emission
    }

    /// Returns the ray-marching step for fog lit by lights, in world units.
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Returns the optical depth of `length` world units, which may be infinite.
    #[inline(always)]
    pub fn depth(&self, length: f64) -> f64 {
        if self.extinction > 0.0 {
            self.extinction * length
        } else {
            0.0
        }
    }

    /// Composites a segment of `length` world units, which may be infinite, lit by incident radiance 1, as one layer in
    /// closed form.
    pub(super) fn pass(&self, length: f64, composite: &mut Composite) {
        if self.extinction > 0.0 {
            let alpha = opacity(self.depth(length));
            // Scale emission to radiance per unit of optical depth
            let source = |channel| self.color[channel] + self.emission[channel] / self.extinction;
            composite.push([0, 1, 2].map(source), alpha);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fog_absorbs_half_at_half_distance_and_all_at_infinity() {
        let fog = Fog::new(2.0, [0.5, 1.0, 0.0], [0.0, 0.0, 4.0], 1.0).unwrap();
        let mut composite = Composite::CLEAR;
        fog.pass(std::f64::consts::LN_2 / 2.0, &mut composite);
        // Half of the colour, and half of 4 / 2.
        for (got, expected) in composite.color().into_iter().zip([0.25, 0.5, 1.0]) {
            assert!((got - expected).abs() <= 4.0 * f64::EPSILON);
        }
        let mut composite = Composite::CLEAR;
        fog.pass(f64::INFINITY, &mut composite);
        assert_eq!(
            (composite.color(), composite.transmittance()),
            ([0.5, 1.0, 2.0], 0.0)
        );
    }

    #[test]
    fn absent_fog_is_clear_to_infinity() {
        let fog = Fog::new(0.0, [1.0; 3], [0.0; 3], 1.0).unwrap();
        let mut composite = Composite::CLEAR;
        fog.pass(f64::INFINITY, &mut composite);
        assert_eq!((composite, fog.depth(f64::INFINITY)), (Composite::CLEAR, 0.0));
    }

    #[test]
    fn invalid_fog_is_rejected() {
        for (extinction, emission, step) in [
            (-1.0, 0.0, 1.0),
            (f64::NAN, 0.0, 1.0),
            (f64::INFINITY, 0.0, 1.0),
            (0.0, 1.0, 1.0),
            (1.0, -1.0, 1.0),
            (1.0, 0.0, 0.0),
            (1.0, 0.0, f64::NAN),
            (1.0, 0.0, 1e-9),
        ] {
            assert!(Fog::new(extinction, [1.0; 3], [emission; 3], step).is_err());
        }
    }
}
