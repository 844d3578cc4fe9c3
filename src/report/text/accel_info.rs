//! Parts of the acceleration structure: plan rows that are not effects. A part that the scene does not need takes no
//! callback, no flag and no memory.

use std::fmt;

use serde::Serialize;

use crate::accel::PrimitiveCounts;
use crate::scene::Scene;

/// Part of the acceleration structure, with the reason why it is present or absent.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StructureRow {
    /// Name of the part: `triangles`, `user-geometry`, `instances`, `planes`, `watertight-triangles` or `filters`.
    pub part: &'static str,
    /// True if the structure contains the part.
    pub on: bool,
    /// Objects in the scene that need the part, or the statement that none does.
    pub reason: String,
}

/// Returns the rows of a scene, with the default options of `whit render`.
pub(super) fn rows(scene: &Scene) -> Vec<StructureRow> {
    // Count primitives by the way in which they are intersected
    let contents = PrimitiveCounts::of(scene);
    // Instanced meshes are user geometry; meshes in world space are Embree triangles
    let PrimitiveCounts {
        world_triangles,
        placed_meshes,
        planes,
        ..
    } = contents;
    // Choose the reason by whether the part is present
    let row = |part, on, there: String, absent: &str| StructureRow {
        part,
        on,
        reason: if on { there } else { absent.into() },
    };
    let has_triangles = world_triangles + placed_meshes > 0;
    let (instances, geometries) = (scene.instances.len(), scene.geometries.len());
    // List every part with its reason
    vec![
        row(
            "triangles",
            has_triangles,
            format!("{world_triangles} in world space, and {placed_meshes} instanced meshes"),
            "there are no meshes",
        ),
        row(
            "user-geometry",
            contents.user_geometry() > 0,
            format!("callbacks intersect {}", user_objects(&contents)),
            "all objects are triangles in world space, so Embree needs no callbacks",
        ),
        row(
            "instances",
            instances > geometries || placed_meshes > 0,
            format!("{instances} of {geometries} geometries, {placed_meshes} of them instanced meshes"),
            "no geometry has two instances, and all meshes are in world space",
        ),
        row(
            "planes",
            planes > 0,
            format!("{planes} infinite planes are intersected after the structure"),
            "there are no infinite planes",
        ),
        row(
            "watertight-triangles",
            has_triangles,
            "edges and corners are watertight, as `--precision watertight` is the default".into(),
            "there are no meshes",
        ),
        row(
            "filters",
            false,
            String::new(),
            "new rays continue through holes; Embree's filter functions are not used",
        ),
    ]
}

/// Returns the numbers of objects that callbacks intersect, by kind.
fn user_objects(counts: &PrimitiveCounts) -> String {
    let PrimitiveCounts {
        shapes,
        points,
        placed_meshes,
        ..
    } = counts;
    match points {
        0 => format!("{shapes} shapes and {placed_meshes} instanced meshes"),
        _ => format!("{points} points, {shapes} shapes and {placed_meshes} instanced meshes"),
    }
}

impl fmt::Display for StructureRow {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let state = if self.on { "on" } else { "off" };
        write!(f, "{} {state}: {}", self.part, self.reason)
    }
}
