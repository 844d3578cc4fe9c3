//! Command `whit verify SCENE --replay FILE`: traces recorded rays again with every backend variant.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use whit::accel::hit_compare::HitComparison;
use whit::accel::{self, Accel, AccelOptions, Backend, Instancing};
use whit::batch::request::{TracingOptions, load_scene};
use whit::gltf::LoadOptions;
use whit::parallel;
use whit::scene::ValidScene;
use whit::verify::{self, Difference, QueryResult, RaysFile, RaysOfPair, VARIANTS, describe_ray, retrace};

use super::args::VerifyArgs;
use super::cross_check::holds;
use super::failure::Failure;
use super::interrupt;
use super::output;

/// Traces the rays of `file` again in the first scene of the arguments.
pub(super) fn run(args: &VerifyArgs, file: &Path) -> Result<(), Failure> {
    let rays = read(file)?;
    let Some(path) = args.scenes.first() else {
        return Err(Failure::Input("give the scene of the rays".into()));
    };
    let pool = TracingOptions::of_threads(args.threads).pool()?;
    let loaded = parallel::install(&pool, || load_scene(path, &[], &LoadOptions::default()))?;
    // The scene must be the one that the rays were recorded in, as far as its size shows
    let found = holds(&loaded.scene);
    if found != rays.holds {
        return Err(Failure::Input(format!(
            "{} has rays of another scene: {} with {} instances and {} primitives, while {} has {} and {}",
            file.display(),
            rays.scene,
            rays.holds[0],
            rays.holds[1],
            path.display(),
            found[0],
            found[1]
        )));
    }
    let all: Vec<Difference> = rays.pairs.iter().flat_map(|pair| &pair.rays).copied().collect();
    let results = parallel::install(&pool, || {
        retrace_all(loaded.scene.validate()?, &all, args.isa.as_deref())
    })?;
    output::print(&format_results(&rays, &results))
}

/// Reads a file of recorded rays.
fn read(path: &Path) -> Result<RaysFile, Failure> {
    let text = fs::read_to_string(path)
        .map_err(|error| Failure::Input(format!("cannot read {}: {error}", path.display())))?;
    RaysFile::parse(&text).map_err(|error| Failure::Input(format!("{}: {error}", path.display())))
}

/// Backend variant with its result for each ray.
struct VariantResults {
    name: &'static str,
    query_results: Vec<(QueryResult, HitComparison)>,
}

/// Traces the rays with all variants, one after another, so that only one acceleration structure is in memory at a
/// time; brute force needs none.
fn retrace_all(
    scene: ValidScene,
    rays: &[Difference],
    isa: Option<&str>,
) -> Result<Vec<VariantResults>, Failure> {
    let brute = accel::build(scene, Backend::Brute, &AccelOptions::default())?;
    let trace = |name, accel: &dyn Accel, instancing| VariantResults {
        name,
        query_results: parallel::map(rays.len(), &|index| {
            retrace(&scene, [&*brute, accel], &rays[index], instancing)
        }),
    };
    let mut results = Vec::new();
    for path in VARIANTS.iter().filter(|path| path.is_built_in()) {
        let Some((_, precision, _)) = path.accel else {
            continue;
        };
        interrupt::check()?;
        let accel = verify::build_variant(scene.get(), path, isa)?;
        let instancing = if path.is_embree() {
            Instancing::Auto.resolved(precision)
        } else {
            Instancing::Callback
        };
        results.push(trace(path.name, &*accel, instancing));
    }
    results.push(trace("brute force", &*brute, Instancing::Callback));
    Ok(results)
}

/// Returns a text with each ray, its recorded results, and the result of each variant now.
fn format_results(file: &RaysFile, results: &[VariantResults]) -> String {
    let mut text = String::new();
    let mut number = 0;
    for RaysOfPair { backends, rays } in &file.pairs {
        // Name the two backends; writing to a string cannot fail
        let [first, second] = backends;
        let _ = writeln!(
            text,
            "{} rays of {} with different results from\n    {first}\n    {second}",
            rays.len(),
            file.scene
        );
        for ray in rays {
            format_ray(&mut text, ray, number, results);
            number += 1;
        }
    }
    text
}

/// Appends the text of the ray `number`.
fn format_ray(text: &mut String, ray: &Difference, number: usize, results: &[VariantResults]) {
    let verdict = if ray.is_wrong { "wrong" } else { "tie" };
    let _ = writeln!(
        text,
        "\n{} {} ray, {verdict}, {}: {}",
        number + 1,
        ray.kind.word(),
        ray.feature.name(),
        describe_ray(&ray.ray)
    );
    // Print the recorded results
    for (name, reply) in ["first, then", "second, then"].into_iter().zip(ray.query_results) {
        let _ = writeln!(text, "    {name:17} {reply}");
    }
    // Print the new results, compared with brute force
    for VariantResults { name, query_results } in results {
        let (reply, agreement) = query_results[number];
        let judged = match agreement {
            HitComparison::Same => "",
            HitComparison::Tie => "  ties with brute force",
            HitComparison::Wrong => "  differs from brute force by more than rounding",
        };
        let _ = writeln!(text, "    {name:17} {reply}{judged}");
    }
}
