//! Output: results go to stdout, everything else to stderr.

use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use mhsplat::base::error::{Error, Result};

/// Writes a line to stderr; a closed stderr is ignored.
pub fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

static QUIET: AtomicBool = AtomicBool::new(false);

/// Keeps [`info`] from writing anything from now on.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// True if the user wants quiet.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Writes a line to stderr unless the user wants quiet.
pub fn info(text: &str) {
    if !is_quiet() {
        note(text);
    }
}

/// First failure to write to stdout that is not a closed pipe.
static FAILED: OnceLock<std::io::Error> = OnceLock::new();

/// Writes a line to stdout. A closed pipe (`| head`) ends the output, not the program; any other failure is told by [`check`].
pub fn line(text: &str) {
    let mut out = std::io::stdout();
    let written = writeln!(out, "{text}").and_then(|()| out.flush());
    if let Err(error) = written
        && error.kind() != std::io::ErrorKind::BrokenPipe
    {
        let _ = FAILED.set(error);
    }
}

/// Refuses output that was lost.
pub fn check() -> Result<()> {
    let failed = FAILED
        .get()
        .map(|e| std::io::Error::new(e.kind(), e.to_string()));
    failed.map_or(Ok(()), |error| Err(Error::io("standard output", error)))
}

/// Writes a JSON document to stdout.
pub fn json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::numerics("json", e))?;
    line(&text);
    Ok(())
}

/// Parses a depth.
pub fn depth(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err("a number above 0 expected".into()),
    }
}

/// Parses a finite number.
pub fn finite(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err("a finite number expected".into()),
    }
}
