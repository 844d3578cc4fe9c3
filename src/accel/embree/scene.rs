//! From a scene to Embree's scenes: native triangles, scenes for placed meshes, their instances, and the user geometry.

#[cfg(test)]
mod speed;

use std::any::Any;
use std::collections::HashSet;
use std::ffi::c_void;
use std::marker::PhantomData;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Arc, Mutex};

use bytemuck::Pod;
use embree_sys as sys;

use super::coincident::later_duplicates;
use super::device::Device;
use super::native;
use super::user::{self, UserGeometry};
use crate::accel::bsp::in_pool;
use crate::accel::{AccelError, AccelOptions, Instancing, Precision, RayOrder};
use crate::mesh::{Mesh, Slab};
use crate::scene::{Geometry, Instance, Scene};

/// Bytes that Embree loads to read one vertex or one row of indices.
const LOAD_BYTES: usize = 16;

/// Every geometry answers every ray; the default differs between versions.
const ALL_RAYS: u32 = u32::MAX;

/// An Embree scene, which reads arrays that live for `'s`.
pub(super) struct EmbreeScene<'s> {
    handle: sys::RTCScene,
    has_instances: bool,
    arrays: PhantomData<&'s Mesh>,
}

/// A committed Embree scene, for tracing.
#[derive(Clone, Copy)]
pub(super) struct SceneRef<'a> {
    handle: sys::RTCScene,
    has_instances: bool,
    scene: PhantomData<&'a ()>,
}

// SAFETY: Embree's scenes may be used from any thread; they are changed only while one thread builds them.
unsafe impl Send for EmbreeScene<'_> {}
// SAFETY: tracing a committed scene from many threads at once is what it is for.
unsafe impl Sync for EmbreeScene<'_> {}

impl SceneRef<'_> {
    /// For Embree's functions.
    pub(super) fn handle(self) -> sys::RTCScene {
        self.handle
    }

    /// Whether Embree's own instances are in it, whose hits carry the instance's number apart.
    #[inline(always)]
    pub(super) fn has_instances(self) -> bool {
        self.has_instances
    }

    /// What Embree may be told of rays in that order: over its own instances 3.13.5 never comes back from a coherent
    /// `rtcOccluded16`.
    pub(super) fn order(self, order: RayOrder) -> RayOrder {
        if self.has_instances {
            RayOrder::Incoherent
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

/// What Embree was given.
pub(super) struct Built<'s> {
    /// The scene that rays start in.
    pub(super) world: EmbreeScene<'s>,
    /// What the callbacks answer: what stands still, and what moves.
    pub(super) users: [Arc<UserGeometry<'s>>; 2],
    /// Triangles that were held back because they coincide with an earlier one.
    pub(super) held_back_count: usize,
    /// Placed meshes that are Embree's own instances.
    pub(super) native_instance_count: usize,
    /// Bytes of the scenes of placed meshes.
    pub(super) placed_bytes: u64,
}

/// Builds the world and the user geometry in it.
pub(super) fn build<'s>(
    scene: &'s Scene,
    device: &Device,
    options: &AccelOptions,
) -> Result<Built<'s>, AccelError> {
    if options.precision == Precision::Watertight {
        return Err(AccelError::NotWatertight);
    }
    let instancing = options.instancing.resolved(options.precision);
    let mut progress = Progress::new(scene, options);
    let plan = in_pool(options.threads, || Plan::new(scene));
    let held_back_count = plan.held_back_count(scene);
    let before = device.memory().bytes();
    let parts = plan.build_placed(device, options, &mut progress)?;
    let placed_bytes = device.memory().bytes().saturating_sub(before);
    let users = UserGeometry::pair(scene, parts, instancing).map(Arc::new);

    let mut world = EmbreeScene::new(device, options.precision)?;
    for (instance, part) in &plan.native {
        world.attach_mesh(device, part, *instance)?;
    }
    // Instances have the numbers below these, and their hits carry the number that the callback writes.
    for (user, id) in users.iter().zip(scene.instances.len() as u32..) {
        if user.primitive_count() > 0 {
            world.attach_user(device, user, id)?;
        }
    }
    let [still, moving] = &users;
    let native_instance_count = attach_instances(scene, device, &mut world, still, instancing)?;
    let object_count = still.primitive_count() + moving.primitive_count() + native_instance_count;
    world.commit(
        device,
        &progress.stage(native_triangle_count(scene) + object_count),
    )?;
    Ok(Built {
        world,
        users,
        held_back_count,
        native_instance_count,
        placed_bytes,
    })
}

/// Makes every placed mesh that Embree may place itself an instance of Embree's own, under the scene's number, and
/// counts them; of several in the same place only the first.
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
        if placed_mesh(scene, instance).is_none() || !native::takes(instance, instancing) {
            continue;
        }
        // Of instances of one mesh in one place the lowest is hit; Embree would answer with any.
        let place = native::columns(&instance.world_from_object()).map(f32::to_bits);
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

/// Triangles that Embree tests itself at the top level.
pub(super) fn native_triangle_count(scene: &Scene) -> usize {
    scene
        .instances
        .iter()
        .filter_map(|i| native_mesh(scene, i))
        .map(|mesh| mesh.triangles.len())
        .sum()
}

/// The mesh of an instance whose object space is world space.
fn native_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// The mesh of an instance that stands elsewhere.
pub(super) fn placed_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if !instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// A mesh for Embree.
struct Part<'s> {
    mesh: &'s Mesh,
    /// Triangles, in rising order, that coincide with an earlier one of the same Embree scene and can never be the
    /// answer.
    held_back: Vec<u32>,
}

/// Which meshes go where.
struct Plan<'s> {
    /// Meshes in the world, each with the first instance that has it there.
    native: Vec<(u32, Part<'s>)>,
    /// Meshes with scenes of their own, by geometry.
    placed: Vec<Option<Part<'s>>>,
}

impl<'s> Plan<'s> {
    fn new(scene: &'s Scene) -> Plan<'s> {
        let mut is_native = vec![false; scene.geometries.len()];
        let mut is_placed = vec![false; scene.geometries.len()];
        let mut native = Vec::new();
        for (index, instance) in (0u32..).zip(&scene.instances) {
            let geometry = instance.geometry as usize;
            if let Some(mesh) = native_mesh(scene, instance) {
                // A second instance in the same place would coincide with the first in every triangle.
                if !std::mem::replace(&mut is_native[geometry], true) {
                    native.push((index, mesh));
                }
            }
            is_placed[geometry] |= placed_mesh(scene, instance).is_some();
        }
        let meshes: Vec<&Mesh> = native.iter().map(|&(_, mesh)| mesh).collect();
        let held_back = later_duplicates(&meshes);
        let native = native.into_iter().zip(held_back);
        let placed = scene.geometries.iter().zip(is_placed);
        Plan {
            native: native
                .map(|((instance, mesh), held_back)| (instance, Part { mesh, held_back }))
                .collect(),
            placed: placed
                .map(|(geometry, is_placed)| match geometry {
                    Geometry::Mesh(mesh) if is_placed => Some(Part::alone(mesh)),
                    _ => None,
                })
                .collect(),
        }
    }

    /// Triangles that Embree is not given, those of repeated instances included.
    fn held_back_count(&self, scene: &Scene) -> usize {
        let native = self.native.iter().map(|(_, part)| part);
        let given: usize = native.clone().map(|part| part.mesh.triangles.len()).sum();
        let held_back = native.chain(self.placed.iter().flatten());
        let held_back: usize = held_back.map(|part| part.held_back.len()).sum();
        native_triangle_count(scene) - given + held_back
    }

    /// One Embree scene for each mesh with placed instances, by the number of its geometry.
    fn build_placed(
        &self,
        device: &Device,
        options: &AccelOptions,
        progress: &mut Progress,
    ) -> Result<Vec<Option<EmbreeScene<'s>>>, AccelError> {
        let mut build = |part: &Part<'s>| {
            let built = EmbreeScene::new(device, options.precision)?;
            built.attach_mesh(device, part, 0)?;
            built.commit(device, &progress.stage(part.mesh.triangles.len()))?;
            Ok(built)
        };
        let parts = self.placed.iter();
        parts
            .map(|part| part.as_ref().map(&mut build).transpose())
            .collect()
    }
}

impl<'s> Part<'s> {
    /// A mesh in a scene of its own.
    fn alone(mesh: &'s Mesh) -> Part<'s> {
        Part {
            mesh,
            held_back: later_duplicates(&[mesh]).pop().unwrap_or_default(),
        }
    }
}

/// What Embree is told of a scene: nothing that it need not know.
pub(super) fn flags(precision: Precision) -> sys::RTCSceneFlags {
    match precision {
        Precision::Fast => sys::RTC_SCENE_FLAG_NONE,
        Precision::Robust | Precision::Watertight => sys::RTC_SCENE_FLAG_ROBUST,
    }
}

impl<'s> EmbreeScene<'s> {
    fn new(device: &Device, precision: Precision) -> Result<EmbreeScene<'s>, AccelError> {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewScene(device.handle()) };
        if handle.is_null() {
            device.check("make a scene")?;
            return Err(AccelError::OutOfMemory);
        }
        let scene = EmbreeScene {
            handle,
            has_instances: false,
            arrays: PhantomData,
        };
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneFlags(handle, flags(precision)) };
        // SAFETY: as above.
        unsafe { sys::rtcSetSceneBuildQuality(handle, sys::RTC_BUILD_QUALITY_MEDIUM) };
        device.check("set up a scene")?;
        Ok(scene)
    }

    /// For tracing; only after [`EmbreeScene::commit`].
    pub(super) fn as_ref(&self) -> SceneRef<'_> {
        SceneRef {
            handle: self.handle,
            has_instances: self.has_instances,
            scene: PhantomData,
        }
    }

    fn attach_mesh(&self, device: &Device, part: &Part<'s>, id: u32) -> Result<(), AccelError> {
        let mesh = part.mesh;
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_TRIANGLE)?;
        geometry.set_array(
            &mesh.positions,
            sys::RTC_BUFFER_TYPE_VERTEX,
            sys::RTC_FORMAT_FLOAT3,
        );
        if part.held_back.is_empty() {
            geometry.set_array(&mesh.triangles, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3);
        } else {
            geometry.set_triangles_without(&mesh.triangles, &part.held_back);
        }
        geometry.attach(self, id);
        device.check("take a mesh")
    }

    fn attach_user(&self, device: &Device, user: &Arc<UserGeometry<'s>>, id: u32) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_USER)?;
        let count = user.primitive_count() as u32;
        let data = Arc::as_ptr(user).cast_mut().cast::<c_void>();
        // SAFETY: the geometry is live and of the user kind.
        unsafe { sys::rtcSetGeometryUserPrimitiveCount(geometry.0, count) };
        if user.step_count() > 0 {
            // SAFETY: as above.
            unsafe { sys::rtcSetGeometryTimeStepCount(geometry.0, user.step_count() + 1) };
        }
        // SAFETY: `EmbreeAccel` keeps the `Arc` until the scene is released; callbacks only share it.
        unsafe { sys::rtcSetGeometryUserData(geometry.0, data) };
        // SAFETY: the callbacks take the data just set, and run only for this geometry.
        unsafe { sys::rtcSetGeometryBoundsFunction(geometry.0, Some(user::on_bounds), std::ptr::null_mut()) };
        // SAFETY: as above.
        unsafe { sys::rtcSetGeometryIntersectFunction(geometry.0, Some(user::on_intersect)) };
        // SAFETY: as above.
        unsafe { sys::rtcSetGeometryOccludedFunction(geometry.0, Some(user::on_occluded)) };
        geometry.attach(self, id);
        device.check("take the shapes")
    }

    /// The part's scene must be committed; Embree keeps it alive.
    fn attach_instance(
        &mut self,
        device: &Device,
        part: SceneRef,
        instance: &Instance,
        id: u32,
    ) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_INSTANCE)?;
        let columns = native::columns(&instance.world_from_object());
        // SAFETY: both are live; the geometry takes a reference of its own.
        unsafe { sys::rtcSetGeometryInstancedScene(geometry.0, part.handle()) };
        let format = sys::RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR;
        // SAFETY: twelve floats, as the format says, which Embree copies.
        unsafe { sys::rtcSetGeometryTransform(geometry.0, 0, format, columns.as_ptr().cast()) };
        geometry.attach(self, id);
        self.has_instances = true;
        device.check("take an instance")
    }

    fn commit(&self, device: &Device, stage: &Stage) -> Result<(), AccelError> {
        let data = std::ptr::from_ref(stage).cast_mut().cast::<c_void>();
        // SAFETY: `stage` outlives the commit and is taken away from Embree right after it.
        unsafe { sys::rtcSetSceneProgressMonitorFunction(self.handle, Some(on_progress), data) };
        // SAFETY: the scene is live and this thread alone holds it.
        unsafe { sys::rtcCommitScene(self.handle) };
        // SAFETY: as above.
        unsafe { sys::rtcSetSceneProgressMonitorFunction(self.handle, None, std::ptr::null_mut()) };
        stage.resume_panic();
        device.check("build a scene")?;
        stage.finish();
        Ok(())
    }
}

/// A geometry until a scene holds it.
struct NewGeometry(sys::RTCGeometry);

impl NewGeometry {
    fn of_kind(device: &Device, kind: sys::RTCGeometryType) -> Result<NewGeometry, AccelError> {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewGeometry(device.handle(), kind) };
        if handle.is_null() {
            device.check("make a geometry")?;
            return Err(AccelError::OutOfMemory);
        }
        // SAFETY: the geometry is live.
        unsafe { sys::rtcSetGeometryMask(handle, ALL_RAYS) };
        Ok(NewGeometry(handle))
    }

    /// Gives Embree an array of three words a row where it lies, or a copy where a load of the last row would leave it.
    fn set_array<T: Pod>(&self, slab: &Slab<T>, kind: sys::RTCBufferType, format: sys::RTCFormat) {
        let row = size_of::<T>();
        let past_end = LOAD_BYTES - row;
        if slab.readable_bytes_past_end() >= past_end {
            let data = slab.as_ptr().cast::<c_void>();
            // SAFETY: the slab lives for the scene's `'s`, is never written, and may be read past its end as Embree
            // does.
            unsafe { sys::rtcSetSharedGeometryBuffer(self.0, kind, 0, format, data, 0, row, slab.len()) };
            return;
        }
        self.set_copy(slab, kind, format);
    }

    /// Gives Embree a copy of an array. Null, and an error of the device, where there is no memory for it.
    fn set_copy<T: Pod>(&self, rows: &[T], kind: sys::RTCBufferType, format: sys::RTCFormat) -> *mut T {
        // SAFETY: the geometry is live.
        let copy =
            unsafe { sys::rtcSetNewGeometryBuffer(self.0, kind, 0, format, size_of::<T>(), rows.len()) };
        let copy = copy.cast::<T>();
        if !copy.is_null() {
            // SAFETY: Embree made room for `rows.len()` rows of `T`'s size, which nobody else knows yet.
            unsafe { std::ptr::copy_nonoverlapping(rows.as_ptr(), copy, rows.len()) };
        }
        copy
    }

    /// Gives Embree a copy of the indices in which some triangles are points, which no ray meets; the others keep their
    /// numbers.
    fn set_triangles_without(&self, triangles: &[[u32; 3]], held_back: &[u32]) {
        let copy = self.set_copy(triangles, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3);
        if copy.is_null() {
            return;
        }
        // SAFETY: all rows have just been filled, nobody else knows them, and Embree reads them only in the commit.
        let copy = unsafe { std::slice::from_raw_parts_mut(copy, triangles.len()) };
        for &number in held_back {
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

/// How far the whole build is, over all its commits.
struct Progress<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    done: usize,
    total: usize,
}

/// One commit's part of the progress.
struct Stage<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    from: f64,
    to: f64,
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl<'a> Progress<'a> {
    fn new(scene: &Scene, options: &AccelOptions<'a>) -> Progress<'a> {
        let mut is_placed = vec![false; scene.geometries.len()];
        for instance in &scene.instances {
            is_placed[instance.geometry as usize] |= placed_mesh(scene, instance).is_some();
        }
        let placed: usize = scene
            .geometries
            .iter()
            .zip(&is_placed)
            .map(|(geometry, &placed)| if placed { geometry.primitive_count() } else { 0 })
            .sum();
        let is_object = |i: &&Instance| user::is_user(scene, i, Instancing::Callback);
        let objects = scene.instances.iter().filter(is_object).count();
        Progress {
            report: options.progress,
            done: 0,
            total: placed + native_triangle_count(scene) + objects,
        }
    }

    /// The next commit, of `count` primitives.
    fn stage(&mut self, count: usize) -> Stage<'a> {
        let fraction = |done: usize| {
            if self.total == 0 {
                1.0
            } else {
                done as f64 / self.total as f64
            }
        };
        let from = fraction(self.done);
        self.done += count;
        Stage {
            report: self.report,
            from,
            to: fraction(self.done),
            panic: Mutex::new(None),
        }
    }
}

impl Stage<'_> {
    fn finish(&self) {
        if let Some(report) = self.report {
            report(self.to);
        }
    }

    fn resume_panic(&self) {
        let payload = self.panic.lock().unwrap_or_else(|e| e.into_inner()).take();
        if let Some(payload) = payload {
            panic::resume_unwind(payload);
        }
    }
}

/// Passes progress on. False cancels the build: after a panic, which must not cross into C, nothing else makes sense.
unsafe extern "C" fn on_progress(stage: *mut c_void, fraction: f64) -> bool {
    // SAFETY: `commit` set this pointer and takes it away before the stage goes.
    let stage = unsafe { &*stage.cast::<Stage>() };
    let Some(report) = stage.report else {
        return true;
    };
    let fraction = stage.from + fraction.clamp(0.0, 1.0) * (stage.to - stage.from);
    match panic::catch_unwind(AssertUnwindSafe(|| report(fraction))) {
        Ok(()) => true,
        Err(payload) => {
            stage
                .panic
                .lock()
                .unwrap_or_else(|e| e.into_inner())
                .get_or_insert(payload);
            false
        }
    }
}
