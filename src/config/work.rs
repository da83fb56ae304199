//! Shortcuts that leave work out.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Iterations of the run that intervals are written for.
const PAPER_ITERATIONS: u64 = 30_000;

/// Upper bound of the number of halvings of the photos.
const MAX_LEVELS: u32 = 4;

/// Shortcuts for the same scene with less work. Each is an item of the plan; switching one off measures what it saves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct WorkConfig {
    /// Number of times that the photos are halved at the start of the run (0: full size throughout; at most 4). Images never get
    /// narrower or lower than 64 pixels. Two halvings reach every PSNR sooner than none or one on the scenes measured.
    pub resolution_levels: u32,
    /// Iterations at each of the smaller sizes, for a run of 30,000 iterations.
    pub resolution_interval: u32,
    /// Morton order of the Gaussians, so that neighbours in space are neighbours in memory.
    pub morton_order: bool,
    /// Culling of whole chunks of neighbouring Gaussians that a view cannot see. Changes no result.
    pub cull_chunks: bool,
    /// Skipping of tiles that are blank in render and photo alike, for photos with alpha or masks. Changes no bit of the scene.
    pub skip_blank: bool,
    /// Removal, at the end, of Gaussians that contribute to no training view.
    pub remove_unseen: bool,
}

impl Default for WorkConfig {
    fn default() -> Self {
        Self {
            resolution_levels: 2,
            resolution_interval: 1500,
            morton_order: true,
            cull_chunks: true,
            skip_blank: true,
            remove_unseen: true,
        }
    }
}

impl WorkConfig {
    pub(super) fn validate(&self) -> Result<()> {
        let levels = self.resolution_levels;
        let what = format!("{levels}; 0 to {MAX_LEVELS} expected");
        Error::unless(levels <= MAX_LEVELS, "work.resolution-levels", &what)?;
        let coarse = u64::from(levels) * u64::from(self.resolution_interval);
        let what = format!(
            "{} iterations at each of {levels} sizes; at least 1, and less than {PAPER_ITERATIONS} in all expected",
            self.resolution_interval
        );
        let good = levels == 0 || (1..PAPER_ITERATIONS).contains(&coarse);
        Error::unless(good, "work.resolution-interval", &what)
    }
}
