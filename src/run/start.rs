//! What a run begins with: its folder and the first Gaussians.

use std::path::Path;

use crate::config::{Init, TrainConfig};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::export::ply;
use crate::model::{Splats, init};

/// Gaussians of a random initialisation.
const RANDOM_GAUSSIANS: usize = 30_000;

/// The first Gaussians that a configuration asks for.
///
/// Never more than `max_gaussians`: of too many points a random part is taken, keyed by the seed.
///
/// # Errors
/// A PLY file that cannot be read, has another SH degree than can be used, or holds too many Gaussians.
pub fn initial_splats(dataset: &Dataset, config: &TrainConfig) -> Result<Splats> {
    let most = config.max_gaussians.unwrap_or(usize::MAX);
    let splats = match &config.init {
        Init::File(path) => {
            let splats = ply::read(path, &dataset.frame)?;
            if splats.len() > most {
                return Err(Error::input(
                    path,
                    format!("{} Gaussians; at most {most} are wanted", splats.len()),
                    "raise --max-gaussians",
                ));
            }
            splats.with_sh_degree(config.sh_degree)
        }
        Init::Points if !dataset.points.positions.is_empty() => {
            let points = init::subset(&dataset.points, most, config.seed);
            init::from_points(&points, config.sh_degree)
        }
        Init::Points | Init::Random => {
            let count = RANDOM_GAUSSIANS.min(most);
            init::random(dataset, count, config.sh_degree, config.seed)
        }
    }?;
    Ok(splats.in_morton_order())
}

/// Makes the run folder; refuses one that exists.
///
/// # Errors
/// An existing folder, or one that cannot be made.
pub fn claim_folder(dir: &Path) -> Result<()> {
    if dir.exists() {
        return Err(Error::input(
            dir,
            "exists already; a run never overwrites anything",
            "choose another folder with -o, or continue it with --resume",
        ));
    }
    std::fs::create_dir_all(dir).map_err(|e| {
        Error::input(
            dir,
            format!("cannot be made: {e}"),
            "choose a folder that can be written with -o",
        )
    })
}

/// Removes a folder that [`claim_folder`] made for a run that could not begin: what such a run writes first, and nothing
/// that anyone else may have put there.
pub fn abandon_folder(dir: &Path) {
    for name in ["run.json", "metrics.csv", "density.csv"] {
        let _ = std::fs::remove_file(dir.join(name));
    }
    let _ = std::fs::remove_dir(dir);
}
