//! Settings of a radiosity solution.

use super::elements::ElementScene;
use super::error::RadiosityError;
use super::gather::RAY_STEP;

/// Largest number of hits of all rays, which take 2 gigabytes.
const MAX_HITS: usize = 1 << 29;

/// Settings of a radiosity solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadiositySettings {
    /// Number of rays of each side of an element, rounded up to a multiple of 32.
    pub rays: u32,
    /// Largest power that later sweeps may add, relative to the power of all sources.
    pub tolerance: f64,
}

impl Default for RadiositySettings {
    /// Returns 256 rays and a tolerance of a thousandth.
    fn default() -> RadiositySettings {
        RadiositySettings {
            rays: 256,
            tolerance: 0.001,
        }
    }
}

impl RadiositySettings {
    /// Returns the number of rays of each side.
    pub(super) fn ray_count(&self) -> usize {
        (self.rays.max(1) as usize).next_multiple_of(RAY_STEP)
    }

    /// Returns an error if the hits of the rays of these elements exceed the limit of memory.
    ///
    /// # Errors
    /// If there are more than 2^29 hits, which take 2 gigabytes.
    pub fn check_memory(&self, elements: &ElementScene) -> Result<(), RadiosityError> {
        let sides = 2 * elements.elements().len();
        match sides * self.ray_count() > MAX_HITS {
            true => Err(RadiosityError::TooManyRays {
                elements: elements.elements().len(),
                rays: self.ray_count(),
            }),
            false => Ok(()),
        }
    }
}
