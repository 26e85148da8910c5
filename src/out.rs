//! Printing that outlives its reader: `cairn ... | head -1` closes the pipe, and the standard library's `println!` panics
//! then.
//!
//! The macros here stand before the standard ones in every module of this binary. Once the reader is gone nothing
//! more is written there, and the command goes on to its end and its ordinary exit code: a training that a person
//! glanced at is not lost. What runs until it is stopped asks [`is_closed`].

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

static OUT_CLOSED: AtomicBool = AtomicBool::new(false);
static ERR_CLOSED: AtomicBool = AtomicBool::new(false);

/// Whether nobody reads standard output any more, as far as was noticed.
pub fn is_closed() -> bool {
    OUT_CLOSED.load(Ordering::Relaxed)
}

/// Writes to standard output.
///
/// # Panics
/// As the standard macros do, where it cannot be written for another reason: a full disk must not pass for an answer.
pub fn out(text: Arguments<'_>) {
    put(std::io::stdout().lock(), &OUT_CLOSED, "stdout", text);
}

/// Writes to standard error.
///
/// # Panics
/// As [`out`].
pub fn err(text: Arguments<'_>) {
    put(std::io::stderr().lock(), &ERR_CLOSED, "stderr", text);
}

fn put(mut to: impl Write, closed: &AtomicBool, name: &str, text: Arguments<'_>) {
    if closed.load(Ordering::Relaxed) {
        return;
    }
    match to.write_fmt(text).and_then(|()| to.flush()) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::BrokenPipe => closed.store(true, Ordering::Relaxed),
        Err(e) => panic!("failed printing to {name}: {e}"),
    }
}

/// As the standard macro, until the reader is gone.
macro_rules! print {
    ($($text:tt)*) => { $crate::out::out(format_args!($($text)*)) };
}

/// As the standard macro, until the reader is gone.
macro_rules! println {
    () => { $crate::out::out(format_args!("\n")) };
    ($($text:tt)*) => { $crate::out::out(format_args!("{}\n", format_args!($($text)*))) };
}

/// As the standard macro, until the reader is gone.
macro_rules! eprintln {
    () => { $crate::out::err(format_args!("\n")) };
    ($($text:tt)*) => { $crate::out::err(format_args!("{}\n", format_args!($($text)*))) };
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Full(ErrorKind);

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_reader_that_left_is_noticed_and_nothing_else_is_taken_for_it() {
        let closed = AtomicBool::new(false);
        put(Full(ErrorKind::BrokenPipe), &closed, "stdout", format_args!("a"));
        assert!(closed.load(Ordering::Relaxed));
        // Nobody is asked again.
        put(Full(ErrorKind::StorageFull), &closed, "stdout", format_args!("b"));
        let full = AtomicBool::new(false);
        let panicked = std::panic::catch_unwind(|| {
            put(Full(ErrorKind::StorageFull), &full, "stdout", format_args!("c"));
        });
        assert!(panicked.is_err() && !full.load(Ordering::Relaxed));
    }
}
