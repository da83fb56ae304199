//! Density steps that are decided while training goes on.

use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::config::{Length, Sampler, Surrogate, TrainingSize};
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Device, DeviceKind};
use mhsplat::run::{checkpoint, initial_gaussians};
use mhsplat::train::reasons::Part;
use mhsplat::train::{Event, PendingStep, Trainer};

use crate::determinism::{drive, room, sampled, saved, trained};

/// Iterations of a run, in which a step comes every 25.
const ITERATIONS: u32 = 120;

fn lagging(sampler: Sampler, lag: u32) -> TrainConfig {
    let mut config = sampled(sampler);
    config.work.density_lag = Some(lag);
    config
}

/// Iterations enqueued when a step was reported, and those after which it began.
fn steps(trainer: &mut Trainer) -> Vec<[u32; 2]> {
    let mut steps = Vec::new();
    while trainer.iteration() < ITERATIONS {
        if let Event::Density(event) = trainer.advance().unwrap() {
            steps.push([trainer.iteration(), event.iteration]);
        }
    }
    steps
}

fn begun(config: &TrainConfig) -> Trainer {
    let (data, device) = (room(64), Device::open(None).unwrap());
    let plan = Plan::new(&data, config).unwrap();
    let splats = initial_gaussians(&data, &plan).unwrap();
    Trainer::new(&device, &data, &plan, &splats).unwrap()
}

#[test]
fn a_step_ends_so_many_iterations_after_it_has_begun() {
    let without = steps(&mut begun(&lagging(Sampler::Mh, 0)));
    assert!(without.len() >= 2 && without.iter().all(|[at, began]| at == began));
    let with = steps(&mut begun(&lagging(Sampler::Mh, 5)));
    let ends: Vec<[u32; 2]> = without
        .iter()
        .map(|[_, began]| [began + 5, *began])
        .collect();
    assert_eq!(with, ends);
    // No more than half of the interval of 25.
    let most = steps(&mut begun(&lagging(Sampler::Mh, 100)));
    assert!(most.iter().all(|[at, began]| at - began == 12), "{most:?}");
}

#[test]
fn the_same_seed_and_lag_give_the_same_bits() {
    let data = room(64);
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = lagging(sampler, 6);
        let (trainer, first) = trained(&data, &config, ITERATIONS);
        let stats = trainer.stats();
        assert!(stats.accepted + stats.cloned > 0, "{stats:?}");
        assert!(
            first == trained(&data, &config, ITERATIONS).1,
            "{sampler:?}"
        );
        let at_once = trained(&data, &lagging(sampler, 0), ITERATIONS).1;
        assert!(first != at_once, "the comparison must be able to fail");
    }
}

#[test]
fn a_run_stopped_while_a_step_is_decided_ends_with_the_same_bits() {
    let data = room(64);
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = lagging(sampler, 8);
        let (_, whole) = trained(&data, &config, ITERATIONS);
        // A step has begun after 50 iterations, or 52 of two epochs.
        let (mut half, _) = trained(&data, &config, 55);
        let folder = tempfile::tempdir().unwrap();
        checkpoint::write(folder.path(), &saved(&mut half, &config, &data)).unwrap();
        // The one that has told its state goes on the same way.
        drive(&mut half, ITERATIONS).unwrap();
        assert!(whole == half.state().unwrap().splats, "{sampler:?}");
        drop(half);
        let read = checkpoint::read(folder.path()).unwrap();
        let pending = read.state.deciding.as_ref().unwrap();
        assert_eq!(pending.ends, pending.begun + 8);
        assert!(!pending.edits.is_empty() && pending.rows > 0);
        let plan = Plan::new(&data, &config).unwrap();
        let device = Device::open(None).unwrap();
        let mut trainer = Trainer::new(&device, &data, &plan, &read.state.splats).unwrap();
        trainer.restore(&read.state).unwrap();
        drive(&mut trainer, ITERATIONS).unwrap();
        assert!(whole == trainer.state().unwrap().splats, "{sampler:?}");
    }
}

#[test]
fn a_pending_step_that_does_not_fit_the_set_is_refused() {
    let data = room(64);
    let config = lagging(Sampler::Mh, 8);
    let (mut half, _) = trained(&data, &config, 55);
    let good = saved(&mut half, &config, &data);
    let folder = tempfile::tempdir().unwrap();
    let read_back = |spoil: &dyn Fn(&mut PendingStep)| {
        let mut checkpoint = good.clone();
        spoil(checkpoint.state.deciding.as_mut().unwrap());
        checkpoint::write(folder.path(), &checkpoint).unwrap();
        checkpoint::read(folder.path())
    };
    let read = read_back(&|_| ()).unwrap();
    assert_eq!(read.state.deciding, good.state.deciding);
    for spoil in [
        &(|step: &mut PendingStep| step.edits[0].src = u32::MAX) as &dyn Fn(&mut PendingStep),
        &|step| step.edits[0].dst = step.rows as u32,
        &|step| step.removed = vec![step.rows as u32],
        &|step| step.removed = vec![2, 1],
        &|step| step.rows = 1,
    ] {
        let error = read_back(spoil).unwrap_err().to_string();
        assert!(error.contains("density step"), "{error}");
    }
}

#[test]
fn pairs_that_do_not_fit_while_a_step_is_decided_change_nothing() {
    for sampler in [Sampler::Mh, Sampler::Mcmc] {
        let config = lagging(sampler, 8);
        let (roomy, whole) = trained(&room(64), &config, ITERATIONS);
        // Right before a step begins, then while it is decided.
        for later in [0, 1, 3] {
            let mut tight = begun(&config);
            let mut shrunk = 0;
            while tight.iteration() < ITERATIONS {
                let at = tight.iteration();
                let event = tight.advance().unwrap();
                let before = at.checked_sub(later);
                let began = before.and_then(|at| tight.schedule().density_due(at));
                if matches!(event, Event::Iteration { .. }) && began.is_some() && shrunk < 8 {
                    tight.shrink_intersections(1024).unwrap();
                    shrunk += 1;
                }
            }
            tight.settle().unwrap();
            assert!(shrunk >= 2 && tight.overflows() > 0);
            assert_eq!(tight.stats(), roomy.stats());
            assert!(
                whole == tight.state().unwrap().splats,
                "{sampler:?} {later}"
            );
        }
    }
}

#[test]
fn a_step_that_has_begun_ends_with_the_run() {
    let mut config = lagging(Sampler::Mh, 100);
    // The last step is due less than its lag before the end.
    config.mh.until_iteration = 30_000;
    config.iterations = 60;
    let (trainer, _) = trained(&room(64), &config, 60);
    let mut ended = begun(&config);
    let mut events = Vec::new();
    loop {
        match ended.advance().unwrap() {
            Event::Density(event) => events.push(event.iteration),
            Event::Finished => break,
            _ => {}
        }
    }
    let due = |at: &u32| ended.schedule().density_due(*at).is_some();
    assert_eq!(events, (1..60).filter(due).collect::<Vec<u32>>());
    assert!(60 - events.last().unwrap() < 12, "{events:?}");
    assert_eq!(trainer.stats(), ended.stats());
}

#[test]
fn the_default_waits_where_the_processor_that_decides_trains() {
    let data = room(64);
    let lag = |kind, config: &TrainConfig| {
        let strategy = mhsplat::density::make(config);
        let plan = Plan::new(&data, config).unwrap();
        let plan = plan.with_strategy(kind, strategy.as_ref());
        // A record says what was asked for, on any device.
        assert_eq!(plan.config, *config);
        plan.schedule().density_lag(0)
    };
    let config = TrainConfig::default();
    assert_eq!(lag(DeviceKind::Cpu, &config), 0);
    assert_eq!(lag(DeviceKind::Gpu, &config), 16);
    // In a short run newborns need the time until the next step, which comes every 34 iterations here.
    let short = TrainConfig {
        iterations: 800,
        ..TrainConfig::default()
    };
    assert_eq!(lag(DeviceKind::Gpu, &short), 5);
    // A time budget changes the length on the way, and the default with it; what was asked for is kept as far as there is room.
    for (asked, after) in [(None, 5), (Some(16), 16)] {
        let mut budget = TrainConfig::default();
        budget.work.density_lag = asked;
        let strategy = mhsplat::density::make(&budget);
        let plan = Plan::new(&data, &budget).unwrap();
        let plan = plan.with_strategy(DeviceKind::Gpu, strategy.as_ref());
        let mut schedule = plan.schedule();
        assert_eq!(schedule.density_lag(1000), 16);
        schedule.set_length(Length::new(100, 800));
        assert_eq!(schedule.density_lag(200), after);
        schedule.set_length(Length::new(300, 30_000));
        assert_eq!(schedule.density_lag(400), 16);
        // A rank lags as its leader does, whatever its own device is.
        let led = plan.led_by(DeviceKind::Cpu);
        let led = led.with_strategy(DeviceKind::Gpu, strategy.as_ref());
        assert_eq!(led.density_lag.value, asked.unwrap_or(0));
    }
    assert_eq!(lag(DeviceKind::Cpu, &lagging(Sampler::Mh, 3)), 3);
    // Estimates need the device while the step is decided.
    let mut probing = lagging(Sampler::Mh, 3);
    probing.mh.surrogate = Surrogate::Probe;
    assert_eq!(lag(DeviceKind::Gpu, &probing), 0);
}

#[test]
fn the_plan_says_whether_training_waits() {
    let data = room(64);
    let told = |config: &TrainConfig| {
        let plan = Plan::new(&data, config).unwrap();
        let parts = plan.parts().into_iter();
        let mut lines = parts.filter(|(part, ..)| *part == Part::Lag);
        lines.next().map(|(_, kept, why)| (kept, why.to_string()))
    };
    let (kept, why) = told(&TrainConfig::default()).unwrap();
    assert!(!kept && why.contains("processor"), "{why}");
    let (kept, why) = told(&lagging(Sampler::Mh, 3)).unwrap();
    assert!(kept && why.contains("3 iterations"), "{why}");
    assert_eq!(told(&sampled(Sampler::None)), None);
}

#[test]
fn a_length_that_changes_after_a_step_is_repeated_to_the_bit() {
    let data = room(64);
    let config = lagging(Sampler::Mh, 6);
    let mut changed = begun(&config);
    while changed.stats().proposed == 0 || !changed.schedule().may_change(changed.iteration()) {
        changed.advance().unwrap();
    }
    let (at, longer) = (changed.iteration(), ITERATIONS + 60);
    changed
        .set_length(longer, TrainingSize::ThreeQuarters)
        .unwrap();
    drive(&mut changed, longer).unwrap();
    let mut repeated = config.clone();
    repeated.lengths = changed.plan().config.lengths.clone();
    assert_eq!(repeated.lengths.last().unwrap().from, at);
    let (again, splats) = trained(&data, &repeated, longer);
    assert_eq!(again.stats(), changed.stats());
    assert!(splats == changed.state().unwrap().splats);
}

#[test]
fn the_group_style_lags_to_the_same_bits() {
    let data = room(64);
    let run = |lag: u32| {
        let config = lagging(Sampler::Mh, lag);
        let plan = Plan::new(&data, &config).unwrap();
        let splats = initial_gaussians(&data, &plan).unwrap();
        let device = Device::open(None).unwrap().with_tuning(Tuning::GPU);
        let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
        drive(&mut trainer, 60).unwrap();
        assert!(trainer.stats().accepted > 0);
        trainer.state().unwrap().splats
    };
    let lagged = run(6);
    assert!(lagged == run(6));
    assert!(lagged != run(0), "the comparison must be able to fail");
}
