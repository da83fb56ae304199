//! Shared libraries of drivers: whether the system can load them.

use std::ffi::OsStr;

use libloading::Library;

/// Loads a library as OpenCL's loader does, and leaves it loaded: drivers do not expect to be taken away again.
///
/// # Errors
/// The system's reason, as text.
pub fn load(library: &OsStr) -> Result<(), String> {
    // SAFETY: the loader has run, or will run, the same initialisers of the same libraries, which the system's administrator named for
    // that; no symbol of them is used here.
    let loaded = unsafe { Library::new(library) };
    loaded.map(std::mem::forget).map_err(|e| e.to_string())
}
