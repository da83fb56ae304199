//! Output: results go to stdout, everything else to stderr.

use std::io::Write;

use serde::Serialize;

use mhsplat::base::error::{Error, Result};

/// Writes a line to stderr; a closed stderr is ignored.
pub fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Writes a line to stdout. A closed pipe (`| head`) ends the output, not the program.
pub fn line(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Writes a JSON document to stdout.
pub fn json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::numerics("json", e))?;
    line(&text);
    Ok(())
}

/// Parses a finite number.
pub fn finite(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err("a finite number expected".into()),
    }
}
