//! Samplers in a run: what a trainer makes of their decisions, bounds, schedules, options.

use crate::determinism::room;
use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::config::{
    AdcConfig, Background, Birth, Length, McmcConfig, MhConfig, OptimizerConfig, Sampler,
};
use mhsplat::device::Device;
use mhsplat::pipeline::stage::adam::LearningRates;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::Event;
use mhsplat::train::schedule::Schedule;
use mhsplat::train::{DensityEvent, Trainer};

/// A run in which the optimiser moves nothing.
fn still(sampler: Sampler) -> TrainConfig {
    TrainConfig {
        sampler,
        iterations: 60,
        max_size: 64,
        // No bands that come and go.
        sh_degree: 0,
        optimizer: OptimizerConfig {
            lr_position: 0.0,
            lr_position_final: 0.0,
            lr_sh0: 0.0,
            lr_sh: 0.0,
            lr_opacity: 0.0,
            lr_scale: 0.0,
            lr_rotation: 0.0,
            ..OptimizerConfig::default()
        },
        ..TrainConfig::default()
    }
}

fn train(config: &TrainConfig, splats: &Gaussians) -> (Vec<DensityEvent>, Gaussians) {
    let device = Device::open(None).unwrap();
    let mut trainer = Trainer::new(
        &device,
        &room(64),
        &Plan::new(&room(64), config).unwrap(),
        splats,
    )
    .unwrap();
    let mut events = Vec::new();
    loop {
        match trainer.advance().unwrap() {
            Event::Finished => break,
            Event::Density(event) => events.push(event),
            _ => {}
        }
    }
    let state = trainer.state().unwrap();
    assert_eq!(state.splats.len(), trainer.gaussians());
    (events, state.splats)
}

/// Rows as bits, sorted: the set without its order.
fn rows(splats: &Gaussians, keep: impl Fn(usize) -> bool) -> Vec<Vec<u32>> {
    let row = |i: usize| splats.planes().iter().map(|p| p[i].to_bits()).collect();
    let mut rows: Vec<Vec<u32>> = (0..splats.len()).filter(|i| keep(*i)).map(row).collect();
    rows.sort();
    rows
}

#[test]
fn pruned_gaussians_are_gone_and_the_others_unchanged() {
    let config = TrainConfig {
        adc: AdcConfig {
            // Nothing is born, and nothing reset.
            grad_threshold: 1e9,
            reset_interval: 1_000_000,
            ..AdcConfig::default()
        },
        ..still(Sampler::Adc)
    };
    let mut splats = initial_gaussians(&room(64), &Plan::new(&room(64), &config).unwrap()).unwrap();
    let n = splats.len();
    for i in (0..n).step_by(3) {
        splats.plane_mut(Plane::OPACITY)[i] = -6.0;
    }
    let (events, left) = train(&config, &splats);
    assert_eq!(events[0].stats.pruned as usize, n.div_ceil(3));
    assert_eq!(events[0].gaussians, n - n.div_ceil(3));
    assert!(events[1..].iter().all(|e| e.stats.pruned == 0));
    assert!(rows(&left, |_| true) == rows(&splats, |i| i % 3 != 0));
}

#[test]
fn a_reset_lowers_every_opacity() {
    let config = TrainConfig {
        adc: AdcConfig {
            grad_threshold: 1e9,
            ..AdcConfig::default()
        },
        ..still(Sampler::Adc)
    };
    let splats = initial_gaussians(&room(64), &Plan::new(&room(64), &config).unwrap()).unwrap();
    let (events, left) = train(&config, &splats);
    assert!(events.iter().any(|e| e.stats.opacity_resets == 1));
    let limit = (0.01f32 / 0.99).ln();
    let logits = &left.planes()[Plane::OPACITY];
    assert!(
        logits.iter().all(|l| (l - limit).abs() < 1e-5),
        "0.1 before"
    );
}

#[test]
fn noise_moves_positions_alone_and_only_where_asked_for() {
    let config = TrainConfig {
        // Nothing is relocated, and nothing born.
        mcmc: McmcConfig {
            growth: 1.0,
            dead_opacity: 0.0,
            noise_opacity: 0.5,
            ..McmcConfig::default()
        },
        ..still(Sampler::Mcmc)
    };
    let splats = initial_gaussians(&room(64), &Plan::new(&room(64), &config).unwrap()).unwrap();
    assert!(train(&config, &splats).1 == splats, "no rate, no noise");
    let moving = TrainConfig {
        optimizer: OptimizerConfig {
            // Adam's steps of 1e-9 are lost in rounding; the noise is 10⁷ times as strong.
            lr_position: 1e-9,
            lr_position_final: 1e-9,
            ..config.optimizer
        },
        ..config.clone()
    };
    let (_, moved) = train(&moving, &splats);
    let fixed = TrainConfig {
        sampler: Sampler::None,
        ..moving.clone()
    };
    assert!(train(&fixed, &splats).1 != moved);
    let mh = |noise_rate: f64| TrainConfig {
        sampler: Sampler::Mh,
        mh: MhConfig {
            noise_rate,
            birth: Some(Birth::Copy),
            target_acceptance: [0.0, 0.0],
            dead_opacity: 0.0,
            coarse_proposals: 0,
            fine_proposals: 0,
            pixel_proposals: 0,
            ..MhConfig::default()
        },
        ..moving.clone()
    };
    assert!(train(&mh(5e5), &splats).1 != train(&mh(0.0), &splats).1);
    let sorted = |s: &Gaussians, p: usize| {
        let mut bits: Vec<u32> = s.planes()[p].iter().map(|v| v.to_bits()).collect();
        bits.sort_unstable();
        bits
    };
    for p in 0..splats.planes().len() {
        // Density steps put the rows in another order.
        let same = sorted(&splats, p) == sorted(&moved, p);
        assert_eq!(same, p >= Plane::LOG_SCALE, "plane {p}");
    }
}

#[test]
fn no_sampler_exceeds_the_bound() {
    let free = TrainConfig {
        iterations: 300,
        max_size: 64,
        sh_degree: 0,
        mh: MhConfig {
            pair_pixels: 0.0,
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    };
    let splats = initial_gaussians(&room(64), &Plan::new(&room(64), &free).unwrap()).unwrap();
    let n = splats.len();
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None] {
        let run = |max_gaussians| {
            let config = TrainConfig {
                sampler,
                max_gaussians,
                ..free.clone()
            };
            let (events, splats) = train(&config, &splats);
            (events.iter().map(|e| e.gaussians).max(), splats.len())
        };
        let most = n + 50;
        let (during, after) = run(Some(most));
        assert!(during.is_none_or(|d| d <= most) && after <= most);
        let (during, _) = run(None);
        match sampler {
            Sampler::None => assert_eq!(during, None),
            _ => assert!(during.unwrap() > most, "{sampler:?}: the bound must bind"),
        }
    }
}

/// The photos' own bound holds, and what dies is born again below it.
#[test]
fn few_pixels_bear_few_gaussians() {
    let data = room(64);
    let pixels: u32 = data
        .train
        .iter()
        .map(|v| v.camera.width * v.camera.height)
        .sum();
    let pairs = (data.train.len() - 1) as f64 / 2.0;
    let run = |most: usize, turnover: f64| {
        let config = TrainConfig {
            iterations: 300,
            max_size: 64,
            sh_degree: 0,
            mh: MhConfig {
                // Half a Gaussian more: the division rounds down.
                pair_pixels: f64::from(pixels) * pairs / (most as f64 + 0.5),
                turnover,
                ..MhConfig::default()
            },
            ..TrainConfig::default()
        };
        let plan = Plan::new(&data, &config).unwrap();
        let splats = initial_gaussians(&data, &plan).unwrap();
        let (events, _) = train(&config, &splats);
        let reached = events.iter().map(|e| e.gaussians).max().unwrap();
        let accepted: u64 = events.iter().map(|e| e.stats.accepted).sum();
        (splats.len(), reached, accepted)
    };
    let (n, reached, _) = run(1_000_000, 0.0);
    let most = n + 50;
    assert!(reached > most, "the bound must bind: {reached}");
    assert_eq!(run(most, 0.0).1, most);
    // Below the points nothing but what died is born.
    let (_, reached, accepted) = run(1, MhConfig::default().turnover);
    assert!(reached <= n && accepted > 0, "{reached} {n} {accepted}");
}

/// The photos bound mh, and no strategy of the caller's own.
#[test]
fn photos_do_not_bound_the_callers_own_strategy() {
    let (data, device) = (room(64), Device::open(None).unwrap());
    for (most, expected) in [(None, None), (Some(9000), Some(9000))] {
        let config = TrainConfig {
            max_gaussians: most,
            ..still(Sampler::Mh)
        };
        let plan = Plan::new(&data, &config).unwrap();
        assert!(plan.most_gaussians.value.is_some());
        let splats = initial_gaussians(&data, &plan).unwrap();
        let strategy = mhsplat::density::make(&config);
        let own = Trainer::with_strategy(&device, &data, &plan, &splats, strategy).unwrap();
        assert_eq!(own.plan().most_gaussians.value, expected);
    }
}

#[test]
fn all_dead_scenes_are_survived() {
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = still(sampler);
        let mut splats =
            initial_gaussians(&room(64), &Plan::new(&room(64), &config).unwrap()).unwrap();
        splats.plane_mut(Plane::OPACITY).fill(-9.0);
        let (events, left) = train(&config, &splats);
        assert!(!events.is_empty());
        assert_eq!(left.len(), splats.len(), "{sampler:?}");
    }
}

fn schedule_config(sampler: Sampler, iterations: u32) -> TrainConfig {
    TrainConfig {
        sampler,
        iterations,
        ..TrainConfig::default()
    }
}

fn schedule(sampler: Sampler, iterations: u32) -> Schedule {
    Schedule::new(&schedule_config(sampler, iterations))
}

#[test]
fn each_sampler_has_its_own_times_and_they_scale() {
    let due = |sampler, iterations| -> Vec<u32> {
        let s = schedule(sampler, iterations);
        let due = |i: &u32| s.density_due(*i).is_some();
        (0..iterations).filter(due).collect()
    };
    for (sampler, first, last, steps) in [
        (Sampler::Mh, 500, 19_900, 195),
        (Sampler::Mcmc, 600, 24_900, 244),
        (Sampler::Adc, 600, 14_900, 144),
    ] {
        let at = due(sampler, 30_000);
        assert_eq!((at[0], at[at.len() - 1], at.len()), (first, last, steps));
    }
    assert!(due(Sampler::None, 30_000).is_empty());
    // A tenth of the run: a tenth of the span, at closer steps.
    let at = due(Sampler::Adc, 3000);
    assert!(at[0] > 50 && at[at.len() - 1] < 1500 && at.len() >= 14);
    let at = due(Sampler::Mcmc, 3000);
    assert_eq!((at[0], at[at.len() - 1], at.len()), (100, 2400, 24));
}

/// The progress of the step before, which turnover counts from; none before the first.
#[test]
fn each_step_knows_the_one_before() {
    let s = schedule(Sampler::Mh, 3000);
    let steps = (0..3000).filter_map(|i| Some((i, s.density_due(i)?)));
    let mut before = None;
    for (at, progress) in steps {
        assert_eq!(s.density_before(at), before, "{at}");
        before = Some(progress);
    }
    assert!(before.is_some());
}

#[test]
fn opacity_is_reset_every_3000_of_30000() {
    let resets = |iterations: u32| -> Vec<u32> {
        let s = schedule(Sampler::Adc, iterations);
        let due = |i: &u32| s.density_due(*i).is_some() && s.resets_opacity(*i);
        (0..iterations).filter(due).collect()
    };
    assert_eq!(resets(30_000), [3000, 6000, 9000, 12_000]);
    let short = resets(3000);
    assert_eq!(short.len(), 4, "{short:?}");
    for (k, at) in short.iter().enumerate() {
        let from = 300 * (k as u32 + 1);
        assert!((from..from + 100).contains(at), "{short:?}");
    }
}

#[test]
fn before_white_opacity_is_reset_at_the_first_step_too() {
    let first = |background| {
        let s = Schedule::new(&TrainConfig {
            background,
            ..schedule_config(Sampler::Adc, 30_000)
        });
        assert!(s.density_due(600).is_some() && s.density_due(700).is_some());
        // It does not count among those that come at intervals.
        assert_eq!(s.opacity_resets(700), 0);
        [s.resets_opacity(600), s.resets_opacity(700)]
    };
    assert_eq!(first(Background::White), [true, false]);
    assert_eq!(first(Background::Black), [false, false]);
}

#[test]
fn no_step_comes_after_the_last_iteration() {
    let mut config = schedule_config(Sampler::Mh, 3000);
    config.mh.until_iteration = 60_000;
    let s = Schedule::new(&config);
    assert!((0..3000).any(|i| s.density_due(i).is_some()));
    assert!((3000..6000).all(|i| s.density_due(i).is_none()));
}

#[test]
fn rates_are_the_same_for_every_sampler_but_those_of_scales_in_short_runs() {
    for iterations in [3000, 30_000] {
        let rates = |sampler| schedule(sampler, iterations).rates(100);
        let mh = rates(Sampler::Mh);
        for other in [Sampler::Mcmc, Sampler::Adc, Sampler::None] {
            let other = rates(other);
            assert_eq!(other.scale == mh.scale, iterations == 30_000);
            let scale = mh.scale;
            assert_eq!(LearningRates { scale, ..other }, mh);
        }
    }
}

#[test]
fn rates_settle_at_the_end() {
    let s = schedule(Sampler::None, 3000);
    let [first, still, half, last] = [0, 2500, 2750, 3000].map(|i| s.rates(i));
    assert_eq!((first.opacity, first.sh), (still.opacity, still.sh));
    for (a, b, c) in [
        (first.scale, half.scale, last.scale),
        (first.rotation, half.rotation, last.rotation),
        (first.opacity, half.opacity, last.opacity),
        (first.sh0, half.sh0, last.sh0),
        (first.sh, half.sh, last.sh),
    ] {
        assert!((c / a - 0.1).abs() < 1e-6 && (b * b / (a * c) - 1.0).abs() < 1e-6);
    }
    let mut config = schedule_config(Sampler::None, 3000);
    config.optimizer.lr_settle = 1.0;
    assert_eq!(Schedule::new(&config).rates(3000).scale, first.scale);
    for bad in [0.0, 1.5, f64::NAN] {
        config.optimizer.lr_settle = bad;
        let said = config.validate().unwrap_err().to_string();
        assert!(said.contains("lr-settle"), "{said}");
    }
}

#[test]
fn short_runs_take_larger_steps_and_remember_a_share_of_their_length() {
    let of = |iterations| {
        let s = schedule(Sampler::Mh, iterations);
        (s.rates(0), s.beta2(0))
    };
    let (paper, beta2) = of(30_000);
    let config = schedule_config(Sampler::Mh, 30_000).optimizer;
    assert_eq!((paper.scale, beta2), (config.lr_scale, config.beta2));
    // 7500 iterations: f = 2; from 1875 on f stays at 4; longer runs than the papers' have their rates.
    for (iterations, f) in [(7500, 2.0_f64), (1875, 4.0), (300, 4.0), (60_000, 1.0)] {
        let (rates, memory) = of(iterations);
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{iterations}: {a}, {b}");
        near(rates.position, f.powf(1.5) * paper.position);
        near(rates.scale, f.powf(1.5) * paper.scale);
        near(rates.rotation, f.sqrt() * paper.rotation);
        near(rates.sh, f * paper.sh);
        near(rates.opacity, f.sqrt() * paper.opacity);
        near(rates.sh0, f.sqrt() * paper.sh0);
        near(1.0 - memory, f * f * (1.0 - beta2));
        // On plush mcmc and a fixed set lose by more.
        for sampler in [Sampler::Mcmc, Sampler::Adc, Sampler::None] {
            let other = schedule(sampler, iterations).rates(0);
            near(other.scale, f.sqrt() * paper.scale);
            assert_eq!(
                LearningRates {
                    scale: rates.scale,
                    ..other
                },
                rates
            );
        }
    }
    let mut config = schedule_config(Sampler::Mh, 1500);
    config.optimizer.lr_scales_with_run = false;
    let fixed = Schedule::new(&config);
    assert_eq!((fixed.rates(0).scale, fixed.beta2(0)), (paper.scale, beta2));
    // What no view shows moves on by m/√v, which shrinks where β₁² < β₂ alone.
    config.optimizer.lr_scales_with_run = true;
    for beta2 in [0.85, 0.9, 0.95, 0.98, 0.99, 0.999] {
        config.optimizer.beta2 = beta2;
        let short = Schedule::new(&config).beta2(0);
        assert!(
            short > config.optimizer.beta1.powi(2) && short <= beta2,
            "{beta2}: {short}"
        );
    }
}

#[test]
fn steps_of_density_control_are_as_far_apart_as_it_says() {
    for iterations in [600, 1500, 7000, 30_000] {
        let s = Schedule::new(&schedule_config(Sampler::Mh, iterations));
        let due: Vec<f64> = (0..iterations).filter_map(|i| s.density_due(i)).collect();
        for step in due.windows(2) {
            let apart = step[1] - step[0];
            assert!((apart / s.density_spacing(0) - 1.0).abs() < 1e-9, "{apart}");
        }
        assert!(due.len() > 12);
    }
    // Another length has its own distance from the iteration on at which it is planned.
    let mut config = schedule_config(Sampler::Mh, 1500);
    let short = Schedule::new(&config).density_spacing(0);
    config.set_length(Length::new(1000, 30_000));
    let changed = Schedule::new(&config);
    let long = Schedule::new(&schedule_config(Sampler::Mh, 30_000));
    assert_eq!(changed.density_spacing(999), short);
    assert_eq!(changed.density_spacing(1000), long.density_spacing(0));
}

/// Constant gradients: every step of Adam is one rate, whatever lengths were planned before.
#[test]
fn steps_keep_their_size_where_another_length_is_planned() {
    for (batch, planned) in [
        (1, [900, 12_000]),
        (1, [20_000, 700]),
        (2, [3000, 30_000]),
        (8, [900, 12_000]),
    ] {
        let mut config = TrainConfig {
            batch,
            ..TrainConfig::default()
        };
        let rates = |config: &TrainConfig, from: u32| {
            let schedule = Schedule::new(config);
            let (mut second, mut off) = (0.0, 0.0_f64);
            for iteration in 0..200 {
                let Some(t) = schedule.step_of(iteration) else {
                    continue;
                };
                let decay = schedule.beta2(iteration).powi(batch as i32);
                second = decay * second + 1.0 - decay;
                let corrected = second / (1.0 - decay.powi(t as i32));
                let step = schedule.memory_correction(iteration) / f64::sqrt(corrected);
                let alone = 1.0 / f64::sqrt(corrected);
                assert!((step - 1.0).abs() < 1e-9, "{iteration}: {step}");
                assert!(iteration >= from || (alone - 1.0).abs() < 1e-9);
                off = off.max((alone - 1.0).abs());
            }
            off
        };
        assert!(rates(&config, 200) < 1e-9);
        for (from, iterations) in [20, 60].into_iter().zip(planned) {
            config.set_length(Length::new(from, iterations));
        }
        let schedule = Schedule::new(&config);
        assert!(schedule.beta2(19) > schedule.beta2(20));
        // Without the correction they would be off by a fifth at least.
        assert!(rates(&config, 20) > 0.2);
    }
}

#[test]
fn noise_follows_the_rate_of_a_long_run() {
    let [long, short] = [30_000, 3000].map(|n| schedule(Sampler::Mcmc, n));
    for tenth in 0..10 {
        let [a, b] = [
            long.position_rate(3000 * tenth),
            short.position_rate(300 * tenth),
        ];
        assert!((a / b - 1.0).abs() < 1e-12);
    }
    assert!((long.position_rate(0) - long.rates(0).position).abs() < 1e-18);
    assert!(short.rates(0).position > 5.0 * short.position_rate(0));
}

#[test]
fn options_of_the_samplers_are_read_and_checked() {
    let text = "sampler = \"mcmc\"\nmax-gaussians = 5000\n[mcmc]\nnoise-rate = 1e5\ngrowth = 1.1\n[adc]\nreset-interval = 2000\n";
    let config: TrainConfig = toml::from_str(text).unwrap();
    assert_eq!(config.sampler, Sampler::Mcmc);
    assert_eq!((config.mcmc.noise_rate, config.mcmc.growth), (1e5, 1.1));
    assert_eq!(config.adc.reset_interval, 2000);
    config.validate().unwrap();
    assert!(toml::from_str::<TrainConfig>("[adc]\nresetinterval = 1\n").is_err());
    for (bad, named) in [
        ("[mcmc]\nnoise-rate = -1.0", "mcmc"),
        ("[mcmc]\ngrowth = 0.5", "growth"),
        ("[mcmc]\ndead-opacity = 1.0", "dead-opacity"),
        ("[mcmc]\ncap = 0", "cap"),
        ("[mcmc]\nuntil-iteration = 500", "until-iteration"),
        ("[adc]\ngrad-threshold = nan", "grad-threshold"),
        ("[adc]\nsplit-shrink = 0.5", "split-shrink"),
        ("[adc]\nreset-opacity = 0.0", "reset-opacity"),
        ("[adc]\nreset-interval = 0", "reset-interval"),
        ("[adc]\nreset-interval = 400", "reset-interval"),
        ("[mh]\nbirths-from-iteration = 26000", "births-from"),
        ("[mh]\nbirth-opacity = 0.004", "birth-opacity"),
        ("[mh]\nbirth-scale = 0", "birth-scale"),
        ("[mh]\nbirth-scale = 1.1", "birth-scale"),
        ("[mh]\nsplit-distance = 0.0", "split-distance"),
        ("[mh]\nsplit-distance = 0.96", "split-distance"),
        ("[mh]\nsplit-distance = nan", "split-distance"),
        (
            "[mh]\nbirth = \"split\"\nsurrogate = \"probe\"",
            "surrogate",
        ),
        ("[mh]\nturnover = -0.1", "turnover"),
        ("[mh]\nnoise-rate = -1.0", "noise-rate"),
        ("[mh]\npixel-near = nan", "pixel-near"),
        ("[adc]\ninterval = 0", "interval"),
    ] {
        let config: TrainConfig = toml::from_str(bad).unwrap();
        let said = config.validate().unwrap_err().to_string();
        assert!(said.contains(named), "{bad}: {said}");
    }
}
