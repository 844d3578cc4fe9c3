//! What the camera rays of a tile met first, summed up pixel by pixel for the picture's [layers](super::layers).
//!
//! Hits are those that are shaded, with the points and materials that shading takes: a layer costs its sums. Whoever
//! wants none pays for one question a packet.

use multiversion::multiversion;

use super::Frame;
use super::film::{TILE, Tile};
use super::layers::{LayerKind, LayerSet};
use super::mattes::Matte;
use super::planes::TileLayer;
use super::samples::pixel_of;
use super::surface::{SurfacePacket, Surfaces};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, sum_of_lanes};
use crate::shading::MaterialPacket;

/// Pixels to a side of the block that a packet of a sample a pixel covers.
const BLOCK: usize = 4;

/// The working memory of one thread.
pub(super) struct FirstHits<'f, 's> {
    frame: &'f Frame<'s>,
    /// Of each pixel, `TILE` to a row: samples that met anything.
    counts: Vec<u32>,
    /// What makes means of sums over them; 0 where there are none.
    scales: Vec<f64>,
    /// Instance, material and primitive of the first of them.
    ids: Vec<[u32; 3]>,
    /// Sums over them: of each wanted layer, in their order, but for the ids.
    sums: Vec<Vec<f64>>,
    /// Those that are wanted, in their order.
    mattes: Vec<Matte>,
}

/// The lanes of a packet that met anything, and their pixels.
struct Met {
    /// All bits of the lanes that did, none of the others.
    keep: Lanes<u32>,
    pixel: Lanes<u32>,
    spread: Spread,
}

/// How pixels are spread over lanes.
enum Spread {
    /// All have this one.
    One(usize),
    /// They have a block of neighbours, row by row, this one first.
    Block(usize),
    /// In another way.
    Any,
}

impl<'f, 's> FirstHits<'f, 's> {
    /// Where somebody wants layers.
    pub(super) fn of(frame: &'f Frame<'s>) -> Option<Box<FirstHits<'f, 's>>> {
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

    pub(super) fn clear(&mut self) {
        self.counts.fill(0);
        self.sums.iter_mut().for_each(|sums| sums.fill(0.0));
        self.mattes.iter_mut().for_each(Matte::clear);
    }

    /// Bytes of all of it.
    pub(super) fn byte_count(&self) -> usize {
        let sums: usize = self.sums.iter().map(|sums| size_of_val(&sums[..])).sum();
        let mattes: usize = self.mattes.iter().map(Matte::byte_count).sum();
        let counted = size_of_val(&self.counts[..]) + size_of_val(&self.scales[..]);
        size_of_val(self) + counted + size_of_val(&self.ids[..]) + sums + mattes
    }

    /// Adds what a camera packet has met, `surfaces` worked out.
    pub(super) fn add(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        add(self, packet, label, surfaces);
    }

    #[inline(always)]
    fn add_inlined(&mut self, packet: &RayPacket, label: &Lanes<u32>, surfaces: &Surfaces) {
        let met = Met::of(packet, label, self.frame.shape.block as usize);
        self.count(packet, &met);
        let scale = self.frame.scene.normalisation.scale;
        let points = &surfaces.points;
        let mut place = 0;
        for kind in self.frame.settings.layers.kinds() {
            place += match kind {
                LayerKind::Depth => {
                    let distances = [distances(packet, points, scale)];
                    met.add(&distances, &mut self.sums[place..])
                }
                LayerKind::Normal => met.add(&points.ns, &mut self.sums[place..]),
                LayerKind::Albedo => met.add(&albedo(&surfaces.materials), &mut self.sums[place..]),
                LayerKind::Position => met.add(&self.positions(points), &mut self.sums[place..]),
                LayerKind::Uv => met.add(&self.tex_coords(packet, &met), &mut self.sums[place..]),
                LayerKind::Motion => met.add(&self.motions(packet, &met, points), &mut self.sums[place..]),
                LayerKind::Ids | LayerKind::CryptoObject | LayerKind::CryptoMaterial => 0,
            };
        }
        for (matte, ids) in self.mattes.iter_mut().zip(self.frame.mattes.iter()) {
            for l in (0..LANES).filter(|&l| met.has(l)) {
                matte.add(met.pixel[l], ids[packet.instance[l] as usize]);
            }
        }
    }

    /// Counts the samples that met anything, and notes what the first of a pixel met.
    #[inline(always)]
    fn count(&mut self, packet: &RayPacket, met: &Met) {
        if let Spread::One(pixel) = met.spread {
            if self.counts[pixel] == 0 {
                self.note_first(packet, met, pixel);
            }
            self.counts[pixel] += met.count();
            return;
        }
        for l in (0..LANES).filter(|&l| met.has(l)) {
            let pixel = met.pixel[l] as usize;
            if self.counts[pixel] == 0 {
                self.note(packet, l, pixel);
            }
            self.counts[pixel] += 1;
        }
    }

    /// What the first of a pixel's samples met, where all of the packet are.
    #[inline(never)]
    fn note_first(&mut self, packet: &RayPacket, met: &Met, pixel: usize) {
        for l in 0..LANES {
            if met.has(l) {
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

    /// Places in the file's coordinates.
    fn positions(&self, points: &SurfacePacket) -> Lanes3<f32> {
        let file = &self.frame.scene.normalisation;
        let center = file.center.to_array();
        std::array::from_fn(|axis| points.p[axis].map(|p| (p / file.scale + center[axis]) as f32))
    }

    fn tex_coords(&self, packet: &RayPacket, met: &Met) -> [Lanes<f32>; 2] {
        let surfaces = &self.frame.surfaces;
        let mut coords = [[0.0; LANES]; 2];
        for l in (0..LANES).filter(|&l| met.has(l)) {
            let pose = surfaces.pose(packet, l);
            let chart = surfaces.view(packet.instance[l]).chart(&pose, 0, packet, l);
            [coords[0][l], coords[1][l]] = chart.uv;
        }
        coords
    }

    fn motions(&self, packet: &RayPacket, met: &Met, points: &SurfacePacket) -> [Lanes<f32>; 2] {
        let mut motions = [[0.0; LANES]; 2];
        if let Some(motion) = &self.frame.screen_motion {
            for l in (0..LANES).filter(|&l| met.has(l)) {
                let instance = &self.frame.scene.instances[packet.instance[l] as usize];
                let moved = motion.of(points.point(l), instance, packet.time[l]);
                [motions[0][l], motions[1][l]] = moved.as_vec2().to_array();
            }
        }
        motions
    }

    /// The wanted layers of a tile.
    pub(super) fn layers(&mut self, tile: Tile) -> Vec<TileLayer<'_>> {
        for (scale, &count) in self.scales.iter_mut().zip(&self.counts) {
            *scale = if count == 0 { 0.0 } else { f64::from(count).recip() };
        }
        let samples = self.frame.samples_taken();
        let mattes = self.mattes.iter_mut();
        let mut mattes: Vec<Vec<Vec<f32>>> = mattes.map(|matte| matte.planes(tile, samples)).rev().collect();
        let mut sums = self.sums.iter();
        let wanted = self.frame.settings.layers;
        let mut layers = Vec::with_capacity(wanted.layer_count());
        for kind in wanted.kinds() {
            match kind {
                LayerKind::Ids => layers.extend((0..3).map(|part| TileLayer::Numbers {
                    numbers: &self.ids,
                    part,
                    counts: &self.counts,
                    nothing: nothing(kind),
                })),
                LayerKind::CryptoObject | LayerKind::CryptoMaterial => {
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

impl Met {
    /// Of a packet over blocks of so many pixels to a side.
    #[inline(always)]
    fn of(packet: &RayPacket, label: &Lanes<u32>, block: usize) -> Met {
        let (mut keep, mut pixel) = ([0; LANES], [0; LANES]);
        for l in 0..LANES {
            keep[l] = u32::from(packet.instance[l] != NO_HIT).wrapping_neg();
            pixel[l] = pixel_of(label[l]);
        }
        let first = pixel[0] as usize;
        let spread = match block {
            1 => Spread::One(first),
            BLOCK => Spread::Block(first),
            _ => Spread::Any,
        };
        let met = Met { keep, spread, pixel };
        debug_assert!((0..LANES).all(|l| !met.has(l) || met.is_in_place(l)));
        met
    }

    /// Whether a lane's pixel is where the spread has it.
    fn is_in_place(&self, l: usize) -> bool {
        let pixel = self.pixel[l] as usize;
        match self.spread {
            Spread::One(only) => pixel == only,
            Spread::Block(first) => pixel == first + l / BLOCK * TILE as usize + l % BLOCK,
            Spread::Any => true,
        }
    }

    /// Whether a lane met anything.
    #[inline(always)]
    fn has(&self, l: usize) -> bool {
        self.keep[l] != 0
    }

    /// How many did.
    #[inline(always)]
    fn count(&self) -> u32 {
        let mut ones = self.keep;
        for one in &mut ones {
            *one &= 1;
        }
        sum_of_lanes(ones)
    }

    /// Adds values of the lanes, each to a sum of their pixels; how many values that were.
    #[inline(always)]
    fn add<const N: usize>(&self, values: &[Lanes<f32>; N], sums: &mut [Vec<f64>]) -> usize {
        for (values, sums) in values.iter().zip(sums) {
            // Whatever other lanes hold, numbers or not.
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
            Spread::One(pixel) => sums[pixel] += f64::from(sum_of_lanes(values)),
            Spread::Block(first) => {
                let (rows, _) = values.as_chunks::<BLOCK>();
                for (row, values) in rows.iter().enumerate() {
                    let start = first + row * TILE as usize;
                    for (sum, &value) in sums[start..start + BLOCK].iter_mut().zip(values) {
                        *sum += f64::from(value);
                    }
                }
            }
            Spread::Any => {
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

/// What a layer holds where nothing is met.
fn nothing(kind: LayerKind) -> f32 {
    match kind {
        LayerKind::Depth => f32::INFINITY,
        LayerKind::Ids => -1.0,
        _ => 0.0,
    }
}

/// How many of the wanted layers are sums.
fn sum_count(wanted: LayerSet) -> usize {
    let summed = wanted.kinds().filter(|kind| kind.is_sum());
    summed.map(|kind| kind.names().len()).sum()
}

/// From where rays start to the points, in a unit of which there are `scale`.
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

/// What part of the light that arrives surfaces may send back without a highlight.
#[inline(always)]
fn albedo(materials: &MaterialPacket) -> Lanes3<f32> {
    let mut albedo = materials.base_color;
    let rich = &materials.rich;
    if rich.is_lecture.contains(&true) {
        for channel in 0..3 {
            for l in (0..LANES).filter(|&l| rich.is_lecture[l]) {
                albedo[channel][l] *= rich.diffuse[channel][l];
            }
        }
    }
    albedo
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_without_a_hit_add_nothing_however_pixels_are_spread() {
        let mut value = [f32::NAN; LANES];
        (value[2], value[9]) = (0.5, 4.0);
        let mut packet = RayPacket::EMPTY;
        packet.instance = value.map(|value| if value.is_nan() { NO_HIT } else { 0 });
        let of_block: Lanes<u32> = std::array::from_fn(|l| 33 + l as u32 % 4 + 32 * (l as u32 / 4));
        let mut of_any = [7; LANES];
        of_any[9] = 8;
        // Pixels of lanes 2 and 9, and to how large a block they belong.
        for (pixel, places, block) in [
            ([3; LANES], [3, 3], 1),
            (of_block, [35, 98], 4),
            (of_any, [7, 8], 2),
        ] {
            let met = Met::of(&packet, &pixel, block);
            assert_eq!(met.count(), 2);
            let mut sums = vec![vec![1.0; (TILE * TILE) as usize]; 2];
            assert_eq!(met.add(&[value], &mut sums), 1);
            let mut expected = vec![1.0; (TILE * TILE) as usize];
            expected[places[0]] += 0.5;
            expected[places[1]] += 4.0;
            assert!(sums[0] == expected && sums[1] == vec![1.0; sums[1].len()]);
        }
    }

    #[test]
    fn layers_that_are_no_means_have_no_sums() {
        assert_eq!(
            sum_count(LayerKind::ALL.into_iter().collect()),
            1 + 3 + 3 + 3 + 2 + 2
        );
        assert_eq!(sum_count(LayerSet::NONE.with(LayerKind::Ids)), 0);
    }
}
