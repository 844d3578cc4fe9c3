//! Eight f32 in a register, with the operators of f32.
//!
//! Most kernels are loops over arrays, which the compiler vectorises. Where the loop is a long chain of comparisons,
//! selections and reductions it does not; such kernels are written with [`Float8`]. No operation fuses a product with a
//! sum, and all levels return identical bits.

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Sub};

use super::Scalar;

/// Operations on registers of eight f32. A mask is a register whose lanes have all bits set or none.
pub trait WideLevel: Copy {
    /// Register of eight f32.
    type Register: Copy;

    /// Returns a register with the values of an array.
    fn load(self, values: &[f32; 8]) -> Self::Register;
    /// Returns the values of a register.
    fn store(self, a: Self::Register) -> [f32; 8];
    /// Returns a register whose lanes are all `value`.
    fn splat(self, value: f32) -> Self::Register;
    /// Returns `a + b`.
    fn add(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns `a - b`.
    fn sub(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns `a * b`.
    fn mul(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns `a / b`.
    fn div(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the smaller lanes; those of `b` where either is NaN or both are zero.
    fn min(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the greater lanes; those of `b` where either is NaN or both are zero.
    fn max(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the bits that are set in both.
    fn and(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the bits that are set in either.
    fn or(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the bits that are set in exactly one.
    fn xor(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the mask of `a <= b`; clear for NaN.
    fn le(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the mask of `a < b`; clear for NaN.
    fn lt(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the mask of `a == b`; clear for NaN.
    fn eq(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the mask of `a < b` for lanes that hold the bits of an i32.
    fn lt_i32(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns the lanes of `yes` where the sign bit of `mask` is set, those of `no` elsewhere.
    fn select(self, mask: Self::Register, yes: Self::Register, no: Self::Register) -> Self::Register;
    /// Returns the sign bits: bit `i` is that of lane `i`.
    fn bits(self, a: Self::Register) -> u32;
    /// Returns the mask whose lane `i` is set where bit `i` is.
    fn mask_of(self, bits: u32) -> Self::Register;
    /// Returns the smallest lane; there must be no NaN.
    fn min_lane(self, a: Self::Register) -> f32;
    /// Returns the greatest lane; there must be no NaN.
    fn max_lane(self, a: Self::Register) -> f32;
    /// Hints that `item` will be read soon.
    fn prefetch<T>(self, item: &T);
}

/// Eight f32 in a register.
#[derive(Clone, Copy)]
pub struct Float8<W: WideLevel> {
    level: W,
    register: W::Register,
}

macro_rules! operator {
    ($Operator:ident, $method:ident, $of_level:ident) => {
        impl<W: WideLevel> $Operator for Float8<W> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(self.level.$of_level(self.register, other.register))
            }
        }
    };
}

operator!(Add, add, add);
operator!(Sub, sub, sub);
operator!(Mul, mul, mul);
operator!(Div, div, div);
operator!(BitAnd, bitand, and);
operator!(BitOr, bitor, or);
operator!(BitXor, bitxor, xor);

impl<W: WideLevel> Float8<W> {
    #[inline(always)]
    fn with(self, register: W::Register) -> Self {
        Float8 { register, ..self }
    }

    /// Returns the values of an array.
    #[inline(always)]
    pub fn load(level: W, values: &[f32; 8]) -> Self {
        let register = level.load(values);
        Float8 { level, register }
    }

    /// Returns eight times the same value.
    #[inline(always)]
    pub fn splat(level: W, value: f32) -> Self {
        let register = level.splat(value);
        Float8 { level, register }
    }

    /// Returns the bits of eight u32 as lanes.
    #[inline(always)]
    pub fn load_u32(level: W, values: &[u32; 8]) -> Self {
        Float8::load(level, bytemuck::cast_ref(values))
    }

    /// Returns the mask whose lane `i` is set where bit `i` is.
    #[inline(always)]
    pub fn mask_of(level: W, bits: u32) -> Self {
        let register = level.mask_of(bits);
        Float8 { level, register }
    }

    /// Returns the values as an array.
    #[inline(always)]
    pub fn to_array(self) -> [f32; 8] {
        self.level.store(self.register)
    }

    /// Returns the bits of the lanes as u32.
    #[inline(always)]
    pub fn to_u32s(self) -> [u32; 8] {
        bytemuck::cast(self.to_array())
    }

    /// Returns the smaller lanes; those of `other` where either is NaN or both are zero.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.with(self.level.min(self.register, other.register))
    }

    /// Returns the greater lanes; those of `other` where either is NaN or both are zero.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        self.with(self.level.max(self.register, other.register))
    }

    /// Returns the magnitudes of the lanes.
    #[inline(always)]
    pub fn abs(self) -> Self {
        self & Float8::splat(self.level, f32::from_bits(0x7fff_ffff))
    }

    /// Returns the sign bits alone.
    #[inline(always)]
    pub fn sign(self) -> Self {
        self & Float8::splat(self.level, -0.0)
    }

    /// Returns the mask of `self <= other`; clear for NaN.
    #[inline(always)]
    pub fn le(self, other: Self) -> Self {
        self.with(self.level.le(self.register, other.register))
    }

    /// Returns the mask of `self < other`; clear for NaN.
    #[inline(always)]
    pub fn lt(self, other: Self) -> Self {
        self.with(self.level.lt(self.register, other.register))
    }

    /// Returns the mask of `self == other`; clear for NaN.
    #[inline(always)]
    pub fn eq(self, other: Self) -> Self {
        self.with(self.level.eq(self.register, other.register))
    }

    /// Returns the mask of `self < other` for lanes that hold the bits of an i32.
    #[inline(always)]
    pub fn lt_i32(self, other: Self) -> Self {
        self.with(self.level.lt_i32(self.register, other.register))
    }

    /// Returns, for a mask, the lanes of `yes` where it is set and those of `no` elsewhere.
    #[inline(always)]
    pub fn select(self, yes: Self, no: Self) -> Self {
        self.with(self.level.select(self.register, yes.register, no.register))
    }

    /// Returns the sign bits: for a mask, bit `i` says whether lane `i` is set.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        self.level.bits(self.register)
    }

    /// Returns the smallest lane; there must be no NaN.
    #[inline(always)]
    pub fn min_lane(self) -> f32 {
        self.level.min_lane(self.register)
    }

    /// Returns the greatest lane; there must be no NaN.
    #[inline(always)]
    pub fn max_lane(self) -> f32 {
        self.level.max_lane(self.register)
    }
}

/// Applies an operation to each lane of two arrays.
macro_rules! each_lane {
    ($a:ident, $b:ident, $value:expr) => {{
        let mut out = [0.0; 8];
        for i in 0..8 {
            let ($a, $b) = ($a[i], $b[i]);
            out[i] = $value;
        }
        out
    }};
}

#[inline(always)]
fn mask_lane(is_set: bool) -> f32 {
    f32::from_bits(if is_set { u32::MAX } else { 0 })
}

#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn greatest(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

// Comparisons and operations on bits are calls: inlined in a kernel they would be thousands of scalar instructions, which
// take minutes to compile.
impl WideLevel for Scalar {
    type Register = [f32; 8];

    #[inline(always)]
    fn load(self, values: &[f32; 8]) -> [f32; 8] {
        *values
    }
    #[inline(always)]
    fn store(self, a: [f32; 8]) -> [f32; 8] {
        a
    }
    #[inline(always)]
    fn splat(self, value: f32) -> [f32; 8] {
        [value; 8]
    }
    #[inline(always)]
    fn add(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, a + b)
    }
    #[inline(always)]
    fn sub(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, a - b)
    }
    #[inline(always)]
    fn mul(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, a * b)
    }
    #[inline(always)]
    fn div(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, a / b)
    }
    #[inline(never)]
    fn min(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, least(a, b))
    }
    #[inline(never)]
    fn max(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, greatest(a, b))
    }
    #[inline(never)]
    fn and(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, f32::from_bits(a.to_bits() & b.to_bits()))
    }
    #[inline(never)]
    fn or(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, f32::from_bits(a.to_bits() | b.to_bits()))
    }
    #[inline(never)]
    fn xor(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, f32::from_bits(a.to_bits() ^ b.to_bits()))
    }
    #[inline(never)]
    fn le(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, mask_lane(a <= b))
    }
    #[inline(never)]
    fn lt(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, mask_lane(a < b))
    }
    #[inline(never)]
    fn eq(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, mask_lane(a == b))
    }
    #[inline(never)]
    fn lt_i32(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, mask_lane((a.to_bits() as i32) < b.to_bits() as i32))
    }
    #[inline(never)]
    fn select(self, mask: [f32; 8], yes: [f32; 8], no: [f32; 8]) -> [f32; 8] {
        let mut out = no;
        for i in 0..8 {
            out[i] = if mask[i].is_sign_negative() { yes[i] } else { no[i] };
        }
        out
    }
    #[inline(never)]
    fn bits(self, a: [f32; 8]) -> u32 {
        let mut bits = 0;
        for i in 0..8 {
            bits |= (a[i].to_bits() >> 31) << i;
        }
        bits
    }
    #[inline(never)]
    fn mask_of(self, bits: u32) -> [f32; 8] {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = mask_lane(bits >> i & 1 != 0);
        }
        out
    }
    #[inline(never)]
    fn min_lane(self, a: [f32; 8]) -> f32 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| least(a[i], a[i + 4]));
        least(least(a, c), least(b, d))
    }
    #[inline(never)]
    fn max_lane(self, a: [f32; 8]) -> f32 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| greatest(a[i], a[i + 4]));
        greatest(greatest(a, c), greatest(b, d))
    }
    #[inline(always)]
    fn prefetch<T>(self, _item: &T) {}
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{__m256, _CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _MM_HINT_T0};

    use bytemuck::cast;
    use pulp::x86::V3;

    use super::WideLevel;

    /// Size of a cache line in bytes.
    const LINE: usize = 64;

    impl WideLevel for V3 {
        type Register = __m256;

        #[inline(always)]
        fn load(self, values: &[f32; 8]) -> __m256 {
            cast(*values)
        }
        #[inline(always)]
        fn store(self, a: __m256) -> [f32; 8] {
            cast(a)
        }
        #[inline(always)]
        fn splat(self, value: f32) -> __m256 {
            self.avx._mm256_set1_ps(value)
        }
        #[inline(always)]
        fn add(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_add_ps(a, b)
        }
        #[inline(always)]
        fn sub(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_sub_ps(a, b)
        }
        #[inline(always)]
        fn mul(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_mul_ps(a, b)
        }
        #[inline(always)]
        fn div(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_div_ps(a, b)
        }
        #[inline(always)]
        fn min(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_min_ps(a, b)
        }
        #[inline(always)]
        fn max(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_max_ps(a, b)
        }
        #[inline(always)]
        fn and(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_and_ps(a, b)
        }
        #[inline(always)]
        fn or(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_or_ps(a, b)
        }
        #[inline(always)]
        fn xor(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_xor_ps(a, b)
        }
        #[inline(always)]
        fn le(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_cmp_ps::<_CMP_LE_OQ>(a, b)
        }
        #[inline(always)]
        fn lt(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_cmp_ps::<_CMP_LT_OQ>(a, b)
        }
        #[inline(always)]
        fn eq(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_cmp_ps::<_CMP_EQ_OQ>(a, b)
        }
        #[inline(always)]
        fn lt_i32(self, a: __m256, b: __m256) -> __m256 {
            cast(self.avx2._mm256_cmpgt_epi32(cast(b), cast(a)))
        }
        #[inline(always)]
        fn select(self, mask: __m256, yes: __m256, no: __m256) -> __m256 {
            self.avx._mm256_blendv_ps(no, yes, mask)
        }
        #[inline(always)]
        fn bits(self, a: __m256) -> u32 {
            self.avx._mm256_movemask_ps(a) as u32
        }
        #[inline(always)]
        fn mask_of(self, bits: u32) -> __m256 {
            let each = cast([1, 2, 4, 8, 16, 32, 64, 128]);
            let own = self
                .avx2
                ._mm256_and_si256(self.avx._mm256_set1_epi32(bits as i32), each);
            cast(self.avx2._mm256_cmpeq_epi32(own, each))
        }
        #[inline(always)]
        fn min_lane(self, a: __m256) -> f32 {
            let (low, high) = (
                self.avx._mm256_castps256_ps128(a),
                self.avx._mm256_extractf128_ps::<1>(a),
            );
            let four = self.sse._mm_min_ps(low, high);
            let two = self.sse._mm_min_ps(four, self.sse._mm_movehl_ps(four, four));
            let one = self.sse._mm_min_ss(two, self.sse._mm_shuffle_ps::<1>(two, two));
            self.sse._mm_cvtss_f32(one)
        }
        #[inline(always)]
        fn max_lane(self, a: __m256) -> f32 {
            let (low, high) = (
                self.avx._mm256_castps256_ps128(a),
                self.avx._mm256_extractf128_ps::<1>(a),
            );
            let four = self.sse._mm_max_ps(low, high);
            let two = self.sse._mm_max_ps(four, self.sse._mm_movehl_ps(four, four));
            let one = self.sse._mm_max_ss(two, self.sse._mm_shuffle_ps::<1>(two, two));
            self.sse._mm_cvtss_f32(one)
        }
        #[inline(always)]
        fn prefetch<T>(self, item: &T) {
            let start: *const i8 = std::ptr::from_ref(item).cast();
            for line in 0..size_of::<T>().div_ceil(LINE) {
                self.sse
                    ._mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(line * LINE));
            }
        }
    }
}
