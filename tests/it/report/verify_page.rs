//! Pages of `whit verify` in a browser.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::browser::{self, chromium, is_clean};
use crate::support::cli_program::{first_light, whit};
use serde_json::Value;

/// Uses the filter and writes down what came of it.
const PROBE: &str = r#"
  const field = document.querySelector(".filter input[type=search]");
  const boxes = [...document.querySelectorAll(".filter input[type=checkbox]")];
  const rows = () => shown("table.filtered tbody tr").length;
  const sections = () => shown("section").map((section) => section.id);
  const type = (words) => { field.value = words; field.dispatchEvent(new Event("input", { bubbles: true })); };
  const found = { sections: sections(), rows: rows() };
  if (field) {
    type("h35 FORMULAS");
    found.typed = { sections: sections(), rows: rows(), output: document.querySelector(".filter output").textContent };
    type("no such words");
    found.nothing = rows();
    type("");
    boxes.find((box) => box.value === "holds").click();
    found.unticked = [...new Set(shown("table.filtered tbody tr").map((row) => row.dataset.verdict))];
    boxes.find((box) => box.value === "holds").click();
    found.again = rows();
  }
  found.headings = shown("section h2").map((heading) => heading.textContent);
  found.images = shown("section svg, section img").length;
  return found;
"#;

/// Returns the facts that the browser finds in a page.
fn looked_at(browser: &str, page: &Path, flags: &[&str]) -> Value {
    browser::looked_at(browser, page, PROBE, flags)
}

/// The page of two cases.
fn suite(folder: &Path) -> PathBuf {
    let page = folder.join("verify.html");
    let run = whit(&[
        "verify",
        "--rays",
        "2000",
        "--case",
        "H11",
        "--case",
        "H35",
        "--date",
        "<b>today</b>",
        "--html",
        &page.display().to_string(),
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    page
}

#[test]
fn suite_page_loads_nothing_and_its_filter_works() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let found = looked_at(browser, &suite(folder.path()), &["--window-size=1200,900"]);
    is_clean(&found);
    assert_eq!(found["sections"], serde_json::json!(["H11", "H35"]));
    // H11 on every path that finds hits, H35 on the formulas.
    let rows = if cfg!(feature = "embree") { 8 } else { 4 };
    assert_eq!(found["rows"], rows, "{found}");
    assert_eq!(found["typed"]["rows"], 1, "{found}");
    assert_eq!(found["typed"]["sections"], serde_json::json!(["H35"]));
    assert_eq!(found["typed"]["output"], format!("1 of {rows} rows"));
    assert_eq!(found["nothing"], 0);
    let left = found["unticked"].as_array().unwrap();
    assert!(!left.contains(&"holds".into()), "{found}");
    assert_eq!(
        left.is_empty(),
        !cfg!(feature = "embree"),
        "fast triangles lose rays"
    );
    assert_eq!(found["again"], rows);
    assert!(found["images"].as_u64().unwrap() >= 3, "{found}");
}

#[test]
fn page_fits_narrow_windows_and_follows_the_color_scheme() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = suite(folder.path());
    let narrow = looked_at(browser, &page, &["--window-size=400,800"]);
    assert!(
        narrow["width"][0].as_u64() <= narrow["width"][1].as_u64(),
        "{}",
        narrow["width"]
    );
    let dark = looked_at(
        browser,
        &page,
        &["--window-size=400,800", "--blink-settings=preferredColorScheme=0"],
    );
    assert_ne!(narrow["ground"], dark["ground"]);
}

#[test]
fn scene_page_shows_the_image_and_escapes_the_name() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("<b>it's & \"odd\".gltf");
    fs::copy(first_light(), &scene).unwrap();
    for entry in fs::read_dir(Path::new(&first_light()).parent().unwrap()).unwrap() {
        let entry = entry.unwrap();
        if entry.file_name().to_string_lossy().starts_with("first_light") {
            fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
    }
    let page = folder.path().join("own.html");
    let run = whit(&[
        "verify",
        &scene.display().to_string(),
        "--size",
        "64x48",
        "--html",
        &page.display().to_string(),
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let found = looked_at(browser, &page, &["--window-size=1200,900"]);
    is_clean(&found);
    assert_eq!(found["sections"], serde_json::json!(["scene0"]));
    assert_eq!(found["images"], 1, "{found}");
    let heading = found["headings"][0].as_str().unwrap();
    assert!(heading.ends_with("<b>it's & \"odd\".gltf"), "{found}");
    assert!(!fs::read_to_string(&page).unwrap().contains("<b>it's"));
}

#[test]
fn browser_check_detects_external_loads_and_script_errors() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = suite(folder.path());
    let text = fs::read_to_string(&page).unwrap();
    let planted = "<img src=\"http://127.0.0.1:9/a.png\"><script>console.error(\"planted\"); nowhere();</script></main>";
    fs::write(&page, text.replacen("</main>", planted, 1)).unwrap();
    let found = looked_at(browser, &page, &[]);
    let problems = found["problems"].to_string();
    assert!(problems.contains("nowhere is not defined"), "{found}");
    assert!(problems.contains("127.0.0.1:9"), "{found}");
    assert!(found["console"].to_string().contains("planted"), "{found}");
}
