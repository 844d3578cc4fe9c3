//! Samples of emissive meshes for sixteen shaded points at once.

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use super::shadow_ray_end::ShadowRayEnds;
use crate::mesh::Mesh;
use crate::numeric::{LANES, Lanes, Lanes3, triangle_spawn_bound, warp};
use crate::scene::{Instance, LightSamplePacket};
use crate::shading::MeshLight;

/// Triangles of a mesh light that sixteen points have chosen.
struct ChosenTriangles {
    /// Corners in world space.
    corners: [Lanes3<f64>; 3],
    /// Corners in object space.
    in_object: [Lanes3<f32>; 3],
    /// Random pairs for the points on the triangles.
    u: [Lanes<f64>; 2],
}

/// Samples the points of an emissive mesh that `u` selects for the points `p`: each as
/// [`super::AreaLightSampler::sample`] does, with the same bits. Positions are the ends of the shadow rays.
pub(super) fn sample_emissive_mesh(
    light: &MeshLight,
    (mesh, instance): (&Mesh, &Instance),
    (p, u): (&Lanes3<f32>, &[Lanes<f64>; 2]),
) -> LightSamplePacket {
    // Choose a triangle for each point by inverting the cumulative area, and fetch its corners
    let steps = light.choose_packet(&u[0]);
    let mut chosen = ChosenTriangles {
        corners: [[[0.0; LANES]; 3]; 3],
        in_object: [[[0.0; LANES]; 3]; 3],
        u: [steps.within, u[1]],
    };
    for l in 0..LANES {
        let triangle = steps.index[l];
        let (corners, in_object) = (light.corners(triangle as usize), mesh.corners(triangle));
        for corner in 0..3 {
            for axis in 0..3 {
                chosen.corners[corner][axis][l] = corners[corner][axis];
                chosen.in_object[corner][axis][l] = in_object[corner][axis];
            }
        }
    }
    // Sample the points
    let mut samples = LightSamplePacket {
        position: [[0.0; LANES]; 3],
        direction: [[0.0; LANES]; 3],
        pdf: [0.0; LANES],
    };
    sample_triangles(&chosen, (light.area(), instance), p, &mut samples);
    samples
}

/// Samples a point on each of the chosen triangles.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_triangles(
    chosen: &ChosenTriangles,
    (area, instance): (f64, &Instance),
    p: &Lanes3<f32>,
    samples: &mut LightSamplePacket,
) {
    let ends = ShadowRayEnds::of(instance);
    for l in 0..LANES {
        // Sample a point uniformly on the triangle
        let shaded = DVec3::new(p[0][l].into(), p[1][l].into(), p[2][l].into());
        let [a, b, c] = &chosen.corners;
        let (a, b, c) = (lane(a, l), lane(b, l), lane(c, l));
        let (e1, e2) = (b - a, c - a);
        let [to_b, to_c] = warp::triangle([chosen.u[0][l], chosen.u[1][l]]);
        let position = a + to_b * e1 + to_c * e2;
        let across = e1.cross(e2);
        let normal = across / across.length();
        // Convert the density per area into a density per solid angle
        let to_light = position - shaded;
        let squared = to_light.length_squared();
        let approach = to_light.dot(normal);
        let distance = squared.sqrt();
        let pdf = squared * distance / (approach.abs() * area);
        let direction = to_light / distance;
        // Bound the rounding errors of rays that leave the triangle
        let [v0, v1, v2] = &chosen.in_object;
        let v0 = corner(v0, l);
        let error = triangle_spawn_bound(v0, corner(v1, l) - v0, corner(v2, l) - v0).as_dvec3();
        // End the shadow ray off the surface, on the side that it comes from
        let side = if direction.dot(normal) < 0.0 { 1.0 } else { -1.0 };
        let end = ends.end(position, normal * side, distance * direction, error);
        let is_sample = (pdf > 0.0) & (pdf < f64::INFINITY) & (distance > 0.0) & (distance < f64::INFINITY);
        samples.pdf[l] = if is_sample { pdf } else { 0.0 };
        for axis in 0..3 {
            samples.direction[axis][l] = direction[axis];
            samples.position[axis][l] = end[axis];
        }
    }
}

#[inline(always)]
fn lane(vectors: &Lanes3<f64>, l: usize) -> DVec3 {
    DVec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}

#[inline(always)]
fn corner(vectors: &Lanes3<f32>, l: usize) -> Vec3 {
    Vec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}
