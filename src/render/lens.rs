//! Depth of field: camera rays that leave from points all over the lens. And motion: they leave at times all over that
//! for which the shutter is open, from where the camera is then.
//!
//! A packet's rays are made as a pinhole's first; where the camera has a lens each is bent to go from another point of
//! it to where the pinhole's ray is in focus ([`crate::scene::LensView::ray`]). The point is that of the sample's own
//! pair of numbers for [`Purpose::LENS`], the time is by that for [`Purpose::TIME`]. Widths of rays stay those of the
//! middle of the lens, and the bodies around the camera those around that point in the middle of the time.

use super::Frame;
use super::sampler::{Purpose, SampleGroup};
use super::wave::Block;
use crate::accel::RayPacket;
use crate::numeric::{AnimatedTransform, LANES, Lanes};
use crate::scene::{Camera, CameraRay, CameraView, Effect, EffectSet, LensView};

impl Frame<'_> {
    /// Whether camera rays are other than those of a pinhole that stands still.
    pub(super) fn is_bent(&self) -> bool {
        self.lens.is_some() || self.motion.is_some()
    }

    /// Whether camera rays are bent, have times, or begin paths that keep more than their weights.
    pub(super) fn has_camera_travels(&self) -> bool {
        // Times are kept by paths.
        self.is_bent() || self.travels()
    }

    /// The rays of a packet's samples, which lie at `position` in their pixels.
    pub(super) fn camera_rays(
        &self,
        block: &Block,
        (group, time): (&SampleGroup, &Lanes<f32>),
        position: &[Lanes<f64>; 2],
    ) -> Lanes<CameraRay> {
        std::array::from_fn(|l| {
            let pixel = self.pixel(block, l);
            let [x, y] =
                [0, 1].map(|axis| (f64::from(pixel[axis]) + position[axis][l]) * self.pixel_size[axis]);
            let moved;
            let (view, lens) = match &self.motion {
                None => (&self.view, &self.lens),
                Some(moving) => {
                    moved = moving.at(time[l]);
                    (&moved.0, &moved.1)
                }
            };
            let pinhole = view.ray(x, y);
            match lens {
                None => pinhole,
                Some(lens) => lens.ray(pinhole, self.numbers(block, group, l, Purpose::LENS)),
            }
        })
    }

    /// When the samples of a packet are taken.
    pub(super) fn times(&self, block: &Block, group: &SampleGroup) -> Lanes<f32> {
        std::array::from_fn(|l| {
            let [u, _] = self.numbers(block, group, l, Purpose::TIME);
            self.shutter.time(u)
        })
    }

    /// The pair of numbers of lane `l`'s sample.
    fn numbers(&self, block: &Block, group: &SampleGroup, l: usize, purpose: Purpose) -> [f64; 2] {
        self.settings
            .numbers(self.pixel(block, l), group.sample[l], purpose)
    }

    /// Column and row of lane `l`'s pixel in the picture.
    fn pixel(&self, block: &Block, l: usize) -> [u32; 2] {
        [
            block.tile.x + block.corner.0 + self.pixels[0][l],
            block.tile.y + block.corner.1 + self.pixels[1][l],
        ]
    }
}

/// A camera that moves, for one size of picture.
pub(super) struct MovingCamera {
    camera: Camera,
    motion: AnimatedTransform,
    size: [u32; 2],
    has_lens: bool,
}

impl MovingCamera {
    /// That of a frame of these effects; `None` where the camera stands still or is to be seen as if it did.
    pub(super) fn of(camera: &Camera, size: [u32; 2], effects: EffectSet) -> Option<MovingCamera> {
        let motion = camera.motion().filter(|_| effects.has(Effect::MotionBlur))?;
        Some(MovingCamera {
            camera: camera.clone(),
            motion,
            size,
            has_lens: effects.has(Effect::DepthOfField),
        })
    }

    /// What it is at `time`, and its lens.
    pub(super) fn at(&self, time: f32) -> (CameraView, Option<LensView>) {
        let camera = Camera {
            world_from_camera: self.motion.at(f64::from(time)),
            name: String::new(),
            ..self.camera
        };
        let [width, height] = self.size;
        let lens = camera.lens_view().filter(|_| self.has_lens);
        (camera.view(width, height), lens)
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
