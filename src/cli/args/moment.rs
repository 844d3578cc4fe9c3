//! Flags of the moment at which a scene is shown.

use clap::Args as ArgGroup;

use crate::gltf::Pose;

/// At which moment glTF animations are shown.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct MomentArgs {
    /// Show glTF animations at this time in seconds; without it nodes stand where the file has them
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_hyphen_values = true)]
    pub(in crate::cli) time: Option<f64>,

    /// The animation that is shown, by name or number, see `whit info`; all of them unless said
    #[arg(long, value_name = "NAME|N", requires = "time")]
    pub(in crate::cli) animation: Option<String>,
}

impl MomentArgs {
    /// What is shown of animations, if anything.
    pub(in crate::cli) fn pose(&self) -> Option<Pose> {
        self.time.map(|seconds| Pose {
            animation: self.animation.clone(),
            seconds,
        })
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: Option<f64> = text.parse().ok();
    seconds
        .filter(|seconds| seconds.is_finite())
        .ok_or_else(|| "give a number of seconds, as in 1.5".to_owned())
}
