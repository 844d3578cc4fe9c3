//! Integration tests: the library and the program as their users meet them, in modules by topic.
//!
//! One program, so that the library is linked once. `cargo test --test it aovs` runs the tests whose path contains
//! `aovs`. Tests that repeat a proof with more rays, more kills or more scenes are marked `#[ignore = "slow: ..."]` and
//! are run by `tests/ci/slow`. Tests that need what a machine may lack (Chromium, readers of EXR, the assets beside the
//! project) say that they are skipped and pass.

#![allow(unreachable_pub, reason = "a program of tests has no public items")]

mod accel;
mod batch;
mod cli;
mod cost;
mod formats;
mod image;
mod lighting;
mod report;
mod scenes;
mod support;
