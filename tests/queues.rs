//! Several queues of a process, which run the same kernels at the same time.

use std::sync::Barrier;
use std::thread;

use mhsplat::base::error::Result;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, Defines, Device, Kernels, Program};
use mhsplat::pipeline::stage::peak;

const QUEUES: usize = 4;
const ROUNDS: usize = 256;

/// A device, a program and room for its results.
struct Queue {
    device: Device,
    stage: Program,
    out: Array<f32>,
}

impl Queue {
    fn new() -> Result<Self> {
        let device = Device::open(Some("cpu"))?;
        let kernels = Kernels::new(&device, Defines::new(Tuning::CPU));
        let stage = kernels.build::<f32>("peak")?;
        let out = Array::zeros(&device, "out", (ROUNDS + QUEUES) * stage.lanes())?;
        Ok(Self { device, stage, out })
    }

    /// Runs a kernel over so many work-items, and over some more.
    fn round(&self, items: usize, more: usize) -> Result<()> {
        for items in [items, items + more] {
            peak::multiply_add(&self.stage, items, 100, [0.5, 0.5], &self.out)?;
        }
        self.device.finish()
    }
}

/// PoCL 3.1 loads a kernel once more for more work-items, counts its uses by program and work-group alone, and aborts when devices with
/// the same program mix those counts up.
#[test]
fn devices_run_the_same_kernel_at_the_same_time() {
    let queues: Vec<Queue> = (0..QUEUES).map(|_| Queue::new().unwrap()).collect();
    let together = Barrier::new(QUEUES);
    let work = |(number, queue): (usize, &Queue)| -> Result<()> {
        let mut so_far = Ok(());
        for round in 1..=ROUNDS {
            // Who fails goes on waiting for the others, who would wait for ever.
            together.wait();
            so_far = so_far.and(queue.round(round, number));
        }
        so_far
    };
    thread::scope(|scope| {
        let begin = |one| scope.spawn(move || work(one));
        let all: Vec<_> = queues.iter().enumerate().map(begin).collect();
        for one in all {
            one.join().unwrap().unwrap();
        }
    });
}
