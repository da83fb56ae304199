//! scan: prefix sums.

use super::*;
use mhsplat::device::Array;
use mhsplat::device::tuning::status::{INTERSECTIONS, OVERFLOW};
use mhsplat::pipeline::buffers::ViewBuffers;
use mhsplat::pipeline::stage::scan::{scan as definition, sum_pairs};

#[test]
fn agrees_with_the_reference() {
    agrees("scan");
}

#[test]
fn a_wrong_count_is_rejected() {
    rejects("scan", "pairs counted", |pairs| pairs[0] += 1.0);
}

/// Sums and status after scanning `values` with room for `capacity`.
fn scanned(values: &[u32], capacity: usize, tuning: Tuning) -> (Vec<u32>, Vec<u32>) {
    let device = device();
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let room = values.len().max(1);
    let input = Array::zeros(&device, "values", room).unwrap();
    input.write(0, values).unwrap();
    let out = Array::zeros(&device, "out", room).unwrap();
    let mut frame = ViewBuffers::<f32>::new(&device, &kernels.defines().tuning, false).unwrap();
    frame.capacity = capacity;
    let stage = kernels.build::<f32>("scan").unwrap();
    sum_pairs(&stage, &frame.totals(), values.len(), [&input, &out]).unwrap();
    let status = frame.status.to_vec().unwrap();
    (out.read(0, values.len()).unwrap(), status)
}

#[test]
fn sums_of_every_length() {
    for n in [0usize, 1, 2, 15, 16, 17, 1000, 4097] {
        let values: Vec<u32> = (0..n as u32).map(|i| i * 7 % 11).collect();
        let (sums, total) = definition(&values);
        for tuning in TUNINGS {
            let (got, status) = scanned(&values, 1 << 20, tuning);
            assert_eq!(got, sums, "{n} values");
            assert_eq!(
                u64::from(status[INTERSECTIONS as usize]),
                total,
                "{n} values"
            );
            assert_eq!(status[OVERFLOW as usize], 0);
        }
    }
}

#[test]
fn a_total_beyond_the_capacity_raises_the_flag() {
    let values = vec![3u32; 100];
    for tuning in TUNINGS {
        let status = |values: &[u32], capacity| scanned(values, capacity, tuning).1;
        assert_eq!(status(&values, 300)[INTERSECTIONS as usize], 300);
        let beyond = status(&values, 299);
        assert_eq!(beyond[INTERSECTIONS as usize], 0, "nothing is left to do");
        assert_eq!(
            beyond[OVERFLOW as usize], 300,
            "what would have been needed"
        );
        // They are in different chunks.
        let mut large = [0; 9];
        (large[0], large[8]) = (u32::MAX, u32::MAX);
        let beyond = status(&large, 299);
        assert_eq!(beyond[OVERFLOW as usize], u32::MAX, "saturates");
    }
}
