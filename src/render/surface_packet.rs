//! Sixteen points on surfaces, and where rays start that leave them.

use glam::{DVec3, Vec3};

use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3, shifted_point, spawn_point};

/// Sixteen points to shade, in world space. Lanes without a hit may hold anything, NaN included.
pub(super) struct SurfacePacket {
    /// Lanes that have hit something.
    pub(super) hit: Lanes<bool>,
    /// Whether the ray came from the outside: the side that triangles show their front to.
    pub(super) front: Lanes<bool>,
    /// Geometric normals on the side that the ray came from, to f64 accuracy, of lanes that are no plain triangles.
    pub(super) exact_normal: [DVec3; LANES],
    /// The points.
    pub(super) p: Lanes3<f64>,
    /// Unit geometric normals on the side that the ray came from.
    pub(super) ng: Lanes3<f32>,
    /// Unit shading normals on that side.
    pub(super) ns: Lanes3<f32>,
    /// Unit vectors to where the ray came from.
    pub(super) wo: Lanes3<f32>,
    /// Where rays start that leave on the side of `ng`.
    pub(super) origin: Lanes3<f32>,
    /// Bounds on the distance between `p` and the surface that a traversal sees, along `ng`; not worked out where there
    /// is an offset.
    pub(super) error: Lanes<f64>,
    /// By how much rays start off the surface; absent where that is the bound.
    pub(super) offset: Option<f64>,
}

impl SurfacePacket {
    /// Without a hit.
    pub(super) fn new() -> SurfacePacket {
        SurfacePacket {
            hit: [false; LANES],
            front: [true; LANES],
            exact_normal: [DVec3::ZERO; LANES],
            p: [[0.0; LANES]; 3],
            ng: [[0.0; LANES]; 3],
            ns: [[0.0; LANES]; 3],
            wo: [[0.0; LANES]; 3],
            origin: [[0.0; LANES]; 3],
            error: [0.0; LANES],
            offset: None,
        }
    }

    /// The unit shading normal of lane `l` on the side that the ray came from.
    pub(super) fn shading_normal(&self, l: usize) -> DVec3 {
        lane(&self.ns, l).as_dvec3().normalize()
    }

    /// Whether the shading normal of lane `l` is another than the geometric one.
    pub(super) fn ns_differs(&self, l: usize) -> bool {
        (0..3).any(|axis| self.ns[axis][l] != self.ng[axis][l])
    }

    /// The point of lane `l`.
    pub(super) fn point(&self, l: usize) -> DVec3 {
        DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l])
    }

    /// The unit geometric normal of lane `l` on the side that the ray came from.
    pub(super) fn geometric_normal(&self, l: usize) -> DVec3 {
        lane(&self.ng, l).as_dvec3()
    }

    /// The bound on the distance between the point of lane `l` and the surface that a traversal sees.
    pub(super) fn error(&self, l: usize) -> f64 {
        self.error[l]
    }

    /// Puts all hits where their parameters along the rays say.
    #[inline(always)]
    pub(super) fn report(&mut self, packet: &RayPacket) {
        for axis in 0..3 {
            for l in 0..LANES {
                let way = packet.t_far[l] * packet.direction[axis][l];
                self.p[axis][l] = f64::from(packet.origin[axis][l] + way);
            }
        }
    }

    /// Works out where rays start that leave on the side of `ng`.
    #[inline(always)]
    pub(super) fn spawn(&mut self) {
        if let Some(offset) = self.offset {
            return self.spawn_shifted(offset);
        }
        for l in 0..LANES {
            let p = DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l]);
            let origin = spawn_point(p, lane(&self.ng, l).as_dvec3(), self.error[l]);
            for axis in 0..3 {
                self.origin[axis][l] = origin[axis];
            }
        }
    }

    #[inline(always)]
    fn spawn_shifted(&mut self, offset: f64) {
        for l in 0..LANES {
            let p = DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l]);
            let origin = shifted_point(p, lane(&self.ng, l).as_dvec3(), offset);
            for axis in 0..3 {
                self.origin[axis][l] = origin[axis];
            }
        }
    }

    /// Where a ray starts that leaves lane `l` on the side of the unit normal `side`.
    #[inline(always)]
    pub(super) fn leave(&self, l: usize, side: DVec3) -> Vec3 {
        match self.offset {
            None => spawn_point(self.point(l), side, self.error[l]),
            Some(offset) => shifted_point(self.point(l), side, offset),
        }
    }
}

/// Lane `l` of each row.
#[inline(always)]
pub(super) fn lane(v: &Lanes3<f32>, l: usize) -> Vec3 {
    Vec3::new(v[0][l], v[1][l], v[2][l])
}
