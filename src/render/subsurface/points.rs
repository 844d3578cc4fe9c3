//! Points on the surfaces of objects at which incident irradiance is computed.

use glam::DVec3;

use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::optics::subsurface::{
    Dipole, MAX_SAMPLES, Scattering, SurfaceSample, lattice_samples, surface_samples,
};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Implicit, Shape, ShapeRay};

/// Smallest number of points per object, for any mean free path, because shadows on it have edges.
const MIN_POINTS: f64 = 4096.0;

/// Number of lines along each edge of the bounding box of a shape, used to estimate its area.
const LINES: f64 = 48.0;

/// Point that represents a piece of the surface of an object, in world space.
pub(super) type IrradiancePoint = SurfaceSample;

/// Object that is covered with points.
pub(super) struct IrradiancePoints {
    /// Index of the instance in the scene.
    pub(super) instance: u32,
    pub(super) scattering: Scattering,
    /// Dipole, limited to what the spacing of the points resolves.
    pub(super) dipole: Dipole,
    pub(super) points: Vec<IrradiancePoint>,
    /// Distance between neighbouring points.
    pub(super) spacing: f64,
    /// Distance between points that the material needs.
    wanted: f64,
}

impl IrradiancePoints {
    /// Returns the ratio of the spacing of points to the spacing that the material needs.
    pub(super) fn coarseness(&self) -> f64 {
        self.spacing / self.wanted
    }
}

/// Object and the points that it needs.
struct PointRequest<'s> {
    index: u32,
    instance: &'s Instance,
    geometry: &'s Geometry,
    scattering: Scattering,
    dipole: Dipole,
    /// Distance between its points.
    spacing: f64,
    /// Estimated number of points.
    count: f64,
}

/// Returns the number of points that the objects of a scene need.
pub(super) fn count(scene: &Scene) -> f64 {
    point_requests(scene)
        .iter()
        .map(|point_requests| point_requests.count)
        .sum()
}

/// Covers the objects of a scene that have subsurface scattering with points: at most [`MAX_SAMPLES`] for all of
/// them, for which all distances grow by a common factor.
pub(super) fn cover(scene: &Scene) -> Vec<IrradiancePoints> {
    let point_requests = point_requests(scene);
    let count: f64 = point_requests
        .iter()
        .map(|point_requests| point_requests.count)
        .sum();
    // Enlarge all spacings equally if there are too many points
    let factor = (count / MAX_SAMPLES as f64).sqrt().max(1.0);
    let covered = point_requests
        .iter()
        .map(|point_requests| point_requests.covered(factor));
    covered.filter(|covered| !covered.points.is_empty()).collect()
}

fn point_requests(scene: &Scene) -> Vec<PointRequest<'_>> {
    let all = (0..).zip(&scene.instances);
    all.filter_map(|(index, instance)| PointRequest::of(scene, index, instance))
        .collect()
}

impl<'s> PointRequest<'s> {
    /// Returns the needs of an instance, if it has subsurface scattering and a finite area.
    fn of(scene: &'s Scene, index: u32, instance: &'s Instance) -> Option<PointRequest<'s>> {
        let scattering = *scene.materials[instance.material as usize].scatters()?;
        let dipole = Dipole::new(&scattering).ok()?;
        let geometry = &scene.geometries[instance.geometry as usize];
        let area = area(instance, geometry);
        // Skip degenerate and infinite objects
        if !(area > 0.0 && area < f64::INFINITY) {
            return None;
        }
        let spacing = dipole.sample_spacing().min((area / MIN_POINTS).sqrt());
        Some(PointRequest {
            index,
            instance,
            geometry,
            scattering,
            dipole,
            spacing,
            // Lattices need half as many points again on curved surfaces.
            count: 1.5 * area / (spacing * spacing),
        })
    }

    /// Covers the object with points at `factor` times the distance that it needs.
    fn covered(&self, factor: f64) -> IrradiancePoints {
        let requested_spacing = factor * self.spacing;
        let (points, spacing) = match self.geometry {
            Geometry::Mesh(mesh) => {
                let corners = triangles(self.instance, mesh);
                let mut found = surface_samples(mesh.triangles.len(), corners, requested_spacing);
                if self.instance.is_mirrored() {
                    // Keep the front side if the instance transform mirrors and so reverses the vertex order.
                    found
                        .samples
                        .iter_mut()
                        .for_each(|sample| sample.normal = -sample.normal);
                }
                (found.samples, found.spacing)
            }
            Geometry::Shape(shape) => (
                on_shape(self.instance, shape, requested_spacing),
                requested_spacing,
            ),
            // A valid scene has no subsurface scattering in point clouds
            Geometry::Points(_) => (Vec::new(), requested_spacing),
        };
        IrradiancePoints {
            instance: self.index,
            scattering: self.scattering,
            dipole: self.dipole.widened_for_spacing(spacing),
            points,
            spacing,
            wanted: self.dipole.sample_spacing(),
        }
    }
}

/// Returns the vertices of the triangles of a mesh in world space.
fn triangles<'m>(instance: &Instance, mesh: &'m Mesh) -> impl Fn(usize) -> [DVec3; 3] + Sync + use<'m> {
    let map = instance.world_from_object();
    move |triangle| mesh.corners_f64(triangle as u32).map(|p| map.transform_point3(p))
}

/// Distributes points over a shape, `spacing` apart.
fn on_shape(instance: &Instance, shape: &Shape, spacing: f64) -> Vec<IrradiancePoint> {
    let cross = |origin: DVec3, direction: DVec3, out: &mut dyn FnMut(DVec3, DVec3, u32)| {
        let line = ShapeRay::new(origin, direction);
        shape.crossings(&line, &mut |hit| {
            let point = shape.point(line.at(hit.t), hit.part);
            out(point.p, point.n, hit.part);
        });
    };
    lattice_samples(&shape.bounds(), &instance.world_from_object(), spacing, cross)
}

/// Returns the area of an object in world space; approximately for an analytic shape.
fn area(instance: &Instance, geometry: &Geometry) -> f64 {
    match geometry {
        // Sum up the triangles, without those that overflow
        Geometry::Mesh(mesh) => {
            let corners = triangles(instance, mesh);
            let of_triangle = |[a, b, c]: [DVec3; 3]| 0.5 * (b - a).cross(c - a).length();
            (0..mesh.triangles.len())
                .map(|t| of_triangle(corners(t)))
                .filter(|area| area.is_finite())
                .sum()
        }
        Geometry::Shape(shape) => {
            let bounds: Bounds = shape.bounds();
            let m = instance.world_from_object().matrix3;
            let extent = bounds.extent();
            // Estimate the area of a shape by the areas of its lattice samples
            let edge = (0..3)
                .map(|axis| extent[axis] * m.col(axis).length())
                .fold(0.0, f64::max);
            if !(edge > 0.0 && edge < f64::INFINITY) {
                return 0.0;
            }
            let points = on_shape(instance, shape, edge / LINES);
            points.iter().map(|point| point.area).sum()
        }
        Geometry::Points(_) => 0.0,
    }
}
