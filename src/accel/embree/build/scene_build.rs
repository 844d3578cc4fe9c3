//! Construction of Embree's scenes: native triangles, scenes of instanced meshes, their instances, and user geometry.

use std::collections::HashSet;
use std::ffi::c_void;
use std::sync::Arc;

use embree_sys as sys;

use super::plan::{BuildPlan, InstancedMesh, NativeMesh, Triangles};
use crate::accel::bsp::in_pool;
use crate::accel::embree::built_meshes::BuiltMeshes;
use crate::accel::embree::device::Device;
use crate::accel::embree::geometry::NewGeometry;
use crate::accel::embree::instance_kind::{instanced_mesh, primitive_count, world_triangle_count};
use crate::accel::embree::native_instances;
use crate::accel::embree::progress::BuildProgress;
use crate::accel::embree::scene::{EmbreeScene, SceneRef};
use crate::accel::embree::user_geometry::callbacks;
use crate::accel::embree::user_geometry::primitives::{InstancedScene, UserGeometry};
use crate::accel::embree::user_geometry::triangle_cluster::TriangleClusters;
use crate::accel::{AccelError, AccelOptions, Instancing};
use crate::mesh::simd::SimdLimit;
use crate::scene::{Instance, Scene};

/// Result of building all scenes.
pub(in crate::accel::embree) struct Built<'s> {
    /// Top-level scene that rays are traced in.
    pub(in crate::accel::embree) world: EmbreeScene<'s>,
    /// User geometries: static objects, and moving ones.
    pub(in crate::accel::embree) users: [Arc<UserGeometry<'s>>; 2],
    /// Number of triangles omitted because they coincide with an earlier one.
    pub(in crate::accel::embree) held_back_count: usize,
    /// Number of instanced meshes that are Embree's own instances.
    pub(in crate::accel::embree) native_instance_count: usize,
    /// Bytes of the scenes of instanced meshes.
    pub(in crate::accel::embree) instanced_bytes: u64,
}

/// Builds the world scene and its user geometry.
pub(in crate::accel::embree) fn build<'s>(
    scene: &'s Scene,
    device: &Device,
    options: &AccelOptions,
) -> Result<Built<'s>, AccelError> {
    // Assign meshes to scenes
    let instancing = options.instancing.resolved(options.precision);
    let mut progress = BuildProgress::new(options.progress, primitive_count(scene));
    let plan = in_pool(options.threads, || BuildPlan::new(scene, options.precision));
    let held_back_count = plan.held_back_count();
    // Build a scene for each instanced mesh and measure its memory
    let before = device.memory().bytes();
    let parts = build_instanced(&plan, device, options, &mut progress)?;
    let instanced_bytes = device.memory().bytes().saturating_sub(before);
    // Build triangle clusters and user geometries
    let triangle_clusters = in_pool(options.threads, || plan.triangle_clusters(kept_clusters(options)));
    let users = in_pool(options.threads, || {
        UserGeometry::pair(
            (scene, plan.origin_bound()),
            SimdLimit::within(options.isa.as_deref()),
            parts,
            triangle_clusters,
            instancing,
        )
    });
    let users = users.map(Arc::new);

    // Attach native triangles to the world
    let mut world = EmbreeScene::new(device, options)?;
    for (instance, given) in plan.native() {
        world.attach_mesh(device, given, *instance)?;
    }
    // Attach user geometries; instances have the IDs below theirs, and user hits carry the ID that the callback writes
    for (user, id) in users.iter().zip(scene.instances.len() as u32..) {
        if user.primitive_count() > 0 {
            world.attach_user(device, user, id)?;
        }
    }
    // Attach Embree's own instances
    let [still, moving] = &users;
    let native_instance_count = attach_instances(scene, device, &mut world, still, instancing)?;
    // Commit; triangle clusters are not counted, as their triangles are
    let user_count = still.primitive_count() - still.triangle_cluster_count() + moving.primitive_count();
    let object_count = user_count + native_instance_count;
    world.commit(
        device,
        &progress.stage(world_triangle_count(scene) + object_count),
    )?;
    Ok(Built {
        world,
        users,
        held_back_count,
        native_instance_count,
        instanced_bytes,
    })
}

/// Builds one Embree scene for each mesh with transformed instances, indexed by geometry.
fn build_instanced<'s>(
    plan: &BuildPlan<'s>,
    device: &Device,
    options: &AccelOptions,
    progress: &mut BuildProgress,
) -> Result<Vec<Option<InstancedScene<'s>>>, AccelError> {
    let mut build = |placed: InstancedMesh<'s>| {
        let scene = EmbreeScene::new(device, options)?;
        // Build clusters or find duplicates, on the build threads
        let (triangles, bounds) = in_pool(options.threads, || placed.triangles(kept_clusters(options)));
        let stage = progress.stage(placed.triangle_count());
        // Attach the triangles as native geometry or as user geometry
        let triangle_clusters = match triangles {
            Triangles::Native(given) => {
                scene.attach_mesh(device, &given, 0)?;
                None
            }
            Triangles::TriangleClusters(triangle_clusters) => {
                let user = Arc::new(UserGeometry::of_triangle_clusters(
                    plan.scene(),
                    SimdLimit::within(options.isa.as_deref()),
                    triangle_clusters,
                ));
                scene.attach_user(device, &user, 0)?;
                Some(user)
            }
        };
        // Commit before any instance refers to the scene
        scene.commit(device, &stage)?;
        Ok(InstancedScene {
            scene,
            triangle_clusters,
            bounds,
        })
    };
    let placed = plan.placed();
    placed.map(|placed| placed.map(&mut build).transpose()).collect()
}

/// Attaches every instanced mesh that Embree may transform itself as an instance of Embree's own, with the scene's
/// instance index as ID, and returns their number; of several with equal transforms only the first is attached.
fn attach_instances(
    scene: &Scene,
    device: &Device,
    world: &mut EmbreeScene,
    user: &UserGeometry,
    instancing: Instancing,
) -> Result<usize, AccelError> {
    let mut count = 0;
    let mut taken = HashSet::new();
    for (number, instance) in (0u32..).zip(&scene.instances) {
        if instanced_mesh(scene, instance).is_none() || !native_instances::supports(instance, instancing) {
            continue;
        }
        // Of instances of one mesh with equal transforms the lowest index must be hit; Embree would return any.
        let place = native_instances::columns(&instance.world_from_object()).map(f32::to_bits);
        if !taken.insert((instance.geometry, place)) {
            continue;
        }
        if let Some(part) = user.part(instance.geometry) {
            world.attach_instance(device, part, instance, number)?;
            count += 1;
        }
    }
    Ok(count)
}

impl<'s> EmbreeScene<'s> {
    fn attach_mesh(&self, device: &Device, given: &NativeMesh<'s>, id: u32) -> Result<(), AccelError> {
        let mesh = given.mesh;
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_TRIANGLE)?;
        geometry.set_array(
            &mesh.positions,
            sys::RTC_BUFFER_TYPE_VERTEX,
            sys::RTC_FORMAT_FLOAT3,
        );
        if given.skipped_duplicates.is_empty() {
            geometry.set_array(&mesh.triangles, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3);
        } else {
            geometry.set_triangles_without(&mesh.triangles, &given.skipped_duplicates);
        }
        geometry.attach(self, id);
        device.check("accept a mesh")
    }

    fn attach_user(&self, device: &Device, user: &Arc<UserGeometry<'s>>, id: u32) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_USER)?;
        let count = user.primitive_count() as u32;
        let data = Arc::as_ptr(user).cast_mut().cast::<c_void>();
        // SAFETY: the geometry is live and of the user kind.
        unsafe { sys::rtcSetGeometryUserPrimitiveCount(geometry.handle(), count) };
        if user.step_count() > 0 {
            // SAFETY: the geometry is live and of the user kind.
            unsafe { sys::rtcSetGeometryTimeStepCount(geometry.handle(), user.step_count() + 1) };
        }
        // SAFETY: `EmbreeAccel` keeps the `Arc` until the scene is released; callbacks only read through it.
        unsafe { sys::rtcSetGeometryUserData(geometry.handle(), data) };
        // SAFETY: the callbacks take the data just set, and run only for this geometry.
        unsafe {
            sys::rtcSetGeometryBoundsFunction(
                geometry.handle(),
                Some(callbacks::on_bounds),
                std::ptr::null_mut(),
            )
        };
        // SAFETY: the callback takes the data just set, and runs only for this geometry.
        unsafe { sys::rtcSetGeometryIntersectFunction(geometry.handle(), Some(callbacks::on_intersect)) };
        // SAFETY: the callback takes the data just set, and runs only for this geometry.
        unsafe { sys::rtcSetGeometryOccludedFunction(geometry.handle(), Some(callbacks::on_occluded)) };
        geometry.attach(self, id);
        device.check("accept the shapes")
    }

    /// Attaches an instance of Embree's own. The scene `part` must be committed; Embree keeps it alive.
    fn attach_instance(
        &mut self,
        device: &Device,
        part: SceneRef,
        instance: &Instance,
        id: u32,
    ) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_INSTANCE)?;
        let columns = native_instances::columns(&instance.world_from_object());
        // SAFETY: both are live; the geometry takes a reference of its own.
        unsafe { sys::rtcSetGeometryInstancedScene(geometry.handle(), part.handle()) };
        let format = sys::RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR;
        // SAFETY: the array has twelve floats, as the format says, and Embree copies them.
        unsafe { sys::rtcSetGeometryTransform(geometry.handle(), 0, format, columns.as_ptr().cast()) };
        geometry.attach(self, id);
        self.set_has_instances();
        device.check("accept an instance")
    }
}

/// Returns the cache of triangle clusters, if there is one.
fn kept_clusters<'a>(options: &AccelOptions<'a>) -> Option<&'a BuiltMeshes<TriangleClusters>> {
    options.mesh_cache.map(|mesh_cache| &mesh_cache.patches)
}
