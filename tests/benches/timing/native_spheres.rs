//! Spheres as Embree's own primitives, `RTC_GEOMETRY_TYPE_SPHERE_POINT`, in f32.

use std::mem::{MaybeUninit, offset_of};

use embree_sys as sys;
use whit::accel::{Coherence, RayPacket};

/// Embree's scene of spheres, ready to be traced.
pub(crate) struct NativeSpheres {
    // Fields are dropped in this order: the scene before its device.
    scene: Scene,
    _device: Device,
}

/// An Embree device.
struct Device(sys::RTCDevice);

/// An Embree scene.
struct Scene(sys::RTCScene);

/// An Embree geometry until a scene holds it.
struct Geometry(sys::RTCGeometry);

impl NativeSpheres {
    /// Builds a robust scene of spheres, each given by its center and its radius.
    ///
    /// # Panics
    ///
    /// Panics if Embree reports an error.
    pub(crate) fn build(spheres: &[[f32; 4]]) -> NativeSpheres {
        let device = Device::new();
        let scene = Scene::new(&device);
        let geometry = Geometry::new(&device);
        geometry.set_spheres(spheres);
        geometry.attach(&scene);
        scene.commit();
        device.check();
        NativeSpheres {
            scene,
            _device: device,
        }
    }

    /// Finds the nearest hits by `rtcIntersect16` on every packet; active lanes must be finite and without NaN.
    pub(crate) fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        let mut query = new_query(order);
        for packet in packets {
            let (valid, rays) = pointers(packet);
            // SAFETY: a `RayPacket` begins as an `RTCRayHit16` and holds its aligned mask (asserted at compile time in
            // whit's `accel::embree`); packet and query are this thread's own, and the scene is committed.
            unsafe { sys::embree_intersect16(valid, self.scene.0, &raw mut query, rays.cast()) };
        }
    }

    /// Marks blocked lanes by `rtcOccluded16` on every packet; active lanes must be finite and without NaN.
    pub(crate) fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        let mut query = new_query(order);
        for packet in packets {
            let (valid, rays) = pointers(packet);
            // SAFETY: as in `intersect`; an `RTCRay16` is the beginning of an `RTCRayHit16`.
            unsafe { sys::embree_occluded16(valid, self.scene.0, &raw mut query, rays.cast()) };
        }
    }
}

/// Returns pointers to the mask and to the whole of a packet, of which the first is derived from the second.
fn pointers(packet: &mut RayPacket) -> (*const i32, *mut RayPacket) {
    let rays: *mut RayPacket = packet;
    let valid = rays.wrapping_byte_add(offset_of!(RayPacket, active));
    (valid.cast::<i32>(), rays)
}

/// Returns a query without a filter, for any number of calls.
fn new_query(order: Coherence) -> sys::EmbreeQuery {
    let mut query = MaybeUninit::zeroed();
    // SAFETY: there is room for a query, which the call fills.
    unsafe { sys::embree_query_init(query.as_mut_ptr(), i32::from(order == Coherence::Coherent)) };
    // SAFETY: a C struct of numbers and pointers, zeroed and then filled just now.
    unsafe { query.assume_init() }
}

impl Device {
    fn new() -> Device {
        // SAFETY: without a configuration Embree takes its defaults, as many threads as processors among them.
        let handle = unsafe { sys::rtcNewDevice(std::ptr::null()) };
        assert!(!handle.is_null(), "Embree could not create a device");
        Device(handle)
    }

    /// Panics if Embree has reported an error.
    fn check(&self) {
        // SAFETY: the device is live.
        let code = unsafe { sys::rtcGetDeviceError(self.0) };
        assert_eq!(code, sys::RTC_ERROR_NONE, "Embree reports an error");
    }
}

impl Scene {
    fn new(device: &Device) -> Scene {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewScene(device.0) };
        assert!(!handle.is_null(), "Embree could not create a scene");
        // SAFETY: the scene is live and not yet committed.
        unsafe { sys::rtcSetSceneFlags(handle, sys::RTC_SCENE_FLAG_ROBUST) };
        Scene(handle)
    }

    fn commit(&self) {
        // SAFETY: the scene is live and known to this thread alone.
        unsafe { sys::rtcCommitScene(self.0) };
    }
}

impl Geometry {
    fn new(device: &Device) -> Geometry {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewGeometry(device.0, sys::RTC_GEOMETRY_TYPE_SPHERE_POINT) };
        assert!(!handle.is_null(), "Embree could not create a geometry");
        // SAFETY: the geometry is live. Every ray may hit it; the default differs between versions.
        unsafe { sys::rtcSetGeometryMask(handle, u32::MAX) };
        Geometry(handle)
    }

    /// Gives Embree a copy of the spheres.
    fn set_spheres(&self, spheres: &[[f32; 4]]) {
        let (kind, format) = (sys::RTC_BUFFER_TYPE_VERTEX, sys::RTC_FORMAT_FLOAT4);
        let (row, count) = (size_of::<[f32; 4]>(), spheres.len());
        // SAFETY: the geometry is live.
        let copy = unsafe { sys::rtcSetNewGeometryBuffer(self.0, kind, 0, format, row, count) };
        assert!(!copy.is_null(), "Embree has no memory for the spheres");
        // SAFETY: Embree made room for `count` rows of this size, which nothing else refers to yet.
        unsafe { std::ptr::copy_nonoverlapping(spheres.as_ptr(), copy.cast::<[f32; 4]>(), count) };
    }

    fn attach(self, scene: &Scene) {
        // SAFETY: the geometry is live and has its spheres.
        unsafe { sys::rtcCommitGeometry(self.0) };
        // SAFETY: both are live; the scene takes a reference of its own.
        unsafe { sys::rtcAttachGeometryByID(scene.0, self.0, 0) };
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once; the device's scene is gone (see `NativeSpheres`).
        unsafe { sys::rtcReleaseDevice(self.0) };
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseScene(self.0) };
    }
}

impl Drop for Geometry {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseGeometry(self.0) };
    }
}
