//! What happens, as JSON lines on standard error: `--progress json`. Every line there is then one object; nothing else is
//! said.
//!
//! Keys are stable: they are added to, never renamed. `event` says which of these it is:
//!
//! | event | keys | when |
//! | --- | --- | --- |
//! | `start` | `scene`, `image` | a picture is begun |
//! | `phase` | `scene`, `image`, `phase` | a part of the work begins: `load`, `choose`, `build`, `render` |
//! | `progress` | `scene`, `image`, `phase`, `fraction`, `seconds`, `seconds_left` | at most ten a second; of the phase |
//! | `frame` | `image`, `status`, `message`, `seconds`, `finished`, `total`, `seconds_left` | a picture of a batch is `done`, `failed` or `skipped`; the last two keys before this are of the batch |
//! | `batch` | `images`, `fraction`, `finished`, `total`, `seconds`, `seconds_left` | at most ten a second; of the batch: the pictures being made and how far all are |
//! | `warning` | `message` | the work goes on |
//! | `done` | `scene`, `image`, `seconds` | a picture is written |
//! | `failed` | `scene`, `image`, `message`, `exit_code` | a picture, or all of it, has failed; names are null where it is about none |
//!
//! Fractions go from 0 to 1, `seconds` count from the beginning of what the event is about, and `seconds_left` is null
//! while nobody can tell. Wrong usage of the command line itself is told in words, as `--progress` is not yet known.

use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use super::output;

/// Whether standard error speaks JSON: there is one for the whole process, and Ctrl-C is told by a thread of its own.
static JSON: AtomicBool = AtomicBool::new(false);

/// Something that has happened.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub(super) enum Event<'a> {
    Start {
        scene: &'a str,
        image: &'a str,
    },
    Phase {
        scene: &'a str,
        image: &'a str,
        phase: &'a str,
    },
    Progress {
        scene: &'a str,
        image: &'a str,
        phase: &'a str,
        fraction: f64,
        seconds: f64,
        seconds_left: Option<f64>,
    },
    Frame {
        image: &'a str,
        status: &'a str,
        message: Option<&'a str>,
        seconds: f64,
        finished: usize,
        total: usize,
        seconds_left: Option<f64>,
    },
    Batch {
        images: &'a [String],
        fraction: f64,
        finished: usize,
        total: usize,
        seconds: f64,
        seconds_left: Option<f64>,
    },
    Warning {
        message: &'a str,
    },
    Done {
        scene: &'a str,
        image: &'a str,
        seconds: f64,
    },
    Failed {
        scene: Option<&'a str>,
        image: Option<&'a str>,
        message: &'a str,
        exit_code: i32,
    },
}

/// From now on standard error has JSON lines only.
pub(super) fn speak_json() {
    JSON.store(true, Ordering::Relaxed);
}

/// Whether standard error has JSON lines only.
pub(super) fn are_spoken() -> bool {
    JSON.load(Ordering::Relaxed)
}

/// Tells an event, as one line that is out before this returns.
pub(super) fn tell(event: &Event) {
    // Strings, numbers and lists of strings have a JSON form, always.
    if let Ok(line) = serde_json::to_string(event) {
        output::tell(&line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_line_that_says_what_it_is() {
        let event = Event::Progress {
            scene: "a \"b\"\n.toml",
            image: "a.png",
            phase: "render",
            fraction: 0.5,
            seconds: 2.0,
            seconds_left: None,
        };
        assert_eq!(
            serde_json::to_string(&event).unwrap(),
            "{\"event\":\"progress\",\"scene\":\"a \\\"b\\\"\\n.toml\",\"image\":\"a.png\",\"phase\":\"render\",\
             \"fraction\":0.5,\"seconds\":2.0,\"seconds_left\":null}"
        );
    }
}
