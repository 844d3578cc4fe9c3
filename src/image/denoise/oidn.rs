//! Calls of Open Image Denoise 2 through function pointers of a library that is opened at run time.
//!
//! The declarations are those of `OpenImageDenoise/oidn.h` of version 2; version 1 lacks some of these names.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::Path;
use std::ptr::{self, NonNull};
use std::sync::Arc;

use libloading::{Library, Symbol};

use super::{DenoiseError, DenoiseGuides};

/// Type of devices on the processor, `OIDN_DEVICE_TYPE_CPU`.
const CPU: c_int = 1;
/// Format of three floats a pixel, `OIDN_FORMAT_FLOAT3`.
const FLOAT3: c_int = 3;
/// Megabytes that the filter may take, above which it works on the image in tiles.
const MEMORY: c_int = 2048;

/// OidnDevice or filter of the library.
type Handle = NonNull<c_void>;

type NewDevice = unsafe extern "C" fn(c_int) -> Option<Handle>;
type NewFilter = unsafe extern "C" fn(Handle, *const c_char) -> Option<Handle>;
type Act = unsafe extern "C" fn(Handle);
type SetInt = unsafe extern "C" fn(Handle, *const c_char, c_int);
type SetBool = unsafe extern "C" fn(Handle, *const c_char, bool);
type GetInt = unsafe extern "C" fn(Handle, *const c_char) -> c_int;
type LastError = unsafe extern "C" fn(Option<Handle>, *mut *const c_char) -> c_int;
type SetImage =
    unsafe extern "C" fn(Handle, *const c_char, *mut c_void, c_int, usize, usize, usize, usize, usize);

/// OidnLibrary of the library, which stays open as long as they exist.
#[derive(Clone, Debug)]
pub(super) struct OidnLibrary {
    new_device: NewDevice,
    set_device_int: SetInt,
    set_device_bool: SetBool,
    device_int: GetInt,
    commit_device: Act,
    release_device: Act,
    last_error: LastError,
    new_filter: NewFilter,
    set_image: SetImage,
    set_filter_bool: SetBool,
    set_filter_int: SetInt,
    commit_filter: Act,
    execute_filter: Act,
    release_filter: Act,
    _library: Arc<Library>,
}

impl OidnLibrary {
    /// Opens the library `file`; the error is in the loader's words.
    pub(super) fn load(file: &Path) -> Result<OidnLibrary, String> {
        // SAFETY: initialisers of the library run here; the user names the library or the system provides it, as with
        // any library that a program is linked to.
        let library = unsafe { Library::new(file) }.map_err(|error| error.to_string())?;
        // Looks up a function, whose type is that of the field that it is assigned to.
        macro_rules! symbol {
            ($name:literal) => {
                // SAFETY: each field below has the type that the library's header declares for this name, and the library
                // stays open beside it.
                unsafe { symbol(&library, $name) }?
            };
        }
        Ok(OidnLibrary {
            new_device: symbol!("oidnNewDevice"),
            set_device_int: symbol!("oidnSetDeviceInt"),
            set_device_bool: symbol!("oidnSetDeviceBool"),
            device_int: symbol!("oidnGetDeviceInt"),
            commit_device: symbol!("oidnCommitDevice"),
            release_device: symbol!("oidnReleaseDevice"),
            last_error: symbol!("oidnGetDeviceError"),
            new_filter: symbol!("oidnNewFilter"),
            set_image: symbol!("oidnSetSharedFilterImage"),
            set_filter_bool: symbol!("oidnSetFilterBool"),
            set_filter_int: symbol!("oidnSetFilterInt"),
            commit_filter: symbol!("oidnCommitFilter"),
            execute_filter: symbol!("oidnExecuteFilter"),
            release_filter: symbol!("oidnReleaseFilter"),
            _library: Arc::new(library),
        })
    }

    /// Returns an error if the library has noted one since the last call; `device` is absent before it exists.
    fn check(&self, device: Option<Handle>) -> Result<(), DenoiseError> {
        let mut message: *const c_char = ptr::null();
        // SAFETY: the device is alive or absent, and `message` may be written.
        let code = unsafe { (self.last_error)(device, &mut message) };
        if code == 0 {
            return Ok(());
        }
        let words = if message.is_null() {
            format!("error {code}")
        } else {
            // SAFETY: the library returns a text that ends with a zero and stays until the next call of this thread.
            unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
        };
        Err(DenoiseError::Failed(words))
    }
}

/// Returns the function `name` of a library as a pointer of type `F`.
///
/// # Safety
///
/// `F` must be the function's type, and the pointer must not be called once the library is closed.
unsafe fn symbol<F: Copy>(library: &Library, name: &str) -> Result<F, String> {
    // SAFETY: `F` is the function's type, as this function requires.
    let found: Result<Symbol<F>, _> = unsafe { library.get(name.as_bytes()) };
    found.map(|symbol| *symbol).map_err(|error| error.to_string())
}

/// Processor device of the library.
pub(super) struct OidnDevice<'f> {
    functions: &'f OidnLibrary,
    handle: Handle,
}

impl Drop for OidnDevice<'_> {
    fn drop(&mut self) {
        // SAFETY: the handle is alive and is not used any more.
        unsafe { (self.functions.release_device)(self.handle) }
    }
}

impl<'f> OidnDevice<'f> {
    /// Returns a device of this many threads.
    pub(super) fn new(functions: &'f OidnLibrary, threads: usize) -> Result<OidnDevice<'f>, DenoiseError> {
        // SAFETY: the function takes a number only.
        let handle = unsafe { (functions.new_device)(CPU) };
        let Some(handle) = handle else {
            functions.check(None)?;
            return Err(DenoiseError::Failed(
                "there is no device for this processor".into(),
            ));
        };
        let device = OidnDevice { functions, handle };
        // SAFETY: the device is alive, and the name is a parameter of devices.
        unsafe { (functions.set_device_int)(handle, c"numThreads".as_ptr(), threads as c_int) };
        // SAFETY: as above; threads are not bound to cores, which other threads of this program use, too.
        unsafe { (functions.set_device_bool)(handle, c"setAffinity".as_ptr(), false) };
        // SAFETY: the device is alive.
        unsafe { (functions.commit_device)(handle) };
        functions.check(Some(handle))?;
        Ok(device)
    }

    /// Returns the library's version: major, minor and patch.
    pub(super) fn version(&self) -> [i32; 3] {
        [c"versionMajor", c"versionMinor", c"versionPatch"].map(|name| {
            // SAFETY: the device is alive, and the name is a parameter of devices.
            unsafe { (self.functions.device_int)(self.handle, name.as_ptr()) }
        })
    }

    /// Filters linear colours into `output`; all images have `size` pixels.
    pub(super) fn filter(
        &self,
        size: [usize; 2],
        color: &[[f32; 3]],
        guides: Option<&DenoiseGuides>,
        output: &mut [[f32; 3]],
    ) -> Result<(), DenoiseError> {
        let count = size[0] * size[1];
        assert!(color.len() == count && output.len() == count, "sizes differ");
        let functions = self.functions;
        // SAFETY: the device is alive, and the name is that of the filter of rendered images.
        let handle = unsafe { (functions.new_filter)(self.handle, c"RT".as_ptr()) };
        let Some(handle) = handle else {
            functions.check(Some(self.handle))?;
            return Err(DenoiseError::Failed(
                "there is no filter of rendered images".into(),
            ));
        };
        let filter = OidnFilter { functions, handle };
        // Give the images
        filter.read(c"color", size, color);
        if let Some(guides) = guides {
            assert!(
                guides.albedo.len() == count && guides.normal.len() == count,
                "sizes differ"
            );
            filter.read(c"albedo", size, &guides.albedo);
            filter.read(c"normal", size, &guides.normal);
        }
        filter.image(c"output", size, output.as_mut_ptr().cast());
        // SAFETY: the filter is alive, and the name is a parameter of it.
        unsafe { (functions.set_filter_bool)(handle, c"hdr".as_ptr(), true) };
        // SAFETY: as above.
        unsafe { (functions.set_filter_int)(handle, c"maxMemoryMB".as_ptr(), MEMORY) };
        // SAFETY: the filter is alive.
        unsafe { (functions.commit_filter)(handle) };
        functions.check(Some(self.handle))?;
        // SAFETY: the filter is alive; its images have `size` pixels of three floats, are not used by others, and outlive
        // the call, which returns only when it is done.
        unsafe { (functions.execute_filter)(handle) };
        functions.check(Some(self.handle))
    }
}

/// OidnFilter of one device.
struct OidnFilter<'f> {
    functions: &'f OidnLibrary,
    handle: Handle,
}

impl Drop for OidnFilter<'_> {
    fn drop(&mut self) {
        // SAFETY: the handle is alive and is not used any more.
        unsafe { (self.functions.release_filter)(self.handle) }
    }
}

impl OidnFilter<'_> {
    /// Sets an image that the filter only reads.
    fn read(&self, name: &CStr, size: [usize; 2], pixels: &[[f32; 3]]) {
        self.image(name, size, pixels.as_ptr().cast_mut().cast());
    }

    fn image(&self, name: &CStr, [width, height]: [usize; 2], pixels: *mut c_void) {
        // Offset and strides of 0 are those of adjacent pixels.
        // SAFETY: the filter is alive; the pointer is only kept until the filter is executed or released.
        unsafe {
            (self.functions.set_image)(self.handle, name.as_ptr(), pixels, FLOAT3, width, height, 0, 0, 0)
        };
    }
}
