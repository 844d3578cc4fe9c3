//! SIMD helpers: comparisons that yield one bit a lane, table look-ups, run-time dispatch on the instruction set, and
//! iteration over bit masks.
//!
//! Kernels are loops over arrays, which the compiler vectorises; what it does not recognise is how to collect the
//! results of comparisons in a mask. A [`SimdLevel`] provides these operations. All levels return identical results.

mod wide;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use wide::{Floats, LaneMask, RegisterPair, WideLevel};

/// Sixteen f32 in one or two registers of an instruction set.
pub type Float16<I> = Floats<<I as SimdLevel>::Sixteen, 16>;

/// Instruction set whose availability has been checked.
pub trait SimdLevel: Copy {
    /// Level of operations on eight f32.
    type Eight: WideLevel<8>;
    /// Level of operations on sixteen f32.
    type Sixteen: WideLevel<16>;

    /// Returns the level of operations on eight f32.
    fn eight(self) -> Self::Eight;

    /// Returns the level of operations on sixteen f32.
    fn sixteen(self) -> Self::Sixteen;

    /// Hints that `item` will be read soon.
    fn prefetch<T>(self, item: &T);

    /// Flag for kernels that fall back to f64 where f32 cannot decide; false for [`F32Only`] alone.
    const IS_EXACT: bool = true;
    /// Flag for registers of at least eight f32.
    const HAS_EIGHT: bool = false;
    /// Flag for registers of sixteen f32.
    const HAS_SIXTEEN: bool = false;

    /// Returns a mask whose bit `i` says that `a[i] <= b[i]`; clear for NaN.
    fn le<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32;

    /// Returns a mask whose bit `i` says that `a[i] < b[i]`; clear for NaN.
    fn lt<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32;

    /// Returns a mask whose bit `i` says that `a[i] == b[i]`; clear for NaN.
    fn eq<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32;

    /// Gathers from a table: lane `i` of the result is `table[index[i]]`. The table's size must be a multiple of eight,
    /// and every index within it.
    fn permute<const N: usize>(self, table: &[f32; N], index: &[u32; 8]) -> [f32; 8];

    /// Selects one of four values for each lane: lane `i` of the result is `values[index[i]]`. Every index must be below four.
    fn select_of_four<const N: usize>(self, values: &[f32; 4], index: &[u32; N]) -> [f32; N];

    /// Adds 1 to `below_high[i]` where `a[i] < high`, and to `below_both[i]` where `a[i] <= low` holds as well.
    fn count_below<const N: usize>(
        self,
        a: &[f32; N],
        low: f32,
        high: f32,
        below_high: &mut [i32; N],
        below_both: &mut [i32; N],
    );
}

// Use no closures below: one that is not inlined would be compiled for the lowest instruction set.

/// Returns the smaller of two numbers in one instruction; `b` where either is NaN.
#[inline(always)]
pub(super) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Returns the greater of two numbers in one instruction; `b` where either is NaN.
#[inline(always)]
pub(super) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Returns the sums of two arrays, lane by lane.
#[inline(always)]
pub(super) fn add<const N: usize>(a: &[f32; N], b: &[f32; N]) -> [f32; N] {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = a[i] + b[i];
    }
    out
}

/// Returns the differences of two arrays, lane by lane.
#[inline(always)]
pub(super) fn sub<const N: usize>(a: &[f32; N], b: &[f32; N]) -> [f32; N] {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = a[i] - b[i];
    }
    out
}

/// Returns the products of two arrays, lane by lane.
#[inline(always)]
pub(super) fn mul<const N: usize>(a: &[f32; N], b: &[f32; N]) -> [f32; N] {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = a[i] * b[i];
    }
    out
}

/// Returns the quotients of two arrays, lane by lane.
#[inline(always)]
pub(crate) fn div<const N: usize>(a: &[f32; N], b: &[f32; N]) -> [f32; N] {
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = a[i] / b[i];
    }
    out
}

/// Baseline instruction set of every machine.
#[derive(Clone, Copy, Debug)]
pub struct Scalar;

impl SimdLevel for Scalar {
    type Eight = Scalar;
    type Sixteen = RegisterPair<Scalar>;

    #[inline(always)]
    fn eight(self) -> Scalar {
        self
    }

    #[inline(always)]
    fn sixteen(self) -> RegisterPair<Scalar> {
        RegisterPair(self)
    }

    #[inline(always)]
    fn prefetch<T>(self, _item: &T) {}

    #[inline(always)]
    fn le<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        (0..N).fold(0, |mask, i| mask | u32::from(a[i] <= b[i]) << i)
    }

    #[inline(always)]
    fn lt<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        (0..N).fold(0, |mask, i| mask | u32::from(a[i] < b[i]) << i)
    }

    #[inline(always)]
    fn eq<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        (0..N).fold(0, |mask, i| mask | u32::from(a[i] == b[i]) << i)
    }

    #[inline(always)]
    fn permute<const N: usize>(self, table: &[f32; N], index: &[u32; 8]) -> [f32; 8] {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = table[(index[i] as usize).min(N - 1)];
        }
        out
    }

    #[inline(always)]
    fn select_of_four<const N: usize>(self, values: &[f32; 4], index: &[u32; N]) -> [f32; N] {
        let mut out = [0.0; N];
        for i in 0..N {
            out[i] = values[(index[i] & 3) as usize];
        }
        out
    }

    #[inline(always)]
    fn count_below<const N: usize>(
        self,
        a: &[f32; N],
        low: f32,
        high: f32,
        below_high: &mut [i32; N],
        below_both: &mut [i32; N],
    ) {
        for i in 0..N {
            below_high[i] += i32::from(a[i] < high);
            below_both[i] += i32::from((a[i] < high) & (a[i] <= low));
        }
    }
}

/// Instruction set on which kernels accept the rounding of f32 and never fall back to f64.
#[derive(Clone, Copy, Debug)]
pub struct F32Only<I>(pub I);

impl<I: SimdLevel> SimdLevel for F32Only<I> {
    const IS_EXACT: bool = false;
    const HAS_EIGHT: bool = I::HAS_EIGHT;
    const HAS_SIXTEEN: bool = I::HAS_SIXTEEN;
    type Eight = I::Eight;
    type Sixteen = I::Sixteen;

    #[inline(always)]
    fn eight(self) -> I::Eight {
        self.0.eight()
    }

    #[inline(always)]
    fn sixteen(self) -> I::Sixteen {
        self.0.sixteen()
    }

    #[inline(always)]
    fn prefetch<T>(self, item: &T) {
        self.0.prefetch(item);
    }

    #[inline(always)]
    fn le<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        self.0.le(a, b)
    }

    #[inline(always)]
    fn lt<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        self.0.lt(a, b)
    }

    #[inline(always)]
    fn eq<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        self.0.eq(a, b)
    }

    #[inline(always)]
    fn permute<const N: usize>(self, table: &[f32; N], index: &[u32; 8]) -> [f32; 8] {
        self.0.permute(table, index)
    }

    #[inline(always)]
    fn select_of_four<const N: usize>(self, values: &[f32; 4], index: &[u32; N]) -> [f32; N] {
        self.0.select_of_four(values, index)
    }

    #[inline(always)]
    fn count_below<const N: usize>(
        self,
        a: &[f32; N],
        low: f32,
        high: f32,
        below_high: &mut [i32; N],
        below_both: &mut [i32; N],
    ) {
        self.0.count_below(a, low, high, below_high, below_both);
    }
}

/// Computation that is compiled once for every instruction set.
pub trait SimdKernel {
    /// Result type of the computation.
    type Output;

    /// Runs the computation. It must be `#[inline(always)]`, as must every function it calls that is to use the
    /// instruction set.
    fn run<I: SimdLevel>(self, isa: I) -> Self::Output;
}

/// Instruction sets that kernels are compiled for, in ascending order. Results are the same with each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SimdLimit {
    /// Instructions that every processor of the target has.
    Portable,
    /// AVX2 with FMA and BMI, for registers of eight lanes.
    Avx2,
    /// AVX-512, for registers of sixteen lanes.
    Avx512,
}

impl SimdLimit {
    /// Returns the best set of this machine, within that of Embree's name `isa` if one is given: `avx2`, for example.
    pub fn within(isa: Option<&str>) -> SimdLimit {
        // Choose the form of kernels by the set's name
        let limit = match isa {
            None | Some("avx512") => SimdLimit::Avx512,
            Some("avx2") => SimdLimit::Avx2,
            Some(_) => SimdLimit::Portable,
        };
        // Take no more than the machine has
        limit.min(SimdLimit::best())
    }

    /// Returns the best set of this machine.
    fn best() -> SimdLimit {
        #[cfg(target_arch = "x86_64")]
        {
            if pulp::x86::V4::is_available() {
                return SimdLimit::Avx512;
            }
            if pulp::x86::V3::is_available() {
                return SimdLimit::Avx2;
            }
        }
        SimdLimit::Portable
    }

    /// Returns the set's name in reports.
    pub fn name(self) -> &'static str {
        match self {
            SimdLimit::Portable => "portable",
            SimdLimit::Avx2 => "avx2",
            SimdLimit::Avx512 => "avx512",
        }
    }

    /// Runs `work` with this set at most, and with no more than AVX2.
    #[inline]
    pub fn dispatch<W: SimdKernel>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        if self >= SimdLimit::Avx2
            && let Some(isa) = pulp::x86::V3::try_new()
        {
            return isa.vectorize(x86::DispatchedKernel(isa, work));
        }
        work.run(Scalar)
    }

    /// Runs `work`, which is on sixteen lanes at a time, with this set at most.
    #[inline]
    pub fn dispatch_sixteen<W: SimdKernel>(self, work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        if self >= SimdLimit::Avx512
            && let Some(isa) = pulp::x86::V4::try_new()
        {
            return isa.vectorize(x86::DispatchedKernel(isa, work));
        }
        self.dispatch(work)
    }
}

/// Runs `work` with AVX2 where this machine has it.
#[inline]
pub fn dispatch<W: SimdKernel>(work: W) -> W::Output {
    SimdLimit::Avx2.dispatch(work)
}

/// Runs `work`, which is on sixteen lanes at a time, with AVX-512 or AVX2 where this machine has them.
#[inline]
pub fn dispatch_sixteen<W: SimdKernel>(work: W) -> W::Output {
    SimdLimit::Avx512.dispatch_sixteen(work)
}

/// Returns the indices of the bits set in `mask`, in ascending order.
#[inline(always)]
pub fn lanes(mask: u32) -> MeshLanes {
    MeshLanes(mask)
}

/// Iterator over set bits that [`lanes`] returns.
#[derive(Clone, Copy, Debug)]
pub struct MeshLanes(u32);

impl Iterator for MeshLanes {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let lane = self.0.trailing_zeros() as usize;
        // Clear the lowest set bit
        self.0 &= self.0 - 1;
        Some(lane)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Masks([f32; 16], [f32; 16]);

    impl SimdKernel for Masks {
        type Output = [u32; 3];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [u32; 3] {
            [
                isa.le(&self.0, &self.1),
                isa.lt(&self.0, &self.1),
                isa.eq(&self.0, &self.1),
            ]
        }
    }

    #[test]
    fn comparisons_agree_across_instruction_sets() {
        let mut a = [0.0; 16];
        let mut b = [-0.0; 16];
        a[3] = f32::NAN;
        b[5] = f32::NAN;
        a[9] = 1.0;
        b[14] = f32::INFINITY;
        // Lanes are equal except 3 and 5 (NaN), 9 (greater) and 14 (less).
        let equal = !(1u32 << 3 | 1 << 5 | 1 << 9 | 1 << 14) & 0xffff;
        let expected = [equal | 1 << 14, 1 << 14, equal];
        assert_eq!(Masks(a, b).run(Scalar), expected);
        assert_eq!(dispatch(Masks(a, b)), expected);
    }

    struct Permute([f32; 24], [u32; 8]);

    impl SimdKernel for Permute {
        type Output = [f32; 8];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [f32; 8] {
            isa.permute(&self.0, &self.1)
        }
    }

    #[test]
    fn selections_agree_across_instruction_sets() {
        let table = std::array::from_fn(|i| 100.0 + i as f32);
        for index in [[0, 7, 8, 15, 16, 23, 3, 20], [12; 8]] {
            let expected = index.map(|i| 100.0 + i as f32);
            assert_eq!(Permute(table, index).run(Scalar), expected);
            assert_eq!(dispatch(Permute(table, index)), expected);
        }
    }

    struct SelectOfFour([f32; 4], [u32; 16]);

    impl SimdKernel for SelectOfFour {
        type Output = [f32; 16];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [f32; 16] {
            isa.select_of_four(&self.0, &self.1)
        }
    }

    #[test]
    fn selections_of_four_agree_across_instruction_sets() {
        let index = [0, 1, 2, 3, 3, 2, 1, 0, 2, 2, 0, 3, 1, 1, 0, 3];
        let expected = index.map(|i| 10.0 + i as f32);
        let selection = || SelectOfFour([10.0, 11.0, 12.0, 13.0], index);
        assert_eq!(selection().run(Scalar), expected);
        assert_eq!(dispatch(selection()), expected);
        assert_eq!(dispatch_sixteen(selection()), expected);
    }

    struct CountBelow([f32; 16], f32, f32);

    impl SimdKernel for CountBelow {
        type Output = [[i32; 16]; 2];

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> [[i32; 16]; 2] {
            let mut counts = [[10; 16], [20; 16]];
            let [below_high, below_both] = &mut counts;
            isa.count_below(&self.0, self.1, self.2, below_high, below_both);
            counts
        }
    }

    #[test]
    fn counts_agree_across_instruction_sets() {
        let mut a: [f32; 16] = std::array::from_fn(|i| i as f32);
        a[15] = f32::NAN;
        // The values 0 to 5 are at most 5, 0 to 9 are below 9.5, and NaN is neither.
        let mut expected = [[10; 16], [20; 16]];
        expected[0][..10].fill(11);
        expected[1][..6].fill(21);
        assert_eq!(CountBelow(a, 5.0, 9.5).run(Scalar), expected);
        assert_eq!(dispatch(CountBelow(a, 5.0, 9.5)), expected);
        // A flat primitive in the plane at 4 is not right of it: `<` fails although `<=` holds.
        let mut expected = [[10; 16], [20; 16]];
        expected[0][..4].fill(11);
        expected[1][..4].fill(21);
        assert_eq!(CountBelow(a, 4.0, 4.0).run(Scalar), expected);
        assert_eq!(dispatch(CountBelow(a, 4.0, 4.0)), expected);
    }

    #[test]
    fn set_bits_come_out_in_ascending_order() {
        assert_eq!(lanes(0b1000_0101).collect::<Vec<_>>(), [0, 2, 7]);
        assert_eq!(lanes(0).count(), 0);
    }
}
