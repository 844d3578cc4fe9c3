//! Errors of commands: one sentence for the user and an exit code for the calling process.

use whit::accel::AccelError;
use whit::batch::BatchError;
use whit::batch::request::RequestError;
use whit::bench::BenchError;
use whit::cost::CostError;
use whit::image::ImageError;
use whit::render::Cancelled;
use whit::scene::SceneError;
use whit::scene_file::SceneFileError;

use super::events::{self, Event};
use super::standard_error;

/// Error that ends a command.
#[derive(Debug, thiserror::Error)]
pub(super) enum Failure {
    /// Invalid arguments, or a request for help or the version, with the text by clap.
    #[error("{0}")]
    Usage(clap::Error),
    /// Unusable arguments or input; one sentence: what, where, remedy.
    #[error("{0}")]
    Input(String),
    /// Failure of the work itself, with valid arguments and input.
    #[error("{0}")]
    Work(String),
    /// Failure of some of several scenes, each of which has been reported already.
    #[error("{failed} of {total} scenes failed")]
    Some {
        /// Number of scenes that failed.
        failed: usize,
        /// Number of scenes in total.
        total: usize,
    },
    /// Interruption by the user with Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    /// Error that has been reported already.
    #[error("failed")]
    AlreadyReported {
        /// Exit code of the process.
        exit_code: i32,
    },
}

impl Failure {
    /// Wraps an error of clap, which may be a result: the text of `--help` or `--version`.
    pub(super) fn of_usage(error: clap::Error) -> Failure {
        Failure::Usage(error)
    }

    /// Returns the exit code of the process.
    pub(super) fn exit_code(&self) -> i32 {
        match self {
            Failure::Usage(error) => error.exit_code(),
            Failure::Input(_) => 2,
            Failure::Work(_) | Failure::Some { .. } => 1,
            Failure::Interrupted => 130,
            Failure::AlreadyReported { exit_code } => *exit_code,
        }
    }

    /// Prints the error on standard error, or on standard output if it is a help text or a version.
    pub(super) fn print(&self) {
        match self {
            Failure::Usage(error) if !error.use_stderr() => {
                // A reader that has closed the pipe is no error.
                let _ = error.print();
            }
            Failure::Usage(error) => standard_error::emit(&usage_sentence(error)),
            Failure::AlreadyReported { .. } => {}
            _ if events::is_json() => events::emit(&Event::Failed {
                scene: None,
                image: None,
                message: &self.to_string(),
                exit_code: self.exit_code(),
            }),
            _ => standard_error::emit(&format!("whit: {self}")),
        }
    }
}

/// Returns clap's message with the program's name in front; for a value out of range only the first line.
fn usage_sentence(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text).trim_end();
    let text = match error.kind() {
        clap::error::ErrorKind::ValueValidation => text.lines().next().unwrap_or_default(),
        _ => text,
    };
    format!("whit: {text}")
}

impl From<SceneFileError> for Failure {
    fn from(error: SceneFileError) -> Failure {
        Failure::Input(error.to_string())
    }
}

impl From<Cancelled> for Failure {
    fn from(_: Cancelled) -> Failure {
        Failure::Interrupted
    }
}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Failure {
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

impl From<RequestError> for Failure {
    fn from(error: RequestError) -> Failure {
        match error {
            RequestError::Cancelled(error) => error.into(),
            RequestError::Accel(error) => error.into(),
            RequestError::Threads(..) => Failure::Work(error.to_string()),
            error => Failure::Input(error.to_string()),
        }
    }
}

impl From<BatchError> for Failure {
    fn from(error: BatchError) -> Failure {
        match error {
            BatchError::Cancelled(error) => error.into(),
            BatchError::Request(error) => error.into(),
            BatchError::Image(error) => error.into(),
            // Faults of the job file and of the output folder
            BatchError::DividedAtOnce(_)
            | BatchError::DividedChannels(_)
            | BatchError::TooManyShares { .. }
            | BatchError::UnorderedPattern(_)
            | BatchError::CreateFolder(..)
            | BatchError::NoFolder(_)
            | BatchError::Read(..)
            | BatchError::EarlierRun(_)
            | BatchError::OpenManifest(..) => Failure::Input(error.to_string()),
            error => Failure::Work(error.to_string()),
        }
    }
}

impl From<BenchError> for Failure {
    fn from(error: BenchError) -> Failure {
        match error {
            BenchError::Cancelled(_) => Failure::Interrupted,
            BenchError::Accel(error) => error.into(),
            BenchError::Thread(_) => Failure::Work(error.to_string()),
        }
    }
}

impl From<CostError> for Failure {
    fn from(error: CostError) -> Failure {
        match error {
            CostError::Cancelled(_) => Failure::Interrupted,
            CostError::Accel(error) => error.into(),
            CostError::Denoise(_) => Failure::Work(error.to_string()),
            CostError::Other => Failure::Input(error.to_string()),
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
