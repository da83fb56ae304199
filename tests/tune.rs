//! tune: which way of cutting kernels is taken, and from where.

use mhsplat::Device;
use mhsplat::device::DeviceKind;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::stats::Spread;
use mhsplat::lab::tune::{SizeClass, candidates, chosen, read, together};

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
fn what_several_winners_change_is_tried_together() {
    let own = Tuning::GPU;
    let spread = |middle: f64| Spread::of(&[0.998 * middle, middle, 1.002 * middle]).unwrap();
    let with = |change: &dyn Fn(&mut Tuning)| {
        let mut tuning = own;
        change(&mut tuning);
        tuning
    };
    let chunks = with(&|t| t.chunks = 512);
    let far = with(&|t| t.grad_segment = 256);
    let near = with(&|t| t.grad_segment = 128);
    let wide = with(&|t| (t.grad_group, t.grad_sums) = (128, 3));
    let default = (own, spread(10.0));
    // Both segments win, the nearer one by more; the other group does not.
    let measured = [
        default,
        (chunks, spread(9.7)),
        (far, spread(9.5)),
        (near, spread(9.4)),
        (wide, spread(9.9)),
    ];
    let both = with(&|t| (t.chunks, t.grad_segment) = (512, 128));
    assert_eq!(together(&measured, own), Some(both));
    assert_eq!(chosen(&measured, own), Some(near));
    assert_eq!(together(&measured[..2], own), None, "that one is measured");
    // Three hundredths that not every sample has are none.
    let noisy = Spread::of(&[9.4, 9.5, 10.0]).unwrap();
    assert_eq!(chosen(&[default, (far, noisy)], own), Some(own));
    assert_eq!(
        together(&[default, (far, noisy), (chunks, noisy)], own),
        None
    );
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
        ("tile", 24),
        ("radix-bits", 40),
        ("splat-group", 96),
        ("grad-group", 32),
        ("grad-segment", 100),
        ("grad-sums", 8),
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
    (info.local_memory, info.vendor) = (48 << 10, "NVIDIA Corporation".into());
    let all = candidates(&info);
    assert_eq!((all.len(), all[0]), (13, Tuning::GPU));
    let values = |t: &Tuning| {
        let value = serde_json::to_value(t).unwrap();
        value.as_object().unwrap().clone()
    };
    let own = values(&Tuning::GPU);
    let mut changed = std::collections::BTreeMap::<Vec<&str>, usize>::new();
    for candidate in &all[1..] {
        let others = values(candidate);
        let others = own.iter().filter(|(name, value)| others[*name] != **value);
        let names = others.map(|(name, _)| name.as_str()).collect();
        *changed.entry(names).or_default() += 1;
    }
    let twice = ["chunks", "grad-segment", "local", "splat-group"];
    let mut wanted: std::collections::BTreeMap<_, _> = twice.map(|name| (vec![name], 2)).into();
    // Sums of a larger group take more room, and may be fewer.
    wanted.extend([(vec!["grad-sums"], 1), (vec!["grad-group", "grad-sums"], 2)]);
    // Fewer than 7 take too many launches.
    wanted.insert(vec!["radix-bits"], 1);
    assert_eq!(changed, wanted);
    // What does not fit into the device's local memory is not tried, nor what the checks in double precision could not build.
    for (local_memory, fp64, number) in [(16 << 10, false, 12), (32 << 10, true, 12)] {
        (info.local_memory, info.fp64) = (local_memory, fp64);
        let fit = candidates(&info);
        assert_eq!(fit.len(), number);
        assert!(fit.iter().all(|t| t.grad_local_bytes(fp64) <= local_memory));
    }
}

#[test]
fn sizes_without_a_meaning_are_not_shown() {
    let names = |t: Tuning| {
        t.to_string()
            .split(',')
            .filter_map(|f| f.split_once('='))
            .count()
    };
    assert_eq!([names(Tuning::CPU), names(Tuning::GPU)], [8, 12]);
    assert!(
        Tuning::CPU
            .to_string()
            .starts_with("vector-width=16,block-width=4")
    );
}

#[test]
fn group_sizes_go_by_the_vendor() {
    let mut info = Device::open(None).unwrap().info().clone();
    (info.kind, info.max_work_group, info.local_memory) = (DeviceKind::Gpu, 256, 64 << 10);
    for (vendor, wanted) in [
        ("NVIDIA Corporation", Tuning::GPU),
        ("Advanced Micro Devices, Inc.", Tuning::GPU_WIDE),
        ("Intel(R) Corporation", Tuning::GPU_WIDE),
        ("somebody else", Tuning::GPU),
    ] {
        info.vendor = vendor.into();
        let own = Tuning::for_device(&info);
        assert_eq!((own, own.fault(&info)), (wanted, None), "{vendor}");
        assert_eq!(candidates(&info)[0], wanted);
    }
    info.kind = DeviceKind::Cpu;
    assert!(!Tuning::for_device(&info).group_style);
}
