//! sort: stable radix sort.

use super::*;
use mhsplat::base::rng::Philox;
use mhsplat::device::Array;
use mhsplat::device::tuning::status::{SLOTS, VISIBLE};
use mhsplat::pipeline::buffers::SortBuffers;
use mhsplat::pipeline::stage::sort::{Sort, sort as definition};

#[test]
fn agrees_with_the_reference() {
    agrees("sort");
}

#[test]
fn a_swapped_list_is_rejected() {
    rejects("sort", "tile lists", |lists| {
        lists.split_mut(|g| *g < 0.0).for_each(<[f64]>::reverse)
    });
}

/// Positions of the keys after sorting on the device.
fn sorted(keys: &[u32], bits: u32, tuning: Tuning) -> Vec<u32> {
    let device = device();
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let n = keys.len().max(1);
    let mut elements = SortBuffers::new(&device, ["keys", "values"], n, VISIBLE).unwrap();
    elements.keys[0].write(0, keys).unwrap();
    let positions: Vec<u32> = (0..keys.len() as u32).collect();
    elements.values[0].write(0, &positions).unwrap();
    let status = Array::zeros(&device, "status", SLOTS).unwrap();
    status
        .write(VISIBLE as usize, &[keys.len() as u32])
        .unwrap();
    let sort = Sort::new::<f32>(&kernels).unwrap();
    sort.run(&mut elements, &status, bits).unwrap();
    elements.sorted_values().read(0, keys.len()).unwrap()
}

#[test]
fn any_keys_any_width_both_tunings() {
    for (n, bits) in [
        (0usize, 32u32),
        (1, 32),
        (1000, 32),
        (5000, 12),
        (3000, 5),
        (700, 17),
        (4000, 1),
    ] {
        // Few different keys among many elements: equal keys must keep their order.
        let mask = if bits == 32 {
            u32::MAX
        } else {
            (1 << bits) - 1
        };
        let keys: Vec<u32> = (0..n as u64)
            .map(|i| Philox::words(3, 1, i)[0] & mask)
            .collect();
        let want = definition(&keys);
        for tuning in [
            Tuning::CPU,
            Tuning {
                chunks: 64,
                ..Tuning::GPU
            },
        ] {
            assert_eq!(sorted(&keys, bits, tuning), want, "{n} keys of {bits} bits");
        }
    }
}

#[test]
fn equal_keys_keep_their_order() {
    let keys = vec![7u32; 2000];
    assert_eq!(
        sorted(&keys, 32, Tuning::CPU),
        (0..2000).collect::<Vec<u32>>()
    );
}
