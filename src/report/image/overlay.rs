//! Overlay of the cross-check on the image: wrong rays in red, ties in yellow.

use glam::DVec2;

use crate::image::LinearImage;
use crate::scene::CameraView;
use crate::verify::{Difference, RayKind};

/// Colour of wrong results, linear RGB.
const WRONG: [f32; 3] = [1.0, 0.02, 0.03];
/// Colour of ties, linear RGB.
const TIE: [f32; 3] = [1.0, 0.7, 0.0];
/// Colour of the ring around marks, linear RGB.
const GROUND: [f32; 3] = [0.012; 3];
/// Factor of the image's own brightness and saturation, so that marks stand out.
const DIMMED: f32 = 0.5;
/// Image height over the half side of a mark; marks have a half side of at least a pixel.
const MARK: u32 = 240;

/// Returns the film position of a difference: for a camera ray the point that the ray passes through, for any other ray
/// its origin. `None` for a point behind the camera.
pub fn place(view: &CameraView, difference: &Difference) -> Option<DVec2> {
    let ray = &difference.ray;
    let p = match difference.kind {
        RayKind::Camera => ray.at(1.0),
        RayKind::Shadow | RayKind::Reflection => ray.origin.as_dvec3(),
    };
    view.film_point(p)
}

/// Returns the image with a mark for each difference: red for wrong results, yellow for ties.
pub fn draw(source: &LinearImage, view: &CameraView, differences: &[&Difference]) -> LinearImage {
    let mut image = dimmed(source);
    let reach = (source.height / MARK).max(1);
    // Draw wrong results last, so that ties do not cover them.
    for is_wrong in [false, true] {
        for difference in differences.iter().filter(|d| d.is_wrong == is_wrong) {
            if let Some(at) = place(view, difference) {
                let color = if is_wrong { WRONG } else { TIE };
                mark(&mut image, at, reach, color);
            }
        }
    }
    image
}

fn dimmed(image: &LinearImage) -> LinearImage {
    let pixels = image.pixels.iter().map(|&[r, g, b]| {
        // Use Rec. 709 luminance, and clamp brightness so that marks remain brighter.
        let grey = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        [r, g, b].map(|x| (DIMMED * 0.5 * (x + grey)).clamp(0.0, DIMMED))
    });
    LinearImage {
        pixels: pixels.collect(),
        ..*image
    }
}

/// Draws a square in `color` with a dark edge.
fn mark(image: &mut LinearImage, at: DVec2, reach: u32, color: [f32; 3]) {
    // Skip marks outside the image
    let size = DVec2::new(f64::from(image.width), f64::from(image.height));
    let pixel = (at * size).floor();
    let is_inside = pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
    if !is_inside {
        return;
    }
    let (x, y) = (pixel.x as i64, pixel.y as i64);
    let reach = i64::from(reach);
    // Draw the edge first, then the square
    for (reach, color, is_edge) in [(reach + 1, GROUND, true), (reach, color, false)] {
        for row in y - reach..=y + reach {
            for column in x - reach..=x + reach {
                let has = (0..i64::from(image.width)).contains(&column)
                    && (0..i64::from(image.height)).contains(&row);
                if !has {
                    continue;
                }
                let pixel = &mut image.pixels[(row * i64::from(image.width) + column) as usize];
                // The edge of a mark does not cover other marks.
                if !(is_edge && (*pixel == WRONG || *pixel == TIE)) {
                    *pixel = color;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::numeric::Ray;
    use crate::scene::Camera;
    use crate::verify::{MeshFeature, QueryResult};

    fn difference(view: &CameraView, (x, y): (f64, f64), is_wrong: bool) -> Difference {
        let ray = view.ray(x, y);
        Difference {
            kind: RayKind::Camera,
            ray: Ray::new(ray.origin.as_vec3(), ray.direction.as_vec3()),
            query_results: [QueryResult::Nothing; 2],
            is_wrong,
            feature: MeshFeature::Edge,
        }
    }

    #[test]
    fn marks_are_at_film_positions_with_wrong_ones_on_top() {
        let view = Camera::default().view(40, 30);
        let all = [
            difference(&view, (10.5 / 40.0, 5.5 / 30.0), true),
            difference(&view, (11.5 / 40.0, 5.5 / 30.0), false),
            difference(&view, (30.5 / 40.0, 20.5 / 30.0), false),
            difference(&view, (3.0, 0.5), true),
        ];
        let black = LinearImage::black(40, 30);
        let drawn = draw(&black, &view, &all.iter().collect::<Vec<_>>());
        assert_eq!(drawn.pixel(10, 5), WRONG);
        assert_eq!(drawn.pixel(11, 5), WRONG, "a tie next to it does not cover it");
        assert_eq!(drawn.pixel(30, 20), TIE);
        assert_eq!(drawn.pixel(20, 15), [0.0; 3]);
        assert_eq!((drawn.width, drawn.height), (40, 30));
    }

    #[test]
    fn shadow_rays_are_marked_at_their_origin_unless_behind_the_camera() {
        let view = Camera::default().view(40, 30);
        let from = |origin| Difference {
            kind: RayKind::Shadow,
            ray: Ray::new(origin, Vec3::Y),
            ..difference(&view, (0.5, 0.5), true)
        };
        let middle = place(&view, &from(Vec3::new(0.0, 0.0, -3.0))).unwrap();
        // The bound allows a few roundings of the inverse of a 3x3 matrix.
        assert!(
            middle.distance(DVec2::splat(0.5)) < 8.0 * f64::EPSILON,
            "{middle}"
        );
        assert_eq!(place(&view, &from(Vec3::new(0.0, 0.0, 3.0))), None);
    }
}
