//! Arrays on the device: reads that are under way, and clearing.

use mhsplat::Device;
use mhsplat::device::{Array, Element, PendingRead};
use mhsplat::scene::Edit;

/// More than the buffers that are kept for reads to come hold, in all.
const MANY: usize = 20 << 20;

#[test]
fn a_read_under_way_has_the_values_from_when_it_was_asked_for() {
    let device = Device::open(None).unwrap();
    let array = Array::<u32>::zeros(&device, "counters", 8).unwrap();
    // More at once than training has, twice over, so that buffers are used again; with launches timed and not.
    for timed in [false, true, false] {
        let reads: Vec<PendingRead<u32>> = (0..9)
            .map(|k| {
                array.write(0, &[k; 8]).unwrap();
                array.read_later(3, 4).unwrap()
            })
            .collect();
        array.clear().unwrap();
        device.time_launches(timed).unwrap();
        for (k, read) in reads.into_iter().enumerate().skip(1) {
            assert_eq!(read.wait().unwrap(), [k as u32; 4]);
        }
    }
    let nothing = array.read_later(8, 0).unwrap();
    assert!(nothing.wait().unwrap().is_empty());
    assert!(array.read_later(5, 4).is_err());
}

#[test]
fn large_reads_and_small_ones_share_what_is_kept() {
    let device = Device::open(None).unwrap();
    let values: Vec<u32> = (0..MANY as u32).collect();
    let large = Array::from_slice(&device, "large", &values).unwrap();
    for len in [MANY, 100, MANY - 1, 1 << 20, 101] {
        let read = large.read_later(MANY - len, len).unwrap();
        // One that nobody waits for.
        drop(large.read_later(0, len).unwrap());
        assert!(read.wait().unwrap() == values[MANY - len..], "{len}");
    }
}

fn cleared<T: Element>(device: &Device, value: T, len: usize) -> Vec<T> {
    let array = Array::from_slice(device, "values", &vec![value; len]).unwrap();
    array.clear().unwrap();
    array.to_vec().unwrap()
}

/// Values beside a range that is cleared stay, wherever its bytes begin.
#[test]
fn clearing_a_range_leaves_what_is_beside_it() {
    let device = Device::open(None).unwrap();
    for (first, len) in [
        (0, 0),
        (0, 1),
        (1, 2),
        (1, 6),
        (3, 30),
        (4, 8),
        (5, 11),
        (16, 16),
        (39, 1),
    ] {
        let array = Array::from_slice(&device, "range", &[7u8; 40]).unwrap();
        array.clear_range(first, len).unwrap();
        let mut want = vec![7; 40];
        want[first..first + len].fill(0);
        assert_eq!(array.to_vec().unwrap(), want, "{len} from {first} on");
        assert!(array.clear_range(first, 41 - first).is_err());
    }
}

#[test]
fn clearing_reaches_the_last_byte() {
    let device = Device::open(None).unwrap();
    for len in [1, 2, 3, 4, 5, 15, 16, 17, 1000] {
        assert_eq!(cleared(&device, 255u8, len), vec![0; len]);
        assert_eq!(cleared(&device, u32::MAX, len), vec![0; len]);
        assert_eq!(cleared(&device, f32::NAN, len), vec![0.0; len]);
        let edit = Edit {
            dst: 7,
            opacity_logit: 1.0,
            ..Edit::default()
        };
        assert!(cleared(&device, edit, len) == vec![Edit::default(); len]);
    }
}
