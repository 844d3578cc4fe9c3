//! Description of this process in locks and manifests.

use std::fs;

/// Returns the description of this process in locks and manifests.
pub(super) fn describe_process() -> String {
    format!("process {} on {}", std::process::id(), host())
}

/// Returns the host name of this machine.
pub(super) fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    name.trim().to_owned()
}
