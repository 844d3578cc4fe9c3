//! Reasons for which an acceleration structure could not be built.

/// Reason for which an acceleration structure could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AccelError {
    /// The program was compiled without Embree.
    #[error(
        "this whit was built without Embree: use `--backend bsp`, or build whit with the feature `embree`"
    )]
    NoEmbree,
    /// An Embree call failed.
    #[error("Embree could not {action}: {message}")]
    Embree {
        /// Operation that was attempted.
        action: &'static str,
        /// Error message from Embree.
        message: String,
    },
    /// There is not enough memory.
    #[error("not enough memory for the acceleration structure: use a smaller scene or `--backend bsp`")]
    OutOfMemory,
    /// The running library is not the version that the headers described.
    #[error("whit was built against Embree {built} but runs with {running}: rebuild whit on this machine")]
    VersionMismatch {
        /// Version of the headers at compile time.
        built: String,
        /// Version of the running library.
        running: String,
    },
}
