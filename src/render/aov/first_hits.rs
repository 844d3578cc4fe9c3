//! First-hit AOVs: sums over the first hits of the camera rays of a tile, for the [layers](super::layer) of the
//! image.
//!
//! The hits are those that are shaded, with the points and materials computed for shading, so a layer costs only its
//! sums. Without layers, the cost is one test per packet.

use multiversion::multiversion;

use super::super::context::RenderContext;
use super::super::film::pixel_of;
use super::super::surface::{SurfacePacket, Surfaces};
use super::super::tile::{TILE, Tile};
use super::buffers::TileLayer;
use super::cryptomatte::Matte;
use super::selection::{AovKind, AovSet};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, sum_of_lanes};
use crate::shading::MaterialPacket;

/// Side in pixels of the block that a packet covers when it takes one sample per pixel.
const BLOCK: usize = 4;

/// First-hit sums of one thread, reused from tile to tile.
pub(in crate::render) struct FirstHits<'f, 's> {
    frame: &'f RenderContext<'s>,
    /// Number of samples of each pixel that hit a surface, `TILE` pixels per row.
    counts: Vec<u32>,
    /// Reciprocals of `counts`, which turn sums into means; 0 for pixels without hits.
    scales: Vec<f64>,
    /// Instance, material and primitive of the first hit of each pixel.
    ids: Vec<[u32; 3]>,
    /// Sums over the hits of each pixel: one array per requested layer, in their order, without the ids.
    sums: Vec<Vec<f64>>,
    /// Cryptomatte accumulators of the requested mattes, in their order.
    mattes: Vec<Matte>,
}

/// Lanes of a packet that hit a surface, with their pixels.
struct PrimaryHits {
    /// Bit mask per lane: all bits set if the lane hit a surface, otherwise zero.
    keep: Lanes<u32>,
    pixel: Lanes<u32>,
    spread: PixelLayout,
}

/// Distribution of pixels over the lanes of a packet.
enum PixelLayout {
    /// Single pixel for all lanes.
    One(usize),
    /// Block of neighbouring pixels, one per lane, row by row; holds the first of them.
    Block(usize),
    /// Any other distribution of pixels.
    Any,
}

impl<'f, 's> FirstHits<'f, 's> {
    /// Returns an empty accumulator if layers are requested.
    pub(in crate::render) fn of(frame: &'f RenderContext<'s>) -> Option<Box<FirstHits<'f, 's>>> {
        let pixel_count = (TILE * TILE) as usize;
        let wanted = frame.settings.layers;
        let new = || {
            Box::new(FirstHits {
                frame,
                counts: vec![0; pixel_count],
                scales: vec![0.0; pixel_count],
                ids: vec![[0; 3]; pixel_count],
                sums: vec![vec![0.0; pixel_count]; sum_count(wanted)],
                mattes: frame.mattes.iter().map(|_| Matte::new()).collect(),
            })
        };
        (!wanted.is_empty()).then(new)
    }

    pub(in crate::render) fn clear(&mut self) {
        self.counts.fill(0);
        self.sums.iter_mut().for_each(|sums| sums.fill(0.0));
        self.mattes.iter_mut().for_each(Matte::clear);
    }

    /// Returns the bytes of all sums and lists.
    pub(in crate::render) fn byte_count(&self) -> usize {
        let sums: usize = self.sums.iter().map(|sums| size_of_val(&sums[..])).sum();
        let mattes: usize = self.mattes.iter().map(Matte::byte_count).sum();
        let counted = size_of_val(&self.counts[..]) + size_of_val(&self.scales[..]);
        size_of_val(self) + counted + size_of_val(&self.ids[..]) + sums + mattes
    }

    /// Adds the hits of a camera packet, whose `surfaces` are computed.
    pub(in crate::render) fn add(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        add(self, packet, label, surfaces);
    }

    #[inline(always)]
    fn add_inlined(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        // Count the hits and remember the first of each pixel
        let hits = PrimaryHits::of(packet, label, self.frame.shape.block as usize);
        self.count(packet, &hits);
        let scale = self.frame.scene.normalisation.scale;
        let points = &surfaces.points;
        let mut index = 0;
        // Add to the sums of the requested layers
        for kind in self.frame.settings.layers.kinds() {
            index += match kind {
                AovKind::Depth => {
                    let distances = [distances(packet, points, scale)];
                    hits.add(&distances, &mut self.sums[index..])
                }
                AovKind::Normal => hits.add(&points.ns, &mut self.sums[index..]),
                AovKind::Albedo => hits.add(&albedo(&surfaces.materials), &mut self.sums[index..]),
                AovKind::Position => hits.add(&self.positions(points), &mut self.sums[index..]),
                AovKind::Uv => hits.add(&self.tex_coords(packet, points, &hits), &mut self.sums[index..]),
                AovKind::Motion => hits.add(&self.motions(packet, &hits, points), &mut self.sums[index..]),
                AovKind::Ids | AovKind::CryptoObject | AovKind::CryptoMaterial => 0,
            };
        }
        // Add to the mattes
        for (matte, ids) in self.mattes.iter_mut().zip(self.frame.mattes.iter()) {
            for l in (0..LANES).filter(|&l| hits.has(l)) {
                matte.add(hits.pixel[l], ids[packet.instance[l] as usize]);
            }
        }
    }

    /// Counts the samples that hit a surface, and records the ids of the first hit of each pixel.
    #[inline(always)]
    fn count(&mut self, packet: &RayPacket, hits: &PrimaryHits) {
        if let PixelLayout::One(pixel) = hits.spread {
            if self.counts[pixel] == 0 {
                self.note_first(packet, hits, pixel);
            }
            self.counts[pixel] += hits.count();
            return;
        }
        for l in (0..LANES).filter(|&l| hits.has(l)) {
            let pixel = hits.pixel[l] as usize;
            if self.counts[pixel] == 0 {
                self.note(packet, l, pixel);
            }
            self.counts[pixel] += 1;
        }
    }

    /// Records the ids of the first hit of a pixel that all lanes of the packet share.
    #[inline(never)]
    fn note_first(&mut self, packet: &RayPacket, hits: &PrimaryHits, pixel: usize) {
        for l in 0..LANES {
            if hits.has(l) {
                return self.note(packet, l, pixel);
            }
        }
    }

    #[inline(always)]
    fn note(&mut self, packet: &RayPacket, l: usize, pixel: usize) {
        let instance = packet.instance[l];
        let material = self.frame.scene.instances[instance as usize].material;
        self.ids[pixel] = [instance, material, packet.primitive[l]];
    }

    /// Returns hit points in the coordinates of the scene file, before normalization.
    fn positions(&self, points: &SurfacePacket) -> Lanes3<f32> {
        let file = &self.frame.scene.normalisation;
        let center = file.center.to_array();
        std::array::from_fn(|axis| points.p[axis].map(|p| (p / file.scale + center[axis]) as f32))
    }

    fn tex_coords(&self, packet: &RayPacket, points: &SurfacePacket, hits: &PrimaryHits) -> [Lanes<f32>; 2] {
        let surfaces = &self.frame.surfaces;
        let mut coords = [[0.0; LANES]; 2];
        for l in (0..LANES).filter(|&l| hits.has(l)) {
            let pose = surfaces.pose(packet, l);
            let uv_frame = surfaces
                .view(packet.instance[l])
                .uv_frame(&pose, 0, (packet, points), l);
            [coords[0][l], coords[1][l]] = uv_frame.uv;
        }
        coords
    }

    fn motions(&self, packet: &RayPacket, hits: &PrimaryHits, points: &SurfacePacket) -> [Lanes<f32>; 2] {
        let mut motions = [[0.0; LANES]; 2];
        if let Some(motion) = &self.frame.screen_motion {
            for l in (0..LANES).filter(|&l| hits.has(l)) {
                let instance = &self.frame.scene.instances[packet.instance[l] as usize];
                let moved = motion.of(points.point(l), instance, packet.time[l]);
                [motions[0][l], motions[1][l]] = moved.as_vec2().to_array();
            }
        }
        motions
    }

    /// Returns the requested layers of a tile.
    pub(in crate::render) fn layers(&mut self, tile: Tile) -> Vec<TileLayer<'_>> {
        // Compute the factors from sums to means
        for (scale, &count) in self.scales.iter_mut().zip(&self.counts) {
            *scale = if count == 0 { 0.0 } else { f64::from(count).recip() };
        }
        let samples = self.frame.samples_taken();
        let mattes = self.mattes.iter_mut();
        // Rank the mattes; reversed so that `pop` returns them in order
        let mut mattes: Vec<Vec<Vec<f32>>> = mattes.map(|matte| matte.planes(tile, samples)).rev().collect();
        let mut sums = self.sums.iter();
        let wanted = self.frame.settings.layers;
        let mut layers = Vec::with_capacity(wanted.layer_count());
        // Collect the layers in their fixed order
        for kind in wanted.kinds() {
            match kind {
                AovKind::Ids => layers.extend((0..3).map(|part| TileLayer::Numbers {
                    numbers: &self.ids,
                    part,
                    counts: &self.counts,
                    nothing: nothing(kind),
                })),
                AovKind::CryptoObject | AovKind::CryptoMaterial => {
                    layers.extend(
                        mattes
                            .pop()
                            .unwrap_or_default()
                            .into_iter()
                            .map(TileLayer::Values),
                    );
                }
                _ => layers.extend(
                    sums.by_ref()
                        .take(kind.names().len())
                        .map(|sums| TileLayer::Means {
                            sums,
                            scales: &self.scales,
                            nothing: nothing(kind),
                        }),
                ),
            }
        }
        layers
    }
}

impl PrimaryHits {
    /// Finds the hit lanes and their pixels, for a packet over a block of `block` pixels per side.
    #[inline(always)]
    fn of(packet: &RayPacket, label: &Lanes<u32>, block: usize) -> PrimaryHits {
        let (mut keep, mut pixel) = ([0; LANES], [0; LANES]);
        for l in 0..LANES {
            keep[l] = u32::from(packet.instance[l] != NO_HIT).wrapping_neg();
            pixel[l] = pixel_of(label[l]);
        }
        let first = pixel[0] as usize;
        let spread = match block {
            1 => PixelLayout::One(first),
            BLOCK => PixelLayout::Block(first),
            _ => PixelLayout::Any,
        };
        let hits = PrimaryHits { keep, spread, pixel };
        debug_assert!((0..LANES).all(|l| !hits.has(l) || hits.is_in_place(l)));
        hits
    }

    /// Returns whether the pixel of a lane agrees with the spread.
    fn is_in_place(&self, l: usize) -> bool {
        let pixel = self.pixel[l] as usize;
        match self.spread {
            PixelLayout::One(only) => pixel == only,
            PixelLayout::Block(first) => pixel == first + l / BLOCK * TILE as usize + l % BLOCK,
            PixelLayout::Any => true,
        }
    }

    /// Returns whether a lane hit a surface.
    #[inline(always)]
    fn has(&self, l: usize) -> bool {
        self.keep[l] != 0
    }

    /// Returns the number of lanes that hit a surface.
    #[inline(always)]
    fn count(&self) -> u32 {
        let mut ones = self.keep;
        for one in &mut ones {
            *one &= 1;
        }
        sum_of_lanes(ones)
    }

    /// Adds one value per lane to the sums of their pixels, and returns the number of values.
    #[inline(always)]
    fn add<const N: usize>(&self, values: &[Lanes<f32>; N], sums: &mut [Vec<f64>]) -> usize {
        for (values, sums) in values.iter().zip(sums) {
            // Lanes without a hit may hold any bits, also NaN.
            let mut kept = [0.0; LANES];
            for l in 0..LANES {
                kept[l] = f32::from_bits(values[l].to_bits() & self.keep[l]);
            }
            self.add_kept(kept, sums);
        }
        N
    }

    #[inline(always)]
    fn add_kept(&self, values: Lanes<f32>, sums: &mut [f64]) {
        match self.spread {
            PixelLayout::One(pixel) => sums[pixel] += f64::from(sum_of_lanes(values)),
            PixelLayout::Block(first) => {
                let (rows, _) = values.as_chunks::<BLOCK>();
                for (row, values) in rows.iter().enumerate() {
                    let start = first + row * TILE as usize;
                    for (sum, &value) in sums[start..start + BLOCK].iter_mut().zip(values) {
                        *sum += f64::from(value);
                    }
                }
            }
            PixelLayout::Any => {
                for l in 0..LANES {
                    sums[self.pixel[l] as usize] += f64::from(values[l]);
                }
            }
        }
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn add(hits: &mut FirstHits, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
    hits.add_inlined(packet, label, surfaces);
}

/// Returns the value of a layer for pixels without hits.
fn nothing(kind: AovKind) -> f32 {
    match kind {
        AovKind::Depth => f32::INFINITY,
        AovKind::Ids => -1.0,
        _ => 0.0,
    }
}

/// Returns the number of requested layers that are means of sums.
fn sum_count(wanted: AovSet) -> usize {
    let summed = wanted.kinds().filter(|kind| kind.is_sum());
    summed.map(|kind| kind.names().len()).sum()
}

/// Returns the distances from ray origins to hit points, divided by `scale` to give file units.
#[inline(always)]
fn distances(packet: &RayPacket, points: &SurfacePacket, scale: f64) -> Lanes<f32> {
    let unit = scale.recip();
    let (mut ways, mut distances) = ([[0.0; LANES]; 3], [0.0; LANES]);
    for (axis, ways) in ways.iter_mut().enumerate() {
        for l in 0..LANES {
            ways[l] = (points.p[axis][l] - f64::from(packet.origin[axis][l])) as f32;
        }
    }
    let [x, y, z] = ways;
    for l in 0..LANES {
        let distance = (x[l] * x[l] + y[l] * y[l] + z[l] * z[l]).sqrt();
        distances[l] = (f64::from(distance) * unit) as f32;
    }
    distances
}

/// Returns the albedo without specular reflection; for Phong materials, multiplied by the diffuse coefficient.
#[inline(always)]
fn albedo(materials: &MaterialPacket) -> Lanes3<f32> {
    let mut albedo = materials.base_color;
    let extended = &materials.extended;
    if extended.is_phong.contains(&true) {
        for channel in 0..3 {
            for l in (0..LANES).filter(|&l| extended.is_phong[l]) {
                albedo[channel][l] *= extended.diffuse[channel][l];
            }
        }
    }
    albedo
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_without_hit_add_nothing() {
        let mut value = [f32::NAN; LANES];
        (value[2], value[9]) = (0.5, 4.0);
        let mut packet = RayPacket::EMPTY;
        packet.instance = value.map(|value| if value.is_nan() { NO_HIT } else { 0 });
        let of_block: Lanes<u32> = std::array::from_fn(|l| 33 + l as u32 % 4 + 32 * (l as u32 / 4));
        let mut of_any = [7; LANES];
        of_any[9] = 8;
        // Pixels of the lanes, expected pixels of lanes 2 and 9, and the side of the block.
        for (pixel, places, block) in [
            ([3; LANES], [3, 3], 1),
            (of_block, [35, 98], 4),
            (of_any, [7, 8], 2),
        ] {
            let hits = PrimaryHits::of(&packet, &pixel, block);
            assert_eq!(hits.count(), 2);
            let mut sums = vec![vec![1.0; (TILE * TILE) as usize]; 2];
            assert_eq!(hits.add(&[value], &mut sums), 1);
            let mut expected = vec![1.0; (TILE * TILE) as usize];
            expected[places[0]] += 0.5;
            expected[places[1]] += 4.0;
            assert!(sums[0] == expected && sums[1] == vec![1.0; sums[1].len()]);
        }
    }

    #[test]
    fn layers_that_are_not_means_have_no_sums() {
        assert_eq!(
            sum_count(AovKind::ALL.into_iter().collect()),
            1 + 3 + 3 + 3 + 2 + 2
        );
        assert_eq!(sum_count(AovSet::NONE.with(AovKind::Ids)), 0);
    }
}
