//! Rays that wait to be traced, with what they carry home: generations of mirror rays, and shadow feelers.
//!
//! Memory is kept from tile to tile; packets are filled again rather than made anew.

use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3, Ray};

/// Packets that are traced and shaded together: 24 KB of rays, half of a first-level cache.
pub(super) const BATCH: usize = 16;

/// Whose light a lane's ray carries.
#[derive(Clone)]
pub(super) struct PathPacket {
    /// Pixel within the tile's film.
    pub(super) pixel: Lanes<u32>,
    /// What its radiance is multiplied by, linear RGB.
    pub(super) weight: Lanes3<f32>,
}

impl PathPacket {
    const EMPTY: PathPacket = PathPacket {
        pixel: [0; LANES],
        weight: [[0.0; LANES]; 3],
    };
}

/// Rays of equal depth in the tree. Packets are kept to be filled again.
#[derive(Default)]
pub(super) struct Generation {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    /// Packets in use.
    count: usize,
    /// Lanes in use of the last of them.
    filled: usize,
}

impl Generation {
    /// Forgets all rays.
    pub(super) fn clear(&mut self) {
        self.count = 0;
        self.filled = LANES;
    }

    /// Packets in use.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// The packets in use and their paths.
    pub(super) fn parts(&mut self) -> (&mut [RayPacket], &[PathPacket]) {
        (&mut self.packets[..self.count], &self.paths[..self.count])
    }

    /// A fresh packet with its paths.
    #[inline(always)]
    pub(super) fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        if self.count == self.packets.len() {
            self.packets.push(RayPacket::EMPTY);
            self.paths.push(PathPacket::EMPTY);
        }
        let last = self.count;
        self.count += 1;
        self.packets[last].recycle();
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// One more ray, behind the last.
    #[inline(always)]
    pub(super) fn push(&mut self, ray: &Ray, pixel: u32, weight: [f32; 3]) {
        if self.filled == LANES {
            self.push_packet();
            self.filled = 0;
        }
        let (last, lane) = (self.count - 1, self.filled);
        self.packets[last].set(lane, ray);
        self.paths[last].pixel[lane] = pixel;
        for channel in 0..3 {
            self.paths[last].weight[channel][lane] = weight[channel];
        }
        self.filled += 1;
    }
}

/// Shadow feelers with the light that arrives if nothing is met.
pub(super) struct Feelers {
    packets: [RayPacket; BATCH],
    lights: [Feeler; BATCH],
    /// Packets in use.
    count: usize,
}

#[derive(Clone)]
pub(super) struct Feeler {
    pub(super) pixel: Lanes<u32>,
    pub(super) radiance: Lanes3<f32>,
}

impl Feelers {
    pub(super) fn new() -> Box<Feelers> {
        Box::new(Feelers {
            packets: std::array::from_fn(|_| RayPacket::EMPTY),
            lights: std::array::from_fn(|_| Feeler {
                pixel: [0; LANES],
                radiance: [[0.0; LANES]; 3],
            }),
            count: 0,
        })
    }

    /// Whether there is no room for another packet.
    pub(super) fn is_full(&self) -> bool {
        self.count == BATCH
    }

    /// Memory for one more packet, which counts once [`Feelers::keep`] is called.
    pub(super) fn next(&mut self) -> (&mut RayPacket, &mut Feeler) {
        (&mut self.packets[self.count], &mut self.lights[self.count])
    }

    /// Counts the packet last written.
    pub(super) fn keep(&mut self) {
        self.count += 1;
    }

    /// Hands all packets over and is empty again.
    pub(super) fn take(&mut self) -> (&mut [RayPacket], &mut [Feeler]) {
        let count = std::mem::take(&mut self.count);
        (&mut self.packets[..count], &mut self.lights[..count])
    }
}
