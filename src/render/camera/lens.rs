//! Depth of field and motion blur: camera rays that start on a lens and at sampled times.
//!
//! The rays of a packet are first generated for a pinhole. With a lens, each ray is then moved to start at a lens
//! point and to pass through the pinhole ray's point of focus ([`crate::scene::LensView::ray`]). The lens point is
//! given by the random pair of the sample for [`Purpose::LENS`], the time by that for [`Purpose::TIME`]; the camera
//! has its position at that time. Ray cones are those of the lens centre, and the interiors around the camera are
//! those around this point at the middle of the shutter interval.

use super::super::context::RenderContext;
use super::super::sampler::{Purpose, SampleGroup, number_packet};
use super::super::tile::Block;
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes};
use crate::scene::CameraRay;

impl RenderContext<'_> {
    /// Returns whether camera rays differ from those of a static pinhole.
    pub(in crate::render) fn has_lens_or_motion(&self) -> bool {
        self.lens.is_some() || self.motion.is_some()
    }

    /// Returns whether camera rays are moved, have times, or carry path state.
    pub(in crate::render) fn has_camera_path_states(&self) -> bool {
        // Times are part of the path state.
        self.has_lens_or_motion() || self.has_path_state()
    }

    /// Returns the camera rays for the samples of a packet at `position` within their pixels.
    pub(in crate::render) fn camera_rays(
        &self,
        block: &Block,
        (group, time): (&SampleGroup, &Lanes<f32>),
        position: &[Lanes<f64>; 2],
    ) -> Lanes<CameraRay> {
        // Draw the lens points
        let numbers = match (&self.lens, &self.motion) {
            (None, None) => [[0.0; LANES]; 2],
            _ => self.numbers(block, group, Purpose::LENS),
        };
        std::array::from_fn(|l| {
            // Compute the film point of the sample
            let pixel = self.pixel(block, l);
            let [x, y] =
                [0, 1].map(|axis| (f64::from(pixel[axis]) + position[axis][l]) * self.pixel_size[axis]);
            let moved;
            // Place the camera at the time of the sample
            let (view, lens) = match &self.motion {
                None => (&self.view, &self.lens),
                Some(moving) => {
                    moved = moving.at(time[l]);
                    (&moved.0, &moved.1)
                }
            };
            // Generate the pinhole ray and move it to a lens point
            let pinhole = view.ray(x, y);
            match lens {
                None => pinhole,
                Some(lens) => lens.ray(pinhole, [numbers[0][l], numbers[1][l]]),
            }
        })
    }

    /// Returns the sample times of a packet.
    pub(in crate::render) fn times(&self, block: &Block, group: &SampleGroup) -> Lanes<f32> {
        let [u, _] = self.numbers(block, group, Purpose::TIME);
        u.map(|u| self.shutter.time(u))
    }

    /// Returns the random pairs for the samples of a packet.
    fn numbers(&self, block: &Block, group: &SampleGroup, purpose: Purpose) -> [Lanes<f64>; 2] {
        // Transpose the pixels of the lanes
        let pixels: Lanes<[u32; 2]> = std::array::from_fn(|l| self.pixel(block, l));
        let pixels = [0, 1].map(|axis| pixels.map(|pixel| pixel[axis]));
        number_packet(&pixels, &group.sample, purpose.seeded(self.settings.seed))
    }

    /// Returns the column and row of lane `l`'s pixel in the image.
    fn pixel(&self, block: &Block, l: usize) -> [u32; 2] {
        [
            block.tile.x + block.corner.0 + self.pixels[0][l],
            block.tile.y + block.corner.1 + self.pixels[1][l],
        ]
    }
}

/// Sets the rays of a packet to `rays`, rounded to f32.
pub(in crate::render) fn aim(packet: &mut RayPacket, rays: &Lanes<CameraRay>) {
    for l in 0..LANES {
        for axis in 0..3 {
            packet.origin[axis][l] = rays[l].origin[axis] as f32;
            packet.direction[axis][l] = rays[l].direction[axis] as f32;
        }
    }
}
