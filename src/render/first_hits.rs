//! What the camera rays of a tile met first, summed up pixel by pixel for the picture's [layers](super::layers).
//!
//! Surfaces are worked out here once more than for shading: whoever wants no layers pays for one question a batch of
//! camera packets, and the picture's own way through its surfaces stays as it is.

use glam::{DVec2, DVec3};

use super::Frame;
use super::film::{self, TILE, Tile};
use super::layers::LayerKind;
use super::mattes::Matte;
use super::outcome::Outcome;
use super::queue::Paths;
use super::samples::pixel_of;
use super::surface::Surfaces;
use crate::accel::{NO_HIT, RayPacket};
use crate::image::cryptomatte;
use crate::numeric::LANES;
use crate::shading::MaterialPacket;

/// The working memory of one thread.
pub(super) struct FirstHits<'f, 's> {
    frame: &'f Frame<'s>,
    surfaces: Surfaces,
    /// `TILE` to a row.
    pixels: Vec<PixelHits>,
    /// What Cryptomatte tells, where it is wanted.
    objects: Option<Matte>,
    materials: Option<Matte>,
}

/// What the samples of a pixel met, so far.
#[derive(Clone, Copy)]
struct PixelHits {
    /// Samples that met anything.
    count: u32,
    /// Instance, material and primitive of the first of them.
    ids: [u32; 3],
    /// Sums over them.
    depth: f64,
    normal: DVec3,
    albedo: DVec3,
    position: DVec3,
    uv: DVec2,
    motion: DVec2,
}

impl<'f, 's> FirstHits<'f, 's> {
    /// Where somebody wants layers.
    pub(super) fn of(frame: &'f Frame<'s>) -> Option<Box<FirstHits<'f, 's>>> {
        let layers = frame.settings.layers;
        let matte = |kind: LayerKind| layers.has(kind).then(Matte::new);
        let new = || {
            Box::new(FirstHits {
                frame,
                surfaces: Surfaces::new(frame.effects()),
                pixels: vec![PixelHits::NONE; (TILE * TILE) as usize],
                objects: matte(LayerKind::CryptoObject),
                materials: matte(LayerKind::CryptoMaterial),
            })
        };
        (!layers.is_empty()).then(new)
    }

    pub(super) fn clear(&mut self) {
        self.pixels.fill(PixelHits::NONE);
        self.mattes_mut().for_each(Matte::clear);
    }

    fn mattes_mut(&mut self) -> impl Iterator<Item = &mut Matte> {
        self.objects.iter_mut().chain(&mut self.materials)
    }

    /// Bytes of all of it.
    pub(super) fn byte_count(&self) -> usize {
        let mattes = self.objects.iter().chain(&self.materials);
        size_of_val(self) + size_of_val(&self.pixels[..]) + mattes.map(Matte::byte_count).sum::<usize>()
    }

    /// Adds what a batch of traced camera packets has met.
    #[inline(never)]
    pub(super) fn add(&mut self, outcome: &Outcome, packets: &[RayPacket], paths: Paths) {
        for (index, packet) in packets.iter().enumerate() {
            if packet.instance.iter().all(|&instance| instance == NO_HIT) {
                continue;
            }
            let (path, travels) = paths.at(index);
            let widths = outcome.widths::<false>(travels);
            self.frame.surfaces.meet(packet, widths, &mut self.surfaces);
            for l in (0..LANES).filter(|&l| packet.instance[l] != NO_HIT) {
                let pixel = pixel_of(path.pixel[l]);
                self.add_names(packet.instance[l], pixel);
                self.add_hit(packet, l, pixel as usize);
            }
        }
    }

    /// Adds the names of what a sample has met.
    fn add_names(&mut self, instance: u32, pixel: u32) {
        let scene = self.frame.scene;
        let instance = &scene.instances[instance as usize];
        if let Some(objects) = &mut self.objects {
            objects.add(pixel, cryptomatte::id_of(&instance.name));
        }
        if let Some(materials) = &mut self.materials {
            let material = &scene.materials[instance.material as usize];
            materials.add(pixel, cryptomatte::id_of(&material.name));
        }
    }

    /// Adds what lane `l` has met.
    fn add_hit(&mut self, packet: &RayPacket, l: usize, pixel: usize) {
        let FirstHits {
            frame,
            surfaces: Surfaces {
                points, materials, ..
            },
            pixels,
            ..
        } = self;
        let (wanted, instance) = (frame.settings.layers, packet.instance[l]);
        let file = &frame.scene.normalisation;
        let hits = &mut pixels[pixel];
        if hits.count == 0 {
            let material = frame.scene.instances[instance as usize].material;
            hits.ids = [instance, material, packet.primitive[l]];
        }
        hits.count += 1;
        let p = points.point(l);
        if wanted.has(LayerKind::Depth) {
            let ray = packet.ray(l);
            let direction = ray.direction.as_dvec3().normalize();
            hits.depth += (p - ray.origin.as_dvec3()).dot(direction) / file.scale;
        }
        if wanted.has(LayerKind::Normal) {
            hits.normal += points.shading_normal(l);
        }
        if wanted.has(LayerKind::Albedo) {
            hits.albedo += albedo(materials, l);
        }
        if wanted.has(LayerKind::Position) {
            hits.position += p / file.scale + file.center;
        }
        if wanted.has(LayerKind::Uv) {
            let pose = frame.surfaces.pose(packet, l);
            let chart = frame.surfaces.view(instance).chart(&pose, 0, packet, l);
            hits.uv += DVec2::from(chart.uv.map(f64::from));
        }
        if let Some(motion) = &frame.screen_motion {
            let instance = &frame.scene.instances[instance as usize];
            hits.motion += motion.of(p, instance, packet.time[l]);
        }
    }

    /// The wanted layers of a tile, each row by row.
    pub(super) fn planes(&mut self, tile: Tile) -> Vec<Vec<f32>> {
        let (wanted, samples) = (self.frame.settings.layers, self.frame.samples_taken());
        let mut planes = Vec::with_capacity(wanted.layer_count());
        for kind in wanted.kinds() {
            let matte = match kind {
                LayerKind::CryptoObject => &mut self.objects,
                LayerKind::CryptoMaterial => &mut self.materials,
                _ => &mut None,
            };
            match matte {
                Some(matte) => planes.extend(matte.planes(tile, samples)),
                None => planes.extend(self.planes_of(kind, tile)),
            }
        }
        planes
    }

    /// The layers of a kind that [`PixelHits`] has.
    fn planes_of(&self, kind: LayerKind, tile: Tile) -> impl Iterator<Item = Vec<f32>> {
        let plane = move |part: usize| {
            let pixels = film::cut(tile, &self.pixels);
            pixels.map(|hits| hits.values(kind)[part]).collect()
        };
        (0..kind.names().len()).map(plane)
    }
}

impl PixelHits {
    const NONE: PixelHits = PixelHits {
        count: 0,
        ids: [0; 3],
        depth: 0.0,
        normal: DVec3::ZERO,
        albedo: DVec3::ZERO,
        position: DVec3::ZERO,
        uv: DVec2::ZERO,
        motion: DVec2::ZERO,
    };

    /// The values of a kind's layers, in their order; there may be fewer than three.
    fn values(&self, kind: LayerKind) -> [f32; 3] {
        if self.count == 0 {
            return match kind {
                LayerKind::Depth => [f32::INFINITY; 3],
                LayerKind::Ids => [-1.0; 3],
                _ => [0.0; 3],
            };
        }
        let mean = |sum: DVec3| (sum / f64::from(self.count)).as_vec3().to_array();
        match kind {
            LayerKind::Depth => mean(DVec3::splat(self.depth)),
            LayerKind::Normal => mean(self.normal),
            LayerKind::Albedo => mean(self.albedo),
            LayerKind::Position => mean(self.position),
            LayerKind::Uv => mean(self.uv.extend(0.0)),
            LayerKind::Ids => self.ids.map(|id| id as f32),
            LayerKind::Motion => mean(self.motion.extend(0.0)),
            // Mattes tell them.
            LayerKind::CryptoObject | LayerKind::CryptoMaterial => [0.0; 3],
        }
    }
}

/// What part of the light that arrives at lane `l` its surface may send back without a highlight.
fn albedo(materials: &MaterialPacket, l: usize) -> DVec3 {
    let rich = &materials.rich;
    let channel = |c: usize| {
        let base = f64::from(materials.base_color[c][l]);
        match rich.is_lecture[l] {
            true => base * f64::from(rich.diffuse[c][l]),
            false => base,
        }
    };
    DVec3::new(channel(0), channel(1), channel(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_tells_the_mean_of_what_was_met_and_the_ids_of_the_first() {
        let hits = PixelHits {
            count: 4,
            ids: [7, 2, 30],
            depth: 10.0,
            normal: DVec3::new(0.0, 2.0, 3.0),
            uv: DVec2::new(1.0, 3.0),
            ..PixelHits::NONE
        };
        assert_eq!(hits.values(LayerKind::Depth)[0], 2.5);
        assert_eq!(hits.values(LayerKind::Normal), [0.0, 0.5, 0.75]);
        assert_eq!(hits.values(LayerKind::Uv)[..2], [0.25, 0.75]);
        assert_eq!(hits.values(LayerKind::Ids), [7.0, 2.0, 30.0]);
        assert_eq!(PixelHits::NONE.values(LayerKind::Depth)[0], f32::INFINITY);
        assert_eq!(PixelHits::NONE.values(LayerKind::Ids), [-1.0; 3]);
        assert_eq!(PixelHits::NONE.values(LayerKind::Position), [0.0; 3]);
    }
}
