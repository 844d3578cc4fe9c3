//! Spheres in callbacks: all lanes of a packet at once, for the instruction set at hand.
//!
//! Only for spheres that are spheres in the world; ellipsoids carry each ray into object space and go lane by lane, as
//! all other shapes. To the bits of [`crate::accel::shapes::shape_hit`].

use super::lanes::{Foreign, row};
use super::user::Question;
use crate::accel::{ACTIVE, NO_HIT};
use crate::mesh::lanes::{Isa, Work};
use crate::shape::Sphere;

/// One sphere in world space against the asked lanes of a packet; says which were hit.
pub(super) struct SphereLanes<'a, const W: usize> {
    pub(super) sphere: &'a Sphere,
    pub(super) instance: &'a u32,
    pub(super) packet: Foreign,
    pub(super) asked: &'a [i32; W],
    pub(super) question: Question,
}

#[inline(always)]
fn widened<const W: usize>(v: &[f32; W]) -> [f64; W] {
    let mut wide = [0.0; W];
    for lane in 0..W {
        wide[lane] = f64::from(v[lane]);
    }
    wide
}

#[inline(always)]
fn load<const W: usize>(packet: Foreign, first: usize) -> [[f64; W]; 3] {
    [
        widened(&packet.floats(first)),
        widened(&packet.floats(first + 1)),
        widened(&packet.floats(first + 2)),
    ]
}

impl<const W: usize> Work for SphereLanes<'_, W> {
    type Output = [i32; W];

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> [i32; W] {
        let packet = self.packet;
        let (origin, direction) = (load(packet, row::ORIGIN), load(packet, row::DIRECTION));
        let t_near = widened(&packet.floats(row::T_NEAR));
        let t_far: [f32; W] = packet.floats(row::T_FAR);
        let exact = self
            .sphere
            .nearest_lanes(&origin, &direction, &t_near, &[f64::INFINITY; W]);
        let (mut t, mut hit) = ([0.0f32; W], [0i32; W]);
        let mut any = 0;
        for lane in 0..W {
            t[lane] = exact[lane] as f32;
            // Comparisons with NaN, which is a miss, are false.
            let met = (t[lane] <= t_far[lane]) & (t[lane] < f32::INFINITY);
            hit[lane] = if met { self.asked[lane] } else { 0 };
            any |= hit[lane];
        }
        if any != 0 {
            match self.question {
                Question::Any => self.block(&t_far, &hit),
                Question::Nearest => self.take(&t_far, &t, &mut hit),
            }
        }
        hit
    }
}

impl<const W: usize> SphereLanes<'_, W> {
    #[inline(always)]
    fn block(&self, t_far: &[f32; W], hit: &[i32; W]) {
        let mut ends = [0; W];
        for lane in 0..W {
            let end = if hit[lane] != 0 {
                f32::NEG_INFINITY
            } else {
                t_far[lane]
            };
            ends[lane] = end.to_bits();
        }
        self.packet.store(row::T_FAR, ends);
    }

    /// Writes the hits, but those of lanes whose equally near hit has a lower number.
    #[inline(always)]
    fn take(&self, t_far: &[f32; W], t: &[f32; W], hit: &mut [i32; W]) {
        let instance = *self.instance;
        let held: [u32; W] = self.packet.load(row::INSTANCE);
        for lane in 0..W {
            // A lane without a hit holds the highest number.
            let is_first = (t[lane] < t_far[lane]) | (instance < held[lane]);
            hit[lane] = if is_first & (hit[lane] != 0) { ACTIVE } else { 0 };
        }
        let mut ends = [0; W];
        for lane in 0..W {
            ends[lane] = if hit[lane] != 0 { t[lane] } else { t_far[lane] }.to_bits();
        }
        self.packet.store(row::T_FAR, ends);
        self.set(row::U, 0, hit);
        self.set(row::V, 0, hit);
        self.set(row::PRIMITIVE, 0, hit);
        self.set(row::INSTANCE, instance, hit);
        self.set(row::LEVEL, NO_HIT, hit);
    }

    #[inline(always)]
    fn set(&self, row: usize, value: u32, hit: &[i32; W]) {
        let mut bits: [u32; W] = self.packet.load(row);
        for lane in 0..W {
            bits[lane] = if hit[lane] != 0 { value } else { bits[lane] };
        }
        self.packet.store(row, bits);
    }
}
