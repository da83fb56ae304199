//! tune: which way of cutting kernels is taken, and from where.

use mhsplat::Device;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::stats::Spread;
use mhsplat::lab::tune::{chosen, read};

const OTHER: Tuning = Tuning {
    block_width: 8,
    ..Tuning::CPU
};

#[test]
fn only_a_clear_winner_replaces_the_default() {
    let spread = |samples: [f64; 3]| Spread::of(&samples).unwrap();
    let default = (Tuning::CPU, spread([10.0, 11.0, 12.0]));
    let with = |samples| chosen(&[default, (OTHER, spread(samples))], Tuning::CPU);
    assert_eq!(with([9.0, 9.5, 9.9]), Some(Tuning::CPU), "not clearly");
    assert_eq!(with([8.0, 8.1, 8.2]), Some(OTHER));
    assert_eq!(with([9.0, 9.1, 9.2]), Some(Tuning::CPU), "its best is not");
    assert_eq!(
        with([8.0, 10.0, 11.0]),
        Some(Tuning::CPU),
        "its median is not"
    );
    let alone = [(OTHER, spread([1.0; 3]))];
    assert_eq!(chosen(&alone, Tuning::CPU), None, "the default failed");
}

#[test]
fn a_bad_file_is_ignored() {
    let device = Device::open(None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tuning.json");
    let found = || read(&file, device.info());
    assert_eq!(found(), None, "missing");
    let own = Tuning::for_device(device.info());
    let kept = |tuning: serde_json::Value| {
        let text = serde_json::json!({ "tuning": tuning, "milliseconds": [] }).to_string();
        std::fs::write(&file, text).unwrap();
    };
    kept(serde_json::to_value(own).unwrap());
    assert_eq!(found(), Some(own));
    for (name, value) in [
        ("vector-width", 3),
        ("block-width", 0),
        ("local", 1 << 30),
        ("strip", 7),
        ("radix-bits", 40),
        ("unheard-of", 1),
    ] {
        let mut bad = serde_json::to_value(own).unwrap();
        bad[name] = value.into();
        kept(bad);
        assert_eq!(found(), None, "{name} = {value}");
    }
    std::fs::write(&file, b"{ half a file").unwrap();
    assert_eq!(found(), None, "damaged");
}
