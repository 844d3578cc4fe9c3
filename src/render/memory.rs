//! Memory use of a render by holder: every byte is attributed to one effect, account or structure.
//!
//! Sizes are actual ones: capacities of queues and arrays, mesh data, decoded images and data derived from them. The
//! memory of all threads together is recorded after each tile, because their queues grow on demand and never shrink;
//! all other sizes follow from the image and the scene. With the ledger off, nothing is recorded.

use std::sync::{Mutex, PoisonError};

use super::estimate::PixelStatistics;
use super::film::{self, Tile};
use super::surface::InstanceView;
use super::wave::TileResult;
use super::{PixelCosts, RenderContext, RenderProfile};
use crate::accel::AccelReport;
use crate::mesh::Mesh;
use crate::scene::{Background, Effect, EffectSet, Geometry, Instance, Scene, Texture};

/// Entry of the memory statistics.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MemoryEntry {
    /// Holder: the name of an effect or of an account; `geometry`, `instances`, `triangles`, `user-geometry`, `tree`
    /// or `extents` for data that serves to find hits; `unused` for data of the scene that no active effect reads.
    pub holder: &'static str,
    /// Description of the data.
    pub what: &'static str,
    /// Size in bytes, at its peak.
    pub bytes: u64,
}

/// Memory statistics of a render; empty with the ledger off.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memory {
    holdings: Vec<MemoryEntry>,
    at_once: u64,
}

impl Memory {
    /// Returns all entries, none of which is empty.
    pub fn holdings(&self) -> &[MemoryEntry] {
        &self.holdings
    }

    /// Returns the bytes that are attributed to `holder`.
    pub fn of(&self, holder: &str) -> u64 {
        let held = self.holdings.iter().filter(|holding| holding.holder == holder);
        held.map(|holding| holding.bytes).sum()
    }

    /// Returns the largest number of bytes in use at the same time: thread memory is freed before the image is
    /// assembled.
    pub fn at_once(&self) -> u64 {
        self.at_once
    }

    /// Returns the sum of all entries, each at its own peak.
    pub fn total(&self) -> u64 {
        self.holdings.iter().map(|holding| holding.bytes).sum()
    }

    /// Adds `bytes` to an entry, which is created if necessary.
    pub(super) fn add(&mut self, holder: &'static str, what: &'static str, bytes: usize) {
        if bytes == 0 {
            return;
        }
        let bytes = bytes as u64;
        let known = self.holdings.iter_mut();
        match known
            .into_iter()
            .find(|holding| holding.holder == holder && holding.what == what)
        {
            Some(holding) => holding.bytes += bytes,
            None => self.holdings.push(MemoryEntry { holder, what, bytes }),
        }
    }

    fn add_all(&mut self, other: &Memory) {
        for holding in &other.holdings {
            self.add(holding.holder, holding.what, holding.bytes as usize);
        }
    }

    fn remove_all(&mut self, other: &Memory) {
        for gone in &other.holdings {
            let is_it =
                |holding: &&mut MemoryEntry| (holding.holder, holding.what) == (gone.holder, gone.what);
            if let Some(holding) = self.holdings.iter_mut().find(is_it) {
                holding.bytes -= gone.bytes;
            }
        }
    }
}

/// Memory of all threads of a render together.
#[derive(Debug, Default)]
pub(super) struct ThreadMemory(Mutex<PeakMemory>);

#[derive(Debug, Default)]
struct PeakMemory {
    now: Memory,
    /// Memory of the threads when it was largest.
    peak: Memory,
    /// Bytes of the pixels of finished tiles.
    finished: u64,
    /// Largest sum of thread memory and finished tiles.
    max_bytes: u64,
    /// Largest number of bytes of a round of adaptive sampling.
    max_round_bytes: u64,
}

impl ThreadMemory {
    /// Records that the memory of a thread changed from `before` to `after`.
    fn change(&self, before: &Memory, after: &Memory) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.now.remove_all(before);
        watched.now.add_all(after);
        watched.max_bytes = watched.max_bytes.max(watched.now.total() + watched.finished);
        // Keep a copy of the entries at the peak
        if watched.now.total() > watched.peak.total() {
            watched.peak = watched.now.clone();
        }
    }

    /// Records the bytes of a finished tile.
    fn finish(&self, bytes: usize) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.finished += bytes as u64;
        watched.max_bytes = watched.max_bytes.max(watched.now.total() + watched.finished);
    }

    /// Records the bytes of a round of adaptive sampling: estimates of the image and results of its visits.
    pub(super) fn note_round(&self, bytes: usize) {
        let mut watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.max_round_bytes = watched.max_round_bytes.max(bytes as u64);
    }

    fn max_round_bytes(&self) -> u64 {
        let watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        watched.max_round_bytes
    }

    /// Returns the memory of the threads when it was largest, and the largest sum of thread memory and finished
    /// tiles.
    fn peak(&self) -> (Memory, u64) {
        let watched = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        (watched.peak.clone(), watched.max_bytes)
    }
}

/// Memory of one thread, as recorded last.
pub(super) struct ThreadFootprint<'f> {
    together: &'f ThreadMemory,
    noted: Memory,
}

impl<'f> ThreadFootprint<'f> {
    pub(super) fn new(together: &'f ThreadMemory) -> ThreadFootprint<'f> {
        ThreadFootprint {
            together,
            noted: Memory::default(),
        }
    }

    /// Records the current memory of the thread, and the bytes of output finished since the last call.
    pub(super) fn note(&mut self, memory: Memory, finished: usize) {
        if memory != self.noted {
            self.together.change(&self.noted, &memory);
            self.noted = memory;
        }
        self.together.finish(finished);
    }
}

impl Drop for ThreadFootprint<'_> {
    fn drop(&mut self) {
        self.together.change(&self.noted, &Memory::default());
    }
}

impl RenderContext<'_> {
    /// Returns the memory of the whole render, each entry at its peak.
    pub(super) fn memory(&self) -> Memory {
        let Some(threads) = &self.thread_memory else {
            return Memory::default();
        };
        // Collect thread memory, film, scene and acceleration structure
        let (mut memory, max_tile_bytes) = threads.peak();
        let of_threads = memory.total();
        self.add_film(&mut memory);
        self.add_geometry(&mut memory);
        self.add_appearance(&mut memory);
        add_accel(&self.accel.report(), &mut memory);
        // Replace parts that do not exist at the same time by their maximum
        let (counted, at_once) = self.phases(threads, max_tile_bytes);
        memory.at_once = memory.total() - of_threads - counted + at_once;
        memory
    }

    /// Returns the bytes that do not all exist at the same time, and the maximum of them that does: during sampling
    /// or during assembly of the image.
    fn phases(&self, threads: &ThreadMemory, max_tile_bytes: u64) -> (u64, u64) {
        let image = self.picture_bytes() as u64;
        if self.settings.target().is_some() {
            // Adaptive sampling keeps estimates instead of tiles
            let rounds = threads.max_round_bytes();
            let estimates = (self.pixel_count() * size_of::<PixelStatistics>()) as u64;
            return (rounds + image, (rounds + max_tile_bytes).max(estimates + image));
        }
        let put_together = self.all_tile_bytes() as u64 + image;
        (put_together, max_tile_bytes.max(put_together))
    }

    /// Returns the bytes that a finished tile keeps until the image is assembled.
    pub(super) fn tile_bytes(&self, tile: Tile) -> usize {
        let settings = &self.settings;
        let estimate = if settings.sample_aovs {
            size_of::<PixelStatistics>()
        } else {
            0
        };
        let pixel = size_of::<[f32; 3]>() + estimate + settings.filter.bytes_per_pixel() as usize;
        (tile.width * tile.height) as usize * pixel + size_of::<((Tile, TileResult), RenderProfile)>()
    }

    /// Returns the bytes that all tiles keep when the last one is finished.
    fn all_tile_bytes(&self) -> usize {
        let tiles = film::tiles(self.settings.width, self.settings.height).into_iter();
        tiles.map(|tile| self.tile_bytes(tile)).sum()
    }

    fn pixel_count(&self) -> usize {
        self.settings.width as usize * self.settings.height as usize
    }

    fn picture_bytes(&self) -> usize {
        self.pixel_count() * size_of::<[f32; 3]>()
    }

    /// Returns the number of requested layers of all kinds.
    pub(super) fn layer_count(&self) -> usize {
        self.settings.layers.layer_count() + self.light_sheet.layer_count()
    }

    /// Adds data whose size is proportional to the image.
    fn add_film(&self, memory: &mut Memory) {
        let settings = &self.settings;
        let pixels = self.pixel_count();
        memory.add("film", "the image", self.picture_bytes());
        // Add the estimates of adaptive sampling, or the tiles kept until assembly
        if settings.target().is_some() {
            let rounds = self
                .thread_memory
                .as_ref()
                .map_or(0, ThreadMemory::max_round_bytes);
            memory.add("sampling", "estimates", rounds as usize);
        } else {
            memory.add("film", "images of tiles", self.all_tile_bytes());
            if settings.sample_aovs {
                memory.add("sampling", "estimates", pixels * size_of::<PixelStatistics>());
            }
        }
        if settings.sample_aovs {
            memory.add("sampling", "counts and variances", pixels * 2 * size_of::<f32>());
        }
        // Add layers and costs
        memory.add("film", "layers", pixels * self.layer_count() * size_of::<f32>());
        memory.add("film", "Cryptomatte ids", self.mattes.byte_count());
        if self.costs.is_some() {
            memory.add("other", "costs of pixels", pixels * PixelCosts::BYTES);
        }
        memory.add("sampling", "positions of samples", size_of_val(&self.groups[..]));
    }

    /// Adds meshes, shapes and instances.
    fn add_geometry(&self, memory: &mut Memory) {
        let scene = self.scene;
        for geometry in &scene.geometries {
            memory.add("geometry", "records", size_of::<Geometry>());
            if let Geometry::Mesh(mesh) = geometry {
                add_mesh(mesh, self.effects(), memory);
            }
        }
        let instances = &scene.instances;
        let heap: usize = instances.iter().map(Instance::heap_byte_count).sum();
        memory.add("instances", "placements", size_of_val(&instances[..]) + heap);
        let views = instances.len() * size_of::<InstanceView>();
        memory.add("instances", "views of the renderer", views);
    }

    /// Adds images and volumes, and data derived from them.
    fn add_appearance(&self, memory: &mut Memory) {
        let (scene, effects) = (self.scene, self.effects());
        // Attribute each image to the effect that reads it
        for (image, effect) in scene.images.iter().zip(image_effects(scene, effects)) {
            let bytes = image.texels.byte_count() as usize;
            memory.add(effect.map_or(UNUSED, Effect::name), "decoded images", bytes);
        }
        let levels = self.surfaces.textures().level_byte_count();
        memory.add(Effect::TextureFilter.name(), "mip levels of images", levels);
        // Add data derived from images and volumes
        if let Some(environment) = &self.environment {
            let holder = match effects.has(Effect::Environment) {
                true => Effect::Environment,
                false => Effect::Background,
            };
            memory.add(holder.name(), "map and tables", environment.byte_count());
        }
        let scattered = self.bodies.as_ref().map_or(0, |bodies| bodies.stats.bytes);
        memory.add(
            Effect::Subsurface.name(),
            "trees of subsurface samples",
            scattered as usize,
        );
        let holder = holder(Effect::Volume, effects);
        for volume in &scene.volumes {
            memory.add(holder, "grids", volume.memory());
            memory.add(holder, "blocks of empty space", volume.empty_space().byte_count());
        }
    }
}

/// Holder of data of the scene that no active effect reads.
const UNUSED: &str = "unused";

/// Returns the holder of data that only `effect` reads.
fn holder(effect: Effect, on: EffectSet) -> &'static str {
    if on.has(effect) { effect.name() } else { UNUSED }
}

/// Adds the arrays of a mesh, each for the effect that needs it; those of a memory-mapped file are its pages.
fn add_mesh(mesh: &Mesh, on: EffectSet, memory: &mut Memory) {
    let corners = size_of_val(&mesh.positions[..]) + size_of_val(&mesh.triangles[..]);
    memory.add("geometry", "positions and triangles", corners);
    let mut add = |effect: Effect, what, bytes: usize| memory.add(holder(effect, on), what, bytes);
    let normals = mesh.normals.as_ref().map_or(0, |array| size_of_val(&array[..]));
    add(Effect::SmoothNormals, "vertex normals", normals);
    let tangents = mesh.tangents.as_ref().map_or(0, |array| size_of_val(&array[..]));
    add(Effect::NormalMap, "vertex tangents", tangents);
    let colors = mesh.colors.as_ref().map_or(0, |array| size_of_val(&array[..]));
    add(Effect::VertexColor, "vertex colours", colors);
    let coordinates = mesh.tex_coords.iter().map(|array| size_of_val(&array[..])).sum();
    let lookers = [Effect::Texture, Effect::NormalMap, Effect::Occlusion];
    let looker = lookers.into_iter().find(|&effect| on.has(effect));
    add(
        looker.unwrap_or(Effect::Texture),
        "texture coordinates",
        coordinates,
    );
}

/// Returns, for each image, the first active effect that reads it.
fn image_effects(scene: &Scene, on: EffectSet) -> Vec<Option<Effect>> {
    let mut effects = vec![None; scene.images.len()];
    if let Background::Environment { image, .. } = scene.background {
        let lookers = [Effect::Environment, Effect::Background];
        effects[image as usize] = lookers.into_iter().find(|&effect| on.has(effect));
    }
    for layer in scene.materials.iter().flat_map(|material| &material.layers) {
        if let Texture::Image { image, .. } = &scene.textures[layer.texture.texture as usize]
            && on.has(layer.effect())
        {
            effects[*image as usize].get_or_insert(layer.effect());
        }
    }
    effects
}

fn add_accel(report: &AccelReport, memory: &mut Memory) {
    for part in &report.parts {
        memory.add(part.holder, part.what, part.bytes as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(parts: &[(&'static str, &'static str, usize)]) -> Memory {
        let mut memory = Memory::default();
        for &(holder, what, bytes) in parts {
            memory.add(holder, what, bytes);
        }
        memory
    }

    #[test]
    fn peak_of_summed_thread_memory_is_recorded() {
        let together = ThreadMemory::default();
        let mut first = ThreadFootprint::new(&together);
        first.note(of(&[("film", "sums", 10), ("camera", "rays", 5)]), 3);
        let mut second = ThreadFootprint::new(&together);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 1)]), 0);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 7)]), 0);
        drop(first);
        second.note(of(&[("film", "sums", 10), ("shadow", "rays", 9)]), 0);
        drop(second);
        let (peak, max_bytes) = together.peak();
        // 15 of the first thread and 17 of the second, before the first one ends; plus 3 of the finished tile.
        assert_eq!(max_bytes, 35);
        assert_eq!((peak.total(), peak.of("film"), peak.of("shadow")), (32, 20, 7));
        assert_eq!(together.0.lock().unwrap().now.total(), 0);
    }

    #[test]
    fn equal_holdings_are_merged_and_empty_ones_omitted() {
        let memory = of(&[
            ("film", "sums", 1),
            ("film", "sums", 2),
            ("film", "means", 4),
            ("other", "", 0),
        ]);
        assert_eq!(
            (memory.holdings().len(), memory.of("film"), memory.total()),
            (2, 7, 7)
        );
    }
}
