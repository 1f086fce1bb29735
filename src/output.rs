//! What commands say. Standard output and error may be pipes that nobody reads any more (`lumi eval … | head`): what is said then is
//! lost, and the command goes on to do its work, where `println!` would panic.

use std::fmt::Arguments;
use std::io::Write;

/// As `println!`, but a closed pipe is no fault.
macro_rules! say {
    ($($what:tt)*) => { $crate::output::line(&mut std::io::stdout().lock(), format_args!($($what)*)) };
}

/// As `eprintln!`, but a closed pipe is no fault.
macro_rules! say_aside {
    ($($what:tt)*) => { $crate::output::line(&mut std::io::stderr().lock(), format_args!($($what)*)) };
}

pub(crate) use {say, say_aside};

/// Writes a line, if it can be written: there is nowhere left to complain.
pub fn line(to: &mut dyn Write, what: Arguments<'_>) {
    let _lost = writeln!(to, "{what}").and_then(|()| to.flush());
}

/// Writes text that ends its own lines to standard output.
pub fn text(what: &str) {
    let mut to = std::io::stdout().lock();
    let _lost = to.write_all(what.as_bytes()).and_then(|()| to.flush());
}
