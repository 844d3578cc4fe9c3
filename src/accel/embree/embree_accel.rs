//! Embree's structure of a whole scene: its construction, queries and report.

use std::sync::Arc;

use super::build::scene_build::{self, Built};
use super::device::Device;
use super::query::direction_scale::RescaledRays;
use super::query::packet_width::{Width, Widths};
use super::query::trace::trace;
use super::scene::EmbreeScene;
use super::user_geometry::primitives::UserGeometry;
use super::{instance_kind, native_instances};
use crate::accel::planes::Planes;
use crate::accel::{
    Accel, AccelError, AccelOptions, AccelPart, AccelReport, Coherence, EmbreeIdentity, Precision, Query,
    RayPacket, holder_of_tree,
};
use crate::scene::{Instance, Scene};

/// Embree's structure over a scene that it borrows: Embree reads the vertices in place.
pub struct EmbreeAccel<'s> {
    // Fields in the order of release: the user geometries must outlive the scene that calls back into them.
    pub(super) world: EmbreeScene<'s>,
    users: [Arc<UserGeometry<'s>>; 2],
    device: Device,
    widths: Widths,
    planes: Planes,
    instanced_mesh_count: usize,
    native_instance_count: usize,
    /// Embree's memory for the scenes of instanced meshes, in bytes.
    instanced_bytes: u64,
    /// Memory category of the rest of Embree's memory.
    world_holder: &'static str,
    summary: String,
}

impl<'s> EmbreeAccel<'s> {
    /// Builds the structure of a validated scene.
    ///
    /// # Errors
    ///
    /// If the instruction set is unknown, the running library is not the one whose headers were compiled in, or memory
    /// runs out.
    ///
    /// # Panics
    ///
    /// If `options.progress` panics: the build is cancelled and the panic is resumed.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<EmbreeAccel<'s>, AccelError> {
        // Create the device and build all Embree scenes
        let device = Device::new(options)?;
        let width = Width::of(&device, options.kernel);
        let Built {
            world,
            users,
            held_back_count,
            native_instance_count,
            instanced_bytes,
        } = scene_build::build(scene, &device, options)?;
        // Summarize the structure for the report
        let mut summary = format!(
            "Embree {}, {}, {width}, {} triangles {}, {} shapes and instanced meshes as user geometry",
            device.identity().version,
            options.precision,
            instance_kind::world_triangle_count(scene),
            match options.precision {
                Precision::Watertight => format!("in {} clusters", users[0].triangle_cluster_count()),
                Precision::Fast | Precision::Robust => "native".to_owned(),
            },
            users[0].object_count(),
        );
        if users[1].object_count() > 0 {
            summary += &format!(", {} of them in motion", users[1].object_count());
        }
        if native_instance_count > 0 {
            summary += &format!(", {native_instance_count} instances by Embree");
        }
        if held_back_count > 0 {
            summary += &format!(", {held_back_count} duplicate triangles left out");
        }
        // Choose the widths of packets
        let user_count: usize = users.iter().map(|user| user.object_count()).sum();
        let object_count = user_count + native_instance_count;
        let callback_primitive_count = object_count + users[0].triangle_cluster_count();
        let widths = Widths::new(width, callback_primitive_count, world.size());
        let is_instanced = |instance: &&Instance| instance_kind::instanced_mesh(scene, instance).is_some();
        Ok(EmbreeAccel {
            world,
            users,
            device,
            widths,
            planes: Planes::of(scene),
            native_instance_count,
            instanced_bytes,
            world_holder: holder_of_tree(instance_kind::world_triangle_count(scene), object_count),
            instanced_mesh_count: scene.instances.iter().filter(is_instanced).count(),
            summary,
        })
    }

    #[inline(always)]
    fn trace(&self, packets: &mut [RayPacket], order: Coherence, query: Query) {
        let rescaled = RescaledRays::of(packets);
        trace(&self.world, self.widths, packets, order, query);
        rescaled.restore(packets);
        self.planes.trace(packets, query);
    }

    /// Returns the number of instances of meshes with a transform, to which [`AccelOptions::instancing`]
    /// applies.
    pub fn instanced_mesh_count(&self) -> usize {
        self.instanced_mesh_count
    }

    /// Returns the number of callbacks that panicked since the build. Their lanes missed; the message is on standard
    /// error.
    pub fn panicked_callback_count(&self) -> u64 {
        let [still, moving] = &self.users;
        still.panic_count() + moving.own_panic_count()
    }
}

impl Accel for EmbreeAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        self.trace(packets, order, Query::Nearest);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.trace(packets, order, Query::Any);
    }

    fn report(&self) -> AccelReport {
        let memory = self.device.memory();
        let [still, moving] = &self.users;
        // Count memory that Embree does not report: records of the user geometry and of instances
        let unreported_bytes = still.byte_count()
            + moving.own_byte_count()
            + native_instances::RECORD_BYTES * self.native_instance_count as u64;
        // The monitor counts memory of the world and of instanced meshes together
        let placed = self.instanced_bytes.min(memory.bytes());
        let records = match still.object_count() + moving.object_count() {
            0 => "tree",
            _ => "user-geometry",
        };
        let part = |holder, what, bytes| AccelPart { holder, what, bytes };
        let triangle_clusters = still.triangle_cluster_byte_count();
        // Split the memory by category
        let mut parts = vec![
            part("triangles", "trees of instanced meshes", placed),
            part(self.world_holder, "top-level tree", memory.bytes() - placed),
            part(records, "records", unreported_bytes),
        ];
        if triangle_clusters > 0 {
            parts.push(part("triangles", "patches", triangle_clusters));
        }
        AccelReport {
            parts,
            bytes: memory.bytes() + unreported_bytes + triangle_clusters,
            peak_bytes: memory.peak_bytes() + unreported_bytes + triangle_clusters,
            embree: Some(self.device.identity().clone()),
            summary: self.summary.clone(),
        }
    }
}

/// Returns version and instruction set of Embree when restricted to `isa`.
pub(in crate::accel) fn identity(isa: Option<&str>) -> Result<EmbreeIdentity, AccelError> {
    let options = AccelOptions {
        isa: isa.map(str::to_owned),
        ..AccelOptions::default()
    };
    Ok(Device::new(&options)?.identity().clone())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use embree_sys as sys;

    use super::super::scene;
    use super::*;
    use crate::accel::{BuildQuality, PrimitiveCounts};
    use crate::gltf::LoadOptions;

    /// Returns the number of objects tested by callbacks, and the report of the build.
    fn built(scene: &Scene) -> (usize, AccelReport) {
        let accel = EmbreeAccel::build(scene, &AccelOptions::default()).unwrap();
        (accel.users[0].object_count(), accel.report())
    }

    #[test]
    fn triangle_scene_has_no_user_geometry_and_shape_scene_no_triangles() {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let options = LoadOptions::default();
        let shapes = crate::scene_file::load(&scenes.join("table_of_shapes.toml"), &options).unwrap();
        let mut meshes = crate::gltf::load(&scenes.join("first_light.gltf"), &options).unwrap();
        let geometries = &meshes.geometries;
        let is_native = |i: &Instance| i.is_identity() && !geometries[i.geometry as usize].is_unbounded();
        meshes.instances = meshes
            .instances
            .iter()
            .filter(|i| is_native(i))
            .cloned()
            .collect();
        assert!(!meshes.instances.is_empty());
        let (user_count, report) = built(&meshes);
        assert_eq!((user_count, PrimitiveCounts::of(&meshes).user_geometry()), (0, 0));
        assert!(report.parts.iter().all(|part| part.holder != "user-geometry"));
        let (user_count, _) = built(&shapes.scene);
        assert_eq!(user_count, PrimitiveCounts::of(&shapes.scene).user_geometry());
        assert!(user_count > 0);
    }

    #[test]
    fn scenes_have_only_the_robust_flag() {
        let at = |precision| AccelOptions {
            precision,
            ..AccelOptions::default()
        };
        assert_eq!(scene::flags(&at(Precision::Fast)), sys::RTC_SCENE_FLAG_NONE);
        assert_eq!(scene::flags(&at(Precision::Robust)), sys::RTC_SCENE_FLAG_ROBUST);
    }

    #[test]
    fn compact_trees_take_less_memory_and_fast_builds_differ() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
        let scene = crate::gltf::load(&path, &LoadOptions::default()).unwrap();
        let bytes = |compact, build_quality| {
            let options = AccelOptions {
                precision: Precision::Fast,
                compact,
                build_quality,
                threads: 1,
                ..AccelOptions::default()
            };
            EmbreeAccel::build(&scene, &options).unwrap().report().bytes
        };
        let usual = bytes(false, BuildQuality::Medium);
        assert!(bytes(true, BuildQuality::Medium) < usual);
        assert_ne!(bytes(false, BuildQuality::Low), usual);
    }

    #[test]
    fn no_filter_function_is_declared() {
        let declared = include_str!("../../../embree-sys/build.rs");
        let functions = declared
            .split("const FUNCTIONS")
            .nth(1)
            .unwrap()
            .split(';')
            .next()
            .unwrap();
        assert!(functions.contains("SetSceneFlags") && !functions.contains("Filter"));
        let shim = include_str!("../../../embree-sys/shim.c");
        assert!(!shim.contains("ilter"), "the shim sets a filter");
    }
}
