//! Command `whit verify SCENE --replay FILE`: traces recorded rays again with every backend variant.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use crate::accel::hit_compare::HitComparison;
use crate::accel::{self, Accel, AccelOptions, Backend, Instancing};
use crate::parallel;
use crate::scene::{EffectSet, Scene};
use crate::verify::{self, Difference, PATHS, RaysFile, Reply, ask_again, describe_ray};

use super::args::VerifyArgs;
use super::failure::Failure;
use super::interrupt;
use super::job::Tracing;
use super::output;
use super::own::holds;
use super::scene;

/// Traces the rays of `file` again in the first scene of the arguments.
pub(super) fn run(args: &VerifyArgs, file: &Path) -> Result<(), Failure> {
    let rays = read(file)?;
    let Some(path) = args.scenes.first() else {
        return Err(Failure::Input("name the scene that the rays are of".into()));
    };
    let pool = Tracing::of_threads(args.threads).pool()?;
    let loaded = parallel::install(&pool, || scene::load((path, &[], None), EffectSet::NONE))?;
    // The scene must be the one that the rays were recorded in, as far as its size shows
    let found = holds(&loaded.scene);
    if found != rays.holds {
        return Err(Failure::Input(format!(
            "{} is of another scene: of {} with {} instances and {} primitives, while {} has {} and {}",
            file.display(),
            rays.scene,
            rays.holds[0],
            rays.holds[1],
            path.display(),
            found[0],
            found[1]
        )));
    }
    let heard = parallel::install(&pool, || ask_all(&loaded.scene, &rays.rays, args.isa.as_deref()))?;
    output::print(&told(&rays, &heard))
}

/// Reads a file of recorded rays.
fn read(path: &Path) -> Result<RaysFile, Failure> {
    let text = fs::read_to_string(path)
        .map_err(|error| Failure::Input(format!("could not read {}: {error}", path.display())))?;
    RaysFile::parse(&text).map_err(|error| Failure::Input(format!("{}: {error}", path.display())))
}

/// Backend variant with its result for each ray.
struct Heard {
    name: &'static str,
    replies: Vec<(Reply, HitComparison)>,
}

/// Traces the rays with all variants, one after another, so that only one acceleration structure is in memory at a
/// time; brute force needs none.
fn ask_all(scene: &Scene, rays: &[Difference], isa: Option<&str>) -> Result<Vec<Heard>, Failure> {
    let brute = accel::build(scene, Backend::Brute, &AccelOptions::default())?;
    let ask = |name, accel: &dyn Accel, instancing| Heard {
        name,
        replies: parallel::map(rays.len(), &|index| {
            ask_again(scene, [&*brute, accel], &rays[index], instancing)
        }),
    };
    let mut heard = Vec::new();
    for path in PATHS.iter().filter(|path| path.is_built_in()) {
        let Some((_, precision, _)) = path.accel else {
            continue;
        };
        interrupt::check()?;
        let accel = verify::build_path(scene, path, isa)?;
        let instancing = if path.is_embree() {
            Instancing::Auto.resolved(precision)
        } else {
            Instancing::Callback
        };
        heard.push(ask(path.name, &*accel, instancing));
    }
    heard.push(ask("brute force", &*brute, Instancing::Callback));
    Ok(heard)
}

/// Returns a text with each ray, its recorded results, and the result of each variant now.
fn told(file: &RaysFile, heard: &[Heard]) -> String {
    let [first, second] = &file.answers;
    let mut text = format!(
        "{} rays of {}, answered differently by\n    {first}\n    {second}\n",
        file.rays.len(),
        file.scene
    );
    for (number, ray) in file.rays.iter().enumerate() {
        let verdict = if ray.is_wrong { "wrong" } else { "tie" };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "\n{} {} ray, {verdict}, {}: {}",
            number + 1,
            ray.kind.word(),
            ray.place.name(),
            describe_ray(&ray.ray)
        );
        // Print the recorded results
        for (name, reply) in ["first, then", "second, then"].into_iter().zip(ray.replies) {
            let _ = writeln!(text, "    {name:17} {reply}");
        }
        // Print the new results, compared with brute force
        for Heard { name, replies } in heard {
            let (reply, agreement) = replies[number];
            let judged = match agreement {
                HitComparison::Same => "",
                HitComparison::Tie => "  ties with brute force",
                HitComparison::Wrong => "  differs from brute force by more than rounding",
            };
            let _ = writeln!(text, "    {name:17} {reply}{judged}");
        }
    }
    text
}
