//! Time of grouping two million boxes into clusters that are tested together.

use std::hint::black_box;
use std::time::Instant;

use glam::Vec3;
use whit::accel::cluster_count;

use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::unit_cube;

const BOX_COUNT: usize = 2_000_000;
const HALF_EDGE: f32 = 0.004;
const ROUNDS: usize = 5;
/// Seconds that the fastest round may take.
const MAX_SECONDS: f64 = 1.0;

/// Groups boxes by eight, as spheres are, and by sixteen, as triangles are.
pub(crate) fn run(limits: &mut Limits) {
    let half = Vec3::splat(HALF_EDGE);
    let around = |center: Vec3| [center - half, center + half];
    let boxes: Vec<[Vec3; 2]> = (0..BOX_COUNT)
        .map(|i| around(unit_cube::point(i).as_vec3()))
        .collect();
    for member_limit in [8, 16] {
        let seconds = || {
            let start = Instant::now();
            black_box(cluster_count(black_box(&boxes), member_limit));
            start.elapsed().as_secs_f64()
        };
        let rounds: Vec<f64> = (0..ROUNDS).map(|_| seconds()).collect();
        let least = rounds.iter().copied().fold(f64::INFINITY, f64::min);
        println!(
            "{BOX_COUNT} boxes by {member_limit}: {:.2} s, {least:.2} s at best, {}",
            Quartiles::compute(rounds),
            limits.at_most(least, MAX_SECONDS)
        );
    }
}
