//! The time of a backend's calls on batches as small as the renderer's.

use std::time::{Duration, Instant};

use whit::accel::{LANES, RayPacket};

/// Packets a call: a large array would measure memory.
const BATCH: usize = 16;

/// Seconds and results of tracing.
pub(crate) struct Traced {
    pub(crate) seconds: f64,
    /// Lanes whose `t_far` became finite or -∞; of rays without an end those that hit something.
    pub(crate) hit_count: usize,
}

impl Traced {
    /// Traces copies of all packets, whose rays have no end, batch by batch; copying does not count.
    pub(crate) fn measure(packets: &[RayPacket], trace: &dyn Fn(&mut [RayPacket])) -> Traced {
        let mut spent = Duration::ZERO;
        let mut hit_count = 0;
        for batch in packets.chunks(BATCH) {
            let mut batch = batch.to_vec();
            let start = Instant::now();
            trace(&mut batch);
            spent += start.elapsed();
            hit_count += batch.iter().map(hits).sum::<usize>();
        }
        Traced {
            seconds: spent.as_secs_f64(),
            hit_count,
        }
    }
}

fn hits(packet: &RayPacket) -> usize {
    (0..LANES)
        .filter(|&lane| packet.t_far[lane] < f32::INFINITY)
        .count()
}
