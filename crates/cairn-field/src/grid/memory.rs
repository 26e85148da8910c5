//! Large arrays that are read here and there. With pages of 4 KiB nearly every row
//! of the grid costs a walk through the page tables on top of the cache miss; asking
//! Linux for huge pages made training two to three times faster.

use super::real::Real;

/// Size of a huge page, bytes, and of the least array worth one.
#[cfg(target_os = "linux")]
const HUGE_PAGE: usize = 2 << 20;

/// `len` zeros, on huge pages where the system gives them.
pub(crate) fn zeros<T: Real>(len: usize) -> Vec<T> {
    // From the allocator's zeroed pages, which nothing has touched yet.
    let zeros = vec![T::zero(); len];
    on_huge_pages(&zeros);
    zeros
}

/// As [`zeros`], of row numbers.
pub(crate) fn zero_rows(len: usize) -> Vec<u32> {
    let zeros = vec![0; len];
    on_huge_pages(&zeros);
    zeros
}

/// Asks for huge pages where `values` lie; they take effect where nothing was
/// written yet. A refusal costs speed only.
fn on_huge_pages<T>(values: &[T]) {
    #[cfg(target_os = "linux")]
    {
        let begin = values.as_ptr().addr().next_multiple_of(HUGE_PAGE);
        let end = (values.as_ptr().addr() + size_of_val(values)) / HUGE_PAGE * HUGE_PAGE;
        if begin < end {
            let place = values.as_ptr().with_addr(begin).cast_mut().cast();
            // SAFETY: the range lies within `values`, on page boundaries, and the
            // advice changes no contents.
            unsafe { libc::madvise(place, end - begin, libc::MADV_HUGEPAGE) };
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = values;
}
