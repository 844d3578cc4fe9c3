//! Finds the installed Embree, compiles the shim over its headers and makes bindings from them.
//!
//! Neither Debian release ships a pkg-config file, so the headers themselves are looked for: Embree 4 before 3, in
//! `EMBREE_DIR` (a prefix with `include` and `lib`) or in the usual places; `EMBREE_VERSION=3|4` picks one.

use std::path::{Path, PathBuf};
use std::{env, fs, process};

/// What every failure ends with.
const REMEDY: &str = "install it with `apt-get install libembree-dev libclang-dev gcc`, name another place with \
                      EMBREE_DIR, or build without it: `--no-default-features`";

/// Where Embree is looked for if nothing else is said.
const PREFIXES: [&str; 3] = ["/usr/local", "/usr", "/opt/embree"];

/// The functions, types and constants that are called; nothing else is bound.
const ALLOWED: [&str; 3] = ["rtc[A-Z].*", "RTC.*", "[wW]hit.*"];

/// An installed Embree.
struct Installation {
    /// 3 or 4.
    major: u32,
    /// The folder with `rtcore.h`.
    headers: PathBuf,
    /// The folder with the shared library.
    libraries: PathBuf,
}

fn main() {
    for name in ["EMBREE_DIR", "EMBREE_VERSION"] {
        println!("cargo::rerun-if-env-changed={name}");
    }
    for file in ["build.rs", "shim.c", "shim.h"] {
        println!("cargo::rerun-if-changed={file}");
    }
    if let Err(reason) = build() {
        eprintln!("{reason}: {REMEDY}");
        process::exit(1);
    }
}

fn build() -> Result<(), String> {
    let embree = find()?;
    let config = embree.headers.join("rtcore_config.h");
    println!("cargo::rerun-if-changed={}", config.display());
    let version = header_version(&config)?;
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo has set no OUT_DIR")?);
    let include = include_only(&embree, &out)?;
    compile_shim(&embree, &include)?;
    bind(&embree, &include, &out)?;
    println!("cargo::rustc-link-search=native={}", embree.libraries.display());
    println!("cargo::rustc-link-lib=dylib=embree{}", embree.major);
    println!("cargo::metadata=version={version}");
    println!("cargo::metadata=major={}", embree.major);
    Ok(())
}

fn find() -> Result<Installation, String> {
    let majors: Vec<u32> = match env::var("EMBREE_VERSION").as_deref() {
        Ok("3") => vec![3],
        Ok("4") => vec![4],
        Ok(other) if !other.is_empty() => return Err(format!("EMBREE_VERSION is `{other}`, not 3 or 4")),
        _ => vec![4, 3],
    };
    let prefixes: Vec<PathBuf> = match env::var_os("EMBREE_DIR") {
        Some(prefix) if !prefix.is_empty() => vec![prefix.into()],
        _ => PREFIXES.iter().map(PathBuf::from).collect(),
    };
    majors
        .iter()
        .flat_map(|&major| prefixes.iter().map(move |prefix| (major, prefix)))
        .find_map(|(major, prefix)| installation(major, prefix))
        .ok_or_else(|| {
            let places: Vec<String> = prefixes
                .iter()
                .map(|prefix| prefix.display().to_string())
                .collect();
            format!(
                "Embree's headers and library were not found in {}",
                places.join(", ")
            )
        })
}

fn installation(major: u32, prefix: &Path) -> Option<Installation> {
    let headers = prefix.join(format!("include/embree{major}"));
    headers.join("rtcore_config.h").is_file().then_some(())?;
    let architecture = env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    let folders = [
        "lib64".into(),
        format!("lib/{architecture}-linux-gnu"),
        "lib".into(),
    ];
    let libraries = folders
        .iter()
        .map(|folder| prefix.join(folder))
        .find(|folder| folder.join(format!("libembree{major}.so")).exists())?;
    Some(Installation {
        major,
        headers,
        libraries,
    })
}

/// The version in words, such as `3.13.5`.
fn header_version(config: &Path) -> Result<String, String> {
    let text = fs::read_to_string(config)
        .map_err(|error| format!("{} cannot be read ({error})", config.display()))?;
    text.lines()
        .find_map(|line| line.strip_prefix("#define RTC_VERSION_STRING"))
        .and_then(|value| value.split('"').nth(1))
        .map(String::from)
        .ok_or_else(|| format!("{} states no version", config.display()))
}

/// A folder that shows Embree's headers and nothing else: a foreign prefix may hold another system's C library too.
fn include_only(embree: &Installation, out: &Path) -> Result<PathBuf, String> {
    let include = out.join("include");
    let link = include.join(format!("embree{}", embree.major));
    let made = fs::create_dir_all(&include).and_then(|()| {
        if link.symlink_metadata().is_ok() {
            fs::remove_file(&link)?;
        }
        std::os::unix::fs::symlink(fs::canonicalize(&embree.headers)?, &link)
    });
    made.map_err(|error| format!("{} cannot be made ({error})", link.display()))?;
    Ok(include)
}

fn compile_shim(embree: &Installation, include: &Path) -> Result<(), String> {
    let mut build = cc::Build::new();
    build.file("shim.c").include(include).std("c11").warnings(true);
    if embree.major == 4 {
        build.define("WHIT_EMBREE_4", None);
    }
    build
        .try_compile("whit_embree_shim")
        .map_err(|error| format!("the shim over Embree did not compile ({error})"))
}

fn bind(embree: &Installation, include: &Path, out: &Path) -> Result<(), String> {
    let mut builder = bindgen::Builder::default()
        .header("shim.h")
        .clang_arg(format!("-I{}", include.display()))
        .clang_arg("-std=c11")
        .default_enum_style(bindgen::EnumVariation::Consts)
        .prepend_enum_name(false)
        .layout_tests(true)
        .derive_default(false)
        .merge_extern_blocks(true)
        .generate_comments(false);
    if embree.major == 4 {
        builder = builder.clang_arg("-DWHIT_EMBREE_4");
    }
    for pattern in ALLOWED {
        builder = builder
            .allowlist_function(pattern)
            .allowlist_type(pattern)
            .allowlist_var(pattern);
    }
    // bindgen panics where libclang is missing; its words are replaced by ours.
    std::panic::set_hook(Box::new(|_| {}));
    let generated = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| builder.generate()));
    let _ = std::panic::take_hook();
    generated
        .map_err(|_| "libclang was not found, which reads Embree's headers".to_string())?
        .map_err(|error| format!("Embree's headers could not be read ({error})"))?
        .write_to_file(out.join("bindings.rs"))
        .map_err(|error| format!("the bindings could not be written ({error})"))
}
