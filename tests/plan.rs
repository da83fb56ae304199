//! The plan: what switches each item on, and what is said of it.

use crate::determinism::room;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, Photo, PhotoSource, load};
use mhsplat::config::{Background, Init, Length, Sampler, TrainConfig, TrainingSize};
use mhsplat::run::{Item, PlanRecord};
use mhsplat::train::{Learned, Plan};

/// Why an item is kept (`Ok`) or left out (`Err`); panics if it is on both lists or on none.
fn verdict(plan: &PlanRecord, what: &str) -> Result<String, String> {
    let find = |items: &[Item]| items.iter().find(|i| i.what == what).map(|i| i.why.clone());
    match (find(&plan.kept), find(&plan.left_out)) {
        (Some(why), None) => Ok(why),
        (None, Some(why)) => Err(why),
        found => panic!("{what}: {found:?}"),
    }
}

fn plan(data: &Dataset, change: impl Fn(&mut TrainConfig)) -> PlanRecord {
    let mut config = TrainConfig::default();
    change(&mut config);
    PlanRecord::of(&Plan::new(data, &config).unwrap())
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
        "progressive resolution",
        |c| c.work.resolution_levels = 0,
        false,
    );
    switched(
        "random background in each iteration",
        |c| c.background = Background::Random,
        true,
    );
    switched("Morton order", |c| c.work.morton_order = false, false);
    switched("block culling", |c| c.work.cull_chunks = false, false);
    switched(
        "initial Gaussians from points",
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
    let bound = "bound of the number of Gaussians";
    switched(bound, |c| c.mh.pair_pixels = 0.0, false);
    let free = "space about the cameras kept free";
    switched(free, |c| c.clearance = 0.0, false);
    let early = "births from the first density step on";
    switched(early, |c| c.init = Init::Random, true);
}

#[test]
fn data_switch_items() {
    let mut data = room(256);
    let small = plan(&room(128), |_| {});
    assert!(
        verdict(&small, "progressive resolution")
            .unwrap_err()
            .contains("too small")
    );
    let of = |data: &Dataset, what: &str| verdict(&plan(data, |_| {}), what);
    let alpha = "photo alpha over the background";
    assert!(of(&data, alpha).is_err());
    let backgrounds = "random background in each iteration";
    assert!(of(&data, backgrounds).is_err());
    assert!(of(&data, "undistortion").is_err());
    assert!(of(&data, "held-out evaluation").is_ok());
    assert!(of(&data, "photo prefetch").is_err());
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
    let blank = "loss skipped in blank tiles";
    assert!(of(&data, blank).is_ok());
    let off = plan(&data, |c| c.work.skip_blank = false);
    assert_eq!(verdict(&off, blank).unwrap_err(), "work.skip-blank is off");
    assert!(of(&room(64), blank).unwrap_err().contains("no photo is"));
    let over_white = plan(&data, |c| c.background = Background::White);
    let why = verdict(&over_white, backgrounds).unwrap_err();
    assert_eq!(why, "one colour asked for: white");
    let shortened = |c: &mut TrainConfig| {
        let size = TrainingSize::ThreeQuarters;
        c.lengths = vec![Length {
            from: 20,
            iterations: 500,
            size,
        }];
    };
    for (data, even) in [(&data, 600), (&room(64), 1200)] {
        let budgets = Plan::new(data, &TrainConfig::default())
            .unwrap()
            .for_budgets();
        assert_eq!(budgets.work.resolution_iterations, even);
        let why = verdict(&plan(data, shortened), "photos of the size asked for").unwrap_err();
        assert!(why.contains(&format!("what {even} it")), "{why}");
    }
    assert!(of(&data, "undistortion").unwrap().contains("3 photos"));
    assert!(of(&data, "held-out evaluation").is_err());
    assert!(of(&data, "initial Gaussians from points").is_err());
    let free = verdict(&plan(&data, |_| {}), "space about the cameras kept free");
    assert!(free.unwrap_err().contains("no points"));
    let options = LoadOptions {
        max_size: 64,
        image_budget: Some(30_000),
        ..LoadOptions::default()
    };
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let scarce = load(&path, &options).unwrap();
    assert!(of(&scarce, "photo prefetch").is_ok());
}

/// The pairs of opaque photos or the points bound the births of mh, whichever allow more; the user's number comes before both.
#[test]
fn photos_bound_the_gaussians() {
    let data = room(64);
    let decided = |data: &Dataset, change: fn(&mut TrainConfig)| {
        let mut config = TrainConfig::default();
        change(&mut config);
        let plan = Plan::new(data, &config).unwrap();
        (plan.most_gaussians.value, PlanRecord::of(&plan))
    };
    let most = |data: &Dataset, change: fn(&mut TrainConfig)| decided(data, change).0;
    let (photos, points) = (data.train.len(), data.points.positions.len());
    let pixels = |data: &Dataset| -> u32 {
        let cameras = data.train.iter().map(|v| &v.camera);
        cameras.map(|c| c.width * c.height).sum()
    };
    let by_pairs = |data: &Dataset, places: usize| {
        (f64::from(pixels(data)) * (places - 1) as f64 / 2.0 / 700.0) as usize
    };
    let by_pixels = |data: &Dataset| (f64::from(pixels(data)) / 64.0) as usize;
    let fewer_points = |mut data: Dataset, left: usize| {
        data.points.positions.truncate(left);
        data
    };
    let what = "bound of the number of Gaussians";

    assert!(by_pairs(&data, photos) < points);
    let (value, record) = decided(&data, |_| {});
    assert_eq!(value, Some(points));
    let said = format!("as many Gaussians as sparse points, {points}:");
    assert!(verdict(&record, what).unwrap().contains(&said));
    // As many as were looked for say nothing about the photos.
    let found = Dataset {
        swept: Some(points),
        ..data.clone()
    };
    let by_photos = by_pairs(&data, photos).max(by_pixels(&data));
    assert_eq!(most(&found, |_| {}), Some(by_photos));
    let mut large = room(256);
    let (value, record) = decided(&large, |_| {});
    assert_eq!(value, Some(by_pairs(&large, photos)));
    let said = format!("no births beyond {} Gaussians", value.unwrap());
    assert!(verdict(&record, what).unwrap().starts_with(&said));

    // The sides of a panorama have one centre.
    large.train[1].camera = large.train[0].camera;
    assert_eq!(most(&large, |_| {}), Some(by_pairs(&large, photos - 1)));
    large.train.truncate(1);
    assert_eq!(most(&large, |_| {}), Some(points));
    let few = fewer_points(large, 100);
    assert_eq!(most(&few, |_| {}), Some(by_pixels(&few)));
    assert_eq!(
        most(&data, |c| c.mh.pair_pixels = 1e-300),
        Some(u32::MAX as usize)
    );

    assert_eq!(most(&data, |c| c.mh.pair_pixels = 0.0), None);
    assert_eq!(most(&data, |c| c.max_gaussians = Some(7)), Some(7));
    for sampler in [Sampler::Mcmc, Sampler::Adc, Sampler::None] {
        let config = TrainConfig {
            sampler,
            ..TrainConfig::default()
        };
        assert_eq!(
            Plan::new(&data, &config).unwrap().most_gaussians.value,
            None
        );
    }
    assert_eq!(most(&data, |c| c.init = Init::Random), None);
    assert_eq!(most(&data, |c| c.init = Init::File("x.ply".into())), None);
    for alpha in [Alpha::Transparency, Alpha::Mask] {
        let mut data = room(64);
        let PhotoSource::Memory(photo) = &data.train[0].photo else {
            panic!("the photos fit");
        };
        let clear = Photo::clone(photo).with_alpha(alpha);
        data.train[0].photo = PhotoSource::Memory(clear.into());
        assert_eq!(most(&data, |_| {}), None, "{alpha:?}");
        assert_eq!(most(&data, |c| c.max_gaussians = Some(7)), Some(7));
    }
}

#[test]
fn what_training_finds_is_told() {
    let config = TrainConfig::default();
    let mut plan = Plan::new(&room(64), &config).unwrap();
    let learned = Learned {
        removed: 12,
        finished: Some(300),
        ..Learned::default()
    };
    let decisions = plan.learn(&learned);
    assert_eq!(decisions.len(), 1);
    assert!(decisions[0].to_string().contains("12 removed"));
    assert!(plan.learn(&learned).is_empty(), "learned once");
    let after = PlanRecord::of(&plan);
    let unseen = "whatever no training view shows";
    assert!(
        verdict(&after, unseen)
            .unwrap_err()
            .starts_with("12 removed")
    );
    let mut whole = Plan::new(&room(64), &config).unwrap();
    let kept = Learned {
        removed: 0,
        ..learned
    };
    assert!(
        whole.learn(&kept).is_empty() && whole.unseen.is_none(),
        "nothing was removed, nothing is said"
    );
}

#[test]
fn short_runs_are_told() {
    let data = room(64);
    let exposure = |iterations| {
        let short = plan(&data, |c| c.iterations = iterations);
        verdict(&short, "per-image exposure").unwrap_err()
    };
    assert!(exposure(300).contains("too short to tell"));
    assert!(exposure(301).contains("compared with their renders"));
}
