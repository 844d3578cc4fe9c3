//! The points of bodies at which the light that enters them is found.

use glam::DVec3;

use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::optics::subsurface::{
    Dipole, MAX_SAMPLES, Scattering, SurfaceSample, lattice_samples, surface_samples,
};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Implicit, Shape, ShapeRay};

/// Points of a body however far light goes in it: shadows on it have edges.
const MIN_POINTS: f64 = 4096.0;

/// Lines along each edge of the box around a shape by which its area is estimated.
const LINES: f64 = 48.0;

/// A point that stands for a piece of a body's surface, in world space.
pub(super) type Point = SurfaceSample;

/// A body covered with points.
pub(super) struct Covered {
    /// Which instance it is.
    pub(super) instance: u32,
    pub(super) scattering: Scattering,
    /// As far as the points can show it.
    pub(super) dipole: Dipole,
    pub(super) points: Vec<Point>,
    /// How far apart they lie.
    pub(super) spacing: f64,
    /// How far apart they may.
    wanted: f64,
}

impl Covered {
    /// How many times as far apart as they may the points lie.
    pub(super) fn coarseness(&self) -> f64 {
        self.spacing / self.wanted
    }
}

/// A body and the points that it asks for.
struct Asking<'s> {
    index: u32,
    instance: &'s Instance,
    geometry: &'s Geometry,
    scattering: Scattering,
    dipole: Dipole,
    /// Distance of its points.
    spacing: f64,
    /// How many they are.
    count: f64,
}

/// How many points the bodies of a scene ask for.
pub(super) fn count(scene: &Scene) -> f64 {
    asking(scene).iter().map(|asking| asking.count).sum()
}

/// The bodies of a scene that scatter light within, covered with points: at most [`MAX_SAMPLES`] of all bodies, for
/// which the distances of all grow by one factor.
pub(super) fn cover(scene: &Scene) -> Vec<Covered> {
    let asking = asking(scene);
    let count: f64 = asking.iter().map(|asking| asking.count).sum();
    let factor = (count / MAX_SAMPLES as f64).sqrt().max(1.0);
    let covered = asking.iter().map(|asking| asking.covered(factor));
    covered.filter(|covered| !covered.points.is_empty()).collect()
}

fn asking(scene: &Scene) -> Vec<Asking<'_>> {
    let all = (0..).zip(&scene.instances);
    all.filter_map(|(index, instance)| Asking::of(scene, index, instance))
        .collect()
}

impl<'s> Asking<'s> {
    /// What an instance asks for, if it scatters light within and has an area.
    fn of(scene: &'s Scene, index: u32, instance: &'s Instance) -> Option<Asking<'s>> {
        let scattering = *scene.materials[instance.material as usize].scatters()?;
        let dipole = Dipole::new(&scattering).ok()?;
        let geometry = &scene.geometries[instance.geometry as usize];
        let area = area(instance, geometry);
        if !(area > 0.0 && area < f64::INFINITY) {
            return None;
        }
        let spacing = dipole.sample_spacing().min((area / MIN_POINTS).sqrt());
        Some(Asking {
            index,
            instance,
            geometry,
            scattering,
            dipole,
            spacing,
            // Lattices take half as many again on what is curved.
            count: 1.5 * area / (spacing * spacing),
        })
    }

    /// The body with points `factor` times as far apart as it asks for.
    fn covered(&self, factor: f64) -> Covered {
        let asked = factor * self.spacing;
        let (points, spacing) = match self.geometry {
            Geometry::Mesh(mesh) => {
                let corners = triangles(self.instance, mesh);
                let mut found = surface_samples(mesh.triangles.len(), corners, asked);
                if self.instance.is_mirrored() {
                    // Fronts stay fronts where the placement turns the corners round.
                    found
                        .samples
                        .iter_mut()
                        .for_each(|sample| sample.normal = -sample.normal);
                }
                (found.samples, found.spacing)
            }
            Geometry::Shape(shape) => (on_shape(self.instance, shape, asked), asked),
        };
        Covered {
            instance: self.index,
            scattering: self.scattering,
            dipole: self.dipole.resolved_by(spacing),
            points,
            spacing,
            wanted: self.dipole.sample_spacing(),
        }
    }
}

/// The corners of a mesh's triangles in the world.
fn triangles<'m>(instance: &Instance, mesh: &'m Mesh) -> impl Fn(usize) -> [DVec3; 3] + Sync + use<'m> {
    let map = instance.world_from_object();
    move |triangle| mesh.corners_f64(triangle as u32).map(|p| map.transform_point3(p))
}

/// Points of a shape, `spacing` apart.
fn on_shape(instance: &Instance, shape: &Shape, spacing: f64) -> Vec<Point> {
    let cross = |origin: DVec3, direction: DVec3, out: &mut dyn FnMut(DVec3, DVec3, u32)| {
        let line = ShapeRay::new(origin, direction);
        shape.crossings(&line, &mut |hit| {
            let point = shape.point(line.at(hit.t), hit.part);
            out(point.p, point.n, hit.part);
        });
    };
    lattice_samples(&shape.bounds(), &instance.world_from_object(), spacing, cross)
}

/// The area of a body in the world; of a shape, about that.
fn area(instance: &Instance, geometry: &Geometry) -> f64 {
    match geometry {
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
            let edge = (0..3)
                .map(|axis| extent[axis] * m.col(axis).length())
                .fold(0.0, f64::max);
            if !(edge > 0.0 && edge < f64::INFINITY) {
                return 0.0;
            }
            let points = on_shape(instance, shape, edge / LINES);
            points.iter().map(|point| point.area).sum()
        }
    }
}
