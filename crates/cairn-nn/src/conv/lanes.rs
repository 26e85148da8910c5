//! Eight floats at a time: the one place that names vector instructions.
//!
//! With AVX2 and FMA compiled in (the workspace's floor on x86-64) the lanes
//! are one register; elsewhere they are a plain array that gives the same
//! numbers, since every lane is the same chain of fused multiply-adds.

/// Numbers a [`Lanes`] holds.
pub(crate) const LANES: usize = 8;

#[cfg(all(target_arch = "x86_64", target_feature = "avx2", target_feature = "fma"))]
mod imp {
    use std::arch::x86_64::{__m256, _mm256_fmadd_ps, _mm256_set1_ps};

    /// Eight floats.
    #[derive(Clone, Copy)]
    pub(crate) struct Lanes(__m256);

    /// A register's worth of memory. Read as such and not by `_mm256_loadu_ps`,
    /// whose overlap check in builds with debug assertions costs half the speed.
    #[derive(Clone, Copy)]
    #[repr(C, packed)]
    struct Unaligned(__m256);

    impl Lanes {
        /// All lanes `v`.
        #[inline(always)]
        pub(crate) fn splat(v: f32) -> Self {
            // SAFETY: this module is only compiled where AVX2 and FMA are target features.
            Self(unsafe { _mm256_set1_ps(v) })
        }

        /// Eight neighbours from `from`.
        ///
        /// # Safety
        /// `from` must be valid for reading eight floats; it need not be aligned.
        #[inline(always)]
        pub(crate) unsafe fn load(from: *const f32) -> Self {
            // SAFETY: as promised by the caller; the type asks for no alignment.
            Self(unsafe { (*from.cast::<Unaligned>()).0 })
        }

        /// Writes the eight to `to`.
        ///
        /// # Safety
        /// `to` must be valid for writing eight floats; it need not be aligned.
        #[inline(always)]
        pub(crate) unsafe fn store(self, to: *mut f32) {
            // SAFETY: as promised by the caller; the type asks for no alignment.
            unsafe { *to.cast::<Unaligned>() = Unaligned(self.0) }
        }

        /// `self * b + c`, rounded once.
        #[inline(always)]
        pub(crate) fn mul_add(self, b: Self, c: Self) -> Self {
            // SAFETY: this module is only compiled where AVX2 and FMA are target features.
            Self(unsafe { _mm256_fmadd_ps(self.0, b.0, c.0) })
        }
    }
}

#[cfg(not(all(target_arch = "x86_64", target_feature = "avx2", target_feature = "fma")))]
mod imp {
    use super::LANES;

    /// Eight floats.
    #[derive(Clone, Copy)]
    pub(crate) struct Lanes([f32; LANES]);

    impl Lanes {
        /// All lanes `v`.
        #[inline(always)]
        pub(crate) fn splat(v: f32) -> Self {
            Self([v; LANES])
        }

        /// Eight neighbours from `from`.
        ///
        /// # Safety
        /// `from` must be valid for reading eight floats; it need not be aligned.
        #[inline(always)]
        pub(crate) unsafe fn load(from: *const f32) -> Self {
            // SAFETY: as promised by the caller.
            Self(unsafe { from.cast::<[f32; LANES]>().read_unaligned() })
        }

        /// Writes the eight to `to`.
        ///
        /// # Safety
        /// `to` must be valid for writing eight floats; it need not be aligned.
        #[inline(always)]
        pub(crate) unsafe fn store(self, to: *mut f32) {
            // SAFETY: as promised by the caller.
            unsafe { to.cast::<[f32; LANES]>().write_unaligned(self.0) }
        }

        /// `self * b + c`, rounded once.
        #[inline(always)]
        pub(crate) fn mul_add(self, b: Self, c: Self) -> Self {
            Self(std::array::from_fn(|i| self.0[i].mul_add(b.0[i], c.0[i])))
        }
    }
}

pub(crate) use imp::Lanes;

impl Lanes {
    /// The sum of the eight, always in the same order.
    #[inline(always)]
    pub(crate) fn sum(self) -> f32 {
        let mut v = [0.0_f32; LANES];
        // SAFETY: `v` holds eight floats.
        unsafe { self.store(v.as_mut_ptr()) };
        ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
    }
}
