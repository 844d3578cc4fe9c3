//! Kinds of bounding volumes, and numbers of objects by kind.

/// Kind of bounding volume for objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoundingVolumeKind {
    /// No volume: every object is tested.
    None,
    /// Axis-aligned boxes in world space.
    Box,
    /// Centroid spheres, around the mean of the vertices.
    CentroidSphere,
    /// Smallest enclosing spheres of the objects.
    TightSphere,
    /// For every object the cheapest kind by measured costs.
    Chosen,
}

impl BoundingVolumeKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [BoundingVolumeKind; 5] = [
        BoundingVolumeKind::None,
        BoundingVolumeKind::Box,
        BoundingVolumeKind::CentroidSphere,
        BoundingVolumeKind::TightSphere,
        BoundingVolumeKind::Chosen,
    ];
}

impl std::fmt::Display for BoundingVolumeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.pad(match self {
            BoundingVolumeKind::None => "none",
            BoundingVolumeKind::Box => "box",
            BoundingVolumeKind::CentroidSphere => "centroid sphere",
            BoundingVolumeKind::TightSphere => "tight sphere",
            BoundingVolumeKind::Chosen => "chosen",
        })
    }
}

/// Numbers of objects by kind of bounding volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct BoundingVolumeCounts {
    /// Objects without a bounding volume.
    pub none: u64,
    /// Objects behind a box.
    pub boxes: u64,
    /// Objects behind a centroid sphere.
    pub centroid_spheres: u64,
    /// Objects behind the smallest sphere.
    pub tight_spheres: u64,
}

impl BoundingVolumeCounts {
    /// Counts an object behind a volume of a kind.
    pub(super) fn add(&mut self, kind: BoundingVolumeKind) {
        *match kind {
            BoundingVolumeKind::None | BoundingVolumeKind::Chosen => &mut self.none,
            BoundingVolumeKind::Box => &mut self.boxes,
            BoundingVolumeKind::CentroidSphere => &mut self.centroid_spheres,
            BoundingVolumeKind::TightSphere => &mut self.tight_spheres,
        } += 1;
    }
}
