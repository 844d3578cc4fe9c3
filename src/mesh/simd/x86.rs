//! Operations of kernels by AVX2 and AVX-512.

use std::arch::x86_64::{_CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _MM_HINT_T0};

use bytemuck::cast;
use pulp::x86::{V3, V4};

use super::{RegisterPair, SimdLevel};

/// Size of a cache line in bytes.
const LINE: usize = 64;

/// Computation with the instruction set that it is to be compiled for.
pub(super) struct DispatchedKernel<I, W>(pub(super) I, pub(super) W);

impl<I: SimdLevel, W: super::SimdKernel> pulp::NullaryFnOnce for DispatchedKernel<I, W> {
    type Output = W::Output;

    #[inline(always)]
    fn call(self) -> W::Output {
        self.1.run(self.0)
    }
}

/// Compares eight lanes at a time; `N` must be a multiple of eight.
#[inline(always)]
fn compare<const OP: i32, const N: usize>(isa: V3, a: &[f32; N], b: &[f32; N]) -> u32 {
    let (a, _) = a.as_chunks::<8>();
    let (b, _) = b.as_chunks::<8>();
    let mut mask = 0;
    for i in 0..N / 8 {
        let outcome = isa.avx._mm256_cmp_ps::<OP>(cast(a[i]), cast(b[i]));
        mask |= (isa.avx._mm256_movemask_ps(outcome) as u32) << (8 * i);
    }
    mask
}

impl SimdLevel for V3 {
    const HAS_EIGHT: bool = true;
    type Eight = V3;
    type Sixteen = RegisterPair<V3>;

    #[inline(always)]
    fn eight(self) -> V3 {
        self
    }

    #[inline(always)]
    fn sixteen(self) -> RegisterPair<V3> {
        RegisterPair(self)
    }

    #[inline(always)]
    fn prefetch<T>(self, item: &T) {
        let start: *const i8 = std::ptr::from_ref(item).cast();
        for line in 0..size_of::<T>().div_ceil(LINE) {
            self.sse
                ._mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(line * LINE));
        }
    }

    #[inline(always)]
    fn le<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare::<_CMP_LE_OQ, N>(self, a, b)
    }

    #[inline(always)]
    fn lt<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare::<_CMP_LT_OQ, N>(self, a, b)
    }

    #[inline(always)]
    fn eq<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare::<_CMP_EQ_OQ, N>(self, a, b)
    }

    /// Permutes each eight entries of the table by the low three bits of the index, and blends in the group that
    /// the high bits select.
    #[inline(always)]
    fn permute<const N: usize>(self, table: &[f32; N], index: &[u32; 8]) -> [f32; 8] {
        let (parts, _) = table.as_chunks::<8>();
        let index = cast(*index);
        let mut permuted = self.avx._mm256_setzero_ps();
        for part in 0..N / 8 {
            let here = self.avx2._mm256_permutevar8x32_ps(cast(parts[part]), index);
            permuted = match part {
                0 => here,
                // Keep the lanes whose index lies in an earlier group
                _ => {
                    let last_before = self.avx._mm256_set1_epi32(8 * part as i32 - 1);
                    let is_from_here = self.avx2._mm256_cmpgt_epi32(index, last_before);
                    self.avx._mm256_blendv_ps(permuted, here, cast(is_from_here))
                }
            };
        }
        cast(permuted)
    }

    /// Selects in eight lanes at a time; `N` must be a multiple of eight.
    #[inline(always)]
    fn select_of_four<const N: usize>(self, values: &[f32; 4], index: &[u32; N]) -> [f32; N] {
        // Repeat the values in both halves of a register
        let [a, b, c, d] = *values;
        let values = cast([a, b, c, d, a, b, c, d]);
        let mut out = [0.0; N];
        let (parts, _) = out.as_chunks_mut::<8>();
        let (index, _) = index.as_chunks::<8>();
        for i in 0..N / 8 {
            parts[i] = cast(self.avx._mm256_permutevar_ps(values, cast(index[i])));
        }
        out
    }

    /// Compares eight lanes at a time; `N` must be a multiple of eight.
    #[inline(always)]
    fn count_below<const N: usize>(
        self,
        a: &[f32; N],
        low: f32,
        high: f32,
        below_high: &mut [i32; N],
        below_both: &mut [i32; N],
    ) {
        let (a, _) = a.as_chunks::<8>();
        let (below_high, _) = below_high.as_chunks_mut::<8>();
        let (below_both, _) = below_both.as_chunks_mut::<8>();
        let low = self.avx._mm256_set1_ps(low);
        let high = self.avx._mm256_set1_ps(high);
        // A true comparison is the integer -1 in its lane, so subtracting it counts up.
        for i in 0..N / 8 {
            let is_below_high = self.avx._mm256_cmp_ps::<_CMP_LT_OQ>(cast(a[i]), high);
            let is_below_low = self.avx._mm256_cmp_ps::<_CMP_LE_OQ>(cast(a[i]), low);
            let is_below_both = self.avx._mm256_and_ps(is_below_high, is_below_low);
            below_high[i] = cast(
                self.avx2
                    ._mm256_sub_epi32(cast(below_high[i]), cast(is_below_high)),
            );
            below_both[i] = cast(
                self.avx2
                    ._mm256_sub_epi32(cast(below_both[i]), cast(is_below_both)),
            );
        }
    }
}

/// Compares sixteen lanes at a time, or eight if `N` is only a multiple of eight.
#[inline(always)]
fn compare_sixteen<const OP: i32, const N: usize>(isa: V4, a: &[f32; N], b: &[f32; N]) -> u32 {
    if !N.is_multiple_of(16) {
        return compare::<OP, N>(*isa, a, b);
    }
    let (a, _) = a.as_chunks::<16>();
    let (b, _) = b.as_chunks::<16>();
    let mut mask = 0;
    for i in 0..N / 16 {
        let outcome = isa.avx512f._mm512_cmp_ps_mask::<OP>(cast(a[i]), cast(b[i]));
        mask |= u32::from(outcome) << (16 * i);
    }
    mask
}

impl SimdLevel for V4 {
    const HAS_EIGHT: bool = true;
    const HAS_SIXTEEN: bool = true;
    type Eight = V3;
    type Sixteen = V4;

    #[inline(always)]
    fn eight(self) -> V3 {
        *self
    }

    #[inline(always)]
    fn sixteen(self) -> V4 {
        self
    }

    #[inline(always)]
    fn prefetch<T>(self, item: &T) {
        (*self).prefetch(item);
    }

    #[inline(always)]
    fn le<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare_sixteen::<_CMP_LE_OQ, N>(self, a, b)
    }

    #[inline(always)]
    fn lt<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare_sixteen::<_CMP_LT_OQ, N>(self, a, b)
    }

    #[inline(always)]
    fn eq<const N: usize>(self, a: &[f32; N], b: &[f32; N]) -> u32 {
        compare_sixteen::<_CMP_EQ_OQ, N>(self, a, b)
    }

    #[inline(always)]
    fn permute<const N: usize>(self, table: &[f32; N], index: &[u32; 8]) -> [f32; 8] {
        (*self).permute(table, index)
    }

    /// Selects in sixteen lanes at a time, or in eight if `N` is only a multiple of eight.
    #[inline(always)]
    fn select_of_four<const N: usize>(self, values: &[f32; 4], index: &[u32; N]) -> [f32; N] {
        if !N.is_multiple_of(16) {
            return (*self).select_of_four(values, index);
        }
        // Repeat the values in all quarters of a register
        let values = cast([*values; 4]);
        let mut out = [0.0; N];
        let (parts, _) = out.as_chunks_mut::<16>();
        let (index, _) = index.as_chunks::<16>();
        for i in 0..N / 16 {
            parts[i] = cast(self.avx512f._mm512_permutevar_ps(values, cast(index[i])));
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
        (*self).count_below(a, low, high, below_high, below_both);
    }
}
