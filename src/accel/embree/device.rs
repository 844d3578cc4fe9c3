//! An Embree device: its settings, its error messages, and its memory use.

use std::ffi::{CStr, CString, c_char, c_void};
use std::sync::Mutex;
use std::sync::atomic::{AtomicI64, Ordering};

use embree_sys as sys;

use crate::accel::{AccelError, AccelOptions, EmbreeIdentity};

/// Instruction sets that Embree can be restricted to, in ascending order.
const INSTRUCTION_SETS: [&str; 5] = ["sse2", "sse4.2", "avx", "avx2", "avx512"];

/// An Embree device. Scenes made from it keep it alive inside Embree, but must be released before it, because they
/// report to its monitors on release.
pub(super) struct Device {
    handle: sys::RTCDevice,
    // A raw pointer: Embree holds the address, and moving a `Box` would assert unique access to it.
    monitors: *mut Monitors,
    identity: EmbreeIdentity,
}

/// Data that Embree's callbacks write to, from any thread.
#[derive(Default)]
struct Monitors {
    memory: DeviceMemory,
    error: Mutex<Option<(sys::RTCError, String)>>,
}

/// Bytes of memory that Embree has allocated.
#[derive(Default)]
pub(super) struct DeviceMemory {
    bytes: AtomicI64,
    peak: AtomicI64,
}

// SAFETY: Embree's device functions may be called from any thread, and the monitors are atomics and a mutex.
unsafe impl Send for Device {}
// SAFETY: as for `Send`; nothing is changed through a shared `Device` but the monitors.
unsafe impl Sync for Device {}

impl Device {
    /// Opens a device and checks that the running library has the version of the bindings.
    pub(super) fn new(options: &AccelOptions) -> Result<Device, AccelError> {
        let config = config(options)?;
        // SAFETY: `config` is a C string that outlives the call; Embree copies it.
        let handle = unsafe { sys::rtcNewDevice(config.as_ptr()) };
        if handle.is_null() {
            // SAFETY: with a null device this reads the calling thread's own error.
            let code = unsafe { sys::rtcGetDeviceError(std::ptr::null_mut()) };
            return Err(embree_error("start", code, String::new()));
        }
        // Install the monitors for errors and memory
        let monitors = Box::into_raw(Box::<Monitors>::default());
        let mut device = Device {
            handle,
            monitors,
            identity: EmbreeIdentity {
                version: String::new(),
                isa: String::new(),
            },
        };
        // SAFETY: the device is live, and the monitors are freed only after it is released.
        unsafe { sys::rtcSetDeviceErrorFunction(handle, Some(on_error), monitors.cast()) };
        // SAFETY: the device is live, and the monitors are freed only after it is released.
        unsafe { sys::rtcSetDeviceMemoryMonitorFunction(handle, Some(on_memory), monitors.cast()) };
        // Check the version before any scene is built
        device.identity = EmbreeIdentity {
            version: device.checked_version()?,
            isa: device.instruction_set(options.isa.as_deref()).to_owned(),
        };
        Ok(device)
    }

    /// Returns the handle for Embree's functions, valid as long as `self`.
    pub(super) fn handle(&self) -> sys::RTCDevice {
        self.handle
    }

    /// Returns version and instruction set.
    pub(super) fn identity(&self) -> &EmbreeIdentity {
        &self.identity
    }

    /// Returns the memory that Embree has allocated so far.
    pub(super) fn memory(&self) -> &DeviceMemory {
        &self.monitors().memory
    }

    /// Returns whether packets of that property's width run without being split.
    pub(super) fn has(&self, property: sys::RTCDeviceProperty) -> bool {
        self.property(property) != 0
    }

    /// Returns the first error since the last check, if any.
    pub(super) fn check(&self, action: &'static str) -> Result<(), AccelError> {
        let error = self
            .monitors()
            .error
            .lock()
            .unwrap_or_else(|e| e.into_inner())
            .take();
        error.map_or(Ok(()), |(code, message)| Err(embree_error(action, code, message)))
    }

    fn monitors(&self) -> &Monitors {
        // SAFETY: made in `new`, freed in `drop`, and only ever shared in between.
        unsafe { &*self.monitors }
    }

    fn property(&self, property: sys::RTCDeviceProperty) -> isize {
        // SAFETY: the device is live; an unknown property is an error that Embree reports.
        unsafe { sys::rtcGetDeviceProperty(self.handle, property) }
    }

    /// Returns the running library's version, or an error if it is not that of the headers: structures may differ
    /// between minor versions under one library name.
    fn checked_version(&self) -> Result<String, AccelError> {
        // Embree writes 4.3.3 as 40303.
        let number = self.property(sys::RTC_DEVICE_PROPERTY_VERSION);
        let (major, minor, patch) = (number / 10_000, number / 100 % 100, number % 100);
        let running = format!("{major}.{minor}.{patch}");
        if (major, minor) == (sys::RTC_VERSION_MAJOR as isize, sys::RTC_VERSION_MINOR as isize) {
            return Ok(running);
        }
        let built = format!(
            "{}.{}.{}",
            sys::RTC_VERSION_MAJOR,
            sys::RTC_VERSION_MINOR,
            sys::RTC_VERSION_PATCH
        );
        Err(AccelError::VersionMismatch { built, running })
    }

    /// Returns the instruction set in use. Embree does not report it; its native packet widths show it up to pairs that
    /// share a width. Between these the request or else the processor decides, which is right for builds that include
    /// every set, as Debian's do.
    fn instruction_set(&self, requested: Option<&str>) -> &'static str {
        if !cfg!(any(target_arch = "x86", target_arch = "x86_64")) {
            return "neon";
        }
        let either = |better: &'static str, lesser: &'static str| {
            let takes_better = requested.map_or_else(|| processor_has(better), |isa| isa == better);
            if takes_better { better } else { lesser }
        };
        if self.has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED) {
            "avx512"
        } else if self.has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) {
            either("avx2", "avx")
        } else {
            either("sse4.2", "sse2")
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: `self` owns this reference and gives it up once; all scenes are gone (see `EmbreeAccel`).
        unsafe { sys::rtcReleaseDevice(self.handle) };
        // SAFETY: from `Box::into_raw` in `new`, and the device, which alone could still call back, is released.
        drop(unsafe { Box::from_raw(self.monitors) });
    }
}

impl DeviceMemory {
    /// Returns the bytes in use now.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed).max(0) as u64
    }

    /// Returns the peak of bytes in use.
    pub(super) fn peak_bytes(&self) -> u64 {
        self.peak.load(Ordering::Relaxed).max(0) as u64
    }

    fn add(&self, bytes: i64) {
        let now = self.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(now, Ordering::Relaxed);
    }
}

/// Returns the device's settings as Embree's configuration string.
fn config(options: &AccelOptions) -> Result<CString, AccelError> {
    let mut config = format!("threads={}", options.threads);
    if let Some(isa) = &options.isa {
        config += &format!(",isa={}", checked_instruction_set(isa)?);
    }
    // Digits and names from the list above contain no zero byte.
    Ok(CString::new(config).unwrap_or_default())
}

/// Returns the name of a known set that this processor has: Embree itself would accept any, and then crash.
fn checked_instruction_set(isa: &str) -> Result<&'static str, AccelError> {
    let refused = |message: String| AccelError::Embree {
        action: "be restricted to an instruction set",
        message,
    };
    let known = INSTRUCTION_SETS
        .iter()
        .find(|&&known| known == isa)
        .ok_or_else(|| {
            refused(format!(
                "there is no instruction set `{isa}`: choose one of {}, or none",
                INSTRUCTION_SETS.join(", ")
            ))
        })?;
    if processor_has(known) {
        Ok(known)
    } else {
        Err(refused(format!(
            "this processor has no {isa}: choose an older one of {}, or none",
            INSTRUCTION_SETS.join(", ")
        )))
    }
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
fn processor_has(isa: &str) -> bool {
    match isa {
        "sse2" => is_x86_feature_detected!("sse2"),
        "sse4.2" => is_x86_feature_detected!("sse4.2") && is_x86_feature_detected!("popcnt"),
        "avx" => is_x86_feature_detected!("avx"),
        "avx2" => {
            is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("f16c")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
        }
        "avx512" => {
            is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512cd")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
        }
        _ => false,
    }
}

#[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
fn processor_has(_isa: &str) -> bool {
    false
}

fn embree_error(action: &'static str, code: sys::RTCError, message: String) -> AccelError {
    if code == sys::RTC_ERROR_OUT_OF_MEMORY {
        return AccelError::OutOfMemory;
    }
    let kind = match code {
        sys::RTC_ERROR_INVALID_ARGUMENT => "invalid argument",
        sys::RTC_ERROR_INVALID_OPERATION => "invalid operation",
        sys::RTC_ERROR_UNSUPPORTED_CPU => "this processor is not supported",
        sys::RTC_ERROR_CANCELLED => "cancelled",
        _ => "unknown error",
    };
    let message = if message.is_empty() {
        kind.to_owned()
    } else {
        format!("{kind}: {message}")
    };
    AccelError::Embree { action, message }
}

/// Stores the first error until the next check.
unsafe extern "C" fn on_error(monitors: *mut c_void, code: sys::RTCError, message: *const c_char) {
    // SAFETY: the pointer given together with this function, alive as long as the device.
    let monitors = unsafe { &*monitors.cast::<Monitors>() };
    let text = if message.is_null() {
        String::new()
    } else {
        // SAFETY: not null, and Embree passes a C string that lives for this call.
        unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
    };
    monitors
        .error
        .lock()
        .unwrap_or_else(|e| e.into_inner())
        .get_or_insert((code, text));
}

/// Counts allocated (positive) and freed (negative) bytes. Returning false would refuse the allocation.
unsafe extern "C" fn on_memory(monitors: *mut c_void, bytes: isize, _is_done: bool) -> bool {
    // SAFETY: as in `on_error`.
    let monitors = unsafe { &*monitors.cast::<Monitors>() };
    monitors.memory.add(bytes as i64);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_isa(isa: &str) -> AccelOptions<'static> {
        AccelOptions {
            isa: Some(isa.to_owned()),
            ..AccelOptions::default()
        }
    }

    #[test]
    fn unknown_instruction_set_is_rejected_with_list_of_known_ones() {
        let error = Device::new(&with_isa("avx3,threads=9"))
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains("avx3") && error.contains("sse4.2"), "{error}");
    }

    #[test]
    fn requested_instruction_set_is_reported() {
        for isa in INSTRUCTION_SETS.into_iter().filter(|isa| processor_has(isa)) {
            assert_eq!(Device::new(&with_isa(isa)).unwrap().identity().isa, isa);
        }
    }

    #[test]
    fn peak_memory_includes_freed_bytes() {
        let memory = DeviceMemory::default();
        memory.add(30);
        memory.add(-20);
        memory.add(5);
        assert_eq!((memory.bytes(), memory.peak_bytes()), (15, 30));
    }

    #[test]
    fn out_of_memory_has_its_own_error() {
        assert_eq!(
            embree_error("build", sys::RTC_ERROR_OUT_OF_MEMORY, "x".into()),
            AccelError::OutOfMemory
        );
    }
}
