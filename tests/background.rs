//! What lies behind transparent photos: another colour in each iteration, unless one is asked for.

use crate::determinism::{drive, room, saved, trained};
use mhsplat::Plan;
use mhsplat::capture::{Alpha, Dataset, Photo, PhotoSource};
use mhsplat::config::{Background, Sampler, TrainConfig};
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{CameraArg, Device};
use mhsplat::pipeline::forward::RenderOptions;
use mhsplat::run::{checkpoint, initial_gaussians};
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::schedule::Schedule;
use mhsplat::train::{Begun, Trainer};

/// The room's photos with this alpha in their left halves.
pub fn holed(alpha: u8, meaning: Alpha) -> Dataset {
    let mut data = room(64);
    for view in data.train.iter_mut().chain(&mut data.test) {
        let photo = view.photo.load().unwrap();
        let (w, pixels) = (photo.width as usize, (photo.width * photo.height) as usize);
        let rgba: Vec<u8> = (0..4 * pixels)
            .map(|k| match (k % 4, k / 4) {
                (3, at) if at % w < w / 2 => alpha,
                (3, _) => 255,
                (c, at) => photo.data[c * pixels + at],
            })
            .collect();
        let (w, h) = (photo.width, photo.height);
        let photo = Photo::from_interleaved(w, h, meaning, &rgba).unwrap();
        view.photo = PhotoSource::Memory(photo.into());
    }
    data
}

fn config(background: Background) -> TrainConfig {
    TrainConfig {
        iterations: 90,
        max_size: 64,
        sh_degree: 1,
        seed: 5,
        background,
        ..TrainConfig::default()
    }
}

#[test]
fn the_schedule_changes_it_where_photos_are_transparent() {
    let of = |background| {
        let schedule = Schedule::new(&config(background));
        let over = |transparent| {
            let random = background.changes(transparent);
            [0, 1, 2].map(|i| schedule.background(i, random))
        };
        (over(false), over(true), schedule.fixed_background())
    };
    let (black, white, grey) = ([0.0; 3], [1.0; 3], [0.5; 3]);
    for (background, color) in [
        (Background::Black, black),
        (Background::White, white),
        (Background::Color(grey), grey),
    ] {
        assert_eq!(of(background), ([color; 3], [color; 3], color));
    }
    let (opaque, transparent, fixed) = of(Background::Auto);
    assert_eq!((opaque, fixed), ([black; 3], black));
    assert!(transparent[0] != transparent[1] && transparent[1] != transparent[2]);
    assert_eq!(of(Background::Random), (transparent, transparent, black));
    for background in [Background::Auto, Background::Random, Background::White] {
        let text = String::from(background);
        assert_eq!(text.parse::<Background>().unwrap(), background, "{text}");
    }
    assert_eq!(TrainConfig::default().background, Background::Auto);
}

/// The mean colour of the photos by its definition, to three decimals.
fn mean(data: &Dataset) -> [f32; 3] {
    let photos: Vec<_> = data.train.iter().map(|v| v.photo.load().unwrap()).collect();
    // As many as are looked at, evenly spread.
    let count = photos.len().min(8);
    let photos = (0..count).map(|k| &photos[k * photos.len() / count]);
    let photos: Vec<&Photo> = photos.map(|photo| &**photo).collect();
    [0, 1, 2].map(|c| {
        let pixels = |photo: &Photo| (photo.width * photo.height) as usize;
        let plane = |photo: &Photo| photo.data[c * pixels(photo)..][..pixels(photo)].to_vec();
        let values: Vec<u8> = photos.iter().flat_map(|photo| plane(photo)).collect();
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
        ((mean / 255.0 * 1000.0).round() / 1000.0) as f32
    })
}

#[test]
fn opaque_photos_are_trained_over_their_mean_color() {
    let plan = |data: &Dataset, background| Plan::new(data, &config(background)).unwrap();
    let opaque = room(64);
    let decided = plan(&opaque, Background::Auto);
    let color = mean(&opaque);
    assert_eq!(decided.background.value, color);
    assert_eq!(decided.behind(), Some(color));
    assert_eq!(decided.schedule().fixed_background(), color);
    let said = format!("{:.3}, {:.3}, {:.3}", color[0], color[1], color[2]);
    let why = decided.background.why.to_string();
    assert!(why.contains(&said), "{why}");
    // What nobody is to see behind a scene, and what is asked for.
    let black = [0.0; 3];
    let holes = [
        (holed(0, Alpha::Mask), Background::Auto, black, None),
        (holed(0, Alpha::Transparency), Background::Auto, black, None),
        (
            holed(0, Alpha::Transparency),
            Background::White,
            [1.0; 3],
            None,
        ),
        (room(64), Background::Random, black, None),
        (room(64), Background::Black, black, None),
        (room(64), Background::White, [1.0; 3], Some([1.0; 3])),
    ];
    for (data, asked, color, behind) in holes {
        let decided = plan(&data, asked);
        assert_eq!(decided.background.value, color, "{asked:?}");
        assert_eq!(decided.behind(), behind, "{asked:?}");
    }
    // A run that began over black goes on over it, and one over a colour over that.
    for color in [black, [0.5, 0.25, 0.125]] {
        let begun = Begun {
            background: Some(color),
            ..Begun::default()
        };
        let decided = Plan::begun(&opaque, &config(Background::Auto), &begun).unwrap();
        assert_eq!(decided.background.value, color);
    }
}

#[test]
fn training_asks_what_its_photos_are() {
    let of = |data: &Dataset, background| trained(data, &config(background), 40).1;
    let same = |data: &Dataset| of(data, Background::Auto) == of(data, Background::Black);
    let opaque = room(64);
    assert!(!same(&opaque));
    let mean = Background::Color(mean(&opaque));
    assert!(of(&opaque, Background::Auto) == of(&opaque, mean));
    let masked = holed(0, Alpha::Mask);
    assert_eq!(masked.alpha(), Alpha::Mask);
    assert!(same(&masked));
    let transparent = holed(0, Alpha::Transparency);
    assert!(!same(&transparent));
    assert!(of(&transparent, Background::Auto) == of(&transparent, Background::Random));
}

#[test]
fn a_resumed_run_over_changing_backgrounds_ends_with_the_same_bits() {
    let data = holed(100, Alpha::Transparency);
    let mut config = config(Background::Auto);
    config.mh.surrogate = mhsplat::config::Surrogate::Probe;
    let (done, whole) = trained(&data, &config, 90);
    assert!(done.stats().accepted > 0 && done.stats().pixel[0] > 0);
    let (mut half, _) = trained(&data, &config, 33);
    let folder = tempfile::tempdir().unwrap();
    checkpoint::write(folder.path(), &saved(&mut half, &config, &data)).unwrap();
    let saved = checkpoint::read(folder.path()).unwrap();
    let device = Device::open(None).unwrap();
    let mut trainer = Trainer::new(
        &device,
        &data,
        &Plan::new(&data, &config).unwrap(),
        &saved.state.splats,
    )
    .unwrap();
    trainer.restore(&saved.state).unwrap();
    drive(&mut trainer, 90).unwrap();
    assert!(trainer.state().unwrap().splats == whole);
}

/// Photos in which there is nothing, and black fog before them.
fn fog(background: Background) -> (Dataset, TrainConfig, Gaussians) {
    let mut data = room(64);
    for view in &mut data.train {
        let (w, h) = (view.camera.width, view.camera.height);
        let clear =
            Photo::from_interleaved(w, h, Alpha::Transparency, &vec![0; 4 * (w * h) as usize])
                .unwrap();
        view.photo = PhotoSource::Memory(clear.into());
    }
    let mut config = TrainConfig {
        iterations: 150,
        sh_degree: 0,
        ..config(background)
    };
    (config.loss.lambda_opacity, config.loss.lambda_scale) = (0.0, 0.0);
    let mut splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    for c in 0..3 {
        // Far below black, so that no gradient of the colour moves it.
        splats.plane_mut(Plane::SH + c).fill(-4.0);
    }
    splats.plane_mut(Plane::OPACITY).fill(0.0);
    (data, config, splats)
}

/// Over one background a scene keeps fog of its colour in front of what is transparent, which other views would show.
#[test]
fn fog_of_the_backgrounds_colour_does_not_last() {
    let of = |background| {
        let (data, mut config, splats) = fog(background);
        config.sampler = Sampler::None;
        let device = Device::open(None).unwrap();
        let mut trainer =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        drive(&mut trainer, config.iterations).unwrap();
        trainer.state().unwrap().splats.planes()[Plane::OPACITY].clone()
    };
    assert!(of(Background::Black).iter().all(|o| o.abs() < 1e-3));
    let left = of(Background::Auto);
    let lasting = left.iter().filter(|logit| **logit > -1.0).count();
    assert!(lasting < left.len() / 10, "{lasting} of {}", left.len());
}

/// Where a photo is clear no error brings a Gaussian of the background's colour into being there.
#[test]
fn nothing_is_born_in_image_space_where_there_is_nothing() {
    let born = |data: &Dataset, config: &TrainConfig, splats: &Gaussians| {
        let device = Device::open(None).unwrap();
        let mut trainer =
            Trainer::new(&device, data, &Plan::new(data, config).unwrap(), splats).unwrap();
        drive(&mut trainer, config.iterations).unwrap();
        trainer.stats().pixel[0]
    };
    let (data, mut config, splats) = fog(Background::Auto);
    (config.mh.coarse_proposals, config.mh.fine_proposals) = (0, 0);
    assert_eq!(born(&data, &config, &splats), 0);
    assert!(born(&holed(0, Alpha::Transparency), &config, &splats) > 0);
}

/// The loss is that of the scene, and not of the backgrounds that the last iterations happened to have.
#[test]
fn the_loss_does_not_depend_on_chance_backgrounds() {
    let data = holed(0, Alpha::Transparency);
    let losses = |rate: f64| {
        let mut config = config(Background::Auto);
        config.sampler = Sampler::None;
        let o = &mut config.optimizer;
        (o.lr_position, o.lr_position_final) = (0.0, 0.0);
        (o.lr_sh0, o.lr_sh, o.lr_opacity) = (rate, 0.0, 0.0);
        (o.lr_scale, o.lr_rotation) = (0.0, 0.0);
        let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
        let device = Device::open(None).unwrap();
        let mut trainer =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        [40, 80].map(|until| {
            drive(&mut trainer, until).unwrap();
            trainer.recent_loss().unwrap().unwrap()
        })
    };
    let [before, after] = losses(0.0);
    assert!(before > 0.0 && before == after);
    let [before, after] = losses(1e-3);
    assert!(after < before);
}

/// Gaussians in the middle of the room alone, so that tiles of every photo have none.
fn small(data: &Dataset, config: &TrainConfig) -> Gaussians {
    let mut splats = initial_gaussians(data, &Plan::new(data, config).unwrap()).unwrap();
    for p in 0..3 {
        let position = splats.plane_mut(Plane::POSITION + p);
        position.iter_mut().for_each(|x| *x *= 0.1);
        splats.plane_mut(Plane::LOG_SCALE + p).fill(-5.0);
    }
    splats
}

/// What is blank has no loss, and what is not does not notice.
#[test]
fn skipping_what_is_blank_changes_no_bit() {
    for (meaning, sampler) in [
        (Alpha::Transparency, Sampler::None),
        (Alpha::Mask, Sampler::None),
        (Alpha::Transparency, Sampler::Mh),
        (Alpha::Mask, Sampler::Mh),
    ] {
        let data = holed(0, meaning);
        let mut config = config(Background::Auto);
        config.sampler = sampler;
        // Births of more views reach every tile.
        (config.mh.pixel_views, config.mh.pixel_tolerance) = (2, 0.0);
        let splats = small(&data, &config);
        // Of larger ones none of these photos is blank.
        let device = Device::open(None).unwrap();
        let tuning = Tuning {
            tile: 16,
            ..device.tuning()
        };
        let device = device.with_tuning(tuning);
        let of = |config: &TrainConfig| {
            let mut trainer =
                Trainer::new(&device, &data, &Plan::new(&data, config).unwrap(), &splats).unwrap();
            drive(&mut trainer, config.iterations).unwrap();
            trainer
        };
        let mut skipped = of(&config);
        config.work.skip_blank = false;
        let whole = of(&config).state().unwrap().splats;
        assert!(
            skipped.state().unwrap().splats == whole,
            "{meaning:?} {sampler:?}"
        );
        config.seed += 1;
        assert!(
            of(&config).state().unwrap().splats != whole,
            "{meaning:?} {sampler:?}"
        );
        let camera = CameraArg::new(&data.train[0].camera, device.tuning().tile);
        let (scene, renderer) = skipped.scene_and_renderer().unwrap();
        renderer
            .render(scene, &camera, &RenderOptions::default())
            .unwrap();
        let pairs = renderer.intersections_per_tile().unwrap();
        let across = camera.across as usize;
        let clear = |t: &usize| t % across < across / 2 && pairs[*t] == 0;
        assert!((0..pairs.len()).any(|t| clear(&t)), "nothing was blank");
        assert!(pairs.iter().any(|n| *n > 0));
    }
}
