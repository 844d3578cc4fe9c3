//! All measurements of time: `cargo bench --bench timing -- [NAME...]`.
//!
//! Without a name all of them run, which takes many minutes; `--list` prints the names. Values that have a limit are
//! printed with `within the limit of` or `MISSES the limit of`, and the program ends with status 1 if any misses its
//! limit. Medians are printed with the lower and the upper quartile. The figures mean little on a busy machine.

#[cfg(feature = "embree")]
mod batches;
#[cfg(feature = "embree")]
mod clusters;
#[cfg(target_os = "linux")]
mod default_settings;
#[cfg(feature = "embree")]
mod embree_contract;
mod forecast_shares;
mod irradiance_tree;
mod ledgers;
mod limits;
#[cfg(feature = "embree")]
mod native_spheres;
#[cfg(feature = "embree")]
mod packet_width;
mod profile_seconds;
mod quartiles;
mod render_to_error;
mod shading;
#[cfg(feature = "embree")]
mod small_trees;
#[cfg(feature = "embree")]
mod spheres;
mod texture_filtering;
mod timing_protocol;
#[cfg(feature = "embree")]
mod unit_cube;

#[path = "../../it/support/checkerboards.rs"]
#[allow(unreachable_pub, reason = "a module of the tests too")]
mod checkerboards;
#[path = "../../it/support/scene_folder.rs"]
#[allow(
    dead_code,
    unreachable_pub,
    reason = "a module of the tests too, of which only a part is needed here"
)]
mod scene_folder;

use std::process::ExitCode;

use limits::Limits;

/// Benchmark that can be run by name.
struct Measurement {
    name: &'static str,
    /// One line for `--list`.
    description: &'static str,
    /// Prints what it measured and holds it against its limits.
    run: fn(&mut Limits),
}

const MEASUREMENTS: &[Measurement] = &[
    #[cfg(feature = "embree")]
    Measurement {
        name: "embree_contract",
        description: "the rate of EmbreeAccel over that of a bare loop of Embree's calls",
        run: embree_contract::run,
    },
    #[cfg(feature = "embree")]
    Measurement {
        name: "spheres",
        description: "the rate of whit's spheres, in f64, over that of Embree's own, in f32",
        run: spheres::run,
    },
    #[cfg(feature = "embree")]
    Measurement {
        name: "packet_width",
        description: "the rate of single incoherent rays over that of packets, by the number of spheres",
        run: packet_width::run,
    },
    #[cfg(feature = "embree")]
    Measurement {
        name: "small_trees",
        description: "the time of packets through small meshes over that of single rays",
        run: small_trees::run,
    },
    #[cfg(feature = "embree")]
    Measurement {
        name: "clusters",
        description: "the time to group two million boxes into clusters",
        run: clusters::run,
    },
    Measurement {
        name: "timing_protocol",
        description: "a tenth more of real work as the blocks of `whit cost` measure it",
        run: timing_protocol::run,
    },
    Measurement {
        name: "irradiance_tree",
        description: "the time of the hierarchy of subsurface scattering over that of brute force",
        run: irradiance_tree::run,
    },
    Measurement {
        name: "texture_filtering",
        description: "the time of renders of a checkerboard: not filtered, mipmapped and procedural",
        run: texture_filtering::run,
    },
    Measurement {
        name: "shading",
        description: "prices of lobes, area lights, dispersion and mip maps, in the plainest rays",
        run: shading::run,
    },
    Measurement {
        name: "profile_seconds",
        description: "the part of a render's time that its ledger accounts for, on one thread",
        run: profile_seconds::run,
    },
    Measurement {
        name: "forecast_shares",
        description: "the shares of time that `whit info` forecasts against those of a render",
        run: forecast_shares::run,
    },
    #[cfg(target_os = "linux")]
    Measurement {
        name: "default_settings",
        description: "the time to a displayed error by pattern, adaptive sampling and texture filter (some minutes)",
        run: default_settings::run,
    },
    Measurement {
        name: "render_to_error",
        description: "the time of settings chosen for an error over the least of all (some minutes a scene)",
        run: render_to_error::run,
    },
];

fn main() -> ExitCode {
    // Cargo adds `--bench` to the arguments of every benchmark.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if arguments.iter().any(|argument| argument == "--list") {
        for measurement in MEASUREMENTS {
            println!("{:18} {}", measurement.name, measurement.description);
        }
        return ExitCode::SUCCESS;
    }
    let chosen = match choose(&arguments) {
        Ok(chosen) => chosen,
        Err(message) => {
            eprintln!("error: {message}");
            return ExitCode::from(2);
        }
    };
    let mut missed = Vec::new();
    for measurement in chosen {
        println!("# {}", measurement.name);
        let mut limits = Limits::default();
        (measurement.run)(&mut limits);
        if limits.is_any_missed() {
            missed.push(measurement.name);
        }
    }
    if missed.is_empty() {
        return ExitCode::SUCCESS;
    }
    println!("limits were missed in {}", missed.join(", "));
    ExitCode::FAILURE
}

/// Returns the measurements of these names, or all where there is no name.
///
/// # Errors
///
/// Fails if no measurement has one of the names; the message lists all names.
fn choose(names: &[String]) -> Result<Vec<&'static Measurement>, String> {
    if names.is_empty() {
        return Ok(MEASUREMENTS.iter().collect());
    }
    let named = |name: &String| {
        let found = MEASUREMENTS.iter().find(|measurement| measurement.name == name);
        found.ok_or_else(|| {
            let all: Vec<&str> = MEASUREMENTS.iter().map(|measurement| measurement.name).collect();
            format!("no measurement is named `{name}`: use {}", all.join(", "))
        })
    };
    names.iter().map(named).collect()
}
