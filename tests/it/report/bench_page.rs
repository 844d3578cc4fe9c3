//! The page of `whit bench` in a browser, of measurements that are made up.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{chromium, is_clean, looked_at};
use serde_json::{Value, json};
use whit::accel::{Backend, EmbreeIdentity, Precision};
use whit::bench::{BenchRow, FrameTime, Mode, RayKind, Scaled, ScaledBuild};
use whit::report::bench_page::{Facts, page};

const SIZES: [u64; 5] = [974, 10_094, 99_374, 999_602, 10_002_830];
const KINDS: [RayKind; 4] = [
    RayKind::Camera,
    RayKind::Shadow,
    RayKind::Reflection,
    RayKind::Random,
];
const WAYS: [(Backend, Precision, Mode); 11] = [
    (Backend::Embree, Precision::Watertight, Mode::Packet),
    (Backend::Embree, Precision::Watertight, Mode::Raw),
    (Backend::Embree, Precision::Watertight, Mode::Single),
    (Backend::Embree, Precision::Watertight, Mode::RawSingle),
    (Backend::Embree, Precision::Fast, Mode::Packet),
    (Backend::Embree, Precision::Robust, Mode::Packet),
    (Backend::Native, Precision::Watertight, Mode::Single),
    (Backend::Native, Precision::Watertight, Mode::Batch),
    (Backend::Bsp, Precision::Watertight, Mode::Packet),
    (Backend::Bsp, Precision::Watertight, Mode::Single),
    (Backend::Bsp, Precision::Watertight, Mode::Batch),
];

/// Made up, but neither the same twice nor without order: slower over the size, Embree less so than the BSP.
fn speed(size: u64, kind: usize, way: usize) -> f64 {
    let (backend, _, mode) = WAYS[way];
    let [first, fall] = match backend {
        Backend::Bsp => [90.0, -0.3],
        Backend::Native => [80.0, -0.1],
        _ => [30.0, -0.1],
    };
    let width = match mode {
        Mode::Single | Mode::RawSingle => 0.4,
        _ => 1.0 + 0.05 * way as f64,
    };
    first * width * (size as f64 / 1000.0).powf(fall) / (1.0 + 0.5 * kind as f64)
}

fn row(size: u64, kind: usize, way: usize) -> BenchRow {
    let (backend, precision, mode) = WAYS[way];
    let speed = speed(size, kind, way);
    let build_seconds = 4e-7 * size as f64 * (1.0 + 0.1 * precision as u8 as f64 + backend as u8 as f64);
    let scaled = |threads: usize| Scaled {
        threads,
        mrays_per_s: 0.9 * speed * threads as f64,
        mrays_per_s_min: 0.8 * speed * threads as f64,
        mrays_per_s_max: speed * threads as f64,
    };
    let built = |threads: usize| ScaledBuild {
        threads,
        build_seconds: build_seconds / threads as f64,
        build_seconds_min: 0.9 * build_seconds / threads as f64,
        build_seconds_max: 1.2 * build_seconds / threads as f64,
    };
    BenchRow {
        scene: format!("<made-up> & odd, {size}").into(),
        triangles: size,
        backend,
        instancing: None,
        precision,
        rays: KINDS[kind],
        mode,
        mrays_per_s: speed,
        mrays_per_s_min: 0.96 * speed,
        mrays_per_s_max: 1.03 * speed,
        ray_count: 1 << 18,
        build_seconds,
        build_seconds_min: 0.9 * build_seconds,
        build_seconds_max: 1.2 * build_seconds,
        bytes: size * (34 + 12 * way as u64),
        mismatches: 0,
        ties: way as u64,
        threads: 4,
        waiting: 0.0,
        embree: (backend == Backend::Embree).then(|| EmbreeIdentity {
            version: "4.3.3".to_owned(),
            isa: "avx2".to_owned(),
        }),
        frame: Some(FrameTime {
            seconds: 0.1,
            rays: 1 << 20,
            over_raw: 1.3,
            trace_share: 0.75,
        }),
        scaling: [1, 2, 4].map(scaled).to_vec(),
        build_scaling: [1, 2, 4].map(built).to_vec(),
    }
}

/// All of the first `sizes`.
fn rows(sizes: usize) -> Vec<BenchRow> {
    let places = SIZES[..sizes]
        .iter()
        .flat_map(|&size| (0..4).map(move |kind| (size, kind)));
    let of = |(size, kind)| (0..WAYS.len()).map(move |way| row(size, kind, way));
    places.flat_map(of).collect()
}

fn written(folder: &Path, rows: &[BenchRow]) -> PathBuf {
    let facts = Facts {
        is_sweep: true,
        repeat: 5,
        date: Some("2026-01-02"),
    };
    let path = folder.join("bench.html");
    fs::write(&path, page(rows, &facts)).unwrap();
    path
}

/// Counts what is drawn and points at things.
const PROBE: &str = r##"
  const inside = (box, all) => box.left >= all.left - 1 && box.right <= all.right + 1 && box.top >= all.top - 1 && box.bottom <= all.bottom + 1;
  const drawn = [...document.querySelectorAll(".chart .scroll .mark, .chart .scroll text, .chart .scroll rect")];
  const charts = shown(".chart");
  const found = {
    charts: charts.length,
    points: charts.map((chart) => chart.querySelectorAll(".point").length),
    labels: charts.map((chart) => chart.querySelector(".scroll svg").getAttribute("aria-label")),
    within: drawn.every((mark) => inside(mark.getBoundingClientRect(), mark.ownerSVGElement.getBoundingClientRect())),
    bad: [...document.querySelectorAll("svg *")].filter((mark) => [...mark.attributes].some((a) => /NaN|inf/.test(a.value))).length,
    verdicts: shown("table.crossings tbody tr").map((row) => row.textContent),
    rows: [...document.querySelectorAll("table.speeds")].map((table) => table.querySelectorAll("tbody tr").length),
    legends: charts.map((chart) => chart.querySelectorAll(".legend span").length),
    titles: [...document.querySelectorAll(".chart .point")].every((point) => point.getAttribute("aria-label")),
    bars: [...new Set([...document.querySelectorAll("svg rect.bar")].map((bar) => getComputedStyle(bar).fill))].length,
  };
  const tip = (chart) => {
    const point = chart.querySelector(".point");
    point.dispatchEvent(new Event("pointerenter"));
    const words = shown(".tip").map((tip) => tip.textContent);
    point.dispatchEvent(new Event("pointerleave"));
    return words[0];
  };
  found.tips = charts.map(tip);
  found.quiet = shown(".tip").length;
  const entry = charts[0].querySelector(".legend [data-series]");
  entry?.dispatchEvent(new Event("pointerenter"));
  found.faded = charts[0].querySelectorAll(".series.faded").length;
  entry?.dispatchEvent(new Event("pointerleave"));
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

fn strings(list: &Value) -> Vec<&str> {
    list.as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect()
}

#[test]
fn page_draws_all_sizes_and_methods_and_lists_crossings() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rows = rows(SIZES.len());
    let page = written(folder.path(), &rows);
    let text = fs::read_to_string(&page).unwrap();
    for word in ["http:", "https:", "@import", "url("] {
        assert!(!text.contains(word), "{word}");
    }
    let found = probed(browser, &page, &["--window-size=1200,900"]);
    // Speed by kind of ray, building, memory; then bars and threads of each size.
    assert_eq!(found["charts"], 4 + 2 + 2 * SIZES.len(), "{found}");
    // Bare calls for single rays are in the bars alone. Five structures; three ways of four kinds on three numbers
    // of threads.
    let of_speed = (WAYS.len() - 1) * SIZES.len();
    let mut points = [vec![of_speed; 4], vec![5 * SIZES.len(); 2]].concat();
    points.extend([4 * WAYS.len(), 3 * 4 * 3].repeat(SIZES.len()));
    assert_eq!(found["points"], json!(points), "{found}");
    assert_eq!(found["rows"], json!(vec![4 * WAYS.len(); SIZES.len()]));
    let labels = strings(&found["labels"]);
    assert_eq!(labels[0], "million rays per second over triangles");
    assert_eq!(
        labels[4..6],
        [
            "build seconds over triangles",
            "bytes per triangle over triangles"
        ]
    );
    assert_eq!([&found["within"], &found["titles"]], [&json!(true); 2], "{found}");
    assert_eq!([&found["bad"], &found["quiet"]], [0; 2]);
    assert_eq!(found["overlaps"], json!([]));
    // Bare calls, Embree, and both backends of our own.
    assert_eq!(found["bars"], 4);
    // All series of the first chart but the one pointed at.
    assert_eq!(found["faded"], WAYS.len() - 2);
    let tips = strings(&found["tips"]);
    assert_eq!(
        tips[0],
        "974 triangles\nembree watertight, packet, camera rays\n30.1 million rays per second (28.9 to 31.0)"
    );
    // Two backends: batches at three precisions, single rays at one; builds and memory.
    let verdicts = strings(&found["verdicts"]);
    assert_eq!(verdicts.len(), 2 * (4 * (3 + 1) + 3 + 3), "{verdicts:?}");
    let [of_native, of_bsp] = [verdicts[0], verdicts[1]];
    assert!(
        of_native.contains("the native tree is ahead at every size"),
        "{of_native}"
    );
    // 30 · s^-0.1 and 90 · 1.5 · s^-0.3 of thousands: s = 4.5^5 = 1845. At 999 602 the BSP is ahead still.
    assert!(
        of_bsp.contains(
            "the BSP is ahead up to about 1 800 000 triangles (between 999 602 and 10 002 830), then Embree"
        ),
        "{of_bsp}"
    );
}

#[test]
fn page_fits_narrow_windows_and_follows_the_color_scheme() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = written(folder.path(), &rows(2));
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
    assert_eq!(dark["bars"], 4, "{dark}");
}

#[test]
fn scene_without_thread_scaling_has_only_bars() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut rows = rows(1);
    for row in &mut rows {
        row.scaling.clear();
        row.build_scaling.clear();
        // A scene of shapes has no triangles to share its bytes.
        row.triangles = 0;
    }
    let found = probed(
        browser,
        &written(folder.path(), &rows),
        &["--window-size=1200,900"],
    );
    assert_eq!(found["points"], json!([4 * WAYS.len()]), "{found}");
    assert_eq!([&found["bad"], &found["verdicts"]], [&json!(0), &json!([])]);
}
