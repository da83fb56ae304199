//! The plan: what switches each item on, and what is said of it.

use crate::determinism::room;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, Photo, PhotoSource, load};
use mhsplat::config::{Background, Init, Sampler, TrainConfig};
use mhsplat::train::plan::{Item, Plan};
use mhsplat::train::{BandTrial, Findings};

/// Why an item is kept (`Ok`) or left out (`Err`); panics if it is on both lists or on none.
fn verdict(plan: &Plan, what: &str) -> Result<String, String> {
    let find = |items: &[Item]| items.iter().find(|i| i.what == what).map(|i| i.why.clone());
    match (find(&plan.kept), find(&plan.left_out)) {
        (Some(why), None) => Ok(why),
        (None, Some(why)) => Err(why),
        found => panic!("{what}: {found:?}"),
    }
}

fn plan(data: &Dataset, change: impl Fn(&mut TrainConfig)) -> Plan {
    let mut config = TrainConfig::default();
    change(&mut config);
    Plan::new(data, &config)
}

/// Asserts that `what` is kept by `on` and left out by the default, or the other way round.
fn switched(what: &str, on: impl Fn(&mut TrainConfig), kept: bool) {
    let data = room(256);
    assert_eq!(verdict(&plan(&data, |_| {}), what).is_ok(), !kept, "{what}");
    assert_eq!(verdict(&plan(&data, on), what).is_ok(), kept, "{what}");
}

#[test]
fn options_switch_items() {
    switched("view-dependent colour", |c| c.sh_degree = 0, false);
    switched(
        "coarse photos first",
        |c| c.work.resolution_levels = 0,
        false,
    );
    switched(
        "a background of another colour in each iteration",
        |c| c.background = Background::Random,
        true,
    );
    switched("coarse photos first", |c| c.time_budget = Some(9.0), false);
    switched("Morton order", |c| c.work.morton_order = false, false);
    switched(
        "culling of neighbours together",
        |c| c.work.cull_chunks = false,
        false,
    );
    switched(
        "initial Gaussians from sparse points",
        |c| c.init = Init::Random,
        false,
    );
    switched(
        "importance pass and density control",
        |c| c.sampler = Sampler::None,
        false,
    );
    switched("noise on positions", |c| c.mh.noise_rate = 0.0, false);
    switched("births in image space", |c| c.mh.pixel_proposals = 0, false);
}

#[test]
fn data_switch_items() {
    let mut data = room(256);
    let config = TrainConfig::default();
    let small = Plan::new(&room(128), &config);
    assert!(
        verdict(&small, "coarse photos first")
            .unwrap_err()
            .contains("too small")
    );
    let of = |data: &Dataset, what: &str| verdict(&Plan::new(data, &config), what);
    let alpha = "photo alpha over the background";
    assert!(of(&data, alpha).is_err());
    let backgrounds = "a background of another colour in each iteration";
    assert!(of(&data, backgrounds).is_err());
    assert!(of(&data, "undistortion").is_err());
    assert!(of(&data, "held-out evaluation").is_ok());
    assert!(of(&data, "photos decoded ahead of their use").is_err());
    let PhotoSource::Memory(photo) = &data.train[0].photo else {
        panic!("the photos fit");
    };
    let clear = Photo::clone(photo).with_alpha(Alpha::Transparency);
    data.train[0].photo = PhotoSource::Memory(clear.into());
    data.undistorted = 3;
    data.test.clear();
    data.points.positions.clear();
    assert!(of(&data, alpha).is_ok());
    assert!(of(&data, backgrounds).is_ok());
    let blank = "loss skipped where render and photo are blank";
    assert!(of(&data, blank).is_ok());
    let off = plan(&data, |c| c.work.skip_blank = false);
    assert_eq!(verdict(&off, blank).unwrap_err(), "work.skip-blank is off");
    assert!(of(&room(64), blank).unwrap_err().contains("no photo is"));
    let over_white = plan(&data, |c| c.background = Background::White);
    let why = verdict(&over_white, backgrounds).unwrap_err();
    assert_eq!(why, "one colour asked for: white");
    assert!(of(&data, "undistortion").unwrap().contains("3 photos"));
    assert!(of(&data, "held-out evaluation").is_err());
    assert!(of(&data, "initial Gaussians from sparse points").is_err());
    let options = LoadOptions {
        max_size: 64,
        image_budget: Some(30_000),
        ..LoadOptions::default()
    };
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let scarce = load(&path, &options).unwrap();
    assert!(of(&scarce, "photos decoded ahead of their use").is_ok());
}

/// What the plan says after a band of this degree was judged last, in mid-run or at the end.
fn colour(degree: u32, kept: bool, finished: Option<u32>) -> Result<String, String> {
    let config = TrainConfig::default();
    let mut findings = Findings {
        finished,
        ..Findings::default()
    };
    findings.bands.trials.push(BandTrial {
        iteration: 300,
        degree,
        gain: if kept { 0.5 } else { 0.01 },
        kept,
    });
    let plan = Plan::new(&room(64), &config).observed(&config, &findings);
    verdict(&plan, "view-dependent colour")
}

#[test]
fn what_training_finds_is_told() {
    let end = Some(300);
    assert!(
        colour(2, true, end)
            .unwrap()
            .contains("degree 2 is worth +0.500 dB at iteration 300")
    );
    assert!(colour(2, false, end).unwrap().contains("up to SH degree 1"));
    assert!(colour(1, false, end).unwrap_err().contains("+0.010 dB"));
    assert!(
        colour(1, true, None)
            .unwrap()
            .contains("up to SH degree 3, since the first band was worth +0.500 dB")
    );
    assert!(colour(1, false, None).unwrap_err().contains("tried again"));
    let config = TrainConfig::default();
    let before = Plan::new(&room(64), &config);
    assert_eq!(before.since(&before), None);
    let findings = Findings {
        removed: 12,
        finished: Some(300),
        ..Findings::default()
    };
    let after = before.observed(&config, &findings);
    let unseen = "Gaussians that no training view shows";
    assert!(
        verdict(&after, unseen)
            .unwrap_err()
            .starts_with("12 removed")
    );
    let said = after.since(&before).unwrap();
    assert!(
        said.contains("left out: Gaussians that no training view shows: 12 removed"),
        "{said}"
    );
    assert!(!said.contains("Morton"), "{said}");
}

#[test]
fn bars_of_bands_and_short_runs_are_told() {
    let data = room(64);
    let mut few = data.clone();
    few.train.truncate(7);
    let colour = "view-dependent colour";
    let of = |data: &Dataset| verdict(&plan(data, |_| {}), colour).unwrap();
    for (data, first) in [(&data, true), (&few, false)] {
        let said = of(data);
        assert_eq!(said.contains("gain 0.005 dB by the first band"), first);
        assert!(said.contains("miss less than 0.02 dB"), "{said}");
    }
    let papers = plan(&data, |c| c.work.sh_by_need = false);
    assert!(!verdict(&papers, colour).unwrap().contains("dB"));
    let exposure = |iterations| {
        let short = plan(&data, |c| c.iterations = iterations);
        verdict(&short, "per-image exposure").unwrap_err()
    };
    assert!(exposure(300).contains("too short to tell"));
    assert!(exposure(301).contains("compared with their renders"));
}
