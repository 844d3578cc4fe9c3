//! Watertight test of several rays that share their dominant axis, with one triangle or with one each.

use super::shear::axes_around;
use super::{EdgeTest, LaneHits, Shear, edge_test, project};
use crate::mesh::simd::{SimdLevel, div, lanes};

/// Ray set-up of `N` rays that share their dominant axis.
#[derive(Clone, Copy, Debug)]
pub struct ShearLanes<const N: usize> {
    pub(super) axes: [usize; 3],
    pub(super) origin: [[f32; N]; 3],
    pub(super) shear: [[f32; N]; 3],
}

/// Returns one mask per axis: bit `i` is set if direction `i` is longest along that axis, as [`dominant_axis`] decides.
///
/// [`dominant_axis`]: super::dominant_axis
#[inline(always)]
pub(crate) fn dominant_axes<const N: usize>(isa: impl SimdLevel, direction: &[[f32; N]; 3]) -> [u32; 3] {
    let mut size = [[0.0; N]; 3];
    for axis in 0..3 {
        for lane in 0..N {
            size[axis][lane] = direction[axis][lane].abs();
        }
    }
    let [x, y, z] = &size;
    let is_x = isa.lt(y, x) & isa.lt(z, x);
    let is_y = isa.lt(z, y) & !is_x;
    [is_x, is_y, !(is_x | is_y)]
}

impl<const N: usize> ShearLanes<N> {
    /// Computes the shears of `N` rays whose dominant axis is `dominant`. Other lanes hold garbage and must not be
    /// used.
    #[inline(always)]
    pub fn new(dominant: usize, origin: &[[f32; N]; 3], direction: &[[f32; N]; 3]) -> ShearLanes<N> {
        let axes = axes_around(dominant);
        let [kx, ky, kz] = axes;
        let z = &direction[kz];
        ShearLanes {
            axes,
            origin: [origin[kx], origin[ky], origin[kz]],
            shear: [div(&direction[kx], z), div(&direction[ky], z), div(&[1.0; N], z)],
        }
    }

    /// Returns the shear of one lane.
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> Shear {
        Shear {
            axes: self.axes,
            origin: [self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]],
            shear: [self.shear[0][lane], self.shear[1][lane], self.shear[2][lane]],
        }
    }

    /// Intersects one triangle with all rays, each with the result of [`Shear::intersect`].
    #[inline(always)]
    pub fn intersect(
        &self,
        isa: impl SimdLevel,
        corners: [[f32; 3]; 3],
        t_near: &[f32; N],
        t_far: &[f32; N],
    ) -> LaneHits<N> {
        let [sx, sy, sz] = self.shear;
        let shear = [sx, sy];
        // Project the vertices for all rays
        let [kx, ky, kz] = self.axes;
        let [a, b, c] = corners;
        let a = project([&[a[kx]; N], &[a[ky]; N], &[a[kz]; N]], &self.origin, &shear);
        let b = project([&[b[kx]; N], &[b[ky]; N], &[b[kz]; N]], &self.origin, &shear);
        let c = project([&[c[kx]; N], &[c[ky]; N], &[c[kz]; N]], &self.origin, &shear);
        // Test all lanes in f32, then the undecided ones in f64
        let test = edge_test(isa, [a, b, c], sz, [t_near, t_far]);
        if test.undecided != 0 {
            return self.resolve_in_f64(test, corners, [*t_near, *t_far]);
        }
        test.hits
    }

    /// Intersects each ray with a triangle of its own, with the result of [`Shear::intersect`]. `corners` are indexed by
    /// vertex, axis and ray.
    #[inline(always)]
    pub(crate) fn intersect_each(
        &self,
        isa: impl SimdLevel,
        corners: &[[[f32; N]; 3]; 3],
        t_near: &[f32; N],
        t_far: &[f32; N],
    ) -> LaneHits<N> {
        let [sx, sy, sz] = self.shear;
        let shear = [sx, sy];
        // Project the vertices
        let [kx, ky, kz] = self.axes;
        let [a, b, c] = corners;
        let a = project([&a[kx], &a[ky], &a[kz]], &self.origin, &shear);
        let b = project([&b[kx], &b[ky], &b[kz]], &self.origin, &shear);
        let c = project([&c[kx], &c[ky], &c[kz]], &self.origin, &shear);
        // Test all lanes in f32, then the undecided ones in f64
        let mut test = edge_test(isa, [a, b, c], sz, [t_near, t_far]);
        for lane in lanes(test.undecided) {
            let own = corners.map(|rows| rows.map(|row| row[lane]));
            let hit = self.lane(lane).intersect(own, t_near[lane], t_far[lane]);
            test.resolve_in_f64(lane, hit);
        }
        test.hits
    }

    #[cold]
    #[inline(never)]
    fn resolve_in_f64(
        &self,
        mut test: EdgeTest<N>,
        corners: [[f32; 3]; 3],
        [t_near, t_far]: [[f32; N]; 2],
    ) -> LaneHits<N> {
        for lane in lanes(test.undecided) {
            let hit = self.lane(lane).intersect(corners, t_near[lane], t_far[lane]);
            test.resolve_in_f64(lane, hit);
        }
        test.hits
    }
}
