//! Processes that were launched together, to train one scene.

use std::path::Path;
use std::sync::Arc;

use mhsplat::base::error::{Error, Result};
use mhsplat::capture::{self, Dataset, LoadOptions};
use mhsplat::config::TrainConfig;
use mhsplat::device::Device;
use mhsplat::lab::selftest::self_test;
use mhsplat::ranks::{Exchange, LEADER, launched};
use mhsplat::run;

use crate::cli::common::DeviceOption;
use crate::cli::scene;

/// Opens the devices to train with, those of all processes that were launched together; `None` in a process that does not lead, after it
/// has trained with the one that does.
pub fn open(option: &DeviceOption) -> Result<Option<Device>> {
    match launched::processes() {
        1 => option.open_all().map(Some),
        processes => {
            let exchange = exchange(processes)?;
            let tell = |error: &Error| exchange.fail(&error.to_string());
            let device = option.open_own().inspect_err(tell)?;
            if exchange.rank() == LEADER {
                return Ok(Some(device.with_processes(exchange)));
            }
            follow(&exchange, &device).inspect_err(tell)?;
            Ok(None)
        }
    }
}

#[cfg(feature = "mpi")]
fn exchange(processes: usize) -> Result<Arc<dyn Exchange>> {
    use mhsplat::ranks::{Patience, mpi};

    const NAME: &str = "MHSPLAT_RANK_TIMEOUT";
    let seconds = match std::env::var(NAME) {
        Err(_) => 600.0,
        Ok(text) => {
            let seconds = text.trim().parse().ok().filter(|s: &f64| *s > 0.0);
            let wrong = || Error::config(NAME, format!("{text:?}; seconds expected"));
            seconds.ok_or_else(wrong)?
        }
    };
    let exchange = mpi(Patience {
        seconds,
        tell: |text| crate::cli::output::note(text),
    })?;
    match exchange.ranks() {
        found if found == processes => Ok(exchange),
        // Each would lead a training of its own.
        found => {
            let what = format!("{processes} processes were launched, and MPI finds {found}");
            let fix = "launch them with srun --mpi=pmix (`srun --mpi=list` shows what there is), or with the mpirun of the MPI library that the program was built with; to train alone in each, unset SLURM_STEP_NUM_TASKS";
            Err(Error::device("ranks", what, fix))
        }
    }
}

#[cfg(not(feature = "mpi"))]
fn exchange(processes: usize) -> Result<Arc<dyn Exchange>> {
    let what =
        format!("{processes} processes were launched, by a program that was built without MPI");
    let fix = "start one process, or build with `cargo build --release --features mpi`";
    Err(Error::device("ranks", what, fix))
}

/// Trains as a process that does not lead.
fn follow(exchange: &Arc<dyn Exchange>, device: &Device) -> Result<()> {
    let load = |path: &Path, config: &TrainConfig| -> Result<Dataset> {
        let options = LoadOptions {
            // The leader shows it.
            progress: None,
            keepers: launched::on_this_node(),
            digests: true,
            ..scene::load_options(config)
        };
        capture::load(path, &options)
    };
    run::serve(exchange, device, load, self_test)
}
