//! Several queues of a process, which run the same kernels at the same time.

use std::sync::Barrier;
use std::thread;

use mhsplat::base::error::Result;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, Defines, Device, Kernels};
use mhsplat::pipeline::stage::peak;

const QUEUES: usize = 4;
const ROUNDS: usize = 256;

/// Runs one kernel on a device of its own, over more work-items from round to round, at the same time as the others.
fn rounds(queue: usize, together: &Barrier) -> Result<()> {
    let device = Device::open(Some("cpu"))?;
    let kernels = Kernels::new(&device, Defines::new(Tuning::CPU));
    let stage = kernels.build::<f32>("peak")?;
    let most = (ROUNDS + QUEUES) * stage.lanes();
    let out = Array::<f32>::zeros(&device, "out", most)?;
    for round in 1..=ROUNDS {
        together.wait();
        for items in [round, round + queue] {
            peak::multiply_add(&stage, items, 100, [0.5, 0.5], &out)?;
        }
        device.finish()?;
    }
    Ok(())
}

/// PoCL 3.1 loads a kernel once more for more work-items, counts its uses by program and work-group alone, and aborts when devices with
/// the same program mix those counts up.
#[test]
fn devices_run_the_same_kernel_at_the_same_time() {
    let together = Barrier::new(QUEUES);
    thread::scope(|scope| {
        for queue in 0..QUEUES {
            let together = &together;
            scope.spawn(move || rounds(queue, together).unwrap());
        }
    });
}
