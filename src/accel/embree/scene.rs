//! Construction of Embree's scenes: native triangles, scenes of instanced meshes, their instances, and user geometry.

use std::collections::HashSet;
use std::ffi::c_void;
use std::marker::PhantomData;
use std::sync::Arc;

use bytemuck::Pod;
use embree_sys as sys;

use super::build_plan::{
    BuildPlan, InstancedMesh, NativeMesh, Triangles, instanced_mesh, primitive_count, world_triangle_count,
};
use super::callbacks;
use super::device::Device;
use super::native_instances;
use super::progress::{Progress, Stage, on_progress};
use super::user_geometry::{self, UserGeometry};
use crate::accel::bsp::in_pool;
use crate::accel::{AccelError, AccelOptions, BuildQuality, Coherence, Instancing, Precision};
use crate::mesh::{Buffer, Mesh};
use crate::scene::{Instance, Scene};

/// Number of bytes that Embree loads to read one vertex or one row of indices.
const LOAD_BYTES: usize = 16;

/// Geometry mask that lets every ray hit; the default differs between versions.
const ALL_RAYS: u32 = u32::MAX;

/// Owned Embree scene, which reads arrays that live for `'s`.
pub(super) struct EmbreeScene<'s> {
    handle: sys::RTCScene,
    has_instances: bool,
    arrays: PhantomData<&'s Mesh>,
}

/// Reference to a committed Embree scene, for tracing.
#[derive(Clone, Copy)]
pub(super) struct SceneRef<'a> {
    handle: sys::RTCScene,
    has_instances: bool,
    scene: PhantomData<&'a ()>,
}

// SAFETY: Embree's scenes may be used from any thread; they are changed only while one thread builds them.
unsafe impl Send for EmbreeScene<'_> {}
// SAFETY: Embree allows many threads to trace a committed scene at once.
unsafe impl Sync for EmbreeScene<'_> {}

impl SceneRef<'_> {
    /// Returns the handle for Embree's functions.
    pub(super) fn handle(self) -> sys::RTCScene {
        self.handle
    }

    /// Returns whether the scene has instances of Embree's own, whose hits carry the instance ID in a separate field.
    #[inline(always)]
    pub(super) fn has_instances(self) -> bool {
        self.has_instances
    }

    /// Returns the coherence hint to pass to Embree: over its own instances 3.13.5 never returns from a coherent
    /// `rtcOccluded16`.
    pub(super) fn order(self, order: Coherence) -> Coherence {
        if self.has_instances {
            Coherence::Incoherent
        } else {
            order
        }
    }
}

impl Drop for EmbreeScene<'_> {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseScene(self.handle) };
    }
}

/// Result of building all scenes.
pub(super) struct Built<'s> {
    /// Top-level scene that rays are traced in.
    pub(super) world: EmbreeScene<'s>,
    /// User geometries: static objects, and moving ones.
    pub(super) users: [Arc<UserGeometry<'s>>; 2],
    /// Number of triangles omitted because they coincide with an earlier one.
    pub(super) held_back_count: usize,
    /// Number of instanced meshes that are Embree's own instances.
    pub(super) native_instance_count: usize,
    /// Bytes of the scenes of instanced meshes.
    pub(super) instanced_bytes: u64,
}

/// Builds the world scene and its user geometry.
pub(super) fn build<'s>(
    scene: &'s Scene,
    device: &Device,
    options: &AccelOptions,
) -> Result<Built<'s>, AccelError> {
    // Assign meshes to scenes
    let instancing = options.instancing.resolved(options.precision);
    let mut progress = Progress::new(options.progress, primitive_count(scene));
    let plan = in_pool(options.threads, || BuildPlan::new(scene, options.precision));
    let held_back_count = plan.held_back_count();
    // Build a scene for each instanced mesh and measure its memory
    let before = device.memory().bytes();
    let parts = build_instanced(&plan, device, options, &mut progress)?;
    let instanced_bytes = device.memory().bytes().saturating_sub(before);
    // Build triangle clusters and user geometries
    let triangle_clusters = in_pool(options.threads, || plan.triangle_clusters(options.mesh_cache));
    let users =
        UserGeometry::pair((scene, plan.origin_bound()), parts, triangle_clusters, instancing).map(Arc::new);

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
    progress: &mut Progress,
) -> Result<Vec<Option<user_geometry::InstancedScene<'s>>>, AccelError> {
    let mut build = |placed: InstancedMesh<'s>| {
        let scene = EmbreeScene::new(device, options)?;
        // Build clusters or find duplicates, on the build threads
        let (triangles, bounds) = in_pool(options.threads, || placed.triangles(options.mesh_cache));
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
                    triangle_clusters,
                ));
                scene.attach_user(device, &user, 0)?;
                Some(user)
            }
        };
        // Commit before any instance refers to the scene
        scene.commit(device, &stage)?;
        Ok(user_geometry::InstancedScene {
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

/// Returns the scene flags, only those that the options require.
pub(super) fn flags(options: &AccelOptions) -> sys::RTCSceneFlags {
    let trusted = match options.precision {
        Precision::Fast => sys::RTC_SCENE_FLAG_NONE,
        Precision::Robust | Precision::Watertight => sys::RTC_SCENE_FLAG_ROBUST,
    };
    match options.compact {
        true => trusted | sys::RTC_SCENE_FLAG_COMPACT,
        false => trusted,
    }
}

fn quality(options: &AccelOptions) -> sys::RTCBuildQuality {
    match options.build_quality {
        BuildQuality::Low => sys::RTC_BUILD_QUALITY_LOW,
        BuildQuality::Medium => sys::RTC_BUILD_QUALITY_MEDIUM,
        BuildQuality::High => sys::RTC_BUILD_QUALITY_HIGH,
    }
}

impl<'s> EmbreeScene<'s> {
    fn new(device: &Device, options: &AccelOptions) -> Result<EmbreeScene<'s>, AccelError> {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewScene(device.handle()) };
        if handle.is_null() {
            device.check("create a scene")?;
            return Err(AccelError::OutOfMemory);
        }
        let scene = EmbreeScene {
            handle,
            has_instances: false,
            arrays: PhantomData,
        };
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneFlags(handle, flags(options)) };
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneBuildQuality(handle, quality(options)) };
        device.check("set up a scene")?;
        Ok(scene)
    }

    /// Returns a reference for tracing; valid only after [`EmbreeScene::commit`].
    pub(super) fn as_ref(&self) -> SceneRef<'_> {
        SceneRef {
            handle: self.handle,
            has_instances: self.has_instances,
            scene: PhantomData,
        }
    }

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
        unsafe { sys::rtcSetGeometryUserPrimitiveCount(geometry.0, count) };
        if user.step_count() > 0 {
            // SAFETY: the geometry is live and of the user kind.
            unsafe { sys::rtcSetGeometryTimeStepCount(geometry.0, user.step_count() + 1) };
        }
        // SAFETY: `EmbreeAccel` keeps the `Arc` until the scene is released; callbacks only read through it.
        unsafe { sys::rtcSetGeometryUserData(geometry.0, data) };
        // SAFETY: the callbacks take the data just set, and run only for this geometry.
        unsafe {
            sys::rtcSetGeometryBoundsFunction(geometry.0, Some(callbacks::on_bounds), std::ptr::null_mut())
        };
        // SAFETY: the callback takes the data just set, and runs only for this geometry.
        unsafe { sys::rtcSetGeometryIntersectFunction(geometry.0, Some(callbacks::on_intersect)) };
        // SAFETY: the callback takes the data just set, and runs only for this geometry.
        unsafe { sys::rtcSetGeometryOccludedFunction(geometry.0, Some(callbacks::on_occluded)) };
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
        unsafe { sys::rtcSetGeometryInstancedScene(geometry.0, part.handle()) };
        let format = sys::RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR;
        // SAFETY: the array has twelve floats, as the format says, and Embree copies them.
        unsafe { sys::rtcSetGeometryTransform(geometry.0, 0, format, columns.as_ptr().cast()) };
        geometry.attach(self, id);
        self.has_instances = true;
        device.check("accept an instance")
    }

    fn commit(&self, device: &Device, stage: &Stage) -> Result<(), AccelError> {
        let data = std::ptr::from_ref(stage).cast_mut().cast::<c_void>();
        // SAFETY: `stage` outlives the commit, and the callback is removed right after it.
        unsafe { sys::rtcSetSceneProgressMonitorFunction(self.handle, Some(on_progress), data) };
        // SAFETY: the scene is live, and this thread has exclusive access to it.
        unsafe { sys::rtcCommitScene(self.handle) };
        // SAFETY: the scene is live, and this thread has exclusive access to it.
        unsafe { sys::rtcSetSceneProgressMonitorFunction(self.handle, None, std::ptr::null_mut()) };
        stage.resume_panic();
        device.check("build a scene")?;
        stage.finish();
        Ok(())
    }
}

/// A new geometry, not yet attached to a scene.
struct NewGeometry(sys::RTCGeometry);

impl NewGeometry {
    fn of_kind(device: &Device, kind: sys::RTCGeometryType) -> Result<NewGeometry, AccelError> {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewGeometry(device.handle(), kind) };
        if handle.is_null() {
            device.check("create a geometry")?;
            return Err(AccelError::OutOfMemory);
        }
        // SAFETY: the geometry is live.
        unsafe { sys::rtcSetGeometryMask(handle, ALL_RAYS) };
        Ok(NewGeometry(handle))
    }

    /// Shares an array of three-word rows with Embree in place, or copies it if a load of the last row would leave the
    /// array.
    fn set_array<T: Pod>(&self, slab: &Buffer<T>, kind: sys::RTCBufferType, format: sys::RTCFormat) {
        let row = size_of::<T>();
        let past_end = LOAD_BYTES - row;
        if slab.readable_bytes_past_end() >= past_end {
            let data = slab.as_ptr().cast::<c_void>();
            // SAFETY: the buffer lives for the scene's `'s`, is never written, and may be read past its end as Embree
            // does.
            unsafe { sys::rtcSetSharedGeometryBuffer(self.0, kind, 0, format, data, 0, row, slab.len()) };
            return;
        }
        self.set_copy(slab, kind, format);
    }

    /// Gives Embree a copy of an array. Returns null, and sets an error of the device, if memory runs out.
    fn set_copy<T: Pod>(&self, rows: &[T], kind: sys::RTCBufferType, format: sys::RTCFormat) -> *mut T {
        // SAFETY: the geometry is live.
        let copy =
            unsafe { sys::rtcSetNewGeometryBuffer(self.0, kind, 0, format, size_of::<T>(), rows.len()) };
        let copy = copy.cast::<T>();
        if !copy.is_null() {
            // SAFETY: Embree allocated `rows.len()` rows of `T`'s size, and nothing else has a pointer to them yet.
            unsafe { std::ptr::copy_nonoverlapping(rows.as_ptr(), copy, rows.len()) };
        }
        copy
    }

    /// Gives Embree a copy of the indices in which the omitted triangles are degenerate, so that no ray hits them; the
    /// others keep their indices.
    fn set_triangles_without(&self, triangles: &[[u32; 3]], skipped_duplicates: &[u32]) {
        let copy = self.set_copy(triangles, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3);
        if copy.is_null() {
            return;
        }
        // SAFETY: all rows have just been written, nothing else has a pointer to them, and Embree reads them only in
        // the commit.
        let copy = unsafe { std::slice::from_raw_parts_mut(copy, triangles.len()) };
        for &number in skipped_duplicates {
            let [corner, ..] = copy[number as usize];
            copy[number as usize] = [corner; 3];
        }
    }

    fn attach(self, scene: &EmbreeScene, id: u32) {
        // SAFETY: the geometry is live and has all its arrays or callbacks.
        unsafe { sys::rtcCommitGeometry(self.0) };
        // SAFETY: both are live; the scene takes a reference of its own.
        unsafe { sys::rtcAttachGeometryByID(scene.handle, self.0, id) };
    }
}

impl Drop for NewGeometry {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseGeometry(self.0) };
    }
}
