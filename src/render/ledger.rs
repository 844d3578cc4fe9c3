//! What was traced and how long it took, by the purpose of the rays.

use std::ops::AddAssign;

use super::losses::Limit;

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
    /// Through surfaces: refracted, or where a surface is not there.
    pub refraction: RayTally,
    /// Rays that were not followed because of the depth limit of transparent scenes or the weight cut-off.
    pub lost_rays: u64,
    /// The sum of their weights: by so many times the largest radiance, at most, is the sum of all samples too dark.
    pub lost_weight: f64,
    /// The most that any pixel lacks: the sum of its samples' lost weights over their number. By so many times the radiance
    /// that a lost ray could have brought, at most, is a pixel wrong that is filtered by a box. With adaptive sampling it
    /// is the most of any round, which is no less.
    pub max_lost_weight: f64,
    /// Of the lost rays, those beyond the depth limit.
    pub depth_limit: Loss,
    /// Of the lost rays, those that weighed too little.
    pub weight_cutoff: Loss,
}

/// Rays that one limit cut off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// How many.
    pub rays: u64,
    /// The sum of their weights.
    pub weight: f64,
    /// The most that any pixel lacks, as [`Ledger::max_lost_weight`] has it.
    pub max_weight: f64,
}

impl Ledger {
    /// Seconds inside the backend, summed over threads.
    pub fn trace_seconds(&self) -> f64 {
        self.camera.seconds + self.shadow.seconds + self.reflection.seconds + self.refraction.seconds
    }

    /// Books rays that left surfaces, of which `refracted` went through; they shared packets, and so share the time.
    pub(super) fn book(&mut self, all: RayTally, refracted: u64) {
        let share = refracted as f64 / all.rays.max(1) as f64;
        self.reflection += RayTally {
            rays: all.rays.saturating_sub(refracted),
            seconds: all.seconds * (1.0 - share),
        };
        self.refraction += RayTally {
            rays: refracted,
            seconds: all.seconds * share,
        };
    }

    /// Books a ray that is not followed.
    pub(super) fn lose(&mut self, limit: Limit, weight: f32) {
        self.lost_rays += 1;
        self.lost_weight += f64::from(weight);
        let loss = match limit {
            Limit::Depth => &mut self.depth_limit,
            Limit::Weight => &mut self.weight_cutoff,
        };
        loss.rays += 1;
        loss.weight += f64::from(weight);
    }
}

impl AddAssign for RayTally {
    fn add_assign(&mut self, other: RayTally) {
        self.rays += other.rays;
        self.seconds += other.seconds;
    }
}

impl AddAssign for Loss {
    /// Adds another task's; pixels are different ones.
    fn add_assign(&mut self, other: Loss) {
        self.rays += other.rays;
        self.weight += other.weight;
        self.max_weight = self.max_weight.max(other.max_weight);
    }
}

impl AddAssign for Ledger {
    /// Adds another task's tallies; wall-clock time is not a sum.
    fn add_assign(&mut self, other: Ledger) {
        self.camera += other.camera;
        self.shadow += other.shadow;
        self.reflection += other.reflection;
        self.refraction += other.refraction;
        self.lost_rays += other.lost_rays;
        self.lost_weight += other.lost_weight;
        self.max_lost_weight = self.max_lost_weight.max(other.max_lost_weight);
        self.depth_limit += other.depth_limit;
        self.weight_cutoff += other.weight_cutoff;
    }
}
