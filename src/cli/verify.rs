//! Command `whit verify`: hard cases with exact results, run through every backend variant. For scenes, see
//! `cross_check`.

use std::collections::BTreeSet;

use whit::accel::{AccelError, Backend};
use whit::batch::request::TracingOptions;
use whit::image::check_writable;
use whit::mesh::simd::SimdLimit;
use whit::parallel;
use whit::report::verify::{VerifyRow, case_list, table};
use whit::report::verify_page;
use whit::verify::{self, BackendVariant, Case, Recording, VARIANTS, Verdict, VerdictCache};

use super::args::VerifyArgs;
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::progress::{Progress, Verbosity};

/// Instruction sets that Embree can be restricted to, in ascending order.
const INSTRUCTION_SETS: [&str; 5] = ["sse2", "sse4.2", "avx", "avx2", "avx512"];

/// Runs the cases that the arguments select, or checks the scenes that they name.
pub(super) fn run(args: &VerifyArgs) -> Result<(), Failure> {
    // Dispatch the other two modes: recorded rays and scenes
    if let Some(file) = &args.replay {
        return super::verify_replay::run(args, file);
    }
    if !args.scenes.is_empty() {
        return super::cross_check::run(args);
    }
    // Select the cases, and check the output files
    let cases = chosen(&args.cases)?;
    if args.list {
        return output::print(&case_list(&cases));
    }
    for path in args.json.iter().chain(&args.html) {
        check_writable(path)?;
    }
    if args.isa.is_some() && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    let pool = TracingOptions::of_threads(args.threads).pool()?;
    let progress = Progress::new(Verbosity::Normal);
    // List all combinations of case, variant and instruction set
    let runs = runs(
        &cases,
        &parallel::install(&pool, || instruction_sets(args.isa.as_deref())),
    );
    let mut rows = Vec::with_capacity(runs.len());
    let mut verdict_cache = ("", VerdictCache::default());
    for (number, (case, path, isa)) in runs.iter().enumerate() {
        interrupt::check()?;
        progress.phase(case.id, path.name);
        progress.fraction(number as f64 / runs.len() as f64);
        let recording = match args.html {
            Some(_) => Recording::Drawings,
            None => Recording::Queries,
        };
        // Verdicts of the exact reference are cached for all variants of a case
        if verdict_cache.0 != case.id {
            verdict_cache = (case.id, VerdictCache::default());
        }
        let outcome = parallel::install(&pool, || {
            verify::check(
                (case, args.rays, recording),
                path,
                isa.as_deref(),
                &verdict_cache.1,
            )
        })?;
        rows.push(VerifyRow::new(case, path, isa.as_deref(), outcome));
    }
    progress.clear();
    // Print the table and write the files
    output::print(&table(&rows))?;
    if let Some(path) = &args.json {
        interrupt::without_interruption(|| output::write_json(path, &rows))?;
    }
    if let Some(path) = &args.html {
        let run = verify_page::Run {
            rays: args.rays,
            date: args.date.clone(),
        };
        let page = verify_page::page(&rows, &run);
        interrupt::without_interruption(|| output::write_text(path, &page))?;
    }
    verdict(&rows)
}

/// Returns the cases of these names, or all if there are none, in the order of the suite.
fn chosen(names: &[String]) -> Result<Vec<&'static Case>, Failure> {
    let all = verify::cases();
    let is_named = |case: &Case| names.iter().any(|name| name.eq_ignore_ascii_case(case.id));
    let unknown = |name: &&String| !all.iter().any(|case| name.eq_ignore_ascii_case(case.id));
    if let Some(name) = names.iter().find(unknown) {
        return Err(Failure::Input(format!(
            "there is no case `{name}`: `whit verify --list` prints all cases"
        )));
    }
    Ok(all
        .into_iter()
        .filter(|case| names.is_empty() || is_named(case))
        .collect())
}

/// Returns the instruction sets that variants are restricted to, each in a run of its own.
fn instruction_sets(requested: Option<&str>) -> Vec<Option<String>> {
    if requested != Some("all") {
        return vec![requested.map(str::to_owned)];
    }
    INSTRUCTION_SETS
        .into_iter()
        .filter(|isa| verify::has_instruction_set(isa))
        .map(|isa| Some(isa.to_owned()))
        .collect()
}

type Run = (&'static Case, BackendVariant, Option<String>);

/// Returns every case on every variant that it applies to: Embree's with each instruction set, the native tree's with each
/// that its kernels are compiled for, and the others once.
fn runs(cases: &[&'static Case], instruction_sets: &[Option<String>]) -> Vec<Run> {
    let mut runs = Vec::new();
    for &case in cases {
        for path in VARIANTS
            .iter()
            .copied()
            .filter(|path| case.applies_to(path) && path.is_built_in())
        {
            // Select the sets that differ for the variant
            let mut sets = instruction_sets.to_vec();
            match path.accel {
                Some((Backend::Embree, ..)) => {}
                Some((Backend::Native, ..)) => {
                    sets.dedup_by_key(|isa| SimdLimit::within(isa.as_deref()));
                }
                _ => sets = vec![None],
            }
            runs.extend(sets.into_iter().map(|isa| (case, path, isa)));
        }
    }
    runs
}

/// Returns an error if a check failed that must not fail.
fn verdict(rows: &[VerifyRow]) -> Result<(), Failure> {
    let failed: Vec<&VerifyRow> = rows
        .iter()
        .filter(|row| row.outcome.verdict == Verdict::Fails)
        .collect();
    if failed.is_empty() {
        return Ok(());
    }
    let names: BTreeSet<String> = failed
        .iter()
        .map(|row| format!("{} on {}", row.case.id, row.path))
        .collect();
    Err(Failure::Work(format!(
        "{} of {} checks failed: {}",
        failed.len(),
        rows.len(),
        names.into_iter().collect::<Vec<_>>().join(", ")
    )))
}
