//! Raw bindings to the installed Embree, 3.13 or 4, generated from its headers when this crate is built.
//!
//! Three kinds of items: Embree's own functions and types where both versions agree, under their own names; the
//! functions of `shim.h` (`embree_*`), which have one signature for both versions; and the version of the headers
//! (`RTC_VERSION_*`). C enumerations are plain integers, because a newer library may return values that these headers
//! do not name.
//!
//! | variable | meaning |
//! | --- | --- |
//! | `EMBREE_DIR` | folder with `include/embree4` (or `embree3`) and `lib`, instead of the system's |
//! | `EMBREE_VERSION` | `3` or `4`, where both are installed; without it 4 is used |

// Generated items carry the names and the (missing) documentation of Embree's headers.
#![allow(
    missing_docs,
    non_camel_case_types,
    non_snake_case,
    non_upper_case_globals,
    unreachable_pub
)]

include!(concat!(env!("OUT_DIR"), "/bindings.rs"));
