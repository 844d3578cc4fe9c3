//! The page of a batch in a browser.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{chromium, is_clean, looked_at};
use serde_json::{Value, json};
use whit::image::{LinearImage, ToneMap};
use whit::report::gallery::{EffectShare, FrameStatus, Gallery, GalleryFrame, thumbnail, thumbnail_side};

const EFFECTS: [&str; 8] = [
    "camera",
    "shadow",
    "reflection",
    "refraction",
    "texture",
    "surface",
    "film",
    "idle",
];

/// Rings whose middle goes round with `turn`, and grain that does not pack well.
fn rings(turn: f32) -> LinearImage {
    let (width, height) = (320, 240);
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [x as f32, y as f32]));
    let mut grain = 1u32;
    let pixels = places.map(|[x, y]| {
        let r = (x - 160.0 - 60.0 * turn.cos()).hypot(y - 120.0 - 60.0 * turn.sin());
        grain = grain.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (grain >> 8) as f32 / (1 << 24) as f32;
        [0, 1, 2].map(|c| 0.4 + 0.3 * (0.1 * r + c as f32 + turn).sin() + 0.1 * noise)
    });
    LinearImage {
        width,
        height,
        pixels: pixels.collect(),
    }
}

fn frame(number: usize, small: &[Vec<u8>]) -> GalleryFrame {
    let name = format!("turn {}.png", number + 1);
    let settings = vec![
        format!("time {:.2} s", number as f64 / 24.0),
        "camera <top>".to_owned(),
    ];
    // The second has failed, the third is missing, the fourth was there.
    let (status, message) = match number {
        1 => (FrameStatus::Failed, "scene & file: no such mesh: name another"),
        2 => (FrameStatus::Missing, ""),
        3 => (FrameStatus::Skipped, "made by an earlier run"),
        _ => (FrameStatus::Done, ""),
    };
    let mut frame = GalleryFrame {
        image: format!("pictures/{name}"),
        name,
        width: 320,
        height: 240,
        spp: 16,
        status,
        message: message.to_owned(),
        settings,
        ..GalleryFrame::default()
    };
    if status != FrameStatus::Done {
        return frame;
    }
    let render = 2.0 + (number as f64 * 0.7).sin();
    let load = if number == 0 { 0.9 } else { 0.0 };
    frame.seconds = [load, 0.2, render, 0.05];
    let share = |(place, &name): (usize, &&'static str)| EffectShare {
        name,
        seconds: render / (place + 1) as f64,
        rays: 100_000 / (place as u64 + 1),
    };
    frame.ledger = EFFECTS.iter().enumerate().map(share).collect();
    frame.thumbnail = small[number % small.len()].clone();
    frame
}

fn written(folder: &Path, count: usize) -> PathBuf {
    let small = |number: usize| {
        let image = rings(number as f32 * 0.26);
        thumbnail(&image, thumbnail_side(count), ToneMap::default()).unwrap()
    };
    let small: Vec<Vec<u8>> = (0..count.min(24)).map(small).collect();
    let gallery = Gallery {
        title: "Turntable <1> & more".to_owned(),
        frames: (0..count).map(|number| frame(number, &small)).collect(),
        seconds: 61.5,
    };
    let path = folder.join("gallery.html");
    fs::write(&path, gallery.page()).unwrap();
    path
}

/// Sorts, filters and goes from frame to frame.
const PROBE: &str = r##"
  const frames = () => shown(".frame").map((frame) => Number(frame.dataset.number));
  const select = document.querySelector("form.order select");
  const by = (value) => { select.value = value; select.dispatchEvent(new Event("input", { bubbles: true })); return frames(); };
  const failed = document.querySelector('.frame[data-number="1"]');
  const style = (element) => getComputedStyle(element);
  const found = {
    frames: frames(),
    byName: by("name"), byTime: by("time"), byStatus: by("status"), byNumber: by("number"),
    failed: [style(failed).backgroundColor, style(failed).color, failed.querySelector(".badge").textContent, failed.querySelector(".message").textContent, failed.querySelectorAll("a").length],
    plain: style(document.querySelector('.frame[data-number="0"]')).backgroundColor,
    link: document.querySelector(".frame a.open").getAttribute("href"),
    bars: [...document.querySelector(".share").children].map((part) => part.getBoundingClientRect().width),
    share: document.querySelector(".share").getBoundingClientRect().width,
    colors: new Set([...document.querySelector(".share").children].map((part) => style(part).backgroundColor)).size,
    columns: document.querySelectorAll(".chart svg[aria-label='seconds over frame'] .point").length,
    wrong: document.querySelectorAll("svg rect.failed").length,
    effects: [...document.querySelectorAll(".chart")].pop().querySelectorAll(".point").length,
    bad: [...document.querySelectorAll("svg *")].filter((mark) => [...mark.attributes].some((a) => /NaN|inf/.test(a.value))).length,
    images: await Promise.all(shown(".frame img").slice(0, 3).map(async (image) => { image.loading = "eager"; await image.decode(); return image.naturalWidth; })),
  };
  const press = (key) => { (document.activeElement || document.body).dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true })); return Number(document.activeElement.dataset?.number ?? -1); };
  found.keys = ["ArrowRight", "ArrowRight", "ArrowLeft", "End", "Home", "ArrowLeft"].map(press);
  const across = shown(".frame").filter((frame) => frame.offsetTop === shown(".frame")[0].offsetTop).length;
  found.down = [press("ArrowDown"), across];
  let opened = null;
  document.addEventListener("click", (event) => { opened = event.target.closest("a")?.getAttribute("href"); event.preventDefault(); });
  press("Home"); press("Enter");
  found.opened = opened;
  press("/");
  found.focus = document.activeElement.type;
  const form = document.querySelector("form.filter");
  const search = form.querySelector("input[type=search]");
  const only = (words) => { search.value = words; search.dispatchEvent(new Event("input", { bubbles: true })); return [frames().length, form.querySelector("output").textContent]; };
  found.words = only("no such mesh");
  found.all = only("");
  for (const box of form.querySelectorAll("input[type=checkbox]")) { box.checked = box.value === "fails"; }
  form.dispatchEvent(new Event("input"));
  found.onlyFailed = frames();
  found.boxes = [...form.querySelectorAll("input[type=checkbox]")].map((box) => box.value);
  return found;
"##;

fn probed(page: &Path, browser: &str, flags: &[&str]) -> Value {
    let found = looked_at(browser, page, PROBE, flags);
    is_clean(&found);
    found
}

#[test]
fn frames_can_be_sorted_filtered_and_focused_without_loading() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = written(folder.path(), 24);
    let text = fs::read_to_string(&page).unwrap();
    for word in ["http:", "https:", "@import", "url("] {
        assert!(!text.contains(word), "{word}");
    }
    let found = probed(&page, browser, &["--window-size=1200,900"]);
    let numbers: Vec<usize> = (0..24).collect();
    for order in ["frames", "byName", "byNumber"] {
        // `turn 10` comes after `turn 9`.
        assert_eq!(found[order], json!(numbers), "{order}");
    }
    // 2 + sin 0.7 n is most at n = 2, which is missing, then at n = 20 (0.99 of 1).
    assert_eq!(found["byTime"][0], 20, "{found}");
    assert_eq!(found["byTime"][23], 3);
    let by_status: Vec<usize> = [1, 2, 0].into_iter().chain(4..24).chain([3]).collect();
    assert_eq!(found["byStatus"], json!(by_status));
    assert_eq!(found["keys"], json!([0, 1, 0, 23, 0, 0]));
    assert_eq!(found["down"][0], found["down"][1]);
    assert_eq!([&found["opened"], &found["link"]], ["./pictures/turn%201.png"; 2]);
    assert_eq!(found["focus"], "search");
    assert_eq!(found["words"], json!([1, "1 of 24 frames"]));
    assert_eq!(found["all"], json!([24, "24 frames"]));
    assert_eq!(found["onlyFailed"], json!([1]));
    assert_eq!(found["boxes"], json!(["holds", "fails", "measured", "skipped"]));
}

#[test]
fn failed_frames_are_marked_and_times_are_drawn() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let found = probed(&written(folder.path(), 24), browser, &["--window-size=1200,900"]);
    assert_ne!(found["failed"][0], found["plain"]);
    assert_eq!(found["failed"][2], "failed");
    assert_eq!(found["failed"][3], "scene & file: no such mesh: name another");
    // There is nothing to open.
    assert_eq!(found["failed"][4], 0);
    assert_eq!([&found["columns"], &found["wrong"], &found["bad"]], [24, 1, 0]);
    assert_eq!(found["effects"], EFFECTS.len());
    // Six have their own colour, two share one.
    assert_eq!(found["colors"], 7);
    let widths = found["bars"]
        .as_array()
        .unwrap()
        .iter()
        .map(|width| width.as_f64().unwrap());
    let (sum, whole) = (widths.sum::<f64>(), found["share"].as_f64().unwrap());
    // Widths are written to a hundredth of a percent.
    assert!((sum - whole).abs() < 0.01 * whole, "{sum} of {whole}");
    assert_eq!(found["images"], json!([256, 256, 256]));
}

#[test]
fn page_fits_narrow_windows_and_follows_the_color_scheme() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = written(folder.path(), 24);
    let narrow = probed(&page, browser, &["--window-size=400,800"]);
    assert!(
        narrow["width"][0].as_u64() <= narrow["width"][1].as_u64(),
        "{}",
        narrow["width"]
    );
    let dark = probed(
        &page,
        browser,
        &["--window-size=400,800", "--blink-settings=preferredColorScheme=0"],
    );
    assert_ne!(narrow["ground"], dark["ground"]);
    assert_ne!(narrow["failed"][0], dark["failed"][0]);
}

#[test]
fn page_of_two_hundred_frames_opens() {
    assert_page_opens(200);
}

#[test]
#[ignore = "slow: a thousand frames"]
fn page_of_a_thousand_frames_opens() {
    assert_page_opens(1000);
}

fn assert_page_opens(count: usize) {
    let folder = tempfile::tempdir().unwrap();
    let page = written(folder.path(), count);
    // As large as pictures full of noise make it.
    let megabytes = fs::metadata(&page).unwrap().len() as f64 / 1e6;
    println!("{megabytes:.1} MB");
    assert!(megabytes < 32.0, "{megabytes} MB");
    let Some(browser) = chromium() else { return };
    let found = probed(&page, browser, &["--window-size=1200,900"]);
    assert_eq!(found["all"], json!([count, format!("{count} frames")]));
    assert_eq!(found["keys"][3], count - 1);
}

#[test]
fn batch_without_frames_has_a_page() {
    let page = Gallery::default().page();
    assert!(page.contains(r#"{"cards":[],"kind":"gallery"}"#), "{page}");
}

/// Writes the page of 24 frames to look at: `GALLERY_PAGE=FILE tests/ci/slow gallery_page`.
#[test]
#[ignore = "slow: writes a page to look at"]
fn writes_a_page_for_visual_inspection() {
    let Ok(path) = std::env::var("GALLERY_PAGE") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    fs::copy(written(folder.path(), 24), path).unwrap();
}
