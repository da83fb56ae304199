//! tune: which way of cutting kernels is taken, and from where.

use mhsplat::Device;
use mhsplat::device::DeviceKind;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::stats::Spread;
use mhsplat::lab::tune::{SizeClass, candidates, chosen, read};

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

#[test]
fn a_run_is_tuned_for_its_size() {
    use SizeClass::{Large, Medium, Small};
    for (gaussians, side, class) in [
        (0, 1, Small),
        (30_000, 500, Small),
        (32_000, 500, Medium),
        (30_000, 510, Medium),
        (310_000, 1130, Medium),
        (320_000, 100, Large),
        (100, 1140, Large),
    ] {
        let found = SizeClass::of(gaussians, side * side);
        assert_eq!(found, class, "{gaussians} Gaussians, {side} pixels");
    }
    let data = crate::determinism::room(64);
    let config = mhsplat::config::TrainConfig::default();
    assert_eq!(SizeClass::of_run(&data, &config), Small);

    let device = Device::open(Some("cpu")).unwrap();
    let mut info = device.info().clone();
    let most = |info: &_| SizeClass::told_apart(info).last().copied();
    let cpu = most(&info);
    assert_eq!(cpu, Some(Small), "the bits of all runs are of one width");
    info.kind = DeviceKind::Gpu;
    info.global_memory = 24 << 30;
    assert_eq!(most(&info), Some(Large));
    for class in SizeClass::told_apart(&info) {
        let [gaussians, side] = class.case();
        assert_eq!(SizeClass::of(gaussians, side * side), *class);
    }
    info.global_memory = 4 << 30;
    assert_eq!(most(&info), Some(Medium));
}

#[test]
fn a_gpu_tries_one_size_after_the_other() {
    let mut info = Device::open(None).unwrap().info().clone();
    (info.kind, info.max_work_group) = (DeviceKind::Gpu, 256);
    let all = candidates(&info);
    assert_eq!((all.len(), all[0]), (7, Tuning::GPU));
    let values = |t: &Tuning| {
        let value = serde_json::to_value(t).unwrap();
        value.as_object().unwrap().clone()
    };
    let own = values(&Tuning::GPU);
    let mut changed = std::collections::BTreeMap::<String, usize>::new();
    for candidate in &all[1..] {
        let others = values(candidate);
        let mut others = own.iter().filter(|(name, value)| others[*name] != **value);
        let (name, _) = others.next().unwrap();
        assert!(others.next().is_none(), "{candidate:?}");
        *changed.entry(name.clone()).or_default() += 1;
    }
    let two = ["chunks", "local", "radix-bits"].map(|name| (name.to_owned(), 2));
    assert_eq!(changed, two.into());
}
