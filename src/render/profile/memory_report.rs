//! Memory statistics of a whole render: its threads, image, scene and acceleration structure.

use super::super::aov::PixelCosts;
use super::super::context::RenderContext;
use super::super::film::{PixelStatistics, TileResult};
use super::super::surface::InstanceView;
use super::super::tile::{Tile, tiles};
use super::memory::{Memory, ThreadMemory};
use super::render_profile::RenderProfile;
use crate::accel::AccelReport;
use crate::mesh::{Mesh, PointCloud};
use crate::scene::{Background, Effect, EffectSet, Geometry, Instance, Scene, Texture};

impl RenderContext<'_> {
    /// Returns the memory of the whole render, each entry at its peak.
    pub(in crate::render) fn memory(&self) -> Memory {
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
        if self.settings.target().is_some() {
            // Adaptive sampling keeps estimates instead of tiles
            let image = self.picture_bytes() as u64;
            let rounds = threads.max_round_bytes();
            let estimates = (self.pixel_count() * size_of::<PixelStatistics>()) as u64;
            return (rounds + image, (rounds + max_tile_bytes).max(estimates + image));
        }
        let tiles = self.all_tile_bytes() as u64;
        (tiles, max_tile_bytes.max(tiles))
    }

    /// Returns the bytes that a finished tile keeps until the image is assembled, besides its pixels in the image.
    pub(in crate::render) fn tile_bytes(&self, tile: Tile) -> usize {
        let settings = &self.settings;
        let estimate = if settings.sample_aovs {
            size_of::<PixelStatistics>()
        } else {
            0
        };
        let film = estimate + settings.filter.bytes_per_pixel() as usize;
        let pixel = if settings.has_alpha() {
            2 * film + size_of::<[f32; 3]>()
        } else {
            film
        };
        (tile.width * tile.height) as usize * pixel + size_of::<((Tile, TileResult), RenderProfile)>()
    }

    /// Returns the bytes that all tiles keep when the last one is finished.
    fn all_tile_bytes(&self) -> usize {
        let tiles = tiles(self.settings.width, self.settings.height).into_iter();
        tiles.map(|tile| self.tile_bytes(tile)).sum()
    }

    fn pixel_count(&self) -> usize {
        self.settings.width as usize * self.settings.height as usize
    }

    fn picture_bytes(&self) -> usize {
        self.pixel_count() * size_of::<[f32; 3]>()
    }

    /// Returns the number of requested layers of all kinds.
    pub(in crate::render) fn layer_count(&self) -> usize {
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
            memory.add("film", "tiles before assembly", self.all_tile_bytes());
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

    /// Adds meshes, shapes, point clouds and instances.
    fn add_geometry(&self, memory: &mut Memory) {
        let scene = self.scene;
        for geometry in &scene.geometries {
            memory.add("geometry", "records", size_of::<Geometry>());
            match geometry {
                Geometry::Mesh(mesh) => add_mesh(mesh, self.effects(), memory),
                Geometry::Points(cloud) => add_points(cloud, self.effects(), memory),
                Geometry::Shape(_) => (),
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
        let photons = self.photons.as_ref().map_or(0, |map| map.byte_count());
        memory.add(Effect::Caustics.name(), "photon map", photons);
        let light_tree = self.light_tree.as_ref().map_or(0, |tree| tree.byte_count());
        memory.add(Effect::Interreflection.name(), "light tree", light_tree);
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

/// Adds the arrays of a mesh, each for the effect that needs it.
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

/// Adds the arrays of a point cloud.
fn add_points(cloud: &PointCloud, on: EffectSet, memory: &mut Memory) {
    memory.add("geometry", "centres of points", size_of_val(&cloud.positions[..]));
    let colors = cloud.colors.as_ref().map_or(0, |array| size_of_val(&array[..]));
    memory.add(holder(Effect::VertexColor, on), "vertex colours", colors);
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
