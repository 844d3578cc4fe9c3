//! Eight or sixteen f32 in a register, with the operators of f32.
//!
//! Most kernels are loops over arrays, which the compiler vectorises. Where the loop is a long chain of comparisons,
//! selections and reductions it does not; such kernels are written with [`Floats`]. No operation fuses a product with a
//! sum, and all levels return identical bits.

#[cfg(target_arch = "x86_64")]
mod x86;

use std::ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Sub};

use super::Scalar;

/// Operations on registers of `N` f32.
pub trait WideLevel<const N: usize>: Copy {
    /// Register of `N` f32.
    type Register: Copy;
    /// Truth value of each lane.
    type Mask: Copy;

    /// Returns a register with the values of an array.
    fn load(self, values: &[f32; N]) -> Self::Register;
    /// Returns the values of a register.
    fn store(self, a: Self::Register) -> [f32; N];
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
    /// Returns the bits that are set in exactly one.
    fn xor(self, a: Self::Register, b: Self::Register) -> Self::Register;
    /// Returns whether `a <= b`; false for NaN.
    fn le(self, a: Self::Register, b: Self::Register) -> Self::Mask;
    /// Returns whether `a < b`; false for NaN.
    fn lt(self, a: Self::Register, b: Self::Register) -> Self::Mask;
    /// Returns whether `a == b`; false for NaN.
    fn eq(self, a: Self::Register, b: Self::Register) -> Self::Mask;
    /// Returns whether `a < b` for lanes that hold the bits of an i32.
    fn lt_i32(self, a: Self::Register, b: Self::Register) -> Self::Mask;
    /// Returns whether the bits of `a` and `b` are the same.
    fn eq_bits(self, a: Self::Register, b: Self::Register) -> Self::Mask;
    /// Returns whether both are true.
    fn both(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Returns whether at least one is true.
    fn either(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Returns the lanes of `yes` where the mask is true, those of `no` elsewhere.
    fn select(self, mask: Self::Mask, yes: Self::Register, no: Self::Register) -> Self::Register;
    /// Returns the truth values: bit `i` is that of lane `i`.
    fn bits(self, mask: Self::Mask) -> u32;
    /// Returns the mask whose lane `i` is true where bit `i` is set.
    fn mask_of(self, bits: u32) -> Self::Mask;
    /// Returns the sign bits: bit `i` is that of lane `i`.
    fn signs(self, a: Self::Register) -> u32;
    /// Returns the smallest lane; there must be no NaN.
    fn min_lane(self, a: Self::Register) -> f32;
    /// Returns the greatest lane; there must be no NaN.
    fn max_lane(self, a: Self::Register) -> f32;
}

/// Several f32 in a register.
#[derive(Clone, Copy)]
pub struct Floats<W: WideLevel<N>, const N: usize> {
    level: W,
    register: W::Register,
}

/// Truth values of the lanes of [`Floats`].
#[derive(Clone, Copy)]
pub struct LaneMask<W: WideLevel<N>, const N: usize> {
    level: W,
    mask: W::Mask,
}

macro_rules! operator {
    ($Operator:ident, $method:ident, $of_level:ident) => {
        impl<W: WideLevel<N>, const N: usize> $Operator for Floats<W, N> {
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
operator!(BitXor, bitxor, xor);

impl<W: WideLevel<N>, const N: usize> BitAnd for LaneMask<W, N> {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        self.with(self.level.both(self.mask, other.mask))
    }
}

impl<W: WideLevel<N>, const N: usize> BitOr for LaneMask<W, N> {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        self.with(self.level.either(self.mask, other.mask))
    }
}

impl<W: WideLevel<N>, const N: usize> LaneMask<W, N> {
    #[inline(always)]
    fn with(self, mask: W::Mask) -> Self {
        LaneMask { mask, ..self }
    }

    /// Returns the mask whose lane `i` is true where bit `i` is set.
    #[inline(always)]
    pub fn of_bits(level: W, bits: u32) -> Self {
        let mask = level.mask_of(bits);
        LaneMask { level, mask }
    }

    /// Returns the truth values: bit `i` is that of lane `i`.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        self.level.bits(self.mask)
    }

    /// Returns the lanes of `yes` where the mask is true, those of `no` elsewhere.
    #[inline(always)]
    pub fn select(self, yes: Floats<W, N>, no: Floats<W, N>) -> Floats<W, N> {
        yes.with(self.level.select(self.mask, yes.register, no.register))
    }
}

impl<W: WideLevel<N>, const N: usize> Floats<W, N> {
    #[inline(always)]
    fn with(self, register: W::Register) -> Self {
        Floats { register, ..self }
    }

    #[inline(always)]
    fn mask(self, mask: W::Mask) -> LaneMask<W, N> {
        let level = self.level;
        LaneMask { level, mask }
    }

    /// Returns the level of the register.
    #[inline(always)]
    pub fn level(self) -> W {
        self.level
    }

    /// Returns the values of an array.
    #[inline(always)]
    pub fn load(level: W, values: &[f32; N]) -> Self {
        let register = level.load(values);
        Floats { level, register }
    }

    /// Returns the same value in all lanes.
    #[inline(always)]
    pub fn splat(level: W, value: f32) -> Self {
        let register = level.splat(value);
        Floats { level, register }
    }

    /// Returns the values as an array.
    #[inline(always)]
    pub fn to_array(self) -> [f32; N] {
        self.level.store(self.register)
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
        let magnitude = self.level.splat(f32::from_bits(0x7fff_ffff));
        self.with(self.level.and(self.register, magnitude))
    }

    /// Returns the sign bits alone.
    #[inline(always)]
    pub fn sign(self) -> Self {
        self.with(self.level.and(self.register, self.level.splat(-0.0)))
    }

    /// Returns the sign bits: bit `i` is that of lane `i`.
    #[inline(always)]
    pub fn signs(self) -> u32 {
        self.level.signs(self.register)
    }

    /// Returns whether `self <= other`; false for NaN.
    #[inline(always)]
    pub fn le(self, other: Self) -> LaneMask<W, N> {
        self.mask(self.level.le(self.register, other.register))
    }

    /// Returns whether `self < other`; false for NaN.
    #[inline(always)]
    pub fn lt(self, other: Self) -> LaneMask<W, N> {
        self.mask(self.level.lt(self.register, other.register))
    }

    /// Returns whether `self == other`; false for NaN.
    #[inline(always)]
    pub fn eq(self, other: Self) -> LaneMask<W, N> {
        self.mask(self.level.eq(self.register, other.register))
    }

    /// Returns whether `self < other` for lanes that hold the bits of an i32.
    #[inline(always)]
    pub fn lt_i32(self, other: Self) -> LaneMask<W, N> {
        self.mask(self.level.lt_i32(self.register, other.register))
    }

    /// Returns whether the bits of both are the same.
    #[inline(always)]
    pub fn eq_bits(self, other: Self) -> LaneMask<W, N> {
        self.mask(self.level.eq_bits(self.register, other.register))
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

/// Compares each lane of two arrays.
macro_rules! compare_lanes {
    ($a:ident, $b:ident, $value:expr) => {{
        let mut out = [false; 8];
        for i in 0..8 {
            let ($a, $b) = ($a[i], $b[i]);
            out[i] = $value;
        }
        out
    }};
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
impl WideLevel<8> for Scalar {
    type Register = [f32; 8];
    type Mask = [bool; 8];

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
    fn xor(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        each_lane!(a, b, f32::from_bits(a.to_bits() ^ b.to_bits()))
    }
    #[inline(never)]
    fn le(self, a: [f32; 8], b: [f32; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a <= b)
    }
    #[inline(never)]
    fn lt(self, a: [f32; 8], b: [f32; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a < b)
    }
    #[inline(never)]
    fn eq(self, a: [f32; 8], b: [f32; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a == b)
    }
    #[inline(never)]
    fn lt_i32(self, a: [f32; 8], b: [f32; 8]) -> [bool; 8] {
        compare_lanes!(a, b, (a.to_bits() as i32) < b.to_bits() as i32)
    }
    #[inline(never)]
    fn eq_bits(self, a: [f32; 8], b: [f32; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a.to_bits() == b.to_bits())
    }
    #[inline(never)]
    fn both(self, a: [bool; 8], b: [bool; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a & b)
    }
    #[inline(never)]
    fn either(self, a: [bool; 8], b: [bool; 8]) -> [bool; 8] {
        compare_lanes!(a, b, a | b)
    }
    #[inline(never)]
    fn select(self, mask: [bool; 8], yes: [f32; 8], no: [f32; 8]) -> [f32; 8] {
        let mut out = no;
        for i in 0..8 {
            out[i] = if mask[i] { yes[i] } else { no[i] };
        }
        out
    }
    #[inline(never)]
    fn bits(self, mask: [bool; 8]) -> u32 {
        let mut bits = 0;
        for i in 0..8 {
            bits |= u32::from(mask[i]) << i;
        }
        bits
    }
    #[inline(never)]
    fn mask_of(self, bits: u32) -> [bool; 8] {
        let mut out = [false; 8];
        for i in 0..8 {
            out[i] = bits >> i & 1 != 0;
        }
        out
    }
    #[inline(never)]
    fn signs(self, a: [f32; 8]) -> u32 {
        let mut bits = 0;
        for i in 0..8 {
            bits |= (a[i].to_bits() >> 31) << i;
        }
        bits
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
}

/// Registers of sixteen f32 as two of eight.
#[derive(Clone, Copy, Debug)]
pub struct RegisterPair<W>(pub W);

/// Applies an operation of the level to both halves of two registers or masks.
macro_rules! each_half {
    ($($method:ident: $Operand:ident -> $Result:ident),* $(,)?) => {$(
        #[inline(always)]
        fn $method(self, a: [W::$Operand; 2], b: [W::$Operand; 2]) -> [W::$Result; 2] {
            [self.0.$method(a[0], b[0]), self.0.$method(a[1], b[1])]
        }
    )*};
}

impl<W: WideLevel<8>> WideLevel<16> for RegisterPair<W> {
    type Register = [W::Register; 2];
    type Mask = [W::Mask; 2];

    each_half! {
        add: Register -> Register,
        sub: Register -> Register,
        mul: Register -> Register,
        div: Register -> Register,
        min: Register -> Register,
        max: Register -> Register,
        and: Register -> Register,
        xor: Register -> Register,
        le: Register -> Mask,
        lt: Register -> Mask,
        eq: Register -> Mask,
        lt_i32: Register -> Mask,
        eq_bits: Register -> Mask,
        both: Mask -> Mask,
        either: Mask -> Mask,
    }

    #[inline(always)]
    fn load(self, values: &[f32; 16]) -> [W::Register; 2] {
        let [low, high]: &[[f32; 8]; 2] = bytemuck::cast_ref(values);
        [self.0.load(low), self.0.load(high)]
    }
    #[inline(always)]
    fn store(self, a: [W::Register; 2]) -> [f32; 16] {
        bytemuck::cast([self.0.store(a[0]), self.0.store(a[1])])
    }
    #[inline(always)]
    fn splat(self, value: f32) -> [W::Register; 2] {
        [self.0.splat(value); 2]
    }
    #[inline(always)]
    fn select(self, mask: [W::Mask; 2], yes: [W::Register; 2], no: [W::Register; 2]) -> [W::Register; 2] {
        [
            self.0.select(mask[0], yes[0], no[0]),
            self.0.select(mask[1], yes[1], no[1]),
        ]
    }
    #[inline(always)]
    fn bits(self, mask: [W::Mask; 2]) -> u32 {
        self.0.bits(mask[0]) | self.0.bits(mask[1]) << 8
    }
    #[inline(always)]
    fn mask_of(self, bits: u32) -> [W::Mask; 2] {
        [self.0.mask_of(bits), self.0.mask_of(bits >> 8)]
    }
    #[inline(always)]
    fn signs(self, a: [W::Register; 2]) -> u32 {
        self.0.signs(a[0]) | self.0.signs(a[1]) << 8
    }
    #[inline(always)]
    fn min_lane(self, a: [W::Register; 2]) -> f32 {
        self.0.min_lane(self.0.min(a[0], a[1]))
    }
    #[inline(always)]
    fn max_lane(self, a: [W::Register; 2]) -> f32 {
        self.0.max_lane(self.0.max(a[0], a[1]))
    }
}
