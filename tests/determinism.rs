//! Same seed, same bits; interruptions and small buffers change nothing.

use mhsplat::Plan;
use mhsplat::capture::{Dataset, LoadOptions, load};
use mhsplat::config::{ExposureChoice, Length, MhConfig, Sampler, TrainingSize};
use mhsplat::device::Device;
use mhsplat::device::tuning::Tuning;
use mhsplat::run::checkpoint::Checkpoint;
use mhsplat::run::{Reading, checkpoint, initial_gaussians};
use mhsplat::scene::Gaussians;
use mhsplat::train::Event;
use mhsplat::train::schedule::Schedule;
use mhsplat::train::sizes::Sizes;
use mhsplat::train::{Trainer, TrainerState};
use mhsplat::{Result, TrainConfig};

/// The bundled scene.
pub fn room(max_size: u32) -> Dataset {
    room_within(max_size, None)
}

/// The bundled scene with so many bytes for photos.
pub fn room_within(max_size: u32, image_budget: Option<u64>) -> Dataset {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    load(
        &path,
        &LoadOptions {
            max_size,
            image_budget,
            ..LoadOptions::default()
        },
    )
    .unwrap()
}

fn config(iterations: u32) -> TrainConfig {
    TrainConfig {
        iterations,
        max_size: 64,
        sh_degree: 2,
        seed: 5,
        // The set grows.
        mh: MhConfig {
            pair_pixels: 0.0,
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    }
}

pub fn saved(trainer: &mut Trainer, config: &TrainConfig, data: &Dataset) -> Checkpoint {
    Checkpoint {
        state: trainer.state().unwrap(),
        config: config.clone(),
        clock: Reading::default(),
        dataset: data.fingerprint(),
        tuning: Device::open(None).unwrap().tuning(),
        stages: Vec::new(),
    }
}

pub fn drive(trainer: &mut Trainer, until: u32) -> Result<()> {
    trainer.advance_to(until)
}

pub fn trained(dataset: &Dataset, config: &TrainConfig, until: u32) -> (Trainer, Gaussians) {
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(dataset, &Plan::new(dataset, config).unwrap()).unwrap();
    let mut trainer = Trainer::new(
        &device,
        dataset,
        &Plan::new(dataset, config).unwrap(),
        &splats,
    )
    .unwrap();
    drive(&mut trainer, until).unwrap();
    let splats = trainer.state().unwrap().splats;
    (trainer, splats)
}

/// Those that change the set.
const SAMPLERS: [Sampler; 3] = [Sampler::Mh, Sampler::Mcmc, Sampler::Adc];

/// A run of 120 iterations, with a density step every 25 or so.
pub fn sampled(sampler: Sampler) -> TrainConfig {
    TrainConfig {
        sampler,
        ..config(120)
    }
}

#[test]
fn same_seed_same_bits_and_another_seed_other_bits() {
    let data = room(64);
    for config in SAMPLERS.map(sampled) {
        let (trainer, first) = trained(&data, &config, 120);
        let s = trainer.stats();
        let took_part = match config.sampler {
            Sampler::Adc => s.cloned > 0 && s.split > 0 && s.pruned > 0 && s.opacity_resets > 0,
            Sampler::Mcmc => s.accepted > 0 && s.relocated > 0,
            _ => s.accepted > 0,
        };
        assert!(took_part, "{s:?}");
        assert!(first == trained(&data, &config, 120).1);
        let other = TrainConfig { seed: 6, ..config };
        assert!(
            first != trained(&data, &other, 120).1,
            "the comparison must be able to fail"
        );
    }
}

#[test]
fn a_resumed_run_ends_with_the_same_bits() {
    let data = room(64);
    // After 48 iterations gradients and errors for the density step after 50 are half gathered.
    for config in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None].map(sampled) {
        let (_, whole) = trained(&data, &config, 120);
        let (mut half, _) = trained(&data, &config, 48);
        let folder = tempfile::tempdir().unwrap();
        checkpoint::write(folder.path(), &saved(&mut half, &config, &data)).unwrap();
        drop(half);
        let saved = checkpoint::read(folder.path()).unwrap();
        assert_eq!(saved.config, config);
        assert_eq!(saved.dataset, data.fingerprint());
        let rows = [3, 0, 2, 0][config.sampler as usize];
        assert_eq!(saved.state.rows.statistics.len(), rows);
        let gathered = saved
            .state
            .rows
            .statistics
            .last()
            .is_none_or(|views| views.iter().any(|v| *v > 0.0));
        assert!(gathered, "{:?}", config.sampler);
        let device = Device::open(None).unwrap();
        let mut trainer = Trainer::new(
            &device,
            &data,
            &Plan::new(&data, &config).unwrap(),
            &saved.state.splats,
        )
        .unwrap();
        trainer.restore(&saved.state).unwrap();
        drive(&mut trainer, 120).unwrap();
        assert!(
            whole == trainer.state().unwrap().splats,
            "{:?}",
            config.sampler
        );
    }
}

/// Advances to the end and keeps the state after the first event of each kind and after every density step and pause.
fn states_at_events(trainer: &mut Trainer) -> Vec<(Event, TrainerState)> {
    let mut kept: Vec<(Event, TrainerState)> = Vec::new();
    loop {
        let event = trainer.advance().unwrap();
        let kind = std::mem::discriminant(&event);
        let known = kept.iter().any(|(e, _)| std::mem::discriminant(e) == kind);
        if !known || matches!(event, Event::Density(_) | Event::Settled(_)) {
            kept.push((event.clone(), trainer.state().unwrap()));
        }
        if event == Event::Finished {
            return kept;
        }
    }
}

#[test]
fn a_run_does_not_end_within_the_time_that_births_are_given() {
    let schedule = Schedule::new(&config(3000));
    let steps: Vec<u32> = (0..3000)
        .filter(|i| schedule.density_due(*i).is_some())
        .collect();
    let [first, second] = [steps[0], steps[1]];
    assert!(schedule.recovered(first - 1) && schedule.recovered(first));
    assert!(!schedule.recovered(first + 1) && !schedule.recovered(first + 24));
    assert!(schedule.recovered(first + 25) && schedule.recovered(second));
    assert!(schedule.recovered(2999));
}

#[test]
fn a_run_goes_on_from_every_event_with_the_same_bits() {
    let data = room(64);
    let config = TrainConfig {
        exposure: ExposureChoice::On,
        eval_every: Some(40),
        export_every: 50,
        ..config(100)
    };
    let (mut straight, _) = trained(&data, &config, 0);
    let states = states_at_events(&mut straight);
    let kinds = |of: fn(&Event) -> bool| states.iter().filter(|(e, _)| of(e)).count();
    assert!(kinds(|e| matches!(e, Event::Density(_))) > 1);
    assert!(kinds(|e| matches!(e, Event::Settled(_))) > 2);
    for one in [
        kinds(|e| matches!(e, Event::Iteration { .. })),
        kinds(|e| matches!(e, Event::Compiling)),
        kinds(|e| matches!(e, Event::Compiled)),
        kinds(|e| matches!(e, Event::Finished)),
    ] {
        assert_eq!(one, 1);
    }
    // Gaussians that are removed at the end are the only decision here.
    let decided = kinds(|e| matches!(e, Event::Decided(_)));
    let removed = straight.state().unwrap().learned.removed;
    assert_eq!(decided, usize::from(removed > 0));
    // What is born has not found its place right after a density step: a pause comes before it.
    let at = |of: &dyn Fn(&Event) -> bool| states.iter().position(|(e, _)| of(e)).unwrap();
    let pause = at(&|e| *e == Event::Settled(50));
    assert!(pause < at(&|e| matches!(e, Event::Density(d) if d.iteration == 50)));
    let end = straight.state().unwrap();
    let device = Device::open(None).unwrap();
    let plan = Plan::new(&data, &config).unwrap();
    for (event, state) in &states {
        let mut resumed = Trainer::new(&device, &data, &plan, &state.splats).unwrap();
        resumed.restore(state).unwrap();
        while resumed.advance().unwrap() != Event::Finished {}
        let state = resumed.state().unwrap();
        assert!(end.splats == state.splats, "{event:?}");
        assert!(end.losses == state.losses, "{event:?}");
        assert_eq!(end.learned, state.learned, "{event:?}");
    }
}

#[test]
fn cues_of_another_sampler_are_refused() {
    let data = room(64);
    let (mut adc, _) = trained(&data, &sampled(Sampler::Adc), 3);
    let state = adc.state().unwrap();
    let (mut mh, _) = trained(&data, &sampled(Sampler::Mh), 0);
    let said = mh.restore(&state).unwrap_err().to_string();
    assert!(
        said.contains("2 rows of error statistics; 3 expected"),
        "{said}"
    );
}

#[test]
fn culling_neighbours_together_changes_no_bit() {
    let (data, config) = (room(64), config(80));
    let (_, culled) = trained(&data, &config, 80);
    let mut everything = config.clone();
    everything.work.cull_chunks = false;
    assert!(culled == trained(&data, &everything, 80).1);
    // Another order adds in another order: the comparison can fail.
    let mut unordered = config;
    unordered.work.morton_order = false;
    assert!(culled != trained(&data, &unordered, 80).1);
}

#[test]
fn a_run_that_begins_with_coarse_photos_resumes_with_the_same_bits() {
    let (data, mut config) = (room(200), config(60));
    config.work.resolution_levels = 1;
    (config.work.resolution_detail, config.work.resolution_share) = (1e-6, 0.5);
    let (_, whole) = trained(&data, &config, 60);
    let (mut part, _) = trained(&data, &config, 20);
    let state = part.state().unwrap();
    let device = Device::open(None).unwrap();
    let mut trainer = Trainer::new(
        &device,
        &data,
        &Plan::new(&data, &config).unwrap(),
        &state.splats,
    )
    .unwrap();
    trainer.restore(&state).unwrap();
    drive(&mut trainer, 60).unwrap();
    assert!(whole == trainer.state().unwrap().splats);
    config.work.resolution_levels = 0;
    assert!(
        whole != trained(&data, &config, 60).1,
        "coarse photos must have been used"
    );
}

#[test]
fn coarse_photos_come_first_and_keep_64_pixels() {
    let schedule = Schedule::new(&config(3000));
    let sizes = Sizes::at_shares(&[0.05, 0.1]);
    let factors = |size| [0, 149, 150, 299, 300].map(|i| schedule.scale_of(&sizes, i, size).den);
    assert_eq!(factors([800, 600]), [4, 4, 2, 2, 1]);
    assert_eq!(factors([800, 200]), [2, 2, 2, 2, 1]);
    assert_eq!(factors([100, 90]), [1; 5]);
}

#[test]
fn photos_do_not_shrink_again_in_a_run_that_gets_longer() {
    let (sizes, photo) = (Sizes::at_shares(&[0.75]), [800, 600]);
    let mut schedule = Schedule::new(&config(1000));
    let mut lengthen = |from, iterations| {
        schedule.set_length(Length::new(from, iterations));
        let factors = [0, 749, 750, 2249, 2250].map(|i| schedule.scale_of(&sizes, i, photo).den);
        (factors, schedule.full_size_from(&sizes, photo))
    };
    // Full size was reached before; then not yet, and at once when the run gets shorter.
    assert_eq!(lengthen(800, 3000), ([2, 2, 1, 1, 1], 750));
    assert_eq!(lengthen(400, 3000), ([2, 2, 2, 2, 1], 2250));
    assert_eq!(lengthen(900, 1000), ([2, 2, 2, 1, 1], 900));
}

/// The largest size is that of the length; smaller sizes come from it, whatever it is.
#[test]
fn a_length_says_the_largest_size_of_the_photos() {
    let (sizes, photo) = (Sizes::at_shares(&[0.25, 0.5]), [800, 600]);
    let mut schedule = Schedule::new(&config(1000));
    let mut set = |from, iterations, size| {
        schedule.set_length(Length {
            size,
            ..Length::new(from, iterations)
        });
        let at = [0, 100, 300, 700, 950].map(|i| schedule.scale_of(&sizes, i, photo));
        let at = at.map(|scale| (scale.num, scale.den));
        (at, schedule.full_size_from(&sizes, photo))
    };
    let quarters = set(20, 1000, TrainingSize::ThreeQuarters);
    assert_eq!(quarters, ([(1, 4), (3, 16), (3, 8), (3, 4), (3, 4)], 500));
    let full = set(900, 1200, TrainingSize::Full);
    assert_eq!(full, ([(1, 4), (3, 16), (3, 8), (3, 4), (1, 1)], 900));
}

#[test]
fn a_damaged_checkpoint_is_refused() {
    let (data, config) = (room(64), config(10));
    let (mut trainer, _) = trained(&data, &config, 2);
    let folder = tempfile::tempdir().unwrap();
    checkpoint::write(folder.path(), &saved(&mut trainer, &config, &data)).unwrap();
    let file = checkpoint::path(folder.path());
    let bytes = std::fs::read(&file).unwrap();
    for keep in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&file, &bytes[..keep]).unwrap();
        assert!(
            checkpoint::read(folder.path()).is_err(),
            "{keep} of {} bytes",
            bytes.len()
        );
    }
}

#[test]
fn pairs_that_do_not_fit_are_repeated_not_lost() {
    let data = room(64);
    // As many iterations as it takes to have two density steps.
    for config in SAMPLERS.map(sampled) {
        let (_, roomy) = trained(&data, &config, 60);
        let device = Device::open(None).unwrap();
        assert!(
            roomy == overflowing(&device, &data, &config, 60),
            "{:?}",
            config.sampler
        );
    }
}

/// The style of GPUs sorts pairs by tile: those that were left over from before must not count.
#[test]
fn pairs_that_do_not_fit_are_repeated_in_the_other_style() {
    let (data, config) = (room(64), sampled(SAMPLERS[0]));
    let device = Device::open(None).unwrap().with_tuning(Tuning {
        chunks: 64,
        ..Tuning::GPU
    });
    let plan = Plan::new(&data, &config).unwrap();
    let splats = initial_gaussians(&data, &plan).unwrap();
    let mut roomy = Trainer::new(&device, &data, &plan, &splats).unwrap();
    drive(&mut roomy, 12).unwrap();
    assert!(roomy.state().unwrap().splats == overflowing(&device, &data, &config, 12));
}

/// Gaussians after a training that has had too little room for its pairs.
fn overflowing(
    device: &Device,
    data: &Dataset,
    config: &TrainConfig,
    iterations: u32,
) -> Gaussians {
    let plan = Plan::new(data, config).unwrap();
    let splats = initial_gaussians(data, &plan).unwrap();
    let mut tight = Trainer::new(device, data, &plan, &splats).unwrap();
    tight.shrink_intersections(256).unwrap();
    drive(&mut tight, iterations).unwrap();
    assert!(
        tight.overflows() > 0,
        "the small buffer must have overflowed"
    );
    tight.state().unwrap().splats
}

#[test]
fn an_overflow_right_after_density_control_does_not_repeat_it() {
    let data = room(64);
    for config in SAMPLERS.map(sampled) {
        let (roomy, whole) = trained(&data, &config, 120);
        let device = Device::open(None).unwrap();
        let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
        let mut tight =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        let mut shrunk = 0;
        while tight.iteration() < 120 {
            if let Event::Density(_) = tight.advance().unwrap() {
                // The next iteration finds no room, and the trainer comes back to this one.
                tight.shrink_intersections(1024).unwrap();
                shrunk += 1;
            }
        }
        tight.settle().unwrap();
        assert!(shrunk >= 2 && tight.overflows() >= shrunk);
        assert_eq!(tight.stats(), roomy.stats());
        assert!(
            whole == tight.state().unwrap().splats,
            "{:?}",
            config.sampler
        );
    }
}

#[test]
fn fingerprints_tell_datasets_apart() {
    let data = room(64);
    assert_eq!(data.fingerprint(), room(64).fingerprint());
    assert_ne!(data.fingerprint(), room(32).fingerprint());
    let mut moved = data.clone();
    moved.train[3].camera.translation.x += 1e-9;
    assert_ne!(data.fingerprint(), moved.fingerprint());
}

#[test]
fn making_a_trainer_changes_no_gaussian() {
    let data = room(64);
    let device = Device::open(None).unwrap();
    // 256 rows fill the planes to the last one where nothing is to grow.
    for sampler in [Sampler::None, Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = TrainConfig {
            sampler,
            max_gaussians: Some(256),
            ..config(60)
        };
        let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
        assert_eq!(splats.len(), 256);
        let mut trainer =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        assert!(trainer.state().unwrap().splats == splats, "{sampler:?}");
    }
}

/// What density control may do beyond the paper: pictures are rendered between iterations, and nothing is kept of them.
#[test]
fn births_in_image_space_and_a_wanted_rate_repeat_and_resume() {
    let data = room(64);
    let mut config = sampled(Sampler::Mh);
    config.mh.pixel_proposals = 500;
    config.mh.target_acceptance = [0.5, 0.2];
    config.mh.voxel_growth_from = 0.5;
    let (trainer, whole) = trained(&data, &config, 120);
    let s = *trainer.stats();
    assert!(s.pixel[1] > 0 && s.pixel[1] < s.pixel[0], "{s:?}");
    let (mut half, _) = trained(&data, &config, 48);
    let state = half.state().unwrap();
    let device = Device::open(None).unwrap();
    let mut resumed = Trainer::new(
        &device,
        &data,
        &Plan::new(&data, &config).unwrap(),
        &state.splats,
    )
    .unwrap();
    resumed.restore(&state).unwrap();
    drive(&mut resumed, 120).unwrap();
    assert!(whole == resumed.state().unwrap().splats);
    assert_eq!(*resumed.stats(), s);
}
