//! Radiosity solution with its errors.

/// Power that light sources emit, including the first reflection of light from lights and background, and the parts
/// that elements absorb and that leave the scene. Only their ratios have a meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnergyBalance {
    /// Power of all sources.
    pub emitted: f64,
    /// Power that elements absorb.
    pub absorbed: f64,
    /// Power that leaves the scene or arrives at objects without elements.
    pub escaped: f64,
}

impl EnergyBalance {
    /// Returns the power that is neither absorbed nor escapes, relative to the emitted power; 0 without light.
    pub fn imbalance(&self) -> f64 {
        match self.emitted > 0.0 {
            true => 1.0 - (self.absorbed + self.escaped) / self.emitted,
            false => 0.0,
        }
    }
}

/// Size and errors of a radiosity solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadiosityReport {
    /// Number of elements in the scene.
    pub elements: usize,
    /// Number of rays of each side of an element.
    pub rays: usize,
    /// Number of sweeps over all sides.
    pub sweeps: u32,
    /// Power that later sweeps would add, relative to the power of all sources; estimated from the last two.
    pub remaining: f64,
    /// True if the remaining power is below the tolerance.
    pub has_converged: bool,
    /// Standard error of the radiance of an element by sampling, root mean square over the lit area, relative to the mean.
    /// Radiance above white counts as white.
    pub sampling_error: f64,
    /// Balance of the powers in the solution.
    pub energy: EnergyBalance,
}

/// Light of one side of an element, linear RGB.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SideLight {
    /// Radiance that leaves the side in all directions, its own emission included.
    pub radiance: [f32; 3],
    /// Irradiance by other sides over π.
    pub gathered: [f32; 3],
    /// Fraction of the incident light that is reflected.
    pub albedo: [f32; 3],
    /// True if the side itself emits light.
    pub is_emissive: bool,
    /// Fraction of the element whose side is outside of solids.
    pub visible: f32,
}

/// Radiosity solution of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiositySolution {
    /// Light of the sides of all elements: the front of element i has number 2 i, its back 2 i + 1.
    pub sides: Vec<SideLight>,
    /// Size and errors of the solution.
    pub report: RadiosityReport,
}
