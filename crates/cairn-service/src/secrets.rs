//! Keeps secret keys out of core dumps and out of reach of other processes of the same user.
//!
//! A crash would otherwise write the whole memory, keys and passphrases included, into a file with the crash's reader as
//! its audience; and a debugger of the same user could take them from a process at work. Pages are not locked against
//! being swapped out: who fears that encrypts the swap space.

/// Forbids core dumps of this process and its children, and on Linux attaching to it; for good.
///
/// To be called before any secret is read.
///
/// # Errors
/// What the system says, where it does not allow it.
pub fn keep_out_of_dumps() -> std::io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        // SAFETY: this option reads its one argument, a number, and touches no memory of ours.
        if unsafe { libc::prctl(libc::PR_SET_DUMPABLE, 0_u64, 0_u64, 0_u64, 0_u64) } != 0 {
            return Err(std::io::Error::last_os_error());
        }
    }
    #[cfg(unix)]
    {
        let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        // SAFETY: `none` is a whole `rlimit` that outlives the call, which only reads it.
        if unsafe { libc::setrlimit(libc::RLIMIT_CORE, &raw const none) } != 0 {
            return Err(std::io::Error::last_os_error());
        }
    }
    Ok(())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn this_process_leaves_no_core() {
        keep_out_of_dumps().unwrap();
        // SAFETY: reads a flag of this process, no memory.
        assert_eq!(unsafe { libc::prctl(libc::PR_GET_DUMPABLE, 0_u64, 0_u64, 0_u64, 0_u64) }, 0);
        let mut limit = libc::rlimit { rlim_cur: 1, rlim_max: 1 };
        // SAFETY: `limit` is a whole `rlimit` that outlives the call, which writes it.
        assert_eq!(unsafe { libc::getrlimit(libc::RLIMIT_CORE, &raw mut limit) }, 0);
        assert_eq!((limit.rlim_cur, limit.rlim_max), (0, 0));
    }
}
