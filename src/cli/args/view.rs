//! Flags of the camera: one of the scene's, a position and a target, or a named view.

use std::str::FromStr;

use clap::Args as ArgGroup;
use glam::DVec3;

use whit::scene::{CameraPlacement, DEFAULT_FOV, FramedView, LookAt, ViewSide};

/// Flags of the camera from which a scene is rendered.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct ViewArgs {
    /// Camera to render from, by name or number; see `whit info`
    #[arg(long, value_name = "NAME|N")]
    pub(in crate::cli) camera: Option<String>,

    /// Position of a camera in place of the scene's, in the coordinates of the file
    #[arg(
        long,
        value_name = "X,Y,Z",
        group = "placement",
        conflicts_with = "camera",
        allow_hyphen_values = true
    )]
    pub(in crate::cli) from: Option<Point>,

    /// Point that the camera looks at [default: the centre of the scene]
    #[arg(long, value_name = "X,Y,Z", requires = "from", allow_hyphen_values = true)]
    pub(in crate::cli) at: Option<Point>,

    /// Direction that is up in the image [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", requires = "from", allow_hyphen_values = true)]
    pub(in crate::cli) up: Option<Point>,

    /// Side from which a camera in place of the scene's shows all of it
    #[arg(
        long,
        value_name = "SIDE",
        value_enum,
        group = "placement",
        conflicts_with = "camera"
    )]
    pub(in crate::cli) view: Option<ViewSide>,

    /// Vertical field of view in degrees of the camera of --from or --view [default: 45]
    #[arg(long, value_name = "DEGREES", requires = "placement", value_parser = degrees)]
    pub(in crate::cli) fov: Option<f64>,
}

impl ViewArgs {
    /// Returns the placement of a camera in place of the scene's, if one is requested.
    pub(in crate::cli) fn placement(&self) -> Option<CameraPlacement> {
        let y_fov = self.fov.map_or(DEFAULT_FOV, f64::to_radians);
        let look_at = |from: Point| {
            CameraPlacement::LookAt(LookAt {
                from: from.0,
                at: self.at.map(|at| at.0),
                up: self.up.map_or(LookAt::default().up, |up| up.0),
                y_fov,
            })
        };
        let framed = |side| CameraPlacement::Framed(FramedView { side, y_fov });
        self.from.map(look_at).or(self.view.map(framed))
    }
}

/// Point or direction of three finite coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::cli) struct Point(pub(in crate::cli) DVec3);

impl FromStr for Point {
    type Err = String;

    fn from_str(text: &str) -> Result<Point, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, z]) if [x, y, z].iter().all(|x| x.is_finite()) => Ok(Point(DVec3::new(x, y, z))),
            _ => Err("give three numbers, as in 1.5,0,-3".into()),
        }
    }
}

fn degrees(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|&degrees: &f64| degrees > 0.0 && degrees < 180.0)
        .ok_or_else(|| "give degrees between 0 and 180".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn point_is_three_finite_numbers() {
        let point = |text: &str| text.parse::<Point>();
        assert_eq!(point("1.5,0, -3"), Ok(Point(DVec3::new(1.5, 0.0, -3.0))));
        for bad in ["", "1", "1,2", "1,2,3,4", "1,2,x", "1,2,inf", "nan,0,0"] {
            assert!(point(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn field_of_view_is_less_than_a_half_turn() {
        assert_eq!(degrees("45"), Ok(45.0));
        for bad in ["0", "180", "-1", "nan", "x"] {
            assert!(degrees(bad).is_err(), "{bad}");
        }
    }
}
