//! Flags of the environment map in place of a scene's background.

use clap::Args as ArgGroup;

use whit::batch::request::{EnvironmentRequest, EnvironmentSource};

/// Flags of the environment map in place of a scene's background, ambient light and default light.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct EnvironmentArgs {
    /// Environment map that lights the scene, in place of background, ambient light and the light of files without one:
    /// an .hdr or .exr file, `studio` or `sky`
    #[arg(long, value_name = "FILE|studio|sky", conflicts_with = "ambient")]
    pub(in crate::cli) environment: Option<EnvironmentSource>,

    /// Degrees that the environment is turned by about +y, counter-clockwise as seen from above; `studio` and `sky` are
    /// turned with the camera, too [default: 0]
    #[arg(long, value_name = "DEGREES", requires = "environment", value_parser = turn, allow_hyphen_values = true)]
    pub(in crate::cli) environment_turn: Option<f64>,

    /// Factor on the radiance of the environment [default: 1]
    #[arg(long, value_name = "X", requires = "environment", value_parser = scale, allow_hyphen_values = true)]
    pub(in crate::cli) environment_scale: Option<f32>,
}

impl EnvironmentArgs {
    /// Returns the requested environment map, if there is one.
    pub(in crate::cli) fn request(&self) -> Option<EnvironmentRequest> {
        Some(EnvironmentRequest {
            source: self.environment.clone()?,
            rotation: self.environment_turn.unwrap_or(0.0).to_radians(),
            scale: self.environment_scale.unwrap_or(1.0),
        })
    }
}

fn turn(text: &str) -> Result<f64, String> {
    let degrees: Option<f64> = text.parse().ok();
    degrees
        .filter(|degrees| degrees.is_finite())
        .ok_or_else(|| "give degrees, as in 90".to_owned())
}

fn scale(text: &str) -> Result<f32, String> {
    let factor: Option<f32> = text.parse().ok();
    factor
        .filter(|factor| (0.0..f32::INFINITY).contains(factor))
        .ok_or_else(|| "give a factor of 0 or more, as in 0.5".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turn_and_scale_are_finite_numbers() {
        assert_eq!((turn("-90"), scale("0.5")), (Ok(-90.0), Ok(0.5)));
        assert!(turn("inf").is_err() && turn("x").is_err());
        assert!(scale("-1").is_err() && scale("nan").is_err() && scale("inf").is_err());
    }
}
