//! What the camera rays of a tile met first, summed up pixel by pixel for the picture's [layers](super::layers).
//!
//! Hits are those that are shaded, with the points and materials that shading takes: a layer costs its sums. Whoever wants
//! none pays for one question a packet.

use multiversion::multiversion;

use super::Frame;
use super::film::{self, TILE, Tile};
use super::layers::{LayerKind, LayerSet};
use super::mattes::Matte;
use super::planes::TileLayer;
use super::samples::pixel_of;
use super::surface::{SurfacePacket, Surfaces};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, sum_of_lanes};
use crate::shading::MaterialPacket;

/// Layers that are sums, at most.
const MOST_SUMS: usize = 14;

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
    /// What a packet adds to each of the sums.
    rows: [Lanes<f32>; MOST_SUMS],
}

/// The lanes of a packet that met anything, and their pixels.
struct Met {
    hit: Lanes<bool>,
    pixel: Lanes<usize>,
    /// The pixel of all lanes, if it is one.
    only: Option<usize>,
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
                rows: [[0.0; LANES]; MOST_SUMS],
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
        let met = Met::of(packet, label);
        if !met.hit.contains(&true) {
            return;
        }
        self.count(packet, &met);
        let mut place = 0;
        for kind in self.frame.settings.layers.kinds() {
            let rows = &mut self.rows[place..];
            place += match kind {
                LayerKind::Depth => {
                    distances(
                        packet,
                        &surfaces.points,
                        self.frame.scene.normalisation.scale,
                        &mut rows[0],
                    );
                    1
                }
                LayerKind::Normal => copied(&surfaces.points.ns, rows),
                LayerKind::Albedo => albedo(&surfaces.materials, rows),
                LayerKind::Position => self.positions(&surfaces.points, place),
                LayerKind::Uv => self.tex_coords(packet, &met, place),
                LayerKind::Motion => self.motions(packet, &met, &surfaces.points, place),
                LayerKind::Ids | LayerKind::CryptoObject | LayerKind::CryptoMaterial => 0,
            };
        }
        for (matte, ids) in self.mattes.iter_mut().zip(self.frame.mattes.iter()) {
            for l in (0..LANES).filter(|&l| met.hit[l]) {
                matte.add(met.pixel[l] as u32, ids[packet.instance[l] as usize]);
            }
        }
        for (sums, row) in self.sums.iter_mut().zip(&self.rows) {
            met.add(row, sums);
        }
    }

    /// Counts the samples that met anything, and notes what the first of a pixel met.
    #[inline(always)]
    fn count(&mut self, packet: &RayPacket, met: &Met) {
        if let Some(pixel) = met.only {
            let count = met.hit.iter().map(|&hit| u32::from(hit)).sum::<u32>();
            if self.counts[pixel] == 0
                && let Some(first) = met.hit.iter().position(|&hit| hit)
            {
                self.note(packet, first, pixel);
            }
            self.counts[pixel] += count;
            return;
        }
        for l in (0..LANES).filter(|&l| met.hit[l]) {
            let pixel = met.pixel[l];
            if self.counts[pixel] == 0 {
                self.note(packet, l, pixel);
            }
            self.counts[pixel] += 1;
        }
    }

    #[inline(always)]
    fn note(&mut self, packet: &RayPacket, l: usize, pixel: usize) {
        let instance = packet.instance[l];
        let material = self.frame.scene.instances[instance as usize].material;
        self.ids[pixel] = [instance, material, packet.primitive[l]];
    }

    /// Places in the file's coordinates.
    fn positions(&mut self, points: &SurfacePacket, place: usize) -> usize {
        let file = &self.frame.scene.normalisation;
        let center = file.center.to_array();
        for axis in 0..3 {
            self.rows[place + axis] = points.p[axis].map(|p| (p / file.scale + center[axis]) as f32);
        }
        3
    }

    fn tex_coords(&mut self, packet: &RayPacket, met: &Met, place: usize) -> usize {
        let surfaces = &self.frame.surfaces;
        for l in (0..LANES).filter(|&l| met.hit[l]) {
            let pose = surfaces.pose(packet, l);
            let chart = surfaces.view(packet.instance[l]).chart(&pose, 0, packet, l);
            [self.rows[place][l], self.rows[place + 1][l]] = chart.uv;
        }
        2
    }

    fn motions(&mut self, packet: &RayPacket, met: &Met, points: &SurfacePacket, place: usize) -> usize {
        if let Some(motion) = &self.frame.screen_motion {
            for l in (0..LANES).filter(|&l| met.hit[l]) {
                let instance = &self.frame.scene.instances[packet.instance[l] as usize];
                let moved = motion.of(points.point(l), instance, packet.time[l]);
                [self.rows[place][l], self.rows[place + 1][l]] = moved.as_vec2().to_array();
            }
        }
        2
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
                LayerKind::Ids => {
                    layers.extend((0..3).map(|part| TileLayer::Values(self.ids_of(tile, part))))
                }
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

    fn ids_of(&self, tile: Tile, part: usize) -> Vec<f32> {
        let nothing = nothing(LayerKind::Ids);
        let id = |(&count, ids): (&u32, &[u32; 3])| if count == 0 { nothing } else { ids[part] as f32 };
        film::cut(tile, &self.counts)
            .zip(film::cut(tile, &self.ids))
            .map(id)
            .collect()
    }
}

impl Met {
    #[inline(always)]
    fn of(packet: &RayPacket, label: &Lanes<u32>) -> Met {
        let pixel = label.map(|label| pixel_of(label) as usize);
        let differ = pixel.iter().fold(0, |differ, other| differ | (other ^ pixel[0]));
        Met {
            hit: packet.instance.map(|instance| instance != NO_HIT),
            only: (differ == 0).then_some(pixel[0]),
            pixel,
        }
    }

    /// Adds one value a lane to the sums of pixels.
    #[inline(always)]
    fn add(&self, row: &Lanes<f32>, sums: &mut [f64]) {
        let row: Lanes<f32> = std::array::from_fn(|l| if self.hit[l] { row[l] } else { 0.0 });
        if let Some(pixel) = self.only {
            sums[pixel] += f64::from(sum_of_lanes(row));
            return;
        }
        for l in 0..LANES {
            sums[self.pixel[l]] += f64::from(row[l]);
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
fn distances(packet: &RayPacket, points: &SurfacePacket, scale: f64, row: &mut Lanes<f32>) {
    let unit = scale.recip();
    for l in 0..LANES {
        let way = |axis: usize| (points.p[axis][l] - f64::from(packet.origin[axis][l])) as f32;
        let [x, y, z] = [way(0), way(1), way(2)];
        row[l] = (f64::from((x * x + y * y + z * z).sqrt()) * unit) as f32;
    }
}

#[inline(always)]
fn copied(lanes: &Lanes3<f32>, rows: &mut [Lanes<f32>]) -> usize {
    for (row, lanes) in rows.iter_mut().zip(lanes) {
        *row = *lanes;
    }
    3
}

/// What part of the light that arrives surfaces may send back without a highlight.
#[inline(always)]
fn albedo(materials: &MaterialPacket, rows: &mut [Lanes<f32>]) -> usize {
    copied(&materials.base_color, rows);
    let rich = &materials.rich;
    if rich.is_lecture.contains(&true) {
        for channel in 0..3 {
            for l in (0..LANES).filter(|&l| rich.is_lecture[l]) {
                rows[channel][l] *= rich.diffuse[channel][l];
            }
        }
    }
    3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_without_a_hit_add_nothing_to_one_pixel_or_to_several() {
        let mut row = [f32::NAN; LANES];
        (row[2], row[9]) = (0.5, 4.0);
        let mut met = Met {
            hit: row.map(|value| !value.is_nan()),
            pixel: [3; LANES],
            only: Some(3),
        };
        let mut sums = [1.0; 5];
        met.add(&row, &mut sums);
        assert_eq!(sums, [1.0, 1.0, 1.0, 5.5, 1.0]);
        met.pixel[9] = 4;
        met.only = None;
        met.add(&row, &mut sums);
        assert_eq!(sums, [1.0, 1.0, 1.0, 6.0, 5.0]);
    }

    #[test]
    fn there_is_room_for_all_sums() {
        assert_eq!(sum_count(LayerKind::ALL.into_iter().collect()), MOST_SUMS);
        assert_eq!(sum_count(LayerSet::NONE.with(LayerKind::Ids)), 0);
    }
}
