//! Huge pages for large arrays: a tenth of the time of a short render went into page faults.

/// Smallest array that is worth the call: four pages of the usual 2 MiB.
#[cfg(target_os = "linux")]
const MIN_BYTES: usize = 8 << 20;

/// Asks the system for huge pages behind `array`, best before its first use; its values stay as they are.
#[cfg(target_os = "linux")]
pub(crate) fn advise<T>(array: &mut [T]) {
    use rustix::mm::{Advice, madvise};

    /// Size and alignment of the smallest pages of the supported machines.
    const PAGE: usize = 4096;
    let start = array.as_mut_ptr().cast::<u8>();
    let before = start.align_offset(PAGE);
    let bytes = size_of_val(array);
    if bytes < MIN_BYTES.max(before) {
        return;
    }
    let start = start.wrapping_add(before).cast();
    // Without huge pages nothing is lost but time
    // SAFETY: the range lies within `array`, and the advice changes no contents.
    let _ = unsafe { madvise(start, bytes - before, Advice::LinuxHugepage) };
}

/// Does nothing on other systems.
#[cfg(not(target_os = "linux"))]
pub(crate) fn advise<T>(_: &mut [T]) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advised_arrays_keep_their_values() {
        for bytes in [0, 1, 4095, (8 << 20) + 13] {
            let mut array: Vec<u8> = (0..bytes).map(|i| i as u8).collect();
            advise(&mut array[..]);
            assert!(array.iter().enumerate().all(|(i, &byte)| byte == i as u8));
        }
    }
}
