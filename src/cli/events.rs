//! Events as JSON lines on standard error, for `--progress json`: every line is one object, and there is no other
//! output.
//!
//! Keys are stable: keys may be added but are never renamed. `event` gives the kind of event. Kinds with their other
//! keys:
//!
//! * `start` (`scene`, `image`): an image is started.
//! * `phase` (`scene`, `image`, `phase`): a part of the work begins: `load`, `choose`, `build`, `render`.
//! * `progress` (`scene`, `image`, `phase`, `fraction`, `seconds`, `seconds_left`): progress of the phase, at most ten
//!   per second.
//! * `frame` (`image`, `status`, `message`, `seconds`, `finished`, `total`, `seconds_left`): an image of a batch is
//!   `done`, `failed` or `skipped`; the last three keys are of the batch.
//! * `batch` (`images`, `fraction`, `finished`, `total`, `seconds`, `seconds_left`): progress of the batch, at most ten
//!   per second: the images in progress and the fraction of all.
//! * `warning` (`message`): the work goes on.
//! * `done` (`scene`, `image`, `seconds`): an image is written.
//! * `failed` (`scene`, `image`, `message`, `exit_code`): an image, or the whole command, has failed; names are null if
//!   it concerns no image.
//!
//! Fractions go from 0 to 1, `seconds` count from the beginning of what the event is about, and `seconds_left` is null
//! while it is unknown. Wrong usage of the command line itself is reported as text, as `--progress` is not parsed yet.

use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use super::standard_error;

/// True if standard error is JSON: a global of the process, as Ctrl-C is handled by a separate thread.
static JSON: AtomicBool = AtomicBool::new(false);

/// Event on standard error, serialized with its kind.
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

/// Switches standard error to JSON lines for the rest of the process.
pub(super) fn use_json() {
    JSON.store(true, Ordering::Relaxed);
}

/// Returns whether standard error consists of JSON lines.
pub(super) fn is_json() -> bool {
    JSON.load(Ordering::Relaxed)
}

/// Prints an event as one line, which is flushed before the function returns.
pub(super) fn emit(event: &Event) {
    // Serialization cannot fail: all fields are strings, numbers and lists of strings.
    if let Ok(line) = serde_json::to_string(event) {
        standard_error::emit(&line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn event_is_one_json_line_with_its_kind() {
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
