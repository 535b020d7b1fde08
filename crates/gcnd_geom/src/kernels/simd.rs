//! What the kernels share of run-time SIMD: dispatch, multiply-add and aligned scratch memory.

use std::any::TypeId;

use bytemuck::{Pod, Zeroable};
use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Runs an operation with the widest vectors of the processor, four lanes at least.
#[inline]
pub(super) fn dispatch<Op: WithSimd>(arch: Arch, operation: Op) -> Op::Output {
    match arch {
        // Four lanes in an array, which the compiler maps to the baseline's registers.
        Arch::Scalar => operation.with_simd(Scalar128b),
        detected => detected.dispatch(operation),
    }
}

/// Returns a · b + c, fused where the processor has an instruction for it.
#[inline(always)]
pub(super) fn mul_add<S: Simd>(simd: S, a: S::f32s, b: S::f32s, c: S::f32s) -> S::f32s {
    if TypeId::of::<S>() == TypeId::of::<Scalar128b>() {
        // Without the instruction, a fused multiply-add is a library call per lane.
        simd.add_f32s(simd.mul_f32s(a, b), c)
    } else {
        simd.mul_add_e_f32s(a, b, c)
    }
}

/// Floats in one cache line.
const LINE: usize = 16;

/// One cache line of floats.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
struct Line([f32; LINE]);

/// A buffer of floats that starts on a cache line, so that no vector straddles two.
pub(super) struct AlignedBuffer(Vec<Line>);

impl AlignedBuffer {
    /// A buffer of at least `len` zeros.
    pub(super) fn zeros(len: usize) -> Self {
        Self(vec![Line([0.0; LINE]); len.div_ceil(LINE)])
    }

    /// The floats.
    #[inline(always)]
    pub(super) fn floats(&self) -> &[f32] {
        bytemuck::cast_slice(&self.0)
    }

    /// The floats, to be written.
    #[inline(always)]
    pub(super) fn floats_mut(&mut self) -> &mut [f32] {
        bytemuck::cast_slice_mut(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Fma;

    impl WithSimd for Fma {
        type Output = (usize, f32);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let sum = mul_add(simd, simd.splat_f32s(3.0), simd.splat_f32s(5.0), simd.splat_f32s(-1.0));
            (S::F32_LANES, simd.reduce_max_f32s(sum))
        }
    }

    #[test]
    fn every_width_multiplies_and_adds() {
        assert_eq!(dispatch(Arch::Scalar, Fma), (4, 14.0));
        let (lanes, sum) = dispatch(Arch::new(), Fma);
        assert!(lanes >= 4 && sum == 14.0);
    }

    #[test]
    fn buffers_start_on_a_cache_line() {
        let buffer = AlignedBuffer::zeros(17);
        assert_eq!((buffer.floats().len(), buffer.floats().as_ptr().align_offset(64)), (32, 0));
    }
}
