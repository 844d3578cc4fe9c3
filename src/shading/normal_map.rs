//! Normal perturbation by textures: normal maps (glTF 2.0, 3.9.3) and bump maps (Blinn, "Simulation of wrinkled
//! surfaces", SIGGRAPH 1978), and the correction that keeps perturbed normals visible.
//!
//! All vectors are in one space, chosen by the caller. The order is: frame or derivatives with the outward normal,
//! perturb, flip to the viewer's side, correct.

use glam::{DMat3, DVec3, Vec3};

use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::UvTransform;

/// Orthonormal tangent frame on a surface: glTF's tangent space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TangentFrame {
    /// Direction of increasing u: right in the image.
    pub tangent: DVec3,
    /// Direction up in the image, of decreasing v: the frame is left-handed where the image is mirrored on the surface.
    pub bitangent: DVec3,
    /// Shading normal of the point.
    pub n: DVec3,
}

impl TangentFrame {
    /// Returns the frame around the unit normal `n` from the point's derivatives by u and v; `None` where they do not
    /// span the surface, as at a pole.
    pub fn from_derivatives(n: DVec3, [dpdu, dpdv]: [DVec3; 2]) -> Option<TangentFrame> {
        let up = dpdv.try_normalize()?;
        let handedness = -n.cross(dpdu.try_normalize()?).dot(up);
        (handedness != 0.0)
            .then(|| TangentFrame::new(n, dpdu, handedness))
            .flatten()
    }

    /// Returns the frame around the unit normal `n` from a mesh tangent: XYZ is the tangent, the sign of W the
    /// handedness. `None` where the tangent is parallel to the normal.
    pub fn from_tangent(n: DVec3, tangent: DVec3, handedness: f32) -> Option<TangentFrame> {
        TangentFrame::new(n, tangent, handedness.into())
    }

    fn new(n: DVec3, tangent: DVec3, handedness: f64) -> Option<TangentFrame> {
        let along = tangent.try_normalize()?;
        let tangent = (along - n * n.dot(along)).try_normalize()?;
        Some(TangentFrame {
            tangent,
            bitangent: n.cross(tangent) * handedness.signum(),
            n,
        })
    }

    /// Returns the normal of a normal map's linear RGB `texel`, with glTF's `scale` of its X and Y: (2 texel - 1) in
    /// this frame, normalised. A texel of zero length leaves the normal unchanged.
    pub fn perturbed(&self, texel: [f32; 3], scale: f32) -> DVec3 {
        let [x, y, z] = texel.map(|c| 2.0 * f64::from(c) - 1.0);
        let scale = f64::from(scale);
        let n = self.tangent * (scale * x) + self.bitangent * (scale * y) + self.n * z;
        n.try_normalize().unwrap_or(self.n)
    }
}

/// Returns the point's derivatives by the coordinates after `transform`, from those before it; `None` where it is
/// singular.
///
/// Right and up of a transformed normal map are along these derivatives.
pub fn transformed_derivatives([dpdu, dpdv]: [DVec3; 2], transform: &UvTransform) -> Option<[DVec3; 2]> {
    let [[a, b], [c, d]] = transform.matrix.map(|row| row.map(f64::from));
    let determinant = a * d - b * c;
    // dp/duv' = dp/duv times the inverse of the matrix.
    let derivatives = [
        (dpdu * d - dpdv * c) / determinant,
        (dpdv * a - dpdu * b) / determinant,
    ];
    derivatives.iter().all(|p| p.is_finite()).then_some(derivatives)
}

/// Returns the unit normal of a surface displaced along its unit normal `n` by a height whose derivatives by u and v
/// are `h_u` and `h_v`, in units of length.
///
/// With the gradient on the surface, g = (h_u dpdv x n + h_v n x dpdu) / (n . dpdu x dpdv), it is n - g, normalised.
/// Returns `n` where the derivatives do not span the surface.
pub fn bumped(n: DVec3, [dpdu, dpdv]: [DVec3; 2], [h_u, h_v]: [f32; 2]) -> DVec3 {
    let rise = dpdv.cross(n) * f64::from(h_u) + n.cross(dpdu) * f64::from(h_v);
    let area = n.dot(dpdu.cross(dpdv));
    if area == 0.0 {
        return n;
    }
    // Scale by the area, which preserves the direction and avoids a division.
    (n * area.abs() - rise * area.signum())
        .try_normalize()
        .unwrap_or(n)
}

/// Smallest sine of the elevation at which a mirror ray leaves the surface, unless the viewer's elevation is lower.
const MIN_ELEVATION: f64 = 0.01;

/// Returns the unit normal `n`, bent toward the viewer if needed to keep both the viewer and the mirror ray above the
/// surface.
///
/// `wo` points to the viewer and `ng` is the geometric normal on the viewer's side, both of unit length. Where the ray
/// reflected by `n` would point into the surface, or barely off it, that ray is raised to an elevation whose sine is
/// 0.01, or the viewer's own where that is lower; the result is the normal half-way between it and the viewer, so that
/// `n . wo > 0` too (after Keller et al., "The Iray light transport simulation and rendering system", 2017, A.3). It is
/// a continuous function of `n`.
pub fn bend_toward_viewer(n: DVec3, ng: DVec3, wo: DVec3) -> DVec3 {
    let min_elevation = MIN_ELEVATION.min(ng.dot(wo));
    // A normal that faces away from the viewer counts as edge-on: it sends the ray straight on.
    let reflected = n * (2.0 * n.dot(wo).max(0.0)) - wo;
    if reflected.dot(ng) >= min_elevation {
        return n;
    }
    // Raise the reflected ray to the least elevation
    let horizontal = reflected - ng * reflected.dot(ng);
    let Some(horizontal) = horizontal.try_normalize() else {
        return ng;
    };
    let raised = horizontal * (1.0 - min_elevation * min_elevation).sqrt() + ng * min_elevation;
    (wo + raised).try_normalize().unwrap_or(ng)
}

/// Tangents of sixteen points, in the space of their normals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TangentPacket {
    tangent: Lanes3<f32>,
    handedness: Lanes<f32>,
}

impl TangentPacket {
    /// Packet whose lanes have no tangents.
    pub(crate) const ZERO: TangentPacket = TangentPacket {
        tangent: [[0.0; LANES]; 3],
        handedness: [1.0; LANES],
    };

    /// Sets lane `l` to a mesh tangent: see [`TangentFrame::from_tangent`].
    #[inline(always)]
    pub(crate) fn set(&mut self, l: usize, [x, y, z, w]: [f32; 4]) {
        self.tangent[0][l] = x;
        self.tangent[1][l] = y;
        self.tangent[2][l] = z;
        self.handedness[l] = w;
    }

    /// Transforms lane `l` by a matrix that may mirror.
    pub(crate) fn transform(&mut self, l: usize, matrix: &DMat3, is_mirrored: bool) {
        let tangent = [0, 1, 2].map(|axis| f64::from(self.tangent[axis][l]));
        // Of unit length, so that squares of f32 neither overflow nor underflow
        let turned = (*matrix * DVec3::from_array(tangent)).normalize_or_zero();
        for axis in 0..3 {
            self.tangent[axis][l] = turned[axis] as f32;
        }
        if is_mirrored {
            self.handedness[l] = -self.handedness[l];
        }
    }

    /// Returns the normals of a normal map's linear RGB `texels` around the unit normals `n`, and the lanes that have a
    /// tangent frame. The method is that of [`TangentFrame::perturbed`].
    #[inline(always)]
    pub(crate) fn perturbed(
        &self,
        n: &Lanes3<f32>,
        texels: &Lanes<[f32; 4]>,
        scale: f32,
    ) -> (Lanes3<f32>, Lanes<bool>) {
        let mut mapped = *n;
        let mut has_frame = [false; LANES];
        // Transpose the texels to the components of the normals
        let mut components = [[0.0; LANES]; 3];
        for l in 0..LANES {
            for axis in 0..3 {
                components[axis][l] = 2.0 * texels[l][axis] - 1.0;
            }
        }
        for l in 0..LANES {
            let lane = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
            // Make the tangent perpendicular to the normal
            let (n, tangent) = (lane(n), lane(&self.tangent));
            let along = tangent * tangent.dot(tangent).sqrt().recip();
            let across = along - n * n.dot(along);
            let squared = across.dot(across);
            let tangent = across * squared.sqrt().recip();
            let bitangent = n.cross(tangent) * 1f32.copysign(self.handedness[l]);
            // Combine the components, and normalise
            let texel = lane(&components);
            let sum = tangent * (scale * texel.x) + bitangent * (scale * texel.y) + n * texel.z;
            let length = sum.dot(sum);
            has_frame[l] = squared > 0.0;
            let is_valid = (squared > 0.0) & (length > 0.0);
            let unit = sum * length.sqrt().recip();
            for axis in 0..3 {
                mapped[axis][l] = if is_valid { unit[axis] } else { n[axis] };
            }
        }
        (mapped, has_frame)
    }
}

/// Returns sixteen unit normals `n`, bent toward the viewers: see [`bend_toward_viewer`].
#[inline(always)]
pub(crate) fn bend_packet_toward_viewer(n: &Lanes3<f32>, ng: &Lanes3<f32>, wo: &Lanes3<f32>) -> Lanes3<f32> {
    let mut bent = *n;
    for l in 0..LANES {
        let lane = |v: &Lanes3<f32>| Vec3::new(v[0][l], v[1][l], v[2][l]);
        let (n, ng, wo) = (lane(n), lane(ng), lane(wo));
        let min_elevation = (MIN_ELEVATION as f32).min(ng.dot(wo));
        let reflected = n * (2.0 * n.dot(wo).max(0.0)) - wo;
        let elevation = reflected.dot(ng);
        // Raise the reflected ray to the least elevation
        let horizontal = reflected - ng * elevation;
        let squared = horizontal.dot(horizontal);
        let cos = (1.0 - min_elevation * min_elevation).sqrt();
        let raised = horizontal * (cos / squared.sqrt()) + ng * min_elevation;
        let half = wo + raised;
        let length = half.dot(half);
        let unit = half * length.sqrt().recip();
        let is_low = !(elevation >= min_elevation);
        let has_direction = (squared > 0.0) & (length > 0.0);
        for axis in 0..3 {
            let low = if has_direction { unit[axis] } else { ng[axis] };
            bent[axis][l] = if is_low { low } else { n[axis] };
        }
    }
    bent
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns unit vectors in all directions.
    fn directions() -> impl Iterator<Item = DVec3> {
        const COUNT: i32 = 200;
        (0..COUNT).map(|i| {
            let z = (2.0 * f64::from(i) + 1.0) / f64::from(COUNT) - 1.0;
            let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
            let rho = (1.0 - z * z).sqrt();
            DVec3::new(rho * cos, rho * sin, z)
        })
    }

    fn is_near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn the_green_of_a_normal_map_points_up_in_the_image() {
        // Image on a wall, seen from +z: u to the right, v downwards.
        let frame = TangentFrame::from_derivatives(DVec3::Z, [DVec3::X * 3.0, -DVec3::Y]).unwrap();
        assert!(is_near(frame.perturbed([0.5, 1.0, 0.5], 1.0), DVec3::Y));
        assert!(is_near(frame.perturbed([1.0, 0.5, 0.5], 1.0), DVec3::X));
        assert!(is_near(frame.perturbed([0.5, 0.5, 1.0], 1.0), DVec3::Z));
        // Mirrored image: u to the left.
        let frame = TangentFrame::from_derivatives(DVec3::Z, [-DVec3::X, -DVec3::Y]).unwrap();
        assert!(is_near(frame.perturbed([1.0, 0.5, 0.5], 1.0), -DVec3::X));
        assert!(is_near(frame.perturbed([0.5, 1.0, 0.5], 1.0), DVec3::Y));
    }

    #[test]
    fn a_mesh_tangent_gives_the_frame_of_the_same_derivatives() {
        let n = DVec3::new(0.6, 0.0, 0.8);
        let (dpdu, dpdv) = (DVec3::new(0.8, 0.1, -0.6), DVec3::new(0.1, -2.0, 0.0));
        let derived = TangentFrame::from_derivatives(n, [dpdu, dpdv]).unwrap();
        let stored = TangentFrame::from_tangent(n, dpdu * 7.0, 1.0).unwrap();
        assert!(is_near(derived.tangent, stored.tangent) && is_near(derived.bitangent, stored.bitangent));
        assert!(derived.tangent.dot(n).abs() < 1e-15);
        let mirrored = TangentFrame::from_tangent(n, dpdu, -1.0).unwrap();
        assert!(is_near(mirrored.bitangent, -stored.bitangent));
    }

    #[test]
    fn the_scale_of_a_normal_map_scales_its_slope() {
        let frame = TangentFrame::from_tangent(DVec3::Z, DVec3::X, 1.0).unwrap();
        // The vector (0.6, 0, 0.8) has the slope 3/4; twice that is 3/2.
        let n = frame.perturbed([0.8, 0.5, 0.9], 2.0);
        assert!((n.x / n.z - 1.5).abs() < 1e-6);
        assert_eq!(frame.perturbed([0.5; 3], 1.0), DVec3::Z);
    }

    #[test]
    fn degenerate_derivatives_give_no_tangent_frame() {
        let none = |dpdu, dpdv| TangentFrame::from_derivatives(DVec3::Z, [dpdu, dpdv]).is_none();
        assert!(none(DVec3::ZERO, DVec3::Y));
        assert!(none(DVec3::X, DVec3::ZERO));
        assert!(none(DVec3::X, DVec3::X));
        assert!(none(DVec3::Z, DVec3::Y));
        assert!(none(DVec3::NAN, DVec3::Y));
        assert!(TangentFrame::from_tangent(DVec3::Z, DVec3::Z, 1.0).is_none());
    }

    #[test]
    fn bump_map_gives_normal_of_displaced_surface() {
        // Plane with oblique derivatives, raised by 0.3 u - 0.2 v: its tangents are dpdu + 0.3 n and dpdv - 0.2 n.
        let (dpdu, dpdv) = (DVec3::new(1.0, 0.5, 0.0), DVec3::new(-0.25, 2.0, 0.0));
        let exact = (dpdu + 0.3 * DVec3::Z).cross(dpdv - 0.2 * DVec3::Z).normalize();
        let n = bumped(DVec3::Z, [dpdu, dpdv], [0.3, -0.2]);
        // The slopes are f32.
        assert!((n - exact).length() < 1e-7, "{n}, not {exact}");
        // With mirrored derivatives the height is still along the normal.
        let n = bumped(DVec3::Z, [dpdv, dpdu], [-0.2, 0.3]);
        assert!((n - exact).length() < 1e-7, "{n}, not {exact}");
        assert_eq!(bumped(DVec3::Z, [DVec3::ZERO, dpdv], [0.3, -0.2]), DVec3::Z);
    }

    #[test]
    fn rotated_map_rotates_its_tangent_frame() {
        // For u' = 2 v, v' = -u, right in the image is dp/dv / 2.
        let transform = UvTransform {
            matrix: [[0.0, 2.0], [-1.0, 0.0]],
            offset: [0.3, 0.1],
        };
        let [right, down] = transformed_derivatives([DVec3::X, DVec3::Y], &transform).unwrap();
        assert!(is_near(right, 0.5 * DVec3::Y) && is_near(down, -DVec3::X));
        let singular = UvTransform {
            matrix: [[1.0, 2.0], [2.0, 4.0]],
            ..transform
        };
        assert!(transformed_derivatives([DVec3::X, DVec3::Y], &singular).is_none());
    }

    #[test]
    fn every_bent_normal_faces_the_viewer_and_reflects_off_the_surface() {
        let ng = DVec3::Z;
        for wo in directions().filter(|wo| wo.z > 0.0) {
            for n in directions() {
                let bent = bend_toward_viewer(n, ng, wo);
                let reflected = bent * (2.0 * bent.dot(wo)) - wo;
                assert!((bent.length() - 1.0).abs() < 1e-12);
                assert!(bent.dot(wo) > 0.0 && bent.dot(ng) > 0.0, "{n} {wo}: {bent}");
                assert!(reflected.dot(ng) > 0.0, "{n} {wo}: {bent}");
                let fine = (n * (2.0 * n.dot(wo)) - wo).dot(ng) >= MIN_ELEVATION && n.dot(wo) > 0.0;
                assert!(!fine || bent == n);
            }
        }
    }

    #[test]
    fn the_geometric_normal_is_never_bent() {
        for wo in directions().filter(|wo| wo.z > 0.0) {
            assert!(is_near(bend_toward_viewer(DVec3::Z, DVec3::Z, wo), DVec3::Z));
        }
    }

    #[test]
    fn sixteen_normals_are_perturbed_and_bent_as_each_of_them() {
        let mut random = SplitMix64::new(3, 0);
        let lanes = |random: &mut SplitMix64| -> (Lanes3<f32>, [DVec3; LANES]) {
            let vectors: [DVec3; LANES] = std::array::from_fn(|_| random.direction().as_vec3().as_dvec3());
            ([0, 1, 2].map(|axis| vectors.map(|v| v[axis] as f32)), vectors)
        };
        for _ in 0..1000 {
            let ((n, ns), (wo, wos), (ng, ngs)) =
                (lanes(&mut random), lanes(&mut random), lanes(&mut random));
            let mut tangents = TangentPacket::ZERO;
            let mut scalar = [DVec3::ZERO; LANES];
            let texels: Lanes<[f32; 4]> = std::array::from_fn(|_| [0; 4].map(|_| random.unit() as f32));
            for l in 0..LANES {
                let tangent = random.direction().as_vec3();
                let handedness = if l % 2 == 0 { 1.0 } else { -1.0 };
                tangents.set(l, [tangent.x, tangent.y, tangent.z, handedness]);
                let frame = TangentFrame::from_tangent(ns[l], tangent.as_dvec3(), handedness).unwrap();
                let [x, y, z, _] = texels[l];
                scalar[l] = frame.perturbed([x, y, z], 0.7);
            }
            let (mapped, has_frame) = tangents.perturbed(&n, &texels, 0.7);
            let bent = bend_packet_toward_viewer(&n, &ng, &wo);
            for l in 0..LANES {
                let vector = |v: &Lanes3<f32>| DVec3::new(v[0][l].into(), v[1][l].into(), v[2][l].into());
                // Tangents nearly along the normal, and texels near zero, lose digits in f32
                let sine = ns[l]
                    .cross(DVec3::from(tangents.tangent.map(|axis| f64::from(axis[l]))))
                    .length();
                let length = DVec3::from([0, 1, 2].map(|c| 2.0 * f64::from(texels[l][c]) - 1.0)).length();
                let bound = 4e-6 / (sine * length);
                assert!(has_frame[l] && (vector(&mapped) - scalar[l]).length() < bound);
                if ngs[l].dot(wos[l]) > 0.0 {
                    let expected = bend_toward_viewer(ns[l], ngs[l], wos[l]);
                    let difference = (vector(&bent) - expected).length();
                    assert!(difference < 1e-4, "{:?}, not {expected:?}", vector(&bent));
                }
            }
        }
        // Without a tangent, the normal stays
        let (n, _) = lanes(&mut random);
        let (mapped, has_frame) = TangentPacket::ZERO.perturbed(&n, &[[0.9; 4]; LANES], 1.0);
        assert_eq!((mapped, has_frame), (n, [false; LANES]));
    }
}
