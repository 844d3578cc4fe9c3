//! Finds Embree, compiles the shim against its headers and makes the bindings from them.

use std::env;
use std::fs;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use bindgen::{Builder, EnumVariation, RustEdition};

/// Prefixes at which a system keeps libraries, searched without `EMBREE_DIR`.
const SYSTEM_PREFIXES: [&str; 3] = ["/usr/local", "/usr", "/opt/homebrew"];

/// End of every message, which says what to do.
const REMEDY: &str =
    "run `apt-get install libembree-dev libclang-dev`, or build without Embree by `--no-default-features`";

/// The functions that whit calls; their types come along.
const FUNCTIONS: &str = "rtc(NewDevice|ReleaseDevice|GetDeviceProperty|GetDeviceError|SetDeviceErrorFunction\
    |SetDeviceMemoryMonitorFunction|NewScene|ReleaseScene|CommitScene|GetSceneBounds|SetSceneFlags|SetSceneBuildQuality\
    |SetSceneProgressMonitorFunction|NewGeometry|ReleaseGeometry|CommitGeometry|AttachGeometryByID\
    |SetGeometryBuildQuality|SetGeometryMask|SetSharedGeometryBuffer|SetNewGeometryBuffer|SetGeometryUserPrimitiveCount\
    |SetGeometryTimeStepCount\
    |SetGeometryUserData|SetGeometryInstancedScene|SetGeometryTransform|SetGeometryBoundsFunction|SetGeometryIntersectFunction|SetGeometryOccludedFunction)\
    |embree_.*";

/// Constants are reached by no function's type, so they are named here.
const CONSTANTS: &str = "RTC_VERSION.*";
const TYPES: &str = "RTC(RayHit|RayHit4|RayHit8|RayHit16|Error|DeviceProperty|Format|BufferType|GeometryType|SceneFlags\
    |BuildQuality|IntersectFunctionNArguments|OccludedFunctionNArguments|BoundsFunctionArguments)";

/// One installed Embree.
struct Embree {
    api: u32,
    headers: PathBuf,
    library_folder: PathBuf,
    version: [u32; 3],
}

fn main() -> ExitCode {
    for variable in [
        "EMBREE_DIR",
        "EMBREE_VERSION",
        "LIBCLANG_PATH",
        "LLVM_CONFIG_PATH",
    ] {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    for file in ["build.rs", "shim.c", "shim.h"] {
        println!("cargo::rerun-if-changed={file}");
    }
    match make() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}: {REMEDY}");
            ExitCode::FAILURE
        }
    }
}

fn make() -> Result<(), String> {
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: build with cargo")?);
    let embree = find()?;
    // A folder that holds Embree and nothing else: a whole foreign `include` would shadow this system's C headers.
    let include = out.join("include");
    link_alone(&embree.headers, &include)?;
    compile_shim(&embree, &include)?;
    make_bindings(&embree, &include, &out.join("bindings.rs"))?;

    let [major, minor, patch] = embree.version;
    println!(
        "cargo::rustc-link-search=native={}",
        embree.library_folder.display()
    );
    println!("cargo::rustc-link-lib=dylib=embree{}", embree.api);
    println!("cargo::metadata=version={major}.{minor}.{patch}");
    println!("cargo::metadata=api={}", embree.api);
    println!("cargo::rerun-if-changed={}", embree.headers.display());
    Ok(())
}

/// The newest Embree under `EMBREE_DIR`, or of the system where that is not set.
fn find() -> Result<Embree, String> {
    let apis = match env::var("EMBREE_VERSION").as_deref() {
        Err(_) | Ok("") => vec![4, 3],
        Ok("4") => vec![4],
        Ok("3") => vec![3],
        Ok(other) => return Err(format!("EMBREE_VERSION is `{other}` and must be 3 or 4")),
    };
    let prefixes = match env::var_os("EMBREE_DIR").filter(|dir| !dir.is_empty()) {
        Some(dir) => vec![PathBuf::from(dir)],
        None => SYSTEM_PREFIXES.map(PathBuf::from).to_vec(),
    };
    for &api in &apis {
        for prefix in &prefixes {
            let headers = prefix.join(format!("include/embree{api}"));
            if !headers.join("rtcore.h").is_file() {
                continue;
            }
            let library_folder = find_library(prefix, api)
                .ok_or_else(|| format!("{} has no libembree{api} beside it", headers.display()))?;
            let version = read_version(&headers.join("rtcore_config.h"))?;
            if version < [3, 13, 0] {
                let [major, minor, _] = version;
                return Err(format!("Embree {major}.{minor} is too old, 3.13 or 4 is needed"));
            }
            return Ok(Embree {
                api,
                headers,
                library_folder,
                version,
            });
        }
    }
    let names: Vec<String> = apis
        .iter()
        .map(|api| format!("include/embree{api}/rtcore.h"))
        .collect();
    let places: Vec<String> = prefixes
        .iter()
        .map(|prefix| prefix.display().to_string())
        .collect();
    Err(format!(
        "Embree was not found ({} under {})",
        names.join(" or "),
        places.join(" or ")
    ))
}

fn find_library(prefix: &Path, api: u32) -> Option<PathBuf> {
    let architecture = env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    let folders = [
        format!("lib/{architecture}-linux-gnu"),
        "lib64".into(),
        "lib".into(),
    ];
    let names = [
        format!("libembree{api}.so"),
        format!("libembree{api}.dylib"),
        format!("embree{api}.lib"),
    ];
    folders
        .iter()
        .map(|folder| prefix.join(folder))
        .find(|folder| names.iter().any(|name| folder.join(name).exists()))
}

/// Major, minor and patch from `rtcore_config.h`.
fn read_version(config: &Path) -> Result<[u32; 3], String> {
    let text =
        fs::read_to_string(config).map_err(|e| format!("{} cannot be read ({e})", config.display()))?;
    let part = |name: &str| {
        text.lines()
            .find_map(|line| {
                line.strip_prefix("#define RTC_VERSION_")?
                    .strip_prefix(name)?
                    .trim()
                    .parse()
                    .ok()
            })
            .ok_or_else(|| format!("{} does not say RTC_VERSION_{name}", config.display()))
    };
    Ok([part("MAJOR")?, part("MINOR")?, part("PATCH")?])
}

/// Makes `folder` hold a link to `headers` and nothing else.
fn link_alone(headers: &Path, folder: &Path) -> Result<(), String> {
    let failed = |e: std::io::Error| format!("{} cannot be written ({e})", folder.display());
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(failed)?;
    }
    fs::create_dir_all(folder).map_err(failed)?;
    let headers = headers.canonicalize().map_err(failed)?;
    let link = folder.join(headers.file_name().unwrap_or_default());
    std::os::unix::fs::symlink(headers, link).map_err(failed)
}

fn compile_shim(embree: &Embree, include: &Path) -> Result<(), String> {
    cc::Build::new()
        .file("shim.c")
        .include(include)
        .define("EMBREE_SYS_API", embree.api.to_string().as_str())
        .std("c11")
        // Every packet passes through it, in development builds too.
        .opt_level(2)
        .cargo_warnings(false)
        .try_compile("embree_shim")
        .map_err(|e| {
            format!(
                "the C compiler failed on embree-sys/shim.c ({})",
                one_line(&e.to_string())
            )
        })
}

fn make_bindings(embree: &Embree, include: &Path, file: &Path) -> Result<(), String> {
    let generate = || {
        Builder::default()
            .header("shim.h")
            .clang_arg(format!("-I{}", include.display()))
            .clang_arg(format!("-DEMBREE_SYS_API={}", embree.api))
            .allowlist_function(FUNCTIONS)
            .allowlist_type(TYPES)
            .allowlist_var(CONSTANTS)
            .default_enum_style(EnumVariation::Consts)
            .prepend_enum_name(false)
            .layout_tests(true)
            .generate_comments(false)
            .rust_edition(RustEdition::Edition2024)
            .generate()
    };
    // bindgen panics where libclang is missing. The reader needs one sentence, not where in bindgen that was noticed.
    panic::set_hook(Box::new(|_| {}));
    let bindings = panic::catch_unwind(generate);
    drop(panic::take_hook());
    bindings
        .map_err(|_| "libclang was not found".to_owned())?
        .map_err(|e| {
            format!(
                "libclang could not read Embree's headers ({})",
                one_line(&e.to_string())
            )
        })?
        .write_to_file(file)
        .map_err(|e| format!("{} cannot be written ({e})", file.display()))
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
