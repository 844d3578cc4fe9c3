//! Suite of hard cases: the backends pass it, naive implementations fail it, and `whit verify` reports it.

use std::collections::BTreeSet;
use std::fs;

use crate::support::cli_program::{fails_with, whit};
use crate::support::naive;
use whit::accel::{self, AccelOptions, Backend};
use whit::verify::{
    Build, Formulas, Recording, SystemUnderTest, VARIANTS, Verdict, VerdictCache, cases, check,
};

/// Number of rays per case: enough to find an error in one ray of a hundred, within seconds in a debug build.
const RAYS: u64 = 2000;

#[test]
fn variants_that_guarantee_exact_results_have_no_errors() {
    let mut failures = Vec::new();
    for case in cases() {
        let verdict_cache = VerdictCache::default();
        for path in VARIANTS.iter().filter(|p| case.applies_to(p) && p.is_built_in()) {
            let outcome = check((case, RAYS, Recording::Queries), path, None, &verdict_cache).unwrap();
            let tally = outcome.tally;
            if outcome.verdict == Verdict::Fails || tally.rays == 0 {
                failures.push(format!("{} on {}: {tally:?}", case.id, path.name));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_case_detects_a_naive_implementation() {
    let naive: &Build = &|scene| Ok(Box::new(naive::NaiveAccel::new(scene)));
    let ours: &Build =
        &|scene| accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default());
    let fat: &Build = &|scene| Ok(Box::new(naive::NaiveAccel::fat(scene)));
    let fickle: &Build = &|scene| Ok(Box::new(naive::FickleAccel(naive::NaiveAccel::new(scene))));
    let careless = [
        ("a textbook's structure and formulas", naive, naive::FORMULAS),
        ("starts on the surface", ours, naive::FORMULAS),
        ("starts a fixed distance off", ours, naive::FIXED_EPSILON),
        ("refraction in f32", ours, naive::SINGLE),
        ("larger triangles", fat, Formulas::RENDERER),
        ("results that change", fickle, Formulas::RENDERER),
    ];
    let mut failures = Vec::new();
    for case in cases() {
        let caught = careless.iter().find(|&&(_, build, formulas)| {
            let verdict_cache = &VerdictCache::default();
            let subject = SystemUnderTest {
                build,
                formulas,
                verdict_cache,
            };
            let tally = case.run_case(RAYS / 2, &subject).unwrap();
            assert_eq!(tally.wrong > 0, tally.example.is_some(), "{}", case.id);
            tally.wrong > 0
        });
        match caught {
            Some((by, ..)) => println!("{}: catches {by}", case.id),
            None => failures.push(case.id),
        }
    }
    assert!(failures.is_empty(), "careless code gets through {failures:?}");
}

#[test]
fn tally_is_independent_of_the_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let case = cases().into_iter().find(|case| case.id == "H36").unwrap();
        let build: &Build = &|scene| Ok(Box::new(naive::NaiveAccel::new(scene)));
        let subject = SystemUnderTest {
            build,
            formulas: Formulas::RENDERER,
            verdict_cache: &VerdictCache::default(),
        };
        pool.install(|| case.run_case(20_000, &subject).unwrap())
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn cached_verdicts_equal_fresh_verdicts() {
    let naive: &Build = &|scene| Ok(Box::new(naive::NaiveAccel::new(scene)));
    let ours: &Build =
        &|scene| accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default());
    for case in cases()
        .into_iter()
        .filter(|case| ["H05", "H11", "H17", "H26"].contains(&case.id))
    {
        let run_case = |build, verdict_cache| {
            let subject = SystemUnderTest {
                build,
                formulas: Formulas::RENDERER,
                verdict_cache,
            };
            case.run_case(5000, &subject).unwrap()
        };
        let verdict_cache = VerdictCache::default();
        let first = run_case(naive, &verdict_cache);
        assert_eq!(first, run_case(naive, &verdict_cache), "{}", case.id);
        assert_eq!(
            run_case(ours, &verdict_cache),
            run_case(ours, &VerdictCache::default()),
            "{}",
            case.id
        );
    }
}

#[test]
fn table_and_json_list_every_case_and_variant() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("verify.json").display().to_string();
    let run = whit(&[
        "verify", "--rays", "500", "--case", "H11", "--case", "h35", "--json", &json,
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for words in [
        "H11 vertex leaks",
        "H35 critical angle",
        "bsp single",
        "formulas",
        "holds",
    ] {
        assert!(run.stdout.contains(words), "{words} in {}", run.stdout);
    }
    let rows: serde_json::Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let mut named = BTreeSet::new();
    for row in rows.as_array().unwrap() {
        for key in [
            "id",
            "title",
            "construction",
            "oracle",
            "bound",
            "path",
            "verdict",
        ] {
            assert!(row[key].is_string(), "{key} in {row}");
        }
        for key in ["rays", "wrong", "ties"] {
            assert!(row[key].is_u64(), "{key} in {row}");
        }
        assert!(row["seconds"].as_f64().unwrap() > 0.0, "{row}");
        let path = row["path"].as_str().unwrap();
        assert_eq!(row["embree"].is_object(), path.starts_with("embree"), "{row}");
        named.insert(format!("{} {path}", row["id"].as_str().unwrap()));
    }
    for name in ["H11 bsp", "H11 bsp single", "H35 formulas"] {
        assert!(named.contains(name), "{name} in {named:?}");
    }
    assert_eq!(named.contains("H11 embree robust"), cfg!(feature = "embree"));
}

#[test]
fn list_describes_every_case_and_names_missing_ones() {
    let run = whit(&["verify", "--list"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for case in cases() {
        assert!(run.stdout.contains(&format!("{} {}", case.id, case.title)));
        assert!(run.stdout.contains(case.construction));
    }
    let is_there = |number: u32| cases().iter().any(|case| case.id == format!("H{number:02}"));
    let is_whole = (1..=48).all(is_there);
    assert_eq!(
        run.stdout.contains("not in this suite"),
        !is_whole,
        "{}",
        run.stdout
    );
}

#[cfg(feature = "embree")]
#[test]
fn embree_and_the_native_tree_are_restricted_to_each_instruction_set_in_turn() {
    let run = whit(&["verify", "--rays", "64", "--case", "H01", "--isa", "all"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("sse2"), "{}", run.stdout);
    let lines = |path: &str| run.stdout.lines().filter(|l| l.trim().starts_with(path)).count();
    assert!(lines("embree fast") >= 1);
    assert_eq!(lines("bsp single"), 1);
    // Sets below AVX2 are one form of the native tree
    assert_eq!(lines(&format!("{:18}portable", "native")), 1);
    assert_eq!(
        lines("native"),
        whit::mesh::simd::SimdLimit::within(None) as usize + 1
    );
    let one = whit(&["verify", "--rays", "64", "--case", "H01", "--isa", "sse2"]);
    assert!(one.stdout.contains("sse2") && !one.stdout.contains("avx"));
}

#[test]
fn invalid_requests_are_rejected_in_one_sentence() {
    fails_with(2, "there is no case `H99`", &["verify", "--case", "H99"]);
    fails_with(2, "--rays", &["verify", "--rays", "0"]);
    fails_with(
        2,
        "no-such-folder",
        &["verify", "--json", "/no-such-folder/a.json"],
    );
    #[cfg(not(feature = "embree"))]
    fails_with(2, "built without Embree", &["verify", "--isa", "sse2"]);
}
