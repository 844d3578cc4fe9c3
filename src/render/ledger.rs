//! What was traced and how long it took, by the purpose of the rays.

use std::ops::AddAssign;

/// Rays of one purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayTally {
    /// How many were traced.
    pub rays: u64,
    /// Seconds inside the backend, summed over threads.
    pub seconds: f64,
}

/// The account of a render.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ledger {
    /// Wall-clock seconds of the render phase.
    pub seconds: f64,
    /// From the eye.
    pub camera: RayTally,
    /// From surfaces to lights.
    pub shadow: RayTally,
    /// From mirrors.
    pub reflection: RayTally,
}

impl Ledger {
    /// Seconds inside the backend, summed over threads.
    pub fn trace_seconds(&self) -> f64 {
        self.camera.seconds + self.shadow.seconds + self.reflection.seconds
    }
}

impl AddAssign for RayTally {
    fn add_assign(&mut self, other: RayTally) {
        self.rays += other.rays;
        self.seconds += other.seconds;
    }
}

impl AddAssign for Ledger {
    /// Adds another task's tallies; wall-clock time is not a sum.
    fn add_assign(&mut self, other: Ledger) {
        self.camera += other.camera;
        self.shadow += other.shadow;
        self.reflection += other.reflection;
    }
}
