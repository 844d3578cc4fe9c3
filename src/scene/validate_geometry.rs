//! Validation of meshes, shapes and point clouds.

use super::Geometry;
use super::mesh_cleanup::{all_finite, scan};
use super::validate_value::{check_coordinate_range, is_size};
use crate::mesh::{Mesh, PointCloud};
use crate::numeric::Bounds;
use crate::shape::{Shape, Sphere, Torus};

/// Runs the checks of a mesh that read every vertex, and returns its bounds.
pub(super) fn check_vertices(mesh: &Mesh) -> Result<Bounds, String> {
    if !all_finite(bytemuck::cast_slice(&mesh.positions)) {
        return Err("has a vertex that is not finite: correct its positions".into());
    }
    let scan = scan(mesh).map_err(|bad| {
        format!(
            "triangle {} refers to vertex {} of {}: correct its indices",
            bad.triangle,
            bad.vertex,
            mesh.positions.len()
        )
    })?;
    if scan.unusable > 0 {
        return Err(format!(
            "has {} triangles without an area: remove them",
            scan.unusable
        ));
    }
    // Check the optional vertex attributes
    let optional = [
        mesh.normals.as_ref().map(|n| bytemuck::cast_slice(&n[..])),
        mesh.tangents.as_ref().map(|t| bytemuck::cast_slice(&t[..])),
        mesh.colors.as_ref().map(|c| bytemuck::cast_slice(&c[..])),
    ];
    let sets = mesh.tex_coords.iter().map(|set| bytemuck::cast_slice(&set[..]));
    if !optional.into_iter().flatten().chain(sets).all(all_finite) {
        return Err(
            "has a normal, tangent, colour or texture coordinate that is not finite: correct it".into(),
        );
    }
    Ok(scan.bounds)
}

/// Runs the checks of a point cloud that read every point, and returns its bounds.
pub(super) fn check_points(cloud: &PointCloud) -> Result<Bounds, String> {
    let colors: &[[f32; 4]] = cloud.colors.as_ref().map_or(&[], |colors| colors);
    if !all_finite(bytemuck::cast_slice(&cloud.positions)) || !all_finite(bytemuck::cast_slice(colors)) {
        return Err("has a point whose position or colour is not finite: correct it".into());
    }
    Ok(cloud.bounds())
}

/// Checks the parameters that a shape's own constructor does not check.
fn check_shape(shape: &Shape) -> Result<(), String> {
    match *shape {
        Shape::Sphere(Sphere { center, radius }) if !(is_size(radius) && center.is_finite()) => {
            Err("is a sphere without a positive, finite radius and a finite centre: correct them".into())
        }
        Shape::Torus(Torus { minor_radius }) if !(minor_radius > 0.0 && minor_radius < 1.0) => {
            Err("is a torus whose tube's radius is not between 0 and 1: correct it".into())
        }
        _ => Ok(()),
    }
}

/// Runs all other checks of a geometry with these bounds.
pub(super) fn check_geometry(geometry: &Geometry, bounds: &Bounds) -> Result<(), String> {
    let vertex_range = || check_coordinate_range(bounds.magnitude());
    match geometry {
        Geometry::Shape(Shape::Plane) => Ok(()),
        Geometry::Shape(shape) => {
            check_shape(shape)?;
            vertex_range()
        }
        Geometry::Points(cloud) => check_cloud(cloud),
        Geometry::Mesh(mesh) => {
            // Check that each vertex attribute has one value per vertex
            let count = mesh.positions.len();
            let normals = mesh.normals.as_ref().map_or(count, |n| n.len());
            let tangents = mesh.tangents.as_ref().map_or(count, |t| t.len());
            let colors = mesh.colors.as_ref().map_or(count, |c| c.len());
            if [normals, tangents, colors] != [count; 3] {
                return Err(
                    "has fewer or more normals, tangents or colours than vertices: give one for each".into(),
                );
            }
            vertex_range()
        }
    }
}

/// Checks the radius and the counts of a point cloud. Its object space may have any range, as rays are transformed to it in
/// f64.
fn check_cloud(cloud: &PointCloud) -> Result<(), String> {
    if !is_size(cloud.radius) {
        return Err("is a point cloud without a positive, finite radius: correct it".into());
    }
    if cloud
        .colors
        .as_ref()
        .is_some_and(|colors| colors.len() != cloud.len())
    {
        return Err("has fewer or more colours than points: give one for each".into());
    }
    if cloud.len() > MAX_POINTS {
        return Err(format!(
            "has more than {MAX_POINTS} points: split it into several clouds"
        ));
    }
    Ok(())
}

/// Largest number of points of a cloud: backends number the primitives of a scene by 32 bits, of which they keep the last
/// number for themselves.
const MAX_POINTS: usize = u32::MAX as usize - 1;
