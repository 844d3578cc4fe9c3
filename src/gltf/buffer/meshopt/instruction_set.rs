//! Instruction sets that the codec of vertex attributes is compiled for.

use super::byte_plane::{self, CodePlane, GROUP_SIZE, GroupBytes, Widths};
use super::channel::{self, ChannelMode, ChannelValues};

/// What an instruction set has its own code for.
pub(super) trait InstructionSet: Copy {
    /// Unpacks the codes of a group with these header bits, and returns the number of bytes that they take.
    fn unpack_group(
        self,
        bytes: &GroupBytes,
        widths: Widths,
        header_bits: u8,
        group: &mut [u8; GROUP_SIZE],
    ) -> Option<usize>;

    /// Sets the values to those that begin behind `previous` and have the differences of the lowest `count` codes.
    ///
    /// The values behind those are arbitrary.
    fn sum(
        self,
        mode: ChannelMode,
        previous: u32,
        planes: &[CodePlane; 4],
        count: usize,
        values: &mut ChannelValues,
    );
}

/// Instructions that any processor has.
#[derive(Clone, Copy)]
pub(super) struct Portable;

impl InstructionSet for Portable {
    #[inline(always)]
    fn unpack_group(
        self,
        bytes: &GroupBytes,
        widths: Widths,
        header_bits: u8,
        group: &mut [u8; GROUP_SIZE],
    ) -> Option<usize> {
        byte_plane::unpack_group(bytes, widths.bits()[usize::from(header_bits & 3)], group)
    }

    #[inline(always)]
    fn sum(
        self,
        mode: ChannelMode,
        previous: u32,
        planes: &[CodePlane; 4],
        count: usize,
        values: &mut ChannelValues,
    ) {
        channel::sum(mode, previous, planes, count, values)
    }
}

/// Computation that is compiled for each instruction set.
pub(super) trait Computation {
    /// Result of the computation.
    type Output;

    /// Runs the computation. It must be `#[inline(always)]`, as must all functions that are to use the instruction set.
    fn run<I: InstructionSet>(self, instructions: I) -> Self::Output;
}

/// Runs a computation with the best instruction set of this machine.
pub(super) fn run<T: Computation>(computation: T) -> T::Output {
    #[cfg(target_arch = "x86_64")]
    let computation = match super::x86::try_run(computation) {
        Ok(output) => return output,
        Err(computation) => computation,
    };
    computation.run(Portable)
}
