//! Arrays on the device: reads that are under way, and clearing.

use mhsplat::Device;
use mhsplat::device::{Array, Element, PendingRead, read_sections, write_sections};
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

/// Parts of several arrays, of several types, come and go in their order; empty ones anywhere.
#[test]
fn sections_are_read_and_written_in_their_order() {
    let device = Device::open(None).unwrap();
    let ints = Array::<u32>::from_slice(&device, "ints", &[1, 2, 3, 4]).unwrap();
    let reals = Array::<f32>::from_slice(&device, "reals", &[0.5, 1.5, 2.5]).unwrap();
    let wide = Array::<f64>::from_slice(&device, "wide", &[7.0, 8.0]).unwrap();
    let sections = || {
        [
            ints.section(4, 0).unwrap(),
            reals.section(1, 2).unwrap(),
            ints.section(0, 0).unwrap(),
            wide.section(1, 1).unwrap(),
            ints.section(1, 2).unwrap(),
            reals.section(0, 0).unwrap(),
        ]
    };
    let mut words = vec![9];
    read_sections(&sections(), words.len(), &mut words).unwrap();
    let eight = 8.0f64.to_bits();
    let [one, two] = [1.5f32, 2.5].map(f32::to_bits);
    let want = [9, one, two, eight as u32, (eight >> 32) as u32, 2, 3];
    assert_eq!(words, want);
    // Words that are there are written over, and those after them go.
    for mut words in [vec![9, 9], vec![9; 40]] {
        read_sections(&sections(), 1, &mut words).unwrap();
        assert_eq!(words, want);
    }
    let doubled = [3.0f32, 5.0].map(f32::to_bits);
    let other = 6.25f64.to_bits();
    let halves = [other as u32, (other >> 32) as u32];
    let parts: [&[u32]; 6] = [&[], &doubled, &[], &halves, &[20, 30], &[]];
    let written: Vec<_> = sections().into_iter().zip(parts).collect();
    write_sections(&written).unwrap();
    assert_eq!(ints.to_vec().unwrap(), [1, 20, 30, 4]);
    assert_eq!(reals.to_vec().unwrap(), [0.5, 3.0, 5.0]);
    assert_eq!(wide.to_vec().unwrap(), [7.0, 6.25]);
    // Nothing is written where a section and its words differ in length, and there is none beyond an array.
    let short: [(_, &[u32]); 2] = [
        (ints.section(0, 1).unwrap(), &[5]),
        (wide.section(0, 1).unwrap(), &[5]),
    ];
    assert!(write_sections(&short).is_err());
    assert_eq!(ints.to_vec().unwrap(), [1, 20, 30, 4]);
    assert!(ints.section(3, 2).is_err());
    read_sections(&[], words.len(), &mut words).unwrap();
    write_sections(&[]).unwrap();
    assert_eq!(words.len(), 7);
}
