//! Flags of the animation time at which a scene is rendered.

use clap::Args as ArgGroup;

use whit::gltf::AnimationTime;

/// Flags of the time and the clip of glTF animations.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct AnimationArgs {
    /// Time in seconds of glTF animations; without it, nodes have the transforms of the file
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_hyphen_values = true)]
    pub(in crate::cli) time: Option<f64>,

    /// Animation to apply, by name or number, see `whit info`; all of them by default
    #[arg(long, value_name = "NAME|N", requires = "time")]
    pub(in crate::cli) animation: Option<String>,
}

impl AnimationArgs {
    /// Returns the animation and its time, or `None` for the scene at rest.
    pub(in crate::cli) fn pose(&self) -> Option<AnimationTime> {
        self.time.map(|seconds| AnimationTime {
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
