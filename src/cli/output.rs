//! Where text goes: results to stdout, everything else to stderr.

use std::io::Write;

use serde::Serialize;

use mhsplat::base::error::{Error, Result};

/// A line on stderr. A closed stderr is nobody's loss.
pub fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// A line on stdout. A closed pipe (`| head`) ends the output, not the program.
pub fn line(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// A JSON document on stdout.
pub fn json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::Numerics {
        stage: "json".into(),
        what: e.to_string(),
    })?;
    line(&text);
    Ok(())
}

/// A number on the command line; NaN and infinities are none.
pub fn finite(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err("a finite number expected".into()),
    }
}
