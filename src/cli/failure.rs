//! How a command ends badly: a sentence for the user and an exit code for the caller.

use crate::accel::AccelError;
use crate::gltf::GltfError;
use crate::image::ImageError;
use crate::scene_file::SceneFileError;

use super::events::{self, Event};
use super::output;

/// Why a command did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub(super) enum Failure {
    /// Help or version were asked for, or the arguments make no sense: clap has the text.
    #[error("{0}")]
    Usage(clap::Error),
    /// The arguments or the input cannot be used; one sentence: what, where, remedy.
    #[error("{0}")]
    Input(String),
    /// The arguments and the input are good, yet it failed.
    #[error("{0}")]
    Work(String),
    /// Some of several scenes failed, each of which has been told already.
    #[error("{failed} of {total} scenes failed")]
    Some {
        /// How many failed.
        failed: usize,
        /// Of how many.
        total: usize,
    },
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    /// Something that has been told already.
    #[error("failed")]
    Told {
        /// The process's exit code.
        exit_code: i32,
    },
}

impl Failure {
    /// What clap has to say, which may be no failure: help and version are results.
    pub(super) fn of_usage(error: clap::Error) -> Failure {
        Failure::Usage(error)
    }

    /// The process's exit code.
    pub(super) fn exit_code(&self) -> i32 {
        match self {
            Failure::Usage(error) => error.exit_code(),
            Failure::Input(_) => 2,
            Failure::Work(_) | Failure::Some { .. } => 1,
            Failure::Interrupted => 130,
            Failure::Told { exit_code } => *exit_code,
        }
    }

    /// Tells the user, on standard error unless it is a result.
    pub(super) fn print(&self) {
        match self {
            Failure::Usage(error) if !error.use_stderr() => {
                // A reader that has left needs no answer.
                let _ = error.print();
            }
            Failure::Usage(error) => output::tell(&usage_sentence(error)),
            Failure::Told { .. } => {}
            _ if events::are_spoken() => events::tell(&Event::Failed {
                scene: None,
                image: None,
                message: &self.to_string(),
                exit_code: self.exit_code(),
            }),
            _ => output::tell(&format!("whit: {self}")),
        }
    }
}

/// clap's message with our name in front; a value out of range gets its one sentence and no more.
fn usage_sentence(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text).trim_end();
    let text = match error.kind() {
        clap::error::ErrorKind::ValueValidation => text.lines().next().unwrap_or_default(),
        _ => text,
    };
    format!("whit: {text}")
}

impl From<GltfError> for Failure {
    fn from(error: GltfError) -> Failure {
        Failure::Input(error.to_string())
    }
}

impl From<SceneFileError> for Failure {
    fn from(error: SceneFileError) -> Failure {
        Failure::Input(error.to_string())
    }
}

impl From<AccelError> for Failure {
    fn from(error: AccelError) -> Failure {
        match error {
            AccelError::NoEmbree => Failure::Input(error.to_string()),
            _ => Failure::Work(error.to_string()),
        }
    }
}

impl From<ImageError> for Failure {
    fn from(error: ImageError) -> Failure {
        match error {
            ImageError::Write { .. } => Failure::Work(error.to_string()),
            _ => Failure::Input(error.to_string()),
        }
    }
}
