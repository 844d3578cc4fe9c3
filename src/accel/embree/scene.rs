//! From a scene to Embree's scenes: native triangles, scenes for placed meshes, and the user geometry over both.

#[cfg(test)]
mod speed;

use std::any::Any;
use std::ffi::c_void;
use std::marker::PhantomData;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Arc, Mutex};

use bytemuck::Pod;
use embree_sys as sys;

use super::device::Device;
use super::user::{self, UserGeometry};
use crate::accel::{AccelError, AccelOptions, Precision};
use crate::mesh::{Mesh, Slab};
use crate::scene::{Geometry, Instance, Scene};

/// Bytes that Embree loads to read one vertex or one row of indices.
const LOAD_BYTES: usize = 16;

/// Every geometry answers every ray; the default differs between versions.
const ALL_RAYS: u32 = u32::MAX;

/// An Embree scene, which reads arrays that live for `'s`.
pub(super) struct EmbreeScene<'s> {
    handle: sys::RTCScene,
    arrays: PhantomData<&'s Mesh>,
}

/// A committed Embree scene, for tracing.
#[derive(Clone, Copy)]
pub(super) struct SceneRef<'a> {
    handle: sys::RTCScene,
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
}

impl Drop for EmbreeScene<'_> {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseScene(self.handle) };
    }
}

/// Builds the world and the user geometry in it.
pub(super) fn build<'s>(
    scene: &'s Scene,
    device: &Device,
    options: &AccelOptions,
) -> Result<(EmbreeScene<'s>, Arc<UserGeometry<'s>>), AccelError> {
    if options.precision == Precision::Watertight {
        return Err(AccelError::NotWatertight);
    }
    let mut progress = Progress::new(scene, options);
    let parts = placed_meshes(scene, device, options, &mut progress)?;
    let user = Arc::new(UserGeometry::new(scene, parts));

    let world = EmbreeScene::new(device, options.precision)?;
    for (index, instance) in scene.instances.iter().enumerate() {
        if let Some(mesh) = native_mesh(scene, instance) {
            world.attach_mesh(device, mesh, index as u32)?;
        }
    }
    if user.primitive_count() > 0 {
        // Instances have the numbers below it, and their hits carry the number that the callback writes.
        world.attach_user(device, &user, scene.instances.len() as u32)?;
    }
    world.commit(
        device,
        &progress.stage(native_triangle_count(scene) + user.primitive_count()),
    )?;
    Ok((world, user))
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
fn placed_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if !instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// One Embree scene for each mesh with placed instances, by the number of its geometry.
fn placed_meshes<'s>(
    scene: &'s Scene,
    device: &Device,
    options: &AccelOptions,
    progress: &mut Progress,
) -> Result<Vec<Option<EmbreeScene<'s>>>, AccelError> {
    let mut parts: Vec<Option<EmbreeScene>> = scene.geometries.iter().map(|_| None).collect();
    for instance in &scene.instances {
        let part = &mut parts[instance.geometry as usize];
        if let (None, Some(mesh)) = (&part, placed_mesh(scene, instance)) {
            let built = EmbreeScene::new(device, options.precision)?;
            built.attach_mesh(device, mesh, 0)?;
            built.commit(device, &progress.stage(mesh.triangles.len()))?;
            *part = Some(built);
        }
    }
    Ok(parts)
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
            arrays: PhantomData,
        };
        let flags = match precision {
            Precision::Fast => sys::RTC_SCENE_FLAG_NONE,
            Precision::Robust | Precision::Watertight => sys::RTC_SCENE_FLAG_ROBUST,
        };
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneFlags(handle, flags) };
        // SAFETY: as above.
        unsafe { sys::rtcSetSceneBuildQuality(handle, sys::RTC_BUILD_QUALITY_MEDIUM) };
        device.check("set up a scene")?;
        Ok(scene)
    }

    /// For tracing; only after [`EmbreeScene::commit`].
    pub(super) fn as_ref(&self) -> SceneRef<'_> {
        SceneRef {
            handle: self.handle,
            scene: PhantomData,
        }
    }

    fn attach_mesh(&self, device: &Device, mesh: &'s Mesh, id: u32) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_TRIANGLE)?;
        geometry.set_array(
            &mesh.positions,
            sys::RTC_BUFFER_TYPE_VERTEX,
            sys::RTC_FORMAT_FLOAT3,
        );
        geometry.set_array(&mesh.triangles, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3);
        geometry.attach(self, id);
        device.check("take a mesh")
    }

    fn attach_user(&self, device: &Device, user: &Arc<UserGeometry<'s>>, id: u32) -> Result<(), AccelError> {
        let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_USER)?;
        let count = user.primitive_count() as u32;
        let data = Arc::as_ptr(user).cast_mut().cast::<c_void>();
        // SAFETY: the geometry is live and of the user kind.
        unsafe { sys::rtcSetGeometryUserPrimitiveCount(geometry.0, count) };
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
            // SAFETY: the slab lives for the scene's `'s`, is never written, and may be read past its end as Embree does.
            unsafe { sys::rtcSetSharedGeometryBuffer(self.0, kind, 0, format, data, 0, row, slab.len()) };
            return;
        }
        // SAFETY: the geometry is live.
        let copy = unsafe { sys::rtcSetNewGeometryBuffer(self.0, kind, 0, format, row, slab.len()) };
        if !copy.is_null() {
            // SAFETY: Embree made room for `slab.len()` rows of `row` bytes, which nobody else knows yet.
            unsafe { std::ptr::copy_nonoverlapping(slab.as_ptr(), copy.cast::<T>(), slab.len()) };
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
        let user = scene.instances.iter().filter(|i| user::is_user(scene, i)).count();
        Progress {
            report: options.progress,
            done: 0,
            total: placed + native_triangle_count(scene) + user,
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
