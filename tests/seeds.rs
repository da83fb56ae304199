//! Random numbers follow the seed: for each purpose of [`Stream`], what it alone decides differs from seed to seed.
//!
//! A number drawn with any seed but the run's would be the same in runs of two seeds. A hook in the generator that tells which
//! seeds are used would not see the device's copy of it, and would have to be compiled into the product; decisions need neither.
//! They are taken where training takes them: from `initial_gaussians`, the schedule, the strategies that `density::make` returns,
//! the trainer and the surrogate's check. Each case is made so that nothing else depends on the seed: sources are alike, all
//! are drawn, or all are accepted, except where that is the purpose.

use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use mhsplat::base::rng::Stream;
use mhsplat::config::{AdcConfig, Init, McmcConfig, MhConfig, Sampler};
use mhsplat::density::{
    Edit, Outcome, Picture, SceneState, ScreenGradient, Statistics, StepContext, make,
};
use mhsplat::device::Device;
use mhsplat::lab::surrogate::{Candidate, Draw, Options, Phase, check};
use mhsplat::run::{checkpoint, initial_gaussians};
use mhsplat::scene::Plane;
use mhsplat::train::schedule::Schedule;
use mhsplat::{Plan, TrainConfig};
use tempfile::TempDir;

use crate::determinism::{room, saved, trained};
use crate::wiring;

/// Seeds that differ in the lowest bit, in the lowest of the upper half, and in the highest.
const SEEDS: [u64; 4] = [6, 7, (1 << 32) | 6, (1 << 63) | 6];

/// Purposes whose seed is that of a made scene, not of a run.
const OTHERS: [&str; 1] = ["Synthetic"];

/// Decisions in a fixed order, numbers as their bits; `None` where there was nothing to decide.
type Decisions = Vec<Option<u64>>;

/// Number of decisions that both have taken, and of those among them that are alike.
fn alike(a: &Decisions, b: &Decisions) -> [usize; 2] {
    let both = a.iter().zip(b).filter(|(a, b)| a.is_some() && b.is_some());
    let alike = both.clone().filter(|(a, b)| a == b);
    [both.count(), alike.count()]
}

/// True if two runs may have drawn their decisions independently: three of four may agree by chance, and there are enough to
/// tell.
fn independent(a: &Decisions, b: &Decisions) -> bool {
    let [both, alike] = alike(a, b);
    both >= 20 && 4 * alike <= 3 * both
}

/// A purpose, and its decisions in a run of a seed, those of a kind together.
type Case = (String, Box<dyn Fn(u64) -> Vec<Decisions>>);

fn case(purpose: Stream, decide: impl Fn(u64) -> Decisions + 'static) -> Case {
    (
        format!("{purpose:?}"),
        Box::new(move |seed| vec![decide(seed)]),
    )
}

fn seeded(seed: u64) -> TrainConfig {
    TrainConfig {
        seed,
        max_size: 64,
        ..TrainConfig::default()
    }
}

fn bits(values: impl IntoIterator<Item = f32>) -> Decisions {
    let bits = |v: f32| Some(u64::from(v.to_bits()));
    values.into_iter().map(bits).collect()
}

/// True for each of `count` items that is among the chosen ones.
fn chosen(items: impl IntoIterator<Item = usize>, count: usize) -> Decisions {
    let items: BTreeSet<usize> = items.into_iter().collect();
    (0..count)
        .map(|i| Some(u64::from(items.contains(&i))))
        .collect()
}

/// The decision of each of `count` items that has one.
fn keyed(pairs: impl IntoIterator<Item = (usize, u64)>, count: usize) -> Decisions {
    let mut all = vec![None; count];
    for (at, value) in pairs {
        all[at] = Some(value);
    }
    all
}

fn first_gaussians(seed: u64, init: Init) -> Decisions {
    let mut config = TrainConfig {
        init,
        max_gaussians: Some(100),
        ..seeded(seed)
    };
    config.work.morton_order = false;
    let data = room(64);
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    assert_eq!(splats.len(), 100);
    bits(splats.planes()[Plane::POSITION].iter().copied())
}

fn views(seed: u64) -> Decisions {
    let order = Schedule::new(&seeded(seed)).upcoming(0, 200, 10);
    order.into_iter().map(|v| Some(v as u64)).collect()
}

fn backgrounds(seed: u64) -> Decisions {
    let schedule = Schedule::new(&seeded(seed));
    bits((0..100).map(|i| schedule.background(i, true)[0]))
}

fn noise(seed: u64) -> Decisions {
    let (_, after) = wiring::after_one(&wiring::config(2000, seed, 5e5));
    bits(after.planes()[Plane::POSITION].iter().copied())
}

/// Number of Gaussians in the scene of density steps.
const ROWS: usize = 100;

/// A density step of Gaussians that are alike but for their places; the first `dead` of them are dead.
fn step(config: &TrainConfig, dead: usize, pictures: &[Picture]) -> Outcome {
    let x: Vec<f32> = (0..ROWS).map(|i| i as f32).collect();
    let [zero, one, scale] = [0.0, 1.0, -3.0].map(|v| vec![v; ROWS]);
    let logit = |i: usize| if i < dead { -9.0 } else { 0.0 };
    let logits: Vec<f32> = (0..ROWS).map(logit).collect();
    let scene = SceneState {
        positions: [&x, &zero, &zero],
        log_scales: [&scale; 3],
        rotations: [&one, &zero, &zero, &zero],
        opacity_logits: &logits,
    };
    let views = [1; ROWS];
    let evidence = match config.sampler {
        Sampler::Adc => Statistics::ScreenGradient(ScreenGradient {
            norms: &one,
            views: &views,
        }),
        _ => Statistics::Nothing,
    };
    let context = StepContext {
        pictures,
        ..StepContext::at(700, 0.0, config.seed)
    };
    make(config).step(&context, &scene, &evidence).unwrap()
}

/// The births of a step, with so many proposals of each kind, all of which are accepted or about six of ten.
fn births(seed: u64, [coarse, fine, pixel]: [u32; 3], all: bool) -> Vec<Edit> {
    let config = TrainConfig {
        mh: MhConfig {
            importance: false,
            lambda_voxel: 0.0,
            temperature: [if all { 1e12 } else { 1.0 }; 2],
            coarse_proposals: coarse,
            fine_proposals: fine,
            pixel_proposals: pixel,
            pixel_near: 0.0,
            pixel_tolerance: 0.0,
            ..MhConfig::paper()
        },
        ..seeded(seed)
    };
    let pictures = [picture()];
    let pictures = if pixel > 0 { &pictures[..] } else { &[] };
    let edits = step(&config, 0, pictures).edits;
    edits.into_iter().filter(|e| e.dst >= ROWS as u32).collect()
}

fn sources(births: &[Edit]) -> Decisions {
    chosen(births.iter().map(|e| e.src as usize), ROWS)
}

fn offsets(births: &[Edit]) -> Decisions {
    let of = |e: &Edit| (e.src as usize, u64::from(e.position[1].to_bits()));
    keyed(births.iter().map(of), ROWS)
}

/// Edge of the picture, pixels.
const EDGE: usize = 16;

/// An opaque plane at a depth of 1, pixels being a unit wide there, with the same error everywhere.
fn picture() -> Picture<'static> {
    let pixels = EDGE * EDGE;
    Picture {
        size: [EDGE; 2],
        stride: EDGE,
        intrinsics: [1.0, 1.0, 0.0, 0.0],
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        center: [0.0; 3],
        photo: Arc::new([(); 3].map(|()| vec![0.5; pixels])),
        error: vec![0.5; pixels].into(),
        depth: vec![1.0; pixels].into(),
        transmittance: vec![0.0; pixels].into(),
    }
}

fn pixel(e: &Edit) -> usize {
    // Rounded to f32, a place may be on the border of the next pixel.
    let [x, y] = [e.position[0], e.position[1]].map(|v| (v as usize).min(EDGE - 1));
    y * EDGE + x
}

fn pixels(births: &[Edit]) -> Decisions {
    chosen(births.iter().map(pixel), EDGE * EDGE)
}

fn places(births: &[Edit]) -> Decisions {
    let of = |e: &Edit| (pixel(e), u64::from(e.position[0].to_bits()));
    keyed(births.iter().map(of), EDGE * EDGE)
}

/// Sources of the dead, nothing being born.
fn relocations(seed: u64, sampler: Sampler) -> Decisions {
    let config = TrainConfig {
        sampler,
        mh: MhConfig {
            importance: false,
            coarse_proposals: 0,
            fine_proposals: 0,
            ..MhConfig::paper()
        },
        mcmc: McmcConfig {
            growth: 1.0,
            ..McmcConfig::default()
        },
        ..seeded(seed)
    };
    let edits = step(&config, ROWS / 2, &[]).edits;
    let moved = edits.iter().filter(|e| e.src != e.dst);
    keyed(moved.map(|e| (e.dst as usize, u64::from(e.src))), ROWS)
}

/// Number of times that each row is drawn.
fn growth(seed: u64) -> Decisions {
    let config = TrainConfig {
        sampler: Sampler::Mcmc,
        mcmc: McmcConfig {
            growth: 2.0,
            ..McmcConfig::default()
        },
        ..seeded(seed)
    };
    let edits = step(&config, 0, &[]).edits;
    let born = |row: usize| edits.iter().filter(move |e| e.src as usize == row);
    let count = |row: usize| Some(born(row).filter(|e| e.dst >= ROWS as u32).count() as u64);
    (0..ROWS).map(count).collect()
}

fn splits(seed: u64) -> Decisions {
    let config = TrainConfig {
        sampler: Sampler::Adc,
        adc: AdcConfig::default(),
        ..seeded(seed)
    };
    let outcome = step(&config, 0, &[]);
    assert_eq!(outcome.stats.split as usize, ROWS);
    bits(outcome.edits.iter().map(|e| e.position[1]))
}

fn density_cases() -> Vec<Case> {
    // Rows and pixels are all drawn by so many proposals.
    const MANY: u32 = 6000;
    // About half of the rows, and of the pixels.
    let (rows, pixels_drawn) = (70, 180);
    vec![
        case(Stream::CoarseDraw, move |s| {
            sources(&births(s, [rows, 0, 0], true))
        }),
        case(Stream::CoarseOffset, |s| {
            offsets(&births(s, [MANY, 0, 0], true))
        }),
        case(Stream::CoarseAccept, |s| {
            sources(&births(s, [MANY, 0, 0], false))
        }),
        case(Stream::FineDraw, move |s| {
            sources(&births(s, [0, rows, 0], true))
        }),
        case(Stream::FineOffset, |s| {
            offsets(&births(s, [0, MANY, 0], true))
        }),
        case(Stream::FineAccept, |s| {
            sources(&births(s, [0, MANY, 0], false))
        }),
        case(Stream::PixelDraw, move |s| {
            pixels(&births(s, [0, 0, pixels_drawn], true))
        }),
        case(Stream::PixelPlace, |s| {
            places(&births(s, [0, 0, MANY], true))
        }),
        case(Stream::PixelAccept, |s| {
            pixels(&births(s, [0, 0, MANY], false))
        }),
        case(Stream::Relocation, |s| relocations(s, Sampler::Mh)),
        case(Stream::Relocation, |s| relocations(s, Sampler::Mcmc)),
        case(Stream::Growth, growth),
        case(Stream::Split, splits),
    ]
}

/// Number of Gaussians in the checkpoint that estimates are checked on.
const CHECKED: usize = 60;

/// A folder with a checkpoint. The importance is of the opacity alone, so that it is the same in all views.
fn checkpoint_to_check() -> TempDir {
    let data = room(64);
    let mut config = TrainConfig {
        sampler: Sampler::None,
        iterations: 20,
        max_gaussians: Some(CHECKED),
        ..seeded(0)
    };
    (config.mh.weight_ssim, config.mh.weight_l1) = (0.0, 0.0);
    let (mut trainer, _) = trained(&data, &config, 20);
    let folder = tempfile::tempdir().unwrap();
    checkpoint::write(folder.path(), &saved(&mut trainer, &config, &data)).unwrap();
    folder
}

/// Places of the candidates of a check by their group and source, the sources of each group, and the views.
fn checked(folder: &Path, seed: u64) -> Vec<Decisions> {
    let data = room(64);
    let options = Options {
        candidates: 100,
        views: data.train.len() as u32 / 2,
        seed,
    };
    let device = Device::open(None).unwrap();
    let found = check(folder, data.clone(), &device, &options, &mut |_, _| ()).unwrap();
    let of = |c: &Candidate| {
        let draw = 2 * usize::from(c.draw == Draw::Stratified);
        let group = draw + usize::from(c.phase == Phase::Fine);
        let place = u64::from(c.position[0].to_bits());
        (CHECKED * group + c.source as usize, place)
    };
    let places = keyed(found.candidates.iter().map(of), 4 * CHECKED);
    let drawn = |place: &Option<u64>| Some(u64::from(place.is_some()));
    let sources = places.iter().map(drawn).collect();
    let number = |name: &String| data.train.iter().position(|v| v.name == *name).unwrap();
    let views = chosen(found.views.iter().map(number), data.train.len());
    vec![places, sources, views]
}

fn cases() -> Vec<Case> {
    let folder = OnceCell::new();
    let estimates = move |s| checked(folder.get_or_init(checkpoint_to_check).path(), s);
    let mut cases = vec![
        case(Stream::Init, |s| first_gaussians(s, Init::Random)),
        case(Stream::Subset, |s| first_gaussians(s, Init::Points)),
        case(Stream::ViewOrder, views),
        case(Stream::Background, backgrounds),
        case(Stream::Noise, noise),
        (format!("{:?}", Stream::Surrogate), Box::new(estimates)),
    ];
    cases.extend(density_cases());
    cases
}

#[test]
fn every_number_follows_the_seed() {
    for (purpose, decide) in cases() {
        let first = decide(SEEDS[0]);
        assert!(first == decide(SEEDS[0]), "{purpose} repeats");
        for seed in &SEEDS[1..] {
            for (k, (first, other)) in first.iter().zip(&decide(*seed)).enumerate() {
                let [both, alike] = alike(first, other);
                let seeds = format!("seeds {} and {seed}", SEEDS[0]);
                let found = format!("{alike} of {both} are alike");
                let good = independent(first, other);
                assert!(good, "decisions {k} of {purpose} with {seeds}: {found}");
            }
        }
    }
}

/// Names of the purposes in the source of [`Stream`].
fn purposes(source: &str) -> Vec<&str> {
    let (_, after) = source.split_once("pub enum Stream {").unwrap();
    let (list, _) = after.split_once('}').unwrap();
    let code = list.lines().map(str::trim);
    let variants = code.filter(|line| !line.starts_with("///"));
    variants
        .filter_map(|line| line.split_once(" = "))
        .map(|(name, _)| name)
        .collect()
}

#[test]
fn no_purpose_is_left_out() {
    let purposes = purposes(include_str!("../src/base/rng.rs"));
    assert!(purposes.len() >= 19, "{purposes:?}");
    let cases = cases();
    let known =
        |purpose: &str| OTHERS.contains(&purpose) || cases.iter().any(|(name, _)| name == purpose);
    let unknown: Vec<_> = purposes.into_iter().filter(|p| !known(p)).collect();
    assert_eq!(unknown, Vec::<&str>::new());
    assert!(!known("Unheard"), "a purpose without a case must be found");
}

#[test]
fn decisions_that_ignore_the_seed_are_found() {
    let numbers = |seed: u64| births(seed, [0, 6000, 0], true);
    let (one, other) = (numbers(1), numbers(2));
    assert!(independent(&offsets(&one), &offsets(&other)));
    // All rows are drawn and accepted by either: these are the same decisions twice.
    assert!(!independent(&sources(&one), &sources(&other)));
    assert!(!independent(&offsets(&one), &offsets(&one)));
    // Nine of ten in common, too few to tell, none in common.
    let counted = |n: u64, from: u64| (0..n).map(|i| Some(i.max(from))).collect::<Decisions>();
    assert!(!independent(&counted(100, 0), &counted(100, 10)));
    assert!(!independent(&counted(19, 0), &vec![Some(99); 19]));
    assert!(!independent(&vec![None; 50], &counted(50, 0)));
    assert!(independent(&counted(20, 0), &vec![Some(99); 20]));
}
