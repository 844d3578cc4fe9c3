//! Render of a part of an image, with the bits of that part of the whole image.

use whit::accel::Accel;
use whit::batch::request::RenderRequest;
use whit::render::{Monitor, Parts, Region, RenderSettings, Rendering};
use whit::scene::{Camera, ValidScene};

use super::failure::Failure;

/// Checks that the requested image can be rendered in part.
pub(super) fn check_request(request: &RenderRequest) -> Result<(), Failure> {
    match request.must_render_at_once() {
        true => Err(Failure::Input(
            "`--crop` renders a part alone, which `--adaptive`, `--heat` and the channels `rays` and `time` do not \
             allow: leave out one of them"
                .into(),
        )),
        false => Ok(()),
    }
}

/// Checks that the part lies within the image.
pub(super) fn check_region(region: &Region, settings: &RenderSettings) -> Result<(), Failure> {
    let reaches_beyond =
        |start: u32, length: u32, end: u32| start.checked_add(length).is_none_or(|stop| stop > end);
    let &RenderSettings { width, height, .. } = settings;
    match reaches_beyond(region.x, region.width, width) || reaches_beyond(region.y, region.height, height) {
        true => Err(Failure::Input(format!(
            "the part of `--crop` reaches beyond the image of {width}x{height} pixels: give a smaller one, or a larger \
             `--size`"
        ))),
        false => Ok(()),
    }
}

/// Renders the part of the image.
pub(super) fn render(
    scene: (ValidScene, &Camera),
    accel: &dyn Accel,
    (settings, region): (&RenderSettings, &Region),
    monitor: &Monitor,
) -> Result<Rendering, Failure> {
    let mut parts = Parts::new(scene, accel, settings, monitor)?;
    Ok(parts.region(region, monitor)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn part_beyond_the_image_is_rejected() {
        let settings = RenderSettings {
            width: 10,
            height: 5,
            ..RenderSettings::default()
        };
        let check = |x, y, width, height| check_region(&Region { x, y, width, height }, &settings);
        assert!(check(0, 0, 10, 5).is_ok() && check(9, 4, 1, 1).is_ok());
        for (x, y, width, height) in [(0, 0, 11, 5), (0, 1, 10, 5), (10, 0, 1, 1), (u32::MAX, 0, 2, 1)] {
            assert!(check(x, y, width, height).is_err(), "{x} {y} {width} {height}");
        }
    }
}
