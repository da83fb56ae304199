//! Files of findings about a device that are kept between runs: `mhsplat/` under `$XDG_CACHE_HOME` or `~/.cache`.

use std::hash::{Hash, Hasher};
use std::path::PathBuf;

use rustc_hash::FxHasher;

use crate::device::{DeviceInfo, sources_hash};

/// The file for a finding about a device with its driver and these kernels; `more` identifies anything else the finding depends
/// on. The number of cores that are taken is no part of it: no result depends on it. `None` if the system has no place for it.
#[must_use]
pub fn file(kind: &str, info: &DeviceInfo, more: impl Hash) -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty());
    let cache = set("XDG_CACHE_HOME").map_or_else(
        || set("HOME").map(|home| PathBuf::from(home).join(".cache")),
        |v| Some(PathBuf::from(v)),
    )?;
    let mut hasher = FxHasher::default();
    (&info.platform, &info.name, &info.driver, sources_hash()).hash(&mut hasher);
    more.hash(&mut hasher);
    Some(cache.join(format!("mhsplat/{kind}-{:016x}.json", hasher.finish())))
}

/// Writes a finding. A file that cannot be written is no loss: the next run finds out again.
pub fn keep(file: &std::path::Path, text: &[u8]) {
    if let Some(folder) = file.parent() {
        let _ = std::fs::create_dir_all(folder);
        let _ = crate::base::files::write_bytes(file, text);
    }
}
