//! Text of `whit --version`: version, and with `--verbose` commit, features, SIMD level and Embree.

use std::fmt::Write as _;

/// Returns the name and version of the program, with `is_verbose` also what it was built from and with.
pub(super) fn describe(is_verbose: bool) -> String {
    let embree = embree_version();
    let mut text = match embree {
        Some(version) => format!("whit {} (Embree {version})\n", env!("CARGO_PKG_VERSION")),
        None => format!("whit {} (without Embree)\n", env!("CARGO_PKG_VERSION")),
    };
    if is_verbose {
        let commit = match env!("WHIT_COMMIT") {
            "" => "unknown",
            commit => commit,
        };
        let features = [
            ("embree", cfg!(feature = "embree")),
            ("counters", cfg!(feature = "counters")),
        ];
        let features: Vec<_> = features
            .iter()
            .filter(|(_, is_on)| *is_on)
            .map(|(name, _)| *name)
            .collect();
        let features = if features.is_empty() {
            "none".to_owned()
        } else {
            features.join(", ")
        };
        let embree = embree.unwrap_or("none");
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "commit: {commit}\nfeatures: {features}\nsimd: {}\nembree: {embree}\n",
            simd_level()
        );
    }
    text
}

/// Returns the version of Embree's headers at build time; `None` in builds without Embree.
pub(super) fn embree_version() -> Option<&'static str> {
    Some(env!("WHIT_EMBREE_HEADERS")).filter(|version| !version.is_empty())
}

/// Returns the widest instruction set of this machine that shading and triangle tests use.
#[cfg(target_arch = "x86_64")]
fn simd_level() -> &'static str {
    // The sets of features that the kernels are compiled for
    let has_avx512 = is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512cd")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl");
    let has_avx2 = is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("fma");
    if has_avx512 {
        "avx512"
    } else if has_avx2 {
        "avx2"
    } else {
        "sse2"
    }
}

/// Returns the widest instruction set of this machine that shading and triangle tests use.
#[cfg(not(target_arch = "x86_64"))]
fn simd_level() -> &'static str {
    "portable"
}
