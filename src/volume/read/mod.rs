//! Readers for 3-D arrays: NumPy `.npy`, NRRD, and raw numbers described by the caller.
//!
//! Files are untrusted: nothing is allocated before the size that a header claims was checked against the bytes present
//! and against the caller's limit; every fault is reported in one sentence with the file and a remedy.
//!
//! Axes: x runs fastest in NRRD and raw files; a NumPy array is indexed `[z, y, x]`, with `[z, y, x, c]` for two to
//! four channels, in C or Fortran order.
//!
//! OpenVDB files are rejected with the advice to convert them. The one crate that reads them in Rust, vdb-rs, has had
//! no release since January 2024, does not build its own documentation, panics on files that are damaged or of an older
//! version, drops background values and constant tiles, and decompresses untrusted bytes through C; the OpenVDB library
//! itself is C++ with a dozen dependencies.

mod dtype;
mod fault;
mod npy;
mod nrrd;
mod raw;
mod read_volume;

#[cfg(test)]
mod tests;

pub use dtype::{ByteOrder, Element};
pub use fault::ReadError;
pub use raw::{RawHeader, read_raw};
pub use read_volume::ReadVolume;

use std::ffi::OsStr;
use std::path::Path;

use self::fault::{VolumeFault, content};
use self::read_volume::{bytes_of, grids};

/// Reads the array at `path`, in the format of its extension: `.npy`, `.nrrd` or `.nhdr`.
///
/// Neither the file nor its decoded numbers may take more than `max_bytes` of memory.
pub fn read(path: &Path, max_bytes: u64) -> Result<ReadVolume, ReadError> {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default();
    match ending.to_ascii_lowercase().as_str() {
        "npy" => {
            let bytes = bytes_of(path, max_bytes)?;
            let array = npy::parse(&bytes).map_err(|fault| content(path, fault))?;
            let data = &bytes[array.data_start..];
            grids(path, &array.layout, data, max_bytes, None)
        }
        "nrrd" | "nhdr" => nrrd::read(path, max_bytes),
        "vdb" => {
            let remedy = "convert it, as by `copyToArray` of the Python module openvdb and `numpy.save`";
            let fault = "is an OpenVDB file, which is not supported";
            Err(content(path, VolumeFault::new(fault, remedy)))
        }
        _ => {
            let fault = format!("its extension {ending:?} is not that of a known array format");
            let remedy = "give a .npy or .nrrd file, or describe it as raw numbers";
            Err(content(path, VolumeFault::new(fault, remedy)))
        }
    }
}
