//! Samples of emissive meshes for sixteen shaded points at once.

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use super::shadow_ray_end::ShadowRayEnds;
use crate::mesh::Mesh;
use crate::numeric::{LANES, Lanes, Lanes3, triangle_spawn_bound, warp};
use crate::scene::LightSamplePacket;
use crate::shading::MeshLight;

/// Triangles of a mesh light that sixteen points have chosen, with what [`MeshLight`] knows of each.
struct ChosenTriangles {
    corner: Lanes3<f64>,
    edges: [Lanes3<f64>; 2],
    normal: Lanes3<f64>,
    /// Bounds on the rounding errors of points on them, along each axis of object space.
    errors: Lanes3<f32>,
    /// Random pairs for the points on the triangles.
    u: [Lanes<f64>; 2],
}

/// Samples the points of an emissive mesh that `u` selects for the points `p`: each as
/// [`super::AreaLightSampler::sample`] does, with the same bits. Positions are the ends of the shadow rays.
/// `errors` holds the bounds that [`triangle_errors`] returns.
pub(super) fn sample_emissive_mesh(
    light: &MeshLight,
    (errors, ends): (&[Vec3], &ShadowRayEnds),
    (p, u): (&Lanes3<f32>, &[Lanes<f64>; 2]),
) -> LightSamplePacket {
    // Choose a triangle for each point by inverting the cumulative area
    let steps = light.choose_packet(&u[0]);
    let mut chosen = ChosenTriangles {
        corner: [[0.0; LANES]; 3],
        edges: [[[0.0; LANES]; 3]; 2],
        normal: [[0.0; LANES]; 3],
        errors: [[0.0; LANES]; 3],
        u: [steps.within, u[1]],
    };
    // Fetch the triangles
    for l in 0..LANES {
        let index = steps.index[l] as usize;
        let (triangle, error) = (light.triangle(index), errors[index]);
        for axis in 0..3 {
            chosen.corner[axis][l] = triangle.corner[axis];
            chosen.edges[0][axis][l] = triangle.edges[0][axis];
            chosen.edges[1][axis][l] = triangle.edges[1][axis];
            chosen.normal[axis][l] = triangle.normal[axis];
            chosen.errors[axis][l] = error[axis];
        }
    }
    // Sample the points
    let mut samples = LightSamplePacket {
        position: [[0.0; LANES]; 3],
        direction: [[0.0; LANES]; 3],
        pdf: [0.0; LANES],
    };
    sample_triangles(&chosen, (light.area(), ends), p, &mut samples);
    samples
}

/// Samples a point on each of the chosen triangles.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_triangles(
    chosen: &ChosenTriangles,
    (area, ends): (f64, &ShadowRayEnds),
    p: &Lanes3<f32>,
    samples: &mut LightSamplePacket,
) {
    for l in 0..LANES {
        // Sample a point uniformly on the triangle
        let shaded = DVec3::new(p[0][l].into(), p[1][l].into(), p[2][l].into());
        let [e1, e2] = &chosen.edges;
        let [to_b, to_c] = warp::triangle([chosen.u[0][l], chosen.u[1][l]]);
        let position = lane(&chosen.corner, l) + to_b * lane(e1, l) + to_c * lane(e2, l);
        let normal = lane(&chosen.normal, l);
        // Convert the density per area into a density per solid angle
        let to_light = position - shaded;
        let squared = to_light.length_squared();
        let approach = to_light.dot(normal);
        let distance = squared.sqrt();
        let pdf = squared * distance / (approach.abs() * area);
        let direction = to_light / distance;
        // End the shadow ray off the surface, on the side that it comes from
        let [x, y, z] = &chosen.errors;
        let error = DVec3::new(x[l].into(), y[l].into(), z[l].into());
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

/// Returns bounds on the rounding errors of rays that leave each triangle of a mesh, along each axis of object space.
pub(super) fn triangle_errors(mesh: &Mesh) -> Vec<Vec3> {
    let error = |triangle| {
        let [a, b, c] = mesh.corners(triangle);
        triangle_spawn_bound(a, b - a, c - a)
    };
    (0..mesh.triangles.len() as u32).map(error).collect()
}
