//! Processes that were launched together, to train one scene.

use std::path::Path;
use std::sync::Arc;

use mhsplat::base::error::Result;
use mhsplat::capture::{self, Dataset, LoadOptions};
use mhsplat::config::TrainConfig;
use mhsplat::device::Device;
use mhsplat::ranks::{Exchange, launched};
use mhsplat::run;

use crate::cli::scene;

/// Returns the exchange of the processes that this one was launched with; `None` alone.
pub fn launched() -> Result<Option<Arc<dyn Exchange>>> {
    match launched::processes() {
        1 => Ok(None),
        processes => exchange(processes).map(Some),
    }
}

#[cfg(feature = "mpi")]
fn exchange(_processes: usize) -> Result<Arc<dyn Exchange>> {
    use mhsplat::ranks::{Patience, mpi};

    let asked = std::env::var("MHSPLAT_RANK_TIMEOUT").ok();
    let seconds = asked.and_then(|text| text.trim().parse().ok());
    mpi(Patience {
        seconds: seconds.unwrap_or(600.0),
        tell: |text| crate::cli::output::note(text),
    })
}

#[cfg(not(feature = "mpi"))]
fn exchange(processes: usize) -> Result<Arc<dyn Exchange>> {
    use mhsplat::base::error::Error;

    let what =
        format!("{processes} processes were launched, by a program that was built without MPI");
    let fix = "start one process, or build with `cargo build --release --features mpi`";
    Err(Error::device("ranks", what, fix))
}

/// Trains as a process that does not lead.
pub fn follow(exchange: &Arc<dyn Exchange>, device: &Device) -> Result<()> {
    let load = |path: &Path, config: &TrainConfig| -> Result<Dataset> {
        let options = LoadOptions {
            // The leader shows it.
            progress: None,
            ..scene::load_options(config)
        };
        capture::load(path, &options)
    };
    run::serve(exchange, device, load)
}
