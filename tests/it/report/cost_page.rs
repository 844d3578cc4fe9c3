//! The page of `whit cost` in a browser, of a study that is made up.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{chromium, is_clean, looked_at};
use serde_json::{Value, json};
use whit::cost::{Check, Curve, Interval, Knob, Point, Reference, Study, Timing};
use whit::image::{LinearImage, ToneMap};
use whit::report::cost_page::{ComparedImages, Facts, page};

const SIZE: [u32; 2] = [120, 80];

fn around(value: f64, part: f64) -> Interval {
    let half = part * value.abs();
    Interval {
        value,
        low: value - half,
        high: value + half,
    }
}

/// A point of a base of 0.8 s and an error of 0.021.
fn point(knob: Option<Knob>, level: &str, time: f64, error: f64) -> Point {
    let settings = [
        ("samples", "4"),
        ("pattern", "sobol"),
        ("depth", "6"),
        ("cutoff", "1/512"),
        ("path", "robust"),
    ];
    let mut settings: BTreeMap<String, String> = settings
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect();
    if let Some(knob) = knob {
        settings.insert(knob.name().replace(' ', "_"), level.to_owned());
    }
    let rmse = 0.021 * error;
    Point {
        knob,
        level: level.to_owned(),
        settings,
        build_seconds: 0.02,
        build_bytes: 1_500_000,
        ready_seconds: 0.0,
        seconds: around(0.8 * time, 0.08),
        time_ratio: around(time, 0.02),
        rmse: around(rmse, 0.18),
        bias_squared: around(0.1 * rmse * rmse, 2.0),
        variance: 0.9 * rmse * rmse,
        rel_mse: 2.0 * rmse,
        flip: 3.0 * rmse,
        max: 0.9,
        changed_share: (20.0 * rmse).min(1.0),
        non_finite: 0,
        rays: (1_234_567.0 * time) as u64,
        instructions: None,
        geometry: None,
        on_front: false,
    }
}

/// Levels of all knobs with their times and errors over the base's.
fn levels() -> Vec<(Knob, &'static str, f64, f64)> {
    let mut all = vec![
        (Knob::Pattern, "regular", 0.99, 1.12),
        (Knob::Pattern, "jittered", 1.01, 1.2),
        (Knob::Pattern, "r2", 1.0, 0.97),
        (Knob::TextureFilter, "off", 0.94, 1.35),
        (Knob::HitPath, "fast", 0.92, 1.0),
        (Knob::HitPath, "watertight", 1.4, 0.0),
        (Knob::HitPath, "bsp", 3.1, 0.9995),
        (Knob::Instancing, "flattened", 0.9, 1.0),
    ];
    let mut graded = |knob, levels: &[&'static str], times: &[f64], errors: &[f64]| {
        let all_of = levels.iter().zip(times).zip(errors);
        all.extend(all_of.map(|((&level, &time), &error)| (knob, level, time, error)));
    };
    graded(
        Knob::Samples,
        &["1", "2", "8", "16", "32", "64", "128", "256"],
        &[0.28, 0.52, 1.97, 3.9, 7.8, 15.5, 31.0, 62.0],
        &[2.4, 1.55, 0.64, 0.4, 0.26, 0.17, 0.11, 0.08],
    );
    graded(
        Knob::Adaptive,
        &["0.04", "0.02", "0.01", "0.005"],
        &[1.3, 2.4, 6.0, 14.0],
        &[0.7, 0.42, 0.22, 0.14],
    );
    graded(
        Knob::Depth,
        &["0", "1", "2", "3", "4", "8", "12"],
        &[0.3, 0.5, 0.7, 0.85, 0.95, 1.03, 1.05],
        &[9.0, 5.1, 2.7, 1.4, 1.1, 0.99, 0.99],
    );
    graded(
        Knob::Cutoff,
        &["1/8", "1/32", "1/128", "1/4096", "none"],
        &[0.6, 0.8, 0.93, 1.1, 1.16],
        &[2.0, 1.25, 1.04, 1.0, 1.0],
    );
    graded(
        Knob::LightSamples,
        &["1", "2", "8"],
        &[0.7, 0.8, 1.7],
        &[1.5, 1.2, 0.86],
    );
    graded(
        Knob::RoughRays,
        &["1", "2", "8"],
        &[0.75, 0.82, 1.5],
        &[1.7, 1.3, 0.8],
    );
    graded(
        Knob::MarchStep,
        &["4 times the scene's", "2 times the scene's", "1/2 of the scene's"],
        &[0.7, 0.82, 1.4],
        &[1.6, 1.2, 0.95],
    );
    all
}

fn study() -> Study {
    let mut points = vec![point(None, "base", 1.0, 1.0)];
    points.extend(
        levels()
            .into_iter()
            .map(|(knob, level, time, error)| point(Some(knob), level, time, error)),
    );
    for i in 0..points.len() {
        let is_better = |other: &Point| {
            other.seconds.value < points[i].seconds.value && other.rmse.value <= points[i].rmse.value
        };
        points[i].on_front = !points.iter().any(is_better);
    }
    let curves = Knob::ALL.into_iter().filter(|knob| knob.is_graded());
    let curves = curves.filter_map(|knob| {
        let mut places: Vec<usize> = (0..points.len())
            .filter(|&i| i == 0 || points[i].knob == Some(knob))
            .collect();
        places.sort_by(|&a, &b| points[a].seconds.value.total_cmp(&points[b].seconds.value));
        let slope = match knob {
            Knob::Samples => Some(around(-0.63, 0.1)),
            Knob::Adaptive => Some(around(-0.68, 0.15)),
            Knob::Depth => Some(around(-1.8, 0.2)),
            Knob::Cutoff => Some(around(-1.0, 1.4)),
            _ => Some(around(-0.7, 0.3)),
        };
        let curve = Curve {
            knob,
            points: places,
            slope,
        };
        (curve.points.len() > 1).then_some(curve)
    });
    Study {
        size: SIZE,
        pieces_of: None,
        threads: 2,
        reference: Reference {
            spp: 4096,
            paths: ["robust".to_owned(), "bsp".to_owned()],
            noise: 2.1e-4,
            checks: vec![
                check(
                    "noise",
                    true,
                    "0.00021, at most a fifth of the least error, 0.0017",
                ),
                check("halves", true, "no channel differs by more than chance"),
                check(
                    "depth",
                    false,
                    "8 more bounces change 1.3 % of the pixels; at most 0.1 %",
                ),
            ],
        },
        timing: Timing {
            blocks: 11,
            dropped: 1,
            calibration_spread: 0.013,
            waiting: 0.02,
            spent: 287.0,
            budget: 300.0,
        },
        curves: curves.collect(),
        choice: None,
        points,
    }
}

fn check(name: &str, holds: bool, words: &str) -> Check {
    Check {
        name: name.to_owned(),
        holds,
        words: words.to_owned(),
    }
}

/// Rings, and more of `noise` toward the right.
fn rings(noise: f32) -> LinearImage {
    let [width, height] = SIZE;
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    LinearImage {
        width,
        height,
        pixels: places
            .map(|[x, y]| {
                let r = (x as f32 - 60.0).hypot(y as f32 - 40.0);
                let off = noise * x as f32 / 120.0 * ((x * 7 + y * 13) % 11) as f32 / 11.0;
                [0, 1, 2].map(|c| (0.5 + 0.5 * (0.25 * r + c as f32).sin()) * 0.6 + off)
            })
            .collect(),
    }
}

fn written(folder: &Path, study: &Study) -> PathBuf {
    let facts = Facts {
        scene: Path::new("scenes/<made-up> & odd.gltf"),
        embree: Some("4.3.3".to_owned()),
        tone: ToneMap::default(),
        date: Some("2026-01-02"),
    };
    let [reference, image, difference] = [0.0, 0.3, 0.1].map(rings);
    let images = ComparedImages {
        reference: &reference,
        image: &image,
        difference: &difference,
        flip: &difference,
    };
    let path = folder.join("cost.html");
    fs::write(&path, page(study, &facts, &images).unwrap()).unwrap();
    path
}

/// Counts what is drawn, points at things, and slides.
const PROBE: &str = r##"
  const [chart, ...others] = shown(".chart");
  const inside = (box, all) => box.left >= all.left - 1 && box.right <= all.right + 1 && box.top >= all.top - 1 && box.bottom <= all.bottom + 1;
  const within = (marks) => marks.every((mark) => inside(mark.getBoundingClientRect(), mark.ownerSVGElement.getBoundingClientRect()));
  const found = {
    points: chart.querySelectorAll(".point").length,
    legend: [...chart.querySelectorAll(".legend span")].map((entry) => entry.textContent.trim()),
    charts: others.length,
    within: within([...document.querySelectorAll(".chart .mark, .chart text, .chart rect")].filter((mark) => mark.closest("svg").getAttribute("role"))),
    bad: [...document.querySelectorAll("svg *")].filter((mark) => [...mark.attributes].some((a) => /NaN|inf/.test(a.value))).length,
    stamp: shown(".stamp").map((stamp) => stamp.querySelector("b").textContent),
    rows: document.querySelectorAll("table.dense tbody tr").length,
    tiles: shown(".crops figure").length,
    svgs: shown("figure .chart svg").length,
    crop: shown(".crops img").map((image) => [image.naturalWidth, image.width])[0],
    colors: [...new Set([...chart.querySelectorAll(".series .mark")].map((mark) => getComputedStyle(mark).fill))].length,
  };
  const point = chart.querySelector(".point");
  point.dispatchEvent(new Event("pointerenter"));
  found.tip = shown(".tip").map((tip) => tip.textContent);
  found.tipInside = shown(".tip").every((tip) => inside(tip.getBoundingClientRect(), { left: 0, top: -1e9, right: innerWidth, bottom: 1e9 }));
  point.dispatchEvent(new Event("pointerleave"));
  found.quiet = shown(".tip").length;
  found.titles = [...document.querySelectorAll(".chart .point")].every((point) => point.getAttribute("aria-label"));
  const entry = chart.querySelector(".legend span");
  entry?.dispatchEvent(new Event("pointerenter"));
  found.faded = chart.querySelectorAll(".series.faded").length;
  entry?.dispatchEvent(new Event("pointerleave"));
  found.unfaded = chart.querySelectorAll(".series.faded").length;
  const form = document.querySelector(".viewer form");
  form.elements.cut.value = 25;
  form.dispatchEvent(new Event("input"));
  found.clip = getComputedStyle(document.querySelectorAll(".viewer img")[1]).clipPath;
  // Texts of one chart must not lie on each other.
  found.overlaps = [];
  for (const svg of document.querySelectorAll(".chart .scroll svg")) {
    const texts = [...svg.querySelectorAll("text")].filter((text) => text.textContent);
    const boxes = texts.map((text) => text.getBoundingClientRect());
    for (let i = 0; i < boxes.length; i += 1) {
      for (let k = 0; k < i; k += 1) {
        const [a, b] = [boxes[i], boxes[k]];
        const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (across > 1 && down > 4) found.overlaps.push([texts[i].textContent, texts[k].textContent]);
      }
    }
  }
  return found;
"##;

fn probed(browser: &str, page: &Path, flags: &[&str]) -> Value {
    let found = looked_at(browser, page, PROBE, flags);
    is_clean(&found);
    found
}

#[test]
fn page_draws_every_point_with_a_tooltip() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let study = study();
    let page = written(folder.path(), &study);
    let text = fs::read_to_string(&page).unwrap();
    for word in ["http:", "https:", "@import", "url("] {
        assert!(!text.contains(word), "{word}");
    }
    let found = probed(browser, &page, &["--window-size=1200,900"]);
    assert_eq!(found["points"], study.points.len(), "{found}");
    assert_eq!(found["rows"], study.points.len());
    let legend: Vec<&str> = found["legend"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect();
    // All knobs but wavelengths, and the base.
    assert_eq!(legend.len(), 12, "{found}");
    assert_eq!([legend[0], legend[11]], ["samples", "base"]);
    // Six colours, and the ring of the base.
    assert_eq!(found["colors"], 7, "{found}");
    assert_eq!(found["charts"], study.curves.len() + 1);
    assert_eq!(
        [&found["within"], &found["titles"], &found["tipInside"]],
        [&json!(true); 3],
        "{found}"
    );
    assert_eq!(found["bad"], 0);
    assert_eq!(found["stamp"], json!(["REFERENCE NOT CONVERGED"]));
    assert_eq!(found["overlaps"], json!([]));
    let tip = found["tip"][0].as_str().unwrap();
    assert!(
        tip.starts_with("samples 1") && tip.contains("pattern sobol"),
        "{tip}"
    );
    assert_eq!([&found["quiet"], &found["faded"], &found["unfaded"]], [0, 11, 0]);
}

#[test]
fn viewer_slides_images_and_worst_tiles_are_enlarged() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let found = probed(
        browser,
        &written(folder.path(), &study()),
        &["--window-size=1200,900"],
    );
    assert!(found["clip"].as_str().unwrap().contains("25%"), "{found}");
    assert_eq!(found["tiles"], 8, "{found}");
    assert_eq!(found["crop"], json!([32, 128]));
}

#[test]
fn page_fits_narrow_windows_and_follows_the_color_scheme() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = written(folder.path(), &study());
    let narrow = probed(browser, &page, &["--window-size=400,800"]);
    assert!(
        narrow["width"][0].as_u64() <= narrow["width"][1].as_u64(),
        "{}",
        narrow["width"]
    );
    let dark = probed(
        browser,
        &page,
        &["--window-size=400,800", "--blink-settings=preferredColorScheme=0"],
    );
    assert_ne!(narrow["ground"], dark["ground"]);
    assert_eq!(dark["colors"], 7, "{dark}");
}

#[test]
fn page_of_a_converged_base_has_no_warning() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut study = study();
    study.points.truncate(1);
    study.points[0].rmse = around(0.0, 0.0);
    study.curves.clear();
    for check in &mut study.reference.checks {
        check.holds = true;
    }
    let found = probed(
        browser,
        &written(folder.path(), &study),
        &["--window-size=1200,900"],
    );
    assert_eq!(found["points"], 1, "{found}");
    assert_eq!(found["bad"], 0);
    assert_eq!(found["stamp"], json!([]));
}
