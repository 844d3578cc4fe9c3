//! Counts of leaks, false hits and false shadows.

use serde::{Deserialize, Serialize};

use super::{Interval, Knob};

/// Number of ray results in an image that differ from the f64 reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GeometricErrors {
    /// Number of camera rays that were traced.
    pub camera_rays: u64,
    /// Number of shadow rays that were traced.
    pub shadow_rays: u64,
    /// Camera rays that miss a surface which they should hit, or hit one behind it.
    pub leaks: u64,
    /// Camera rays that hit something where nothing is, or in front of the right surface.
    pub false_hits: u64,
    /// Shadow rays that are occluded although the light is visible: by the surface that they leave, or by others.
    pub false_shadows: u64,
    /// Shadow rays that reach the light although something occludes it.
    pub light_leaks: u64,
    /// Results that differ by no more than rounding explains.
    pub ties: u64,
}

impl GeometricErrors {
    /// Returns the number of results that rounding does not explain.
    pub fn count(&self) -> u64 {
        self.leaks + self.false_hits + self.false_shadows + self.light_leaks
    }

    /// Returns the number of traced rays of both kinds.
    pub fn rays(&self) -> u64 {
        self.camera_rays + self.shadow_rays
    }

    /// Returns the fraction of wrong results, with the score interval (E. B. Wilson, "Probable Inference, the Law of
    /// Succession, and Statistical Inference", Journal of the American Statistical Association 22, 1927).
    pub fn share(&self) -> Interval {
        // Half-width of the central 95 % of a normal distribution, in standard deviations.
        const DEVIATIONS: f64 = 1.96;
        let rays = self.rays() as f64;
        let value = self.count() as f64 / rays;
        let square = DEVIATIONS * DEVIATIONS / rays;
        let middle = (value + 0.5 * square) / (1.0 + square);
        let half = (square * (value * (1.0 - value) + 0.25 * square)).sqrt() / (1.0 + square);
        Interval {
            value,
            low: (middle - half).max(0.0),
            high: (middle + half).min(1.0),
        }
    }

    pub(super) fn with(self, other: GeometricErrors) -> GeometricErrors {
        GeometricErrors {
            camera_rays: self.camera_rays + other.camera_rays,
            shadow_rays: self.shadow_rays + other.shadow_rays,
            leaks: self.leaks + other.leaks,
            false_hits: self.false_hits + other.false_hits,
            false_shadows: self.false_shadows + other.false_shadows,
            light_leaks: self.light_leaks + other.light_leaks,
            ties: self.ties + other.ties,
        }
    }
}

impl Knob {
    /// Returns whether the knob can change which hits are found, so that its points have [`GeometricErrors`].
    pub const fn changes_hits(self) -> bool {
        matches!(
            self,
            Knob::HitPath
                | Knob::Instancing
                | Knob::BuildQuality
                | Knob::Compactness
                | Knob::SpawnPoints
                | Knob::HitRefinement
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_of_few_rays_has_a_wide_interval() {
        let errors = GeometricErrors {
            camera_rays: 100,
            leaks: 10,
            ..GeometricErrors::default()
        };
        // Wilson, 1927: 10 of 100 lie between 0.0552 and 0.1744.
        let share = errors.share();
        assert!(
            (share.low - 0.0552).abs() < 1e-4 && (share.high - 0.1744).abs() < 1e-4,
            "{share:?}"
        );
        let none = GeometricErrors { leaks: 0, ..errors };
        assert!(none.share().low == 0.0 && none.share().high > 0.03);
    }
}
