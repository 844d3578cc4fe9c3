//! The ways of finding hits that cases are put to, as data.

use serde::Serialize;

use crate::accel::{Backend, Kernel, Precision};

/// What a way of finding hits lets no ray slip through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Closes {
    /// Triangles themselves: rays may slip through where two of them meet.
    Faces,
    /// Edges too: rays may slip through where several triangles meet in a corner.
    Edges,
    /// All of a closed mesh.
    Vertices,
}

/// A way of finding hits, or none: the formulas alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Path {
    /// What tables call it.
    pub name: &'static str,
    /// What is asked; `None` for formulas, which need no scene.
    #[serde(skip)]
    pub accel: Option<(Backend, Precision, Kernel)>,
    /// What it guarantees of triangles. Analytic shapes are the same f64 functions on every path, as Embree's user
    /// geometry or in leaves of the BSP.
    pub closes: Closes,
}

/// All of them, least guarantee first.
pub const PATHS: &[Path] = &[
    Path {
        name: "embree fast",
        accel: Some((Backend::Embree, Precision::Fast, Kernel::Packet)),
        closes: Closes::Faces,
    },
    Path {
        name: "embree robust",
        accel: Some((Backend::Embree, Precision::Robust, Kernel::Packet)),
        closes: Closes::Edges,
    },
    Path {
        name: "embree single",
        accel: Some((Backend::Embree, Precision::Robust, Kernel::Single)),
        closes: Closes::Edges,
    },
    Path {
        name: "embree watertight",
        accel: Some((Backend::Embree, Precision::Watertight, Kernel::Packet)),
        closes: Closes::Vertices,
    },
    Path {
        name: "bsp",
        accel: Some((Backend::Bsp, Precision::Watertight, Kernel::Packet)),
        closes: Closes::Vertices,
    },
    Path {
        name: "bsp single",
        accel: Some((Backend::Bsp, Precision::Watertight, Kernel::Single)),
        closes: Closes::Vertices,
    },
    Path {
        name: "formulas",
        accel: None,
        closes: Closes::Vertices,
    },
];

impl Path {
    /// Whether Embree answers.
    pub fn is_embree(&self) -> bool {
        matches!(self.accel, Some((Backend::Embree, ..)))
    }

    /// Whether this program can go it: without Embree built in, some cannot.
    pub fn is_built_in(&self) -> bool {
        cfg!(feature = "embree") || !self.is_embree()
    }
}
