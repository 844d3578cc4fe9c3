//! From the scene to Embree's scenes: buffers shared, masks and flags set, progress and errors heard.

use std::ffi::c_void;

use embree_sys as sys;

use super::device::Device;
use super::query::{Query, Width};
use super::user::{self, Placed, UserGeometry};
use crate::accel::{AccelError, AccelOptions, Precision};
use crate::mesh::{Mesh, Slab};
use crate::numeric::Bounds;
use crate::scene::{Geometry, Scene};

/// A committed Embree scene, released when dropped.
pub(super) struct EmbreeScene {
    raw: sys::RTCScene,
    meshes: usize,
    /// Vertex arrays that could not be shared as they were.
    _copies: Vec<Slab<[f32; 3]>>,
}

// SAFETY: a committed scene is read-only, and Embree's queries on it may run on any number of threads.
unsafe impl Send for EmbreeScene {}
// SAFETY: as above.
unsafe impl Sync for EmbreeScene {}

impl EmbreeScene {
    pub(super) fn raw(&self) -> sys::RTCScene {
        self.raw
    }

    pub(super) fn mesh_count(&self) -> usize {
        self.meshes
    }
}

impl Drop for EmbreeScene {
    fn drop(&mut self) {
        // SAFETY: the scene is live and this is its only owner.
        unsafe { sys::rtcReleaseScene(self.raw) };
    }
}

/// Embree reads the last vertex of a buffer with a load of this many bytes.
const VERTEX_LOAD: usize = 16;

/// The scenes of placed meshes, and the list of user primitives: every instance that is no mesh in world space.
pub(super) fn user_geometry<'s>(
    scene: &'s Scene,
    device: &Device,
    width: Width,
    options: &AccelOptions,
) -> Result<Box<UserGeometry<'s>>, AccelError> {
    if !Query::fits() {
        return Err(AccelError::Embree {
            action: "be used",
            message: "its query structure is larger than expected".into(),
        });
    }
    let mut object_scenes: Vec<Option<EmbreeScene>> = scene.geometries.iter().map(|_| None).collect();
    let mut object_bounds: Vec<Option<Bounds>> = vec![None; scene.geometries.len()];
    let mut primitives = Vec::new();
    for (index, instance) in scene.instances.iter().enumerate() {
        let geometry = &scene.geometries[instance.geometry as usize];
        let slot = instance.geometry as usize;
        match geometry {
            Geometry::Mesh(mesh) if instance.is_identity() || mesh.triangles.is_empty() => continue,
            Geometry::Mesh(mesh) => {
                if object_scenes[slot].is_none() {
                    let mut building = Building::new(device, options)?;
                    building.attach_mesh(mesh, 0)?;
                    object_scenes[slot] = Some(building.commit(options)?);
                }
            }
            Geometry::Sphere(_) => {}
        }
        let bounds = *object_bounds[slot].get_or_insert_with(|| geometry.bounds());
        primitives.push(Placed {
            instance: index as u32,
            bounds: user::world_bounds(bounds, instance),
        });
    }
    Ok(Box::new(UserGeometry::new(
        scene,
        primitives,
        object_scenes,
        width,
    )))
}

/// The scene that rays are sent to.
pub(super) fn top_scene(
    scene: &Scene,
    device: &Device,
    user: &UserGeometry,
    options: &AccelOptions,
) -> Result<EmbreeScene, AccelError> {
    let mut building = Building::new(device, options)?;
    for (index, instance) in scene.instances.iter().enumerate() {
        if let Geometry::Mesh(mesh) = &scene.geometries[instance.geometry as usize]
            && instance.is_identity()
            && !mesh.triangles.is_empty()
        {
            building.attach_mesh(mesh, index as u32)?;
        }
    }
    building.attach_user(user, scene.instances.len() as u32)?;
    building.commit(options)
}

/// A scene that is being put together.
struct Building<'d> {
    device: &'d Device,
    scene: EmbreeScene,
}

impl<'d> Building<'d> {
    fn new(device: &'d Device, options: &AccelOptions) -> Result<Building<'d>, AccelError> {
        // SAFETY: the device is live.
        let raw = unsafe { sys::rtcNewScene(device.raw()) };
        if raw.is_null() {
            device.check("make a scene")?;
            return Err(AccelError::OutOfMemory);
        }
        let scene = EmbreeScene {
            raw,
            meshes: 0,
            _copies: Vec::new(),
        };
        let flags = match options.precision {
            Precision::Fast => sys::RTC_SCENE_FLAG_NONE,
            Precision::Robust | Precision::Watertight => sys::RTC_SCENE_FLAG_ROBUST,
        };
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneFlags(raw, flags) };
        // SAFETY: as above.
        unsafe { sys::rtcSetSceneBuildQuality(raw, sys::RTC_BUILD_QUALITY_MEDIUM) };
        Ok(Building { device, scene })
    }

    /// Attaches a mesh as Embree's own triangles under the number `id`, sharing its arrays.
    fn attach_mesh(&mut self, mesh: &Mesh, id: u32) -> Result<(), AccelError> {
        // SAFETY: the device is live.
        let geometry = unsafe { sys::rtcNewGeometry(self.device.raw(), sys::RTC_GEOMETRY_TYPE_TRIANGLE) };
        let mut positions = mesh.positions.clone();
        let slack = VERTEX_LOAD - size_of::<[f32; 3]>();
        if positions.readable_bytes_past_end() < slack {
            positions = Slab::from(positions.to_vec());
            self.scene._copies.push(positions.clone());
        }
        // SAFETY: the array is borrowed from the scene or kept in `_copies`, both of which outlive the Embree scene;
        // it is 4-byte aligned and readable for `VERTEX_LOAD` bytes at its last vertex.
        unsafe {
            sys::rtcSetSharedGeometryBuffer(
                geometry,
                sys::RTC_BUFFER_TYPE_VERTEX,
                0,
                sys::RTC_FORMAT_FLOAT3,
                positions.as_ptr().cast(),
                0,
                size_of::<[f32; 3]>(),
                positions.len(),
            )
        };
        // SAFETY: as above; every index has been checked against the vertex count.
        unsafe {
            sys::rtcSetSharedGeometryBuffer(
                geometry,
                sys::RTC_BUFFER_TYPE_INDEX,
                0,
                sys::RTC_FORMAT_UINT3,
                mesh.triangles.as_ptr().cast(),
                0,
                size_of::<[u32; 3]>(),
                mesh.triangles.len(),
            )
        };
        self.scene.meshes += 1;
        self.attach(geometry, id)
    }

    /// Attaches all user primitives as one geometry: several kinds at one level would each cost a traversal.
    fn attach_user(&mut self, user: &UserGeometry, id: u32) -> Result<(), AccelError> {
        if user.primitive_count() == 0 {
            return Ok(());
        }
        // SAFETY: the device is live.
        let geometry = unsafe { sys::rtcNewGeometry(self.device.raw(), sys::RTC_GEOMETRY_TYPE_USER) };
        // SAFETY: the geometry is live and of the user type.
        unsafe { sys::rtcSetGeometryUserPrimitiveCount(geometry, user.primitive_count() as u32) };
        // SAFETY: `user` is boxed in the `EmbreeAccel` that releases the scene before it.
        unsafe { sys::rtcSetGeometryUserData(geometry, std::ptr::from_ref(user).cast_mut().cast()) };
        // SAFETY: the callbacks expect the user data just set.
        unsafe { sys::rtcSetGeometryBoundsFunction(geometry, Some(user::bounds), std::ptr::null_mut()) };
        // SAFETY: as above.
        unsafe { sys::rtcSetGeometryIntersectFunction(geometry, Some(user::intersect)) };
        // SAFETY: as above.
        unsafe { sys::rtcSetGeometryOccludedFunction(geometry, Some(user::occluded)) };
        self.attach(geometry, id)
    }

    fn attach(&mut self, geometry: sys::RTCGeometry, id: u32) -> Result<(), AccelError> {
        // Embree 3 and 4 start from different masks.
        // SAFETY: the geometry is live and not yet committed.
        unsafe { sys::rtcSetGeometryMask(geometry, u32::MAX) };
        // SAFETY: as above.
        unsafe { sys::rtcCommitGeometry(geometry) };
        // SAFETY: geometry and scene are live; the scene takes a reference of its own.
        unsafe { sys::rtcAttachGeometryByID(self.scene.raw, geometry, id) };
        // SAFETY: this gives back the reference that creation gave.
        unsafe { sys::rtcReleaseGeometry(geometry) };
        self.device.check("take a mesh")
    }

    fn commit(self, options: &AccelOptions) -> Result<EmbreeScene, AccelError> {
        let listener = Listener(options.progress);
        if options.progress.is_some() {
            let address = std::ptr::from_ref(&listener).cast_mut().cast::<c_void>();
            // SAFETY: `listener` lives until the commit has returned, and is forgotten by Embree right after.
            unsafe { sys::rtcSetSceneProgressMonitorFunction(self.scene.raw, Some(note_progress), address) };
        }
        // SAFETY: the scene is live, and every array that its geometries share is.
        unsafe { sys::rtcCommitScene(self.scene.raw) };
        // SAFETY: the scene is live; this drops the address of `listener`.
        unsafe { sys::rtcSetSceneProgressMonitorFunction(self.scene.raw, None, std::ptr::null_mut()) };
        self.device.check("build the scene")?;
        Ok(self.scene)
    }
}

/// Whoever wants to hear of the build's progress.
struct Listener<'a>(Option<&'a (dyn Fn(f64) + Sync)>);

unsafe extern "C" fn note_progress(listener: *mut c_void, fraction: f64) -> bool {
    // SAFETY: Embree hands back the address that `commit` registered for the time of the call.
    let listener = unsafe { &*listener.cast::<Listener>() };
    if let Some(progress) = listener.0 {
        // A panic must not cross Embree; the progress is lost, the build goes on.
        let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| progress(fraction)));
    }
    true
}
