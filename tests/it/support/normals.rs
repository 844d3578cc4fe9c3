//! Normals bent by textures: glTF's normal maps (glTF 2.0, 3.9.3), Blinn's bump maps (1978), and how far they may bend.

use whit::scene::{TextureBinding, UvTransform};

use super::approx::{Approx, Approx3};
use super::hits::{Decision, Doubt};
use super::shapes::Chart;

/// Sine of the elevation under which a mirrored viewer is at least seen, if the viewer stands higher.
const MIN_ELEVATION: f64 = 0.01;

/// The normal that (2 `texel` - 1) means, X and Y times the layer's strength, in the frame of right and up in the image
/// around `n`.
pub fn mapped(n: Approx3, [right, up]: [Approx3; 2], texel: Approx3, layer: &TextureBinding) -> Approx3 {
    let strength = Approx::exact(f64::from(layer.strength));
    let [x, y, z] = texel.to_array().map(|c| c + c - Approx::ONE);
    (right * (strength * x) + up * (strength * y) + n * z).normalize()
}

/// Right and up around `n` by a mesh's tangent and its handedness.
pub fn frame_of_tangent(n: Approx3, tangent: Approx3, handedness: f64) -> [Approx3; 2] {
    let right = (tangent - n * n.dot(tangent)).normalize();
    let up = n.cross(right);
    [right, if handedness < 0.0 { -up } else { up }]
}

/// Returns the directions in which u' and v' of a transformed image grow, with v' downwards.
pub fn frame_of_chart(n: Approx3, chart: &Chart, transform: &UvTransform) -> [Approx3; 2] {
    // dp = dpdu du + dpdv dv with (du, dv) by Cramer's rule from u' = a u + b v, v' = c u + d v.
    let [[a, b], [c, d]] = transform
        .matrix
        .map(|row| row.map(|x| Approx::exact(f64::from(x))));
    let [dpdu, dpdv] = chart.derivatives;
    let determinant = a * d - b * c;
    let by_u = (dpdu * d - dpdv * c) * (Approx::ONE / determinant);
    let by_v = (dpdv * a - dpdu * b) * (Approx::ONE / determinant);
    let side = n.cross(by_u).dot(by_v).value;
    frame_of_tangent(n, by_u, -side)
}

/// The normal of a surface that is raised along `n` by a height with these slopes by u and v: of its tangents
/// dpdu + h_u n and dpdv + h_v n, on the side of `n`.
pub fn bumped(n: Approx3, chart: &Chart, [h_u, h_v]: [Approx; 2]) -> Approx3 {
    // The part of the derivatives along `n` is no part of the surface that `n` stands on.
    let tangent = |d: Approx3| d - n * n.dot(d);
    let [by_u, by_v] = chart.derivatives.map(tangent);
    let raised = (by_u + n * h_u).cross(by_v + n * h_v);
    let raised = if raised.dot(n).value < 0.0 {
        -raised
    } else {
        raised
    };
    raised.normalize()
}

/// `n`, or what is nearest to it that lets the viewer be seen and its mirror image be above the surface: half-way
/// between the viewer and that image raised to the least elevation.
pub fn bend_toward_viewer(n: Approx3, ng: Approx3, wo: Approx3, doubt: &mut Doubt) -> Approx3 {
    let viewer = ng.dot(wo);
    let least = if viewer.value < MIN_ELEVATION {
        viewer
    } else {
        Approx::rounded(MIN_ELEVATION)
    };
    let cos = n.dot(wo).positive_part();
    let image = n * (cos + cos) - wo;
    let above = image.dot(ng) - least;
    doubt.note(Decision::Facing, above.slack());
    if above.value >= 0.0 {
        return n;
    }
    let level = (image - ng * image.dot(ng)).normalize();
    let raised = level * (1.0 - least.squared()).sqrt() + ng * least;
    (wo + raised).normalize()
}
