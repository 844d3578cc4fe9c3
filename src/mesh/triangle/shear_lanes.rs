//! Watertight test of several rays, which share their dominant axis or have one each, with one triangle or with one each.

#[cfg(any(test, feature = "embree"))]
use super::PACK;
use super::shear::axes_around;
use super::{EdgeTest, LaneHits, Shear, edge_test, project};
use crate::mesh::simd::{SimdLevel, div, lanes};

/// Axes of `N` rays in the order that puts the dominant one last.
pub trait LaneAxes<const N: usize>: Copy {
    /// Returns the coordinates of a vector of each ray in the order of its axes.
    fn permuted(&self, vectors: [&[f32; N]; 3]) -> [[f32; N]; 3];

    /// Returns the axes of one ray.
    fn of_lane(&self, lane: usize) -> [usize; 3];

    /// Returns the coordinates of one point in the order of the axes of each ray.
    #[inline(always)]
    fn along(&self, [x, y, z]: [f32; 3]) -> [[f32; N]; 3] {
        self.permuted([&[x; N], &[y; N], &[z; N]])
    }

    /// Returns the coordinates of one of eight points, given by axis, in the order of the axes of each ray.
    #[cfg(any(test, feature = "embree"))]
    #[inline(always)]
    fn along_slot(&self, [x, y, z]: &[[f32; PACK]; 3], slot: usize) -> [[f32; N]; 3] {
        self.along([x[slot], y[slot], z[slot]])
    }
}

/// Axes of rays that share their dominant one.
#[derive(Clone, Copy, Debug)]
pub struct CommonAxes([usize; 3]);

impl<const N: usize> LaneAxes<N> for CommonAxes {
    #[inline(always)]
    fn permuted(&self, vectors: [&[f32; N]; 3]) -> [[f32; N]; 3] {
        let [kx, ky, kz] = self.0;
        [*vectors[kx], *vectors[ky], *vectors[kz]]
    }

    #[inline(always)]
    fn of_lane(&self, _lane: usize) -> [usize; 3] {
        self.0
    }

    // Permutes three numbers, or the rows they are in, not the vectors of the copies of each
    #[inline(always)]
    fn along(&self, point: [f32; 3]) -> [[f32; N]; 3] {
        let [kx, ky, kz] = self.0;
        [[point[kx]; N], [point[ky]; N], [point[kz]; N]]
    }

    #[cfg(any(test, feature = "embree"))]
    #[inline(always)]
    fn along_slot(&self, points: &[[f32; PACK]; 3], slot: usize) -> [[f32; N]; 3] {
        let [kx, ky, kz] = self.0;
        [
            [points[kx][slot]; N],
            [points[ky][slot]; N],
            [points[kz][slot]; N],
        ]
    }
}

/// Axes of rays with a dominant one each: the masks of all bits for those whose dominant axis is x, and y.
#[derive(Clone, Copy, Debug)]
pub struct OwnAxes<const N: usize> {
    is_x: [i32; N],
    is_y: [i32; N],
}

impl<const N: usize> OwnAxes<N> {
    /// Returns the axes of rays of these directions, as [`dominant_axis`] decides.
    ///
    /// [`dominant_axis`]: super::dominant_axis
    #[inline(always)]
    fn of(direction: &[[f32; N]; 3]) -> OwnAxes<N> {
        let mut axes = OwnAxes {
            is_x: [0; N],
            is_y: [0; N],
        };
        for lane in 0..N {
            // Compare the sizes of the coordinates
            let [x, y, z] = [
                direction[0][lane].abs(),
                direction[1][lane].abs(),
                direction[2][lane].abs(),
            ];
            // Set all bits of the masks
            let is_x = (y < x) & (z < x);
            axes.is_x[lane] = if is_x { -1 } else { 0 };
            axes.is_y[lane] = if (z < y) & !is_x { -1 } else { 0 };
        }
        axes
    }
}

impl<const N: usize> LaneAxes<N> for OwnAxes<N> {
    #[inline(always)]
    fn permuted(&self, [x, y, z]: [&[f32; N]; 3]) -> [[f32; N]; 3] {
        let mut permuted = [[0.0; N]; 3];
        for lane in 0..N {
            // Sign bits alone decide, as they do for instructions that select
            let (is_x, is_y) = (self.is_x[lane] < 0, self.is_y[lane] < 0);
            let (x, y, z) = (x[lane], y[lane], z[lane]);
            // The orders of `axes_around`, by two selections for each coordinate
            let rows = if is_y { [z, x, y] } else { [x, y, z] };
            let rows = if is_x { [y, z, x] } else { rows };
            permuted[0][lane] = rows[0];
            permuted[1][lane] = rows[1];
            permuted[2][lane] = rows[2];
        }
        permuted
    }

    #[inline(always)]
    fn of_lane(&self, lane: usize) -> [usize; 3] {
        axes_around(match (self.is_x[lane], self.is_y[lane]) {
            (0, 0) => 2,
            (0, _) => 1,
            _ => 0,
        })
    }
}

/// Axes of rays in the order that puts the dominant one of each last, for points that are in memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisOrders<const N: usize>([[u32; N]; 3]);

impl<const N: usize> AxisOrders<N> {
    /// Returns the orders of [`axes_around`].
    #[inline(always)]
    pub(crate) fn of(axes: &OwnAxes<N>) -> AxisOrders<N> {
        let mut orders = [[0; N]; 3];
        // Select the axis of each coordinate by the dominant one: x, y or z
        for (row, [x, y, z]) in orders.iter_mut().zip([[1, 2, 0], [2, 0, 1], [0, 1, 2]]) {
            for lane in 0..N {
                let axis = if axes.is_y[lane] < 0 { y } else { z };
                row[lane] = if axes.is_x[lane] < 0 { x } else { axis };
            }
        }
        AxisOrders(orders)
    }

    /// Returns the coordinates of a point, whose fourth value has no meaning, in the order of the axes of each ray: the
    /// result of [`LaneAxes::along`].
    #[inline(always)]
    pub(crate) fn along(&self, isa: impl SimdLevel, point: &[f32; 4]) -> [[f32; N]; 3] {
        let [x, y, z] = &self.0;
        [
            isa.select_of_four(point, x),
            isa.select_of_four(point, y),
            isa.select_of_four(point, z),
        ]
    }
}

/// Ray set-up of `N` rays.
#[derive(Clone, Copy, Debug)]
pub struct ShearLanes<const N: usize, A = CommonAxes> {
    pub(crate) axes: A,
    pub(super) origin: [[f32; N]; 3],
    pub(super) shear: [[f32; N]; 3],
}

/// Returns one mask per axis: bit `i` is set if direction `i` is longest along that axis, as [`dominant_axis`] decides.
///
/// [`dominant_axis`]: super::dominant_axis
#[cfg(feature = "embree")]
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
        ShearLanes::along(CommonAxes(axes_around(dominant)), origin, direction)
    }
}

impl<const N: usize> ShearLanes<N, OwnAxes<N>> {
    /// Computes the shears of `N` rays of any direction.
    #[inline(always)]
    pub(crate) fn of_each(origin: &[[f32; N]; 3], direction: &[[f32; N]; 3]) -> ShearLanes<N, OwnAxes<N>> {
        ShearLanes::along(OwnAxes::of(direction), origin, direction)
    }
}

impl<const N: usize, A: LaneAxes<N>> ShearLanes<N, A> {
    #[inline(always)]
    fn along(axes: A, origin: &[[f32; N]; 3], direction: &[[f32; N]; 3]) -> ShearLanes<N, A> {
        // Divide the directions by their dominant coordinates
        let [x, y, z] = &axes.permuted(direction.each_ref());
        ShearLanes {
            axes,
            origin: axes.permuted(origin.each_ref()),
            shear: [div(x, z), div(y, z), div(&[1.0; N], z)],
        }
    }

    /// Returns the shear of one lane.
    #[inline(always)]
    pub(crate) fn lane(&self, lane: usize) -> Shear {
        Shear {
            axes: self.axes.of_lane(lane),
            origin: [self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]],
            shear: [self.shear[0][lane], self.shear[1][lane], self.shear[2][lane]],
        }
    }

    /// Intersects one triangle with all rays, each with the result of [`Shear::intersect`].
    #[inline(always)]
    pub(crate) fn intersect(
        &self,
        isa: impl SimdLevel,
        corners: [[f32; 3]; 3],
        t_near: &[f32; N],
        t_far: &[f32; N],
    ) -> LaneHits<N> {
        let [sx, sy, sz] = self.shear;
        let shear = [sx, sy];
        // Project the vertices for all rays
        let [a, b, c] = corners;
        let a = project(self.axes.along(a).each_ref(), &self.origin, &shear);
        let b = project(self.axes.along(b).each_ref(), &self.origin, &shear);
        let c = project(self.axes.along(c).each_ref(), &self.origin, &shear);
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
        let [a, b, c] = corners;
        let a = project(self.axes.permuted(a.each_ref()).each_ref(), &self.origin, &shear);
        let b = project(self.axes.permuted(b.each_ref()).each_ref(), &self.origin, &shear);
        let c = project(self.axes.permuted(c.each_ref()).each_ref(), &self.origin, &shear);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::simd::{SimdKernel, dispatch, dispatch_sixteen};

    /// Kernel that returns a point along the axes of sixteen directions by selections, and by permuting axes.
    struct Along([[f32; 16]; 3], [f32; 3]);

    impl SimdKernel for Along {
        type Output = [[[f32; 16]; 3]; 2];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [[[f32; 16]; 3]; 2] {
            let Along(directions, [x, y, z]) = self;
            let axes = OwnAxes::of(&directions);
            let orders = AxisOrders::of(&axes);
            [orders.along(isa, &[x, y, z, 9.0]), axes.along([x, y, z])]
        }
    }

    #[test]
    fn orders_of_axes_permute_as_the_axes_do() {
        // Every third direction has the same dominant axis
        let directions = [0, 1, 2].map(|axis| {
            std::array::from_fn(|lane| {
                if lane % 3 == axis {
                    -2.0
                } else {
                    1.0 + 0.01 * lane as f32
                }
            })
        });
        let along = || Along(directions, [3.0, 4.0, 5.0]);
        for [found, expected] in [
            along().run(crate::mesh::simd::Scalar),
            dispatch(along()),
            dispatch_sixteen(along()),
        ] {
            assert_eq!(found, expected);
            assert_eq!([found[2][0], found[2][1], found[2][2]], [3.0, 4.0, 5.0]);
        }
    }
}
