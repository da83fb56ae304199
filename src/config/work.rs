//! Shortcuts that leave work out.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Upper bound of the number of halvings of the photos.
const MAX_LEVELS: u32 = 4;

/// Shortcuts for the same scene with less work. Each is an item of the plan; switching one off measures what it saves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct WorkConfig {
    /// Largest number of times that the photos are halved at the start of the run (0: full size throughout; at most 4). Images never
    /// get narrower or lower than 64 pixels.
    pub resolution_levels: u32,
    /// A smaller size is left when the L1 loss is expected to fall below so many times the detail that photos lose by it.
    pub resolution_detail: f64,
    /// Largest share of the run at the smaller sizes together.
    pub resolution_share: f64,
    /// Iterations after which as much is expected to be left to be learnt as photos of 3/4 of their size lose: by it a run with a time budget
    /// chooses among all of the size, 3/4 and 9/16 of it (0: at the size asked for). Half of it for transparent photos, which lose more.
    pub resolution_iterations: u32,
    /// Morton order of the Gaussians, in layers from the top, so that neighbours in space are neighbours in memory.
    pub morton_order: bool,
    /// Iterations that training goes on for while a density step is decided, at most half of the interval between two; 0: it waits (absent:
    /// 16, or a sixth of the interval if that is less, on devices that are not the processor that decides, else 0).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density_lag: Option<u32>,
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
            resolution_levels: 4,
            resolution_detail: 1.5,
            resolution_share: 0.75,
            resolution_iterations: 1200,
            morton_order: true,
            density_lag: None,
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
        let detail = self.resolution_detail;
        let what = format!("{detail}; above 0 expected");
        let good = detail > 0.0 && detail.is_finite();
        Error::unless(good, "work.resolution-detail", &what)?;
        let share = self.resolution_share;
        let what = format!("{share}; between 0 and 1 expected");
        let good = share > 0.0 && share < 1.0;
        Error::unless(good, "work.resolution-share", &what)
    }
}
