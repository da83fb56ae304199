//! sort: stable radix sort.

use super::*;
use mhsplat::base::rng::Philox;
use mhsplat::device::Array;
use mhsplat::device::tuning::KEY_CULLED;
use mhsplat::device::tuning::status::{INTERSECTIONS, SLOTS, VISIBLE};
use mhsplat::pipeline::buffers::{SortBuffers, ViewBuffers};
use mhsplat::pipeline::stage::bin::sort_visible;
use mhsplat::pipeline::stage::sort::{Keys, Sort, sort as definition};

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

/// Positions of the keys after sorting on the device, where there might have been `most`.
fn sorted(keys: &[u32], most: usize, tuning: Tuning) -> Vec<u32> {
    let device = device();
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let mut elements = SortBuffers::new(&device, ["keys", "values"], most.max(1)).unwrap();
    elements.keys[0].write(0, keys).unwrap();
    let positions: Vec<u32> = (0..keys.len() as u32).collect();
    elements.values[0].write(0, &positions).unwrap();
    let status = Array::zeros(&device, "status", SLOTS).unwrap();
    status
        .write(VISIBLE as usize, &[keys.len() as u32])
        .unwrap();
    let sort = Sort::new::<f32>(&kernels).unwrap();
    sort.run(&mut elements, &Keys::depths(most), &status)
        .unwrap();
    elements.sorted_values().read(0, keys.len()).unwrap()
}

/// Those of CPUs and GPUs, and one with an odd number of passes or other chunks than elements come in.
fn tunings() -> [Tuning; 4] {
    [
        Tuning::CPU,
        Tuning {
            chunks: 7,
            radix_bits: 7,
            ..Tuning::CPU
        },
        Tuning {
            chunks: 64,
            ..Tuning::GPU
        },
        Tuning {
            chunks: 3,
            radix_bits: 5,
            ..Tuning::GPU
        },
    ]
}

#[test]
fn any_keys_every_tuning() {
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
        let keys: Vec<u32> = (0..n as u64)
            .map(|i| Philox::words(3, 1, i)[0] >> (32 - bits))
            .collect();
        let want = definition(&keys);
        for tuning in tunings() {
            // By one work-item where a work-item is a core, and by many.
            for most in [n, 200_000] {
                let got = sorted(&keys, most, tuning);
                assert_eq!(got, want, "{n} of {most} keys of {bits} bits");
            }
        }
    }
}

/// Tiles of pairs: few bits or many, counted by a slot of their own.
#[test]
fn tiles_are_sorted_by_the_bits_that_they_have() {
    let device = device();
    for tiles in [1usize, 2, 255, 256, 257, 6700, 1 << 24] {
        let keys: Vec<u32> = (0..3000u64)
            .map(|i| match i % 100 {
                7 => tiles as u32 - 1,
                _ => Philox::words(4, 1, i)[0] % tiles as u32,
            })
            .collect();
        let positions: Vec<u32> = (0..3000).collect();
        let want = definition(&keys);
        for tuning in tunings() {
            let mut elements = SortBuffers::new(&device, ["keys", "values"], 4096).unwrap();
            elements.keys[0].write(0, &keys).unwrap();
            elements.values[0].write(0, &positions).unwrap();
            let status = Array::zeros(&device, "status", SLOTS).unwrap();
            status.write(VISIBLE as usize, &[17]).unwrap();
            status.write(INTERSECTIONS as usize, &[3000]).unwrap();
            let sort = Sort::new::<f32>(&Kernels::new(&device, Defines::new(tuning))).unwrap();
            let of_tiles = Keys::tiles(4096, tiles);
            sort.run(&mut elements, &of_tiles, &status).unwrap();
            let got = elements.sorted_values().read(0, 3000).unwrap();
            assert_eq!(got, want, "{tiles} tiles");
        }
    }
}

/// Places as a histogram by chunk and bin determines them: bins in order, within a bin chunks in order.
#[test]
fn places_follow_bins_then_chunks() {
    let device = device();
    let [chunks, bins] = [3, 5];
    let counts = [2, 0, 1, 7, 0, 0, 4, 1, 0, 0, 5, 1, 0, 2, 0];
    for tuning in tunings() {
        let sort = Sort::new::<f32>(&Kernels::new(&device, Defines::new(tuning))).unwrap();
        let histogram = Array::from_slice(&device, "histogram", &counts).unwrap();
        let totals = Array::zeros(&device, "totals", bins + 1).unwrap();
        sort.first_places(&histogram, [chunks, bins], &totals)
            .unwrap();
        let totals = totals.to_vec().unwrap();
        match tuning.group_style {
            // Whoever scatters adds them up.
            true => assert_eq!(totals[..bins], [7, 5, 2, 9, 0]),
            false => assert_eq!(totals, [0, 7, 12, 14, 23, 23]),
        }
        let before = [0, 0, 0, 0, 0, 2, 0, 1, 7, 0, 2, 4, 2, 7, 0];
        assert_eq!(histogram.to_vec().unwrap(), before);
    }
}

/// Chunks of very different numbers of visible ones: none, all, some.
#[test]
fn the_visible_ones_are_sorted_whatever_their_chunks_have() {
    let device = device();
    for n in [1usize, 2000, 10_000, 30_000] {
        let words = |i: u64| Philox::words(5, 1, i)[0];
        let key = |i: usize| match (3 * i / n, words(i as u64)) {
            (0, _) => KEY_CULLED,
            (1, word) => word >> 16,
            (_, word) if word % 7 > 0 => KEY_CULLED,
            (_, word) => word >> 1,
        };
        let keys: Vec<u32> = (0..n).map(key).collect();
        let mut want: Vec<u32> = (0..n as u32)
            .filter(|row| keys[*row as usize] != KEY_CULLED)
            .collect();
        want.sort_by_key(|row| keys[*row as usize]);
        for tuning in tunings() {
            let kernels = Kernels::new(&device, Defines::new(tuning));
            let tuning = &kernels.defines().tuning;
            let mut frame = ViewBuffers::<f32>::new(&device, tuning, false).unwrap();
            frame.fit_gaussians(&device, n).unwrap();
            frame.keys.write(0, &keys).unwrap();
            frame.count = n;
            let sort = Sort::new::<f32>(&kernels).unwrap();
            let stage = kernels.build::<f32>("bin").unwrap();
            sort_visible(&stage, &sort, &mut frame).unwrap();
            let visible = frame.status.read(VISIBLE as usize, 1).unwrap()[0];
            assert_eq!(visible as usize, want.len(), "{n}");
            let got = frame.visible.sorted_values().read(0, want.len()).unwrap();
            assert!(got == want, "{n} Gaussians");
        }
    }
}
