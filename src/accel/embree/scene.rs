//! Embree scene: its creation, its commit, and a reference to it for tracing.

use std::ffi::c_void;
use std::marker::PhantomData;
use std::mem::MaybeUninit;

use embree_sys as sys;

use super::device::Device;
use super::progress::{Stage, on_progress};
use crate::accel::{AccelError, AccelOptions, BuildQuality, Coherence, Precision};
use crate::mesh::Mesh;

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
    /// Creates an empty scene.
    pub(super) fn new(device: &Device, options: &AccelOptions) -> Result<EmbreeScene<'s>, AccelError> {
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

    /// Returns the handle for Embree's functions.
    pub(super) fn handle(&self) -> sys::RTCScene {
        self.handle
    }

    /// Records that the scene has instances of Embree's own.
    pub(super) fn set_has_instances(&mut self) {
        self.has_instances = true;
    }

    /// Returns a reference for tracing; valid only after [`EmbreeScene::commit`].
    pub(super) fn as_ref(&self) -> SceneRef<'_> {
        SceneRef {
            handle: self.handle,
            has_instances: self.has_instances,
            scene: PhantomData,
        }
    }

    /// Builds the tree of the scene, and reports the progress to `stage`.
    pub(super) fn commit(&self, device: &Device, stage: &Stage) -> Result<(), AccelError> {
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

    /// Returns the size of the box around all primitives along its longest axis; valid only after
    /// [`EmbreeScene::commit`]. Not positive if there are none.
    pub(super) fn size(&self) -> f32 {
        let mut bounds = MaybeUninit::uninit();
        // SAFETY: the scene is live and committed, and the pointer is to memory for one box.
        unsafe { sys::rtcGetSceneBounds(self.handle, bounds.as_mut_ptr()) };
        // SAFETY: the call above has written every coordinate.
        let sys::RTCBounds {
            lower_x,
            lower_y,
            lower_z,
            upper_x,
            upper_y,
            upper_z,
            ..
        } = unsafe { bounds.assume_init() };
        (upper_x - lower_x).max(upper_y - lower_y).max(upper_z - lower_z)
    }
}
