//! The device: Embree's configuration, its error messages and its memory.

use std::ffi::{CStr, CString, c_char, c_void};
use std::sync::Mutex;
use std::sync::atomic::{AtomicI64, Ordering};

use embree_sys as sys;

use super::query::Width;
use crate::accel::{AccelError, AccelOptions, EmbreeIdentity};

/// An Embree device, released when dropped.
pub(super) struct Device {
    raw: sys::RTCDevice,
    /// What Embree's monitors write to; boxed, because Embree holds its address.
    watch: Box<Watch>,
    version: u32,
}

// SAFETY: Embree's device functions may be called from any thread, and `Watch` is made of atomics and a lock.
unsafe impl Send for Device {}
// SAFETY: as above; shared use only reads properties and errors.
unsafe impl Sync for Device {}

/// What Embree told its monitors.
#[derive(Default)]
struct Watch {
    bytes: AtomicI64,
    peak_bytes: AtomicI64,
    /// The first error since the last [`Device::check`]: Embree's code and words.
    error: Mutex<Option<(sys::RTCError, String)>>,
}

/// The instruction sets that Debian's Embree is compiled for, narrowest first, with what the processor must have.
const INSTRUCTION_SETS: [&str; 5] = ["sse2", "sse4.2", "avx", "avx2", "avx512"];

impl Device {
    pub(super) fn new(options: &AccelOptions) -> Result<Device, AccelError> {
        let mut config = format!("threads={}", options.threads);
        if let Some(isa) = &options.isa {
            check_instruction_set(isa)?;
            config.push_str(&format!(",isa={isa}"));
        }
        let config = CString::new(config).unwrap_or_default();
        // SAFETY: `config` is a C string that lives through the call, which copies what it needs.
        let raw = unsafe { sys::rtcNewDevice(config.as_ptr()) };
        if raw.is_null() {
            // SAFETY: a null device asks for the calling thread's error, which needs no device.
            let code = unsafe { sys::rtcGetDeviceError(std::ptr::null_mut()) };
            return Err(refusal("start", code, "it gave no reason".into()));
        }
        let watch = Box::<Watch>::default();
        let address = std::ptr::from_ref::<Watch>(&watch).cast_mut().cast::<c_void>();
        // SAFETY: `raw` is a live device; `address` is boxed in the `Device` that releases `raw` before it.
        unsafe { sys::rtcSetDeviceErrorFunction(raw, Some(note_error), address) };
        // SAFETY: as above.
        unsafe { sys::rtcSetDeviceMemoryMonitorFunction(raw, Some(note_memory), address) };
        // SAFETY: `raw` is a live device.
        let version = unsafe { sys::rtcGetDeviceProperty(raw, sys::RTC_DEVICE_PROPERTY_VERSION) };
        let device = Device {
            raw,
            watch,
            version: u32::try_from(version).unwrap_or_default(),
        };
        device.check_version()?;
        Ok(device)
    }

    pub(super) fn raw(&self) -> sys::RTCDevice {
        self.raw
    }

    /// Fails if Embree has reported an error since the last check; `action` says during what.
    pub(super) fn check(&self, action: &'static str) -> Result<(), AccelError> {
        let mut error = self
            .watch
            .error
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        match error.take() {
            Some((code, message)) => Err(refusal(action, code, message)),
            None => Ok(()),
        }
    }

    /// Bytes that Embree holds now.
    pub(super) fn bytes(&self) -> u64 {
        self.watch
            .bytes
            .load(Ordering::Relaxed)
            .try_into()
            .unwrap_or_default()
    }

    /// Most bytes that Embree held at once.
    pub(super) fn peak_bytes(&self) -> u64 {
        self.watch
            .peak_bytes
            .load(Ordering::Relaxed)
            .try_into()
            .unwrap_or_default()
    }

    /// The widest packets that the device traces natively.
    pub(super) fn packet_width(&self) -> Width {
        let has = |property| {
            // SAFETY: the device is live, and the property is one of Embree's.
            unsafe { sys::rtcGetDeviceProperty(self.raw, property) != 0 }
        };
        if has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED) {
            Width::Sixteen
        } else if has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) {
            Width::Eight
        } else if has(sys::RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED) {
            Width::Four
        } else {
            Width::One
        }
    }

    /// The version and the instruction set in use: the one asked for, else the widest that the packets show.
    pub(super) fn identity(&self, options: &AccelOptions) -> EmbreeIdentity {
        let widest = match self.packet_width() {
            Width::Sixteen => "avx512",
            Width::Eight if is_supported("avx2") => "avx2",
            Width::Eight => "avx",
            Width::Four if is_supported("sse4.2") => "sse4.2",
            Width::Four | Width::One => "sse2",
        };
        EmbreeIdentity {
            version: in_words(self.version),
            isa: options.isa.clone().unwrap_or_else(|| widest.to_string()),
        }
    }

    /// Layouts differ between minor versions, patches only mend.
    fn check_version(&self) -> Result<(), AccelError> {
        if self.version / 100 == sys::HEADER_VERSION / 100 {
            return Ok(());
        }
        Err(AccelError::VersionMismatch {
            built: in_words(sys::HEADER_VERSION),
            running: in_words(self.version),
        })
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: the device is live and this is its only owner; scenes hold references of their own.
        unsafe { sys::rtcReleaseDevice(self.raw) };
    }
}

/// `31305` as `3.13.5`.
fn in_words(version: u32) -> String {
    format!("{}.{}.{}", version / 10_000, version / 100 % 100, version % 100)
}

fn refusal(action: &'static str, code: sys::RTCError, message: String) -> AccelError {
    if code == sys::RTC_ERROR_OUT_OF_MEMORY {
        return AccelError::OutOfMemory;
    }
    AccelError::Embree { action, message }
}

fn check_instruction_set(isa: &str) -> Result<(), AccelError> {
    let message = if !INSTRUCTION_SETS.contains(&isa) {
        format!("`{isa}` is none of {}", INSTRUCTION_SETS.join(", "))
    } else if !is_supported(isa) {
        format!("this processor has no {isa}; leave `--isa` out to take the widest it has")
    } else {
        return Ok(());
    };
    Err(AccelError::Embree {
        action: "use that instruction set",
        message,
    })
}

#[cfg(target_arch = "x86_64")]
fn is_supported(isa: &str) -> bool {
    match isa {
        "sse4.2" => is_x86_feature_detected!("sse4.2"),
        "avx" => is_x86_feature_detected!("avx"),
        "avx2" => is_x86_feature_detected!("avx2"),
        "avx512" => is_x86_feature_detected!("avx512vl"),
        _ => true,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn is_supported(_isa: &str) -> bool {
    true
}

unsafe extern "C" fn note_error(watch: *mut c_void, code: sys::RTCError, message: *const c_char) {
    // SAFETY: Embree hands back the address that was registered, whose `Watch` outlives the device.
    let watch = unsafe { &*watch.cast::<Watch>() };
    let words = if message.is_null() {
        String::new()
    } else {
        // SAFETY: Embree passes a C string that lives through the call.
        unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
    };
    let mut error = watch
        .error
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    error.get_or_insert((code, words));
}

unsafe extern "C" fn note_memory(watch: *mut c_void, change: isize, _after: bool) -> bool {
    // SAFETY: Embree hands back the address that was registered, whose `Watch` outlives the device.
    let watch = unsafe { &*watch.cast::<Watch>() };
    let change = change as i64;
    let now = watch.bytes.fetch_add(change, Ordering::Relaxed) + change;
    watch.peak_bytes.fetch_max(now, Ordering::Relaxed);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_that_runs_is_the_one_that_was_bound() {
        let device = Device::new(&AccelOptions::default()).unwrap();
        assert_eq!(device.version / 100, sys::HEADER_VERSION / 100);
        assert!(in_words(sys::HEADER_VERSION).starts_with(&format!("{}.", sys::RTC_VERSION_MAJOR)));
        assert_eq!(in_words(31305), "3.13.5");
    }

    #[test]
    fn an_unknown_instruction_set_is_refused_with_the_known_ones() {
        let options = AccelOptions {
            isa: Some("mmx".into()),
            ..AccelOptions::default()
        };
        let error = Device::new(&options).err().unwrap().to_string();
        assert!(error.contains("mmx") && error.contains("avx2"), "{error}");
    }

    #[test]
    fn a_pinned_instruction_set_decides_the_packet_width() {
        for (isa, width) in [("sse2", Width::Four), ("avx2", Width::Eight)] {
            if !is_supported(isa) {
                continue;
            }
            let options = AccelOptions {
                isa: Some(isa.into()),
                ..AccelOptions::default()
            };
            assert_eq!(Device::new(&options).unwrap().packet_width(), width);
        }
    }
}
