//! Depth of field: camera rays that leave from points all over the lens.
//!
//! A packet's rays are made as a pinhole's first; where the camera has a lens each is bent to go from another point of it
//! to where the pinhole's ray is in focus ([`crate::scene::LensView::ray`]). The point is that of the sample's own pair of
//! numbers for [`Purpose::LENS`]. Widths of rays and the bodies around the camera stay those of the middle of the lens.

use super::Frame;
use super::sampler::{Purpose, SampleGroup, sample_2d};
use super::wave::Block;
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes};
use crate::scene::CameraRay;

impl Frame<'_> {
    /// The rays of a packet's samples, which lie at `position` in their pixels.
    pub(super) fn camera_rays(
        &self,
        block: &Block,
        group: &SampleGroup,
        position: &[Lanes<f64>; 2],
    ) -> Lanes<CameraRay> {
        let settings = &self.settings;
        std::array::from_fn(|l| {
            let pixel = [
                block.tile.x + block.corner.0 + self.pixels[0][l],
                block.tile.y + block.corner.1 + self.pixels[1][l],
            ];
            let [x, y] =
                [0, 1].map(|axis| (f64::from(pixel[axis]) + position[axis][l]) * self.pixel_size[axis]);
            let pinhole = self.view.ray(x, y);
            match &self.lens {
                None => pinhole,
                Some(lens) => {
                    let (pattern, spp) = (settings.pattern, settings.spp);
                    lens.ray(
                        pinhole,
                        sample_2d(pattern, pixel, group.sample[l], spp, Purpose::LENS),
                    )
                }
            }
        })
    }
}

/// Lets the rays of a packet be `rays`, rounded to f32.
pub(super) fn aim(packet: &mut RayPacket, rays: &Lanes<CameraRay>) {
    for l in 0..LANES {
        for axis in 0..3 {
            packet.origin[axis][l] = rays[l].origin[axis] as f32;
            packet.direction[axis][l] = rays[l].direction[axis] as f32;
        }
    }
}
