//! Raw bindings to the installed Embree 3.13 or 4, made at build time from its own headers, and to the shim that hides
//! their differences (`shim.h`).
//!
//! Nothing here is safe and nothing is our own: functions and types are Embree's, C enums are plain integers. Trace
//! calls go through the `whit...` functions of the shim, whose signatures are the same for both versions.

#![allow(
    missing_docs,
    unreachable_pub,
    non_camel_case_types,
    non_snake_case,
    non_upper_case_globals,
    clippy::all
)]

include!(concat!(env!("OUT_DIR"), "/bindings.rs"));

/// The version of the headers that these bindings were made from, as `RTC_VERSION` states it: 31305 for 3.13.5.
pub const HEADER_VERSION: u32 = RTC_VERSION;

/// Marks a lane without a hit.
pub const INVALID_GEOMETRY_ID: u32 = u32::MAX;
