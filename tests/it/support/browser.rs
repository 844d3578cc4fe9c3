//! Tests of HTML pages in headless Chromium, if it is installed.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Names of Chromium's executable.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Largest number of times that a page is opened.
const ATTEMPTS: usize = 3;

/// Script that records errors from the start of the page on.
const LISTENER: &str = r#"<script>
window.problems = [];
addEventListener("error", (event) => problems.push(event.message || `no ${event.target.src}`), true);
document.addEventListener("securitypolicyviolation", (event) => problems.push(`forbidden: ${event.blockedURI}`));
</script>
"#;

/// Script that evaluates the page and writes the result into it.
const PROBE: &str = r#"<script>
const shown = (what) => [...document.querySelectorAll(what)].filter((element) => element.getClientRects().length > 0);
const look = async () => { WHAT };
addEventListener("load", async () => {
  const found = await look();
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

/// Returns the browser, or prints a message and returns `None`.
pub(crate) fn chromium() -> Option<&'static str> {
    let is_there = |name: &&&str| Command::new(name).arg("--version").output().is_ok();
    let found = NAMES.iter().find(is_there).copied();
    if found.is_none() {
        println!("skipped: Chromium is not installed");
    }
    found
}

/// Returns the result of `probe` in a page opened with these flags: `probe` is the body of a JavaScript function that
/// runs once the page is loaded; errors, loaded resources and console messages are included.
pub(crate) fn looked_at(browser: &str, page: &Path, probe: &str, flags: &[&str]) -> Value {
    // Insert the listener and the probe into a copy of the page
    let text = fs::read_to_string(page).unwrap();
    let text = text
        .replacen("<head>\n", &format!("<head>\n{LISTENER}"), 1)
        .replacen("</body>", &format!("{}</body>", PROBE.replace("WHAT", probe)), 1);
    let folder = tempfile::tempdir().unwrap();
    let probed = folder.path().join("page.html");
    fs::write(&probed, text).unwrap();
    // Under load Chromium may use up its time before the page is loaded: try again
    let dumps = (0..ATTEMPTS).map(|_| dumped(browser, &probed, flags));
    let answered = |(dom, log): (String, String)| {
        let (_, encoded) = dom.split_once("<pre id=\"answer\">")?;
        Some((encoded.to_owned(), log))
    };
    let (encoded, log) = dumps.filter_map(answered).next().expect("the probe has run");
    // Extract the result of the probe and the console messages
    let console: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    let (encoded, _) = encoded.split_once("</pre>").unwrap();
    let mut found: Value = serde_json::from_slice(&base64(encoded)).unwrap();
    found["console"] = serde_json::json!(console);
    found
}

/// Returns the page as it is once loaded, and the log, of Chromium with a fresh profile.
fn dumped(browser: &str, page: &Path, flags: &[&str]) -> (String, String) {
    let profile = tempfile::tempdir().unwrap();
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
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(flags)
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let [dom, log] = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    (dom, log)
}

/// Decodes base64, which protects results from HTML escaping.
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
pub(crate) fn is_clean(found: &Value) {
    for key in ["problems", "loaded", "console"] {
        assert_eq!(found[key], serde_json::json!([]), "{key} of {found}");
    }
}
