//! Geometry of an Embree scene, from its creation until it is attached.

use std::ffi::c_void;

use bytemuck::Pod;
use embree_sys as sys;

use super::device::Device;
use super::scene::EmbreeScene;
use crate::accel::AccelError;
use crate::buffer::Buffer;

/// Number of bytes that Embree loads to read one vertex or one row of indices.
const LOAD_BYTES: usize = 16;

/// Geometry mask that lets every ray hit; the default differs between versions.
const ALL_RAYS: u32 = u32::MAX;

/// A new geometry, not yet attached to a scene.
pub(super) struct NewGeometry {
    handle: sys::RTCGeometry,
}

impl NewGeometry {
    /// Returns the handle for Embree's functions.
    pub(super) fn handle(&self) -> sys::RTCGeometry {
        self.handle
    }

    /// Creates an empty geometry of one kind.
    pub(super) fn of_kind(device: &Device, kind: sys::RTCGeometryType) -> Result<NewGeometry, AccelError> {
        // SAFETY: the device is live.
        let handle = unsafe { sys::rtcNewGeometry(device.handle(), kind) };
        if handle.is_null() {
            device.check("create a geometry")?;
            return Err(AccelError::OutOfMemory);
        }
        // SAFETY: the geometry is live.
        unsafe { sys::rtcSetGeometryMask(handle, ALL_RAYS) };
        Ok(NewGeometry { handle })
    }

    /// Shares an array of three-word rows with Embree in place, or copies it if a load of the last row would leave the
    /// array.
    pub(super) fn set_array<T: Pod>(
        &self,
        slab: &Buffer<T>,
        kind: sys::RTCBufferType,
        format: sys::RTCFormat,
    ) {
        let row = size_of::<T>();
        let past_end = LOAD_BYTES - row;
        if slab.readable_bytes_past_end() >= past_end {
            let data = slab.as_ptr().cast::<c_void>();
            // SAFETY: the buffer lives for the scene's `'s`, is never written, and may be read past its end as Embree
            // does.
            unsafe {
                sys::rtcSetSharedGeometryBuffer(self.handle, kind, 0, format, data, 0, row, slab.len())
            };
            return;
        }
        self.set_copy(slab, kind, format);
    }

    /// Gives Embree a copy of an array. Returns null, and sets an error of the device, if memory runs out.
    fn set_copy<T: Pod>(&self, rows: &[T], kind: sys::RTCBufferType, format: sys::RTCFormat) -> *mut T {
        // SAFETY: the geometry is live.
        let copy =
            unsafe { sys::rtcSetNewGeometryBuffer(self.handle, kind, 0, format, size_of::<T>(), rows.len()) };
        let copy = copy.cast::<T>();
        if !copy.is_null() {
            // SAFETY: Embree allocated `rows.len()` rows of `T`'s size, and nothing else has a pointer to them yet.
            unsafe { std::ptr::copy_nonoverlapping(rows.as_ptr(), copy, rows.len()) };
        }
        copy
    }

    /// Gives Embree a copy of the indices in which the omitted triangles are degenerate, so that no ray hits them; the
    /// others keep their indices.
    pub(super) fn set_triangles_without(&self, triangles: &[[u32; 3]], skipped_duplicates: &[u32]) {
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

    /// Commits the geometry, and attaches it to a scene.
    pub(super) fn attach(self, scene: &EmbreeScene, id: u32) {
        // SAFETY: the geometry is live and has all its arrays or callbacks.
        unsafe { sys::rtcCommitGeometry(self.handle) };
        // SAFETY: both are live; the scene takes a reference of its own.
        unsafe { sys::rtcAttachGeometryByID(scene.handle(), self.handle, id) };
    }
}

impl Drop for NewGeometry {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once.
        unsafe { sys::rtcReleaseGeometry(self.handle) };
    }
}
