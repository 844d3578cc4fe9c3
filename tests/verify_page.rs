//! Pages of `whit verify` in a browser: headless Chromium, where it is installed.

mod cli_program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use cli_program::{first_light, whit};
use serde_json::Value;

/// What Chromium is called.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Listens from the page's first moment on for whatever goes wrong.
const LISTENER: &str = r#"<script>
window.problems = [];
addEventListener("error", (event) => problems.push(event.message || `no ${event.target.src}`), true);
document.addEventListener("securitypolicyviolation", (event) => problems.push(`forbidden: ${event.blockedURI}`));
</script>
"#;

/// Uses the filter and writes down what came of it.
const PROBE: &str = r#"<script>
addEventListener("load", () => {
  const shown = (what) => [...document.querySelectorAll(what)].filter((element) => element.getClientRects().length > 0);
  const field = document.querySelector(".filter input[type=search]");
  const boxes = [...document.querySelectorAll(".filter input[type=checkbox]")];
  const rows = () => shown("table.filtered tbody tr").length;
  const sections = () => shown("section").map((section) => section.id);
  const type = (words) => { field.value = words; field.dispatchEvent(new Event("input", { bubbles: true })); };
  const found = { sections: sections(), rows: rows() };
  if (field) {
    type("h35 FORMULAS");
    found.typed = { sections: sections(), rows: rows(), told: document.querySelector(".filter output").textContent };
    type("no such words");
    found.nothing = rows();
    type("");
    boxes.find((box) => box.value === "holds").click();
    found.unticked = [...new Set(shown("table.filtered tbody tr").map((row) => row.dataset.verdict))];
    boxes.find((box) => box.value === "holds").click();
    found.again = rows();
  }
  found.pictures = shown("section svg, section img").length;
  found.width = [document.documentElement.scrollWidth, innerWidth];
  found.ground = getComputedStyle(document.body).backgroundColor;
  found.loaded = performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !name.startsWith("data:"));
  found.problems = problems;
  const answer = document.createElement("pre");
  answer.id = "answer";
  answer.textContent = btoa(unescape(encodeURIComponent(JSON.stringify(found))));
  document.body.append(answer);
});
</script>
"#;

/// The browser, or `None` with a word about it.
fn chromium() -> Option<&'static str> {
    let is_there = |name: &&&str| Command::new(name).arg("--version").output().is_ok();
    let found = NAMES.iter().find(is_there).copied();
    if found.is_none() {
        println!("skipped: Chromium is not installed");
    }
    found
}

/// What the browser finds in a page, looked at with these flags.
fn looked_at(browser: &str, page: &Path, flags: &[&str]) -> Value {
    let text = fs::read_to_string(page).unwrap();
    let text = text
        .replacen("<head>\n", &format!("<head>\n{LISTENER}"), 1)
        .replacen("</body>", &format!("{PROBE}</body>"), 1);
    let folder = tempfile::tempdir().unwrap();
    let probed = folder.path().join("page.html");
    fs::write(&probed, text).unwrap();
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--enable-logging=stderr",
            "--virtual-time-budget=5000",
            "--dump-dom",
        ])
        .arg(format!(
            "--user-data-dir={}",
            folder.path().join("profile").display()
        ))
        .args(flags)
        .arg(format!("file://{}", probed.display()))
        .output()
        .unwrap();
    let (dom, told) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    let console: Vec<&str> = told.lines().filter(|line| line.contains("CONSOLE")).collect();
    let (_, answer) = dom.split_once("<pre id=\"answer\">").expect("the probe has run");
    let (answer, _) = answer.split_once("</pre>").unwrap();
    let mut found: Value = serde_json::from_slice(&base64(answer)).unwrap();
    found["console"] = serde_json::json!(console);
    found
}

/// Decodes base64, which keeps answers free of what HTML would change.
fn base64(text: &str) -> Vec<u8> {
    let digit = |byte: u8| match byte {
        b'A'..=b'Z' => Some(byte - b'A'),
        b'a'..=b'z' => Some(byte - b'a' + 26),
        b'0'..=b'9' => Some(byte - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let (mut bits, mut count, mut bytes) = (0u32, 0, Vec::new());
    for digit in text.bytes().filter_map(digit) {
        bits = bits << 6 | u32::from(digit);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

#[track_caller]
fn is_clean(found: &Value) {
    for key in ["problems", "loaded", "console"] {
        assert_eq!(found[key], serde_json::json!([]), "{key} of {found}");
    }
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
fn the_suites_page_loads_nothing_and_its_filter_works() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let found = looked_at(browser, &suite(folder.path()), &["--window-size=1200,900"]);
    is_clean(&found);
    assert_eq!(found["sections"], serde_json::json!(["H11", "H35"]));
    // H11 on every path that finds hits, H35 on the formulas.
    let rows = if cfg!(feature = "embree") { 7 } else { 3 };
    assert_eq!(found["rows"], rows, "{found}");
    assert_eq!(found["typed"]["rows"], 1, "{found}");
    assert_eq!(found["typed"]["sections"], serde_json::json!(["H35"]));
    assert_eq!(found["typed"]["told"], format!("1 of {rows} rows"));
    assert_eq!(found["nothing"], 0);
    let left = found["unticked"].as_array().unwrap();
    assert!(!left.contains(&"holds".into()), "{found}");
    assert_eq!(
        left.is_empty(),
        !cfg!(feature = "embree"),
        "fast triangles lose rays"
    );
    assert_eq!(found["again"], rows);
    assert!(found["pictures"].as_u64().unwrap() >= 3, "{found}");
}

#[test]
fn pages_are_as_wide_as_the_window_and_as_dark_as_is_wished() {
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
fn a_scenes_page_holds_its_picture_whatever_the_scene_is_called() {
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
    assert_eq!(found["pictures"], 1, "{found}");
    assert!(
        fs::read_to_string(&page)
            .unwrap()
            .contains("&lt;b&gt;it&#39;s &amp; &quot;odd&quot;.gltf")
    );
}

#[test]
fn what_a_page_would_load_or_get_wrong_is_noticed() {
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
