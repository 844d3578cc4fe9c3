//! The subcommand `mutate`: loads mutations of files, and reports each that panics or takes long.
//!
//! A mutated file is written before it is loaded and stays if the process ends, so that an abort leaves its cause.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use whit::batch::request::load_scene;
use whit::gltf::LoadOptions;
use whit::numeric::SplitMix64;

/// Arguments of `mutate`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Exit code 2 if any mutation panicked or took longer than 5 seconds. Limit the memory by the shell, as in `ulimit -v 8000000`.

Examples:
  cargo run --release --example tools -- mutate --count 100000 --out /tmp/mutations a.glb b.gltf
  cargo run --release --example tools -- mutate --seed 7 --count 1000 --out /tmp/mutations scenes/*.toml picture.exr")]
pub(crate) struct Arguments {
    /// Folder that the mutated files are written to; those that fail stay in it
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,

    /// Number of mutations, taken in turn from the files
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    count: u64,

    /// Seed of the random numbers; the same seed makes the same mutations
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Scenes (.glb, .gltf, .toml) and images (.png, .jpg, .webp, .exr, .hdr)
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
}

/// Time after which a load counts as a hang.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest number of changes that one mutation makes.
const MAX_CHANGES: usize = 8;
/// Largest number of bytes that one change inserts, removes or repeats.
const MAX_RUN: usize = 64;
/// Largest number of texels, so that a mutated size does not fill the memory.
const MAX_TEXELS: u64 = 1 << 24;
/// Words that often are limits: zero, one, and the largest of each type, signed and unsigned.
const LIMITS: [u32; 8] = [0, 1, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff];

/// Outcome of loading a file.
enum Ending {
    Loaded,
    Refused,
    Panicked,
    Late,
}

/// Loads the mutations and prints how many loaded and how many were refused.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let unreadable = |path: &Path, error: std::io::Error| format!("{}: {error}", path.display());
    std::fs::create_dir_all(&arguments.out).map_err(|e| unreadable(&arguments.out, e))?;
    let mut originals = Vec::new();
    for path in &arguments.files {
        originals.push(std::fs::read(path).map_err(|e| unreadable(path, e))?);
    }
    // Load one mutation after another
    let (mut loaded, mut failed) = (0u64, 0u64);
    let mut slowest = Duration::ZERO;
    for number in 0..arguments.count {
        let file = (number % arguments.files.len() as u64) as usize;
        let source = &arguments.files[file];
        let mut random = SplitMix64::new(arguments.seed, number);
        let bytes = mutated(originals[file].clone(), &mut random);
        let suffix = source.extension().and_then(|e| e.to_str()).unwrap_or("bin");
        let path = arguments
            .out
            .join(format!("{}-{number}.{suffix}", arguments.seed));
        std::fs::write(&path, bytes).map_err(|e| unreadable(&path, e))?;
        let start = Instant::now();
        let ending = load(path.clone());
        slowest = slowest.max(start.elapsed());
        // Keep the files that fail
        match ending {
            Ending::Panicked | Ending::Late => {
                failed += 1;
                let what = if matches!(ending, Ending::Late) {
                    "takes long"
                } else {
                    "panics"
                };
                println!(
                    "{}: {what}: mutation {number} of {}",
                    path.display(),
                    source.display()
                );
                continue;
            }
            Ending::Loaded => loaded += 1,
            Ending::Refused => {}
        }
        std::fs::remove_file(&path).map_err(|e| unreadable(&path, e))?;
    }
    let refused = arguments.count - loaded - failed;
    println!(
        "{} mutations of {} files: {loaded} loaded, {refused} refused, {failed} failed, slowest {:.2} s",
        arguments.count,
        arguments.files.len(),
        slowest.as_secs_f64()
    );
    match failed {
        0 => Ok(()),
        _ => Err(format!(
            "{failed} mutations failed; they are in {}",
            arguments.out.display()
        )),
    }
}

/// Returns a file with a few random changes.
fn mutated(mut bytes: Vec<u8>, random: &mut SplitMix64) -> Vec<u8> {
    let most = 1 + random.below(MAX_CHANGES);
    for _ in 0..1 + random.below(most) {
        if bytes.is_empty() {
            break;
        }
        let at = random.below(bytes.len());
        let end = (at + 1 + random.below(MAX_RUN)).min(bytes.len());
        match random.below(7) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = random.bits() as u8,
            2 => {
                let word = LIMITS[random.below(LIMITS.len())].to_le_bytes();
                bytes
                    .iter_mut()
                    .skip(at)
                    .zip(word)
                    .for_each(|(byte, new)| *byte = new);
            }
            // A digit of a number in a text
            3 => {
                let digit = bytes[at..].iter_mut().find(|byte| byte.is_ascii_digit());
                digit
                    .into_iter()
                    .for_each(|byte| *byte = b'0' + random.below(10) as u8);
            }
            4 => drop(bytes.drain(at..end)),
            5 => {
                let run = bytes[at..end].to_vec();
                bytes.splice(at..at, run);
            }
            _ if random.below(4) == 0 => bytes.truncate(at),
            _ => bytes[at..end].fill(random.bits() as u8),
        }
    }
    bytes
}

/// Loads a file on a thread of its own, which a hang leaves behind.
fn load(path: PathBuf) -> Ending {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let is_image = path
            .extension()
            .and_then(|e| e.to_str())
            .is_some_and(|e| ["png", "jpg", "jpeg", "webp", "exr", "hdr"].contains(&e));
        let is_loaded = if is_image {
            whit::image::load_image(&path).is_ok()
        } else {
            let options = LoadOptions {
                max_texels: MAX_TEXELS,
                ..LoadOptions::default()
            };
            load_scene(&path, &[], &options).is_ok()
        };
        // The receiver has gone if the load took too long
        let _ = sender.send(is_loaded);
    });
    match receiver.recv_timeout(PATIENCE) {
        Ok(true) => Ending::Loaded,
        Ok(false) => Ending::Refused,
        Err(RecvTimeoutError::Disconnected) => Ending::Panicked,
        Err(RecvTimeoutError::Timeout) => Ending::Late,
    }
}
