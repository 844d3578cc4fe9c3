//! Registers of AVX2 and AVX-512.

use std::arch::x86_64::{__m128, __m256, __m512, __mmask16, _CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ};

use bytemuck::cast;
use pulp::x86::{V3, V4};

use super::WideLevel;

/// Defines methods of two operands, each by one instruction.
macro_rules! instructions {
    ($Operand:ty => $Result:ty {
        $($method:ident: $set:ident.$instruction:ident $(::<$operation:ident>)?,)*
    }) => {$(
        #[inline(always)]
        fn $method(self, a: $Operand, b: $Operand) -> $Result {
            self.$set.$instruction$(::<$operation>)?(a, b)
        }
    )*};
}

impl WideLevel<8> for V3 {
    type Register = __m256;
    type Mask = __m256;

    instructions! { __m256 => __m256 {
        add: avx._mm256_add_ps,
        sub: avx._mm256_sub_ps,
        mul: avx._mm256_mul_ps,
        div: avx._mm256_div_ps,
        min: avx._mm256_min_ps,
        max: avx._mm256_max_ps,
        and: avx._mm256_and_ps,
        xor: avx._mm256_xor_ps,
        le: avx._mm256_cmp_ps::<_CMP_LE_OQ>,
        lt: avx._mm256_cmp_ps::<_CMP_LT_OQ>,
        eq: avx._mm256_cmp_ps::<_CMP_EQ_OQ>,
        both: avx._mm256_and_ps,
        either: avx._mm256_or_ps,
    } }

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
    fn lt_i32(self, a: __m256, b: __m256) -> __m256 {
        cast(self.avx2._mm256_cmpgt_epi32(cast(b), cast(a)))
    }
    #[inline(always)]
    fn eq_bits(self, a: __m256, b: __m256) -> __m256 {
        cast(self.avx2._mm256_cmpeq_epi32(cast(a), cast(b)))
    }
    #[inline(always)]
    fn select(self, mask: __m256, yes: __m256, no: __m256) -> __m256 {
        self.avx._mm256_blendv_ps(no, yes, mask)
    }
    #[inline(always)]
    fn bits(self, mask: __m256) -> u32 {
        self.signs(mask)
    }
    #[inline(always)]
    fn signs(self, a: __m256) -> u32 {
        self.avx._mm256_movemask_ps(a) as u32
    }
    #[inline(always)]
    fn mask_of(self, bits: u32) -> __m256 {
        // Keep the bit of each lane, then compare it with the bit that would be set
        let each = cast([1, 2, 4, 8, 16, 32, 64, 128]);
        let own = self
            .avx2
            ._mm256_and_si256(self.avx._mm256_set1_epi32(bits as i32), each);
        cast(self.avx2._mm256_cmpeq_epi32(own, each))
    }
    #[inline(always)]
    fn min_lane(self, a: __m256) -> f32 {
        // Halve the number of lanes three times
        let [low, high]: [__m128; 2] = cast(a);
        let four = self.sse._mm_min_ps(low, high);
        let two = self.sse._mm_min_ps(four, self.sse._mm_movehl_ps(four, four));
        let one = self.sse._mm_min_ss(two, self.sse._mm_shuffle_ps::<1>(two, two));
        self.sse._mm_cvtss_f32(one)
    }
    #[inline(always)]
    fn max_lane(self, a: __m256) -> f32 {
        // Halve the number of lanes three times
        let [low, high]: [__m128; 2] = cast(a);
        let four = self.sse._mm_max_ps(low, high);
        let two = self.sse._mm_max_ps(four, self.sse._mm_movehl_ps(four, four));
        let one = self.sse._mm_max_ss(two, self.sse._mm_shuffle_ps::<1>(two, two));
        self.sse._mm_cvtss_f32(one)
    }
}

impl WideLevel<16> for V4 {
    type Register = __m512;
    type Mask = __mmask16;

    instructions! { __m512 => __m512 {
        add: avx512f._mm512_add_ps,
        sub: avx512f._mm512_sub_ps,
        mul: avx512f._mm512_mul_ps,
        div: avx512f._mm512_div_ps,
        min: avx512f._mm512_min_ps,
        max: avx512f._mm512_max_ps,
        and: avx512dq._mm512_and_ps,
        xor: avx512dq._mm512_xor_ps,
    } }

    instructions! { __m512 => __mmask16 {
        le: avx512f._mm512_cmp_ps_mask::<_CMP_LE_OQ>,
        lt: avx512f._mm512_cmp_ps_mask::<_CMP_LT_OQ>,
        eq: avx512f._mm512_cmp_ps_mask::<_CMP_EQ_OQ>,
    } }

    #[inline(always)]
    fn load(self, values: &[f32; 16]) -> __m512 {
        cast(*values)
    }
    #[inline(always)]
    fn store(self, a: __m512) -> [f32; 16] {
        cast(a)
    }
    #[inline(always)]
    fn splat(self, value: f32) -> __m512 {
        self.avx512f._mm512_set1_ps(value)
    }
    #[inline(always)]
    fn lt_i32(self, a: __m512, b: __m512) -> __mmask16 {
        self.avx512f._mm512_cmplt_epi32_mask(cast(a), cast(b))
    }
    #[inline(always)]
    fn eq_bits(self, a: __m512, b: __m512) -> __mmask16 {
        self.avx512f._mm512_cmpeq_epi32_mask(cast(a), cast(b))
    }
    #[inline(always)]
    fn both(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }
    #[inline(always)]
    fn either(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a | b
    }
    #[inline(always)]
    fn select(self, mask: __mmask16, yes: __m512, no: __m512) -> __m512 {
        self.avx512f._mm512_mask_blend_ps(mask, no, yes)
    }
    #[inline(always)]
    fn bits(self, mask: __mmask16) -> u32 {
        u32::from(mask)
    }
    #[inline(always)]
    fn signs(self, a: __m512) -> u32 {
        u32::from(self.avx512dq._mm512_movepi32_mask(cast(a)))
    }
    #[inline(always)]
    fn mask_of(self, bits: u32) -> __mmask16 {
        bits as __mmask16
    }
    #[inline(always)]
    fn min_lane(self, a: __m512) -> f32 {
        // Continue with eight lanes, in the order of registers in pairs
        let [low, high]: [__m256; 2] = cast(a);
        WideLevel::<8>::min_lane(*self, self.avx._mm256_min_ps(low, high))
    }
    #[inline(always)]
    fn max_lane(self, a: __m512) -> f32 {
        // Continue with eight lanes, in the order of registers in pairs
        let [low, high]: [__m256; 2] = cast(a);
        WideLevel::<8>::max_lane(*self, self.avx._mm256_max_ps(low, high))
    }
}
