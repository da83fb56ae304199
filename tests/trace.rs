//! The trace of density control: what became of every birth, relocation and death.

use mhsplat::config::MhConfig;
use mhsplat::density::{BirthKind, BirthRecord, DensityStats, Outcome};
use mhsplat::run::density_trace::{funnel, write_trace};
use mhsplat::scene::{Edit, OptionalColor};
use mhsplat::train::trace::{DensityTrace, MoveKind};
use mhsplat::train::{Event, Trainer};
use mhsplat::{Plan, TrainConfig};

use crate::determinism::{room, trained};

fn edit(src: u32, dst: u32) -> Edit {
    Edit {
        src,
        dst,
        position: [0.0; 3],
        log_scale: [0.0; 3],
        opacity_logit: 0.0,
        color: OptionalColor::NONE,
    }
}

fn birth(dst: u32, kind: BirthKind) -> BirthRecord {
    BirthRecord {
        dst,
        source: Some(1),
        kind,
        importance: 0.6,
        change: None,
        ln_ratio: -0.5,
        voxel_count: 2,
    }
}

#[test]
fn a_trace_follows_gaussians_by_hand() {
    let mut trace = DensityTrace::new(4);
    // Row 0 takes over row 3's place, 1 bears two, 2 is removed; then the order is reversed.
    let first = Outcome {
        edits: vec![edit(3, 3), edit(3, 0), edit(1, 4), edit(1, 5)],
        rows: 6,
        removed: vec![2],
        births: vec![birth(4, BirthKind::Coarse), birth(5, BirthKind::Fine)],
        ..Outcome::default()
    };
    trace.step(100, &[-9.0, 1.0, -9.0, 1.0], &first, Some(&[5, 4, 3, 1, 0]));
    assert_eq!(trace.gaussians(), 5);
    let kinds: Vec<_> = trace.moves().iter().map(|m| (m.kind, m.gaussian)).collect();
    use MoveKind::{CoarseBirth, Death, FineBirth, PixelBirth, Relocation};
    assert_eq!(
        kinds,
        [
            (Death, 2),
            (Relocation, 4),
            (CoarseBirth, 5),
            (FineBirth, 6)
        ]
    );
    let sources: Vec<_> = trace.moves().iter().map(|m| m.source).collect();
    assert_eq!(sources, [None, Some(3), Some(1), Some(1)]);
    // The fine birth, now row 0, is dead and gives way; nothing else happens but a birth in image space.
    let second = Outcome {
        edits: vec![edit(2, 2), edit(2, 0), edit(1, 5)],
        rows: 6,
        births: vec![BirthRecord {
            source: None,
            ..birth(5, BirthKind::Pixel)
        }],
        ..Outcome::default()
    };
    trace.step(200, &[-9.0, 0.0, 1.0, 1.0, 1.0], &second, None);
    let moves = trace.moves();
    assert_eq!((moves[3].ended, moves[2].ended), (Some(200), None));
    assert!(moves[3].opacity_next.unwrap() < 0.005);
    assert_eq!(moves[2].opacity_next, Some(0.5));
    assert_eq!((moves[4].kind, moves[4].source), (Relocation, Some(3)));
    assert_eq!((moves[5].kind, moves[5].source), (PixelBirth, None));
    trace.remove_unseen(300, &[0, 1, 5]);
    trace.finish(&[2.0, 2.0, -4.0], &[1.0, 2.0, 5.0]);
    let moves = trace.moves();
    let unseen = moves.iter().filter(|m| m.kind == MoveKind::Unseen);
    assert_eq!(unseen.map(|m| m.gaussian).collect::<Vec<_>>(), [3, 1, 4]);
    assert_eq!(moves[2].contribution, Some(2.0));
    assert_eq!(moves[1].opacity_end, None);
    let stats = DensityStats {
        coarse: [7, 1],
        fine: [9, 1],
        pixel: [3, 1],
        ..DensityStats::default()
    };
    let rows = funnel(&trace, &stats, 0.005);
    let row = |kind| rows.iter().find(|r| r.kind == kind).copied().unwrap();
    let coarse = row(CoarseBirth);
    assert_eq!((coarse.proposed, coarse.made), (Some(7), 1));
    assert_eq!((coarse.alive, coarse.in_use, coarse.share), (1, 1, 0.25));
    let fine = row(FineBirth);
    assert_eq!((fine.made, fine.alive, fine.in_use), (1, 0, 0));
    let pixel = row(PixelBirth);
    assert_eq!((pixel.in_use, pixel.share), (0, 0.625));
}

#[test]
fn a_traced_run_has_the_same_bits_and_every_move() {
    let data = room(64);
    let config = TrainConfig {
        iterations: 120,
        max_size: 64,
        sh_degree: 1,
        trace_density: true,
        mh: MhConfig {
            pair_pixels: 0.0,
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    };
    let (mut traced, _) = trained(&data, &config, 0);
    while traced.advance().unwrap() != Event::Finished {}
    let untraced = TrainConfig {
        trace_density: false,
        ..config.clone()
    };
    let (mut plain, _) = trained(&data, &untraced, 0);
    while plain.advance().unwrap() != Event::Finished {}
    assert!(plain.density_trace().unwrap().is_none());
    assert!(plain.state().unwrap().splats == traced.state().unwrap().splats);

    let stats = *traced.stats();
    let trace = traced.density_trace().unwrap().unwrap().clone();
    let count = |kinds: &[MoveKind]| {
        let of = trace.moves().iter().filter(|m| kinds.contains(&m.kind));
        of.count() as u64
    };
    assert!(stats.accepted > 0);
    use MoveKind::{CoarseBirth, Death, FineBirth, PixelBirth, Relocation};
    assert_eq!(count(&[PixelBirth, CoarseBirth, FineBirth]), stats.accepted);
    assert_eq!(count(&[Relocation]), stats.relocated);
    assert_eq!(count(&[Death]), stats.pruned);
    assert_eq!(trace.gaussians(), traced.gaussians());
    // Weights sum to what the Gaussians cover, which is no more than all pixels.
    let pixels: usize = data
        .train
        .iter()
        .map(|v| (v.camera.width * v.camera.height) as usize)
        .sum();
    let covered = trace.contribution() / pixels as f64;
    assert!((0.5..=1.001).contains(&covered), "{covered}");
    // A birth that is left at the end was not ended before.
    for made in trace.moves().iter().filter(|m| m.opacity_end.is_some()) {
        assert!(made.ended.is_none() && made.contribution.is_some());
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trace.csv");
    write_trace(&path, &trace).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(text.lines().count(), trace.moves().len() + 1);
    assert!(!text.contains("NaN"));

    // A resumed run has no trace: the beginning is not known.
    let (mut half, _) = trained(&data, &config, 48);
    let state = half.state().unwrap();
    let device = mhsplat::device::Device::open(None).unwrap();
    let plan = Plan::new(&data, &config).unwrap();
    let mut resumed = Trainer::new(&device, &data, &plan, &state.splats).unwrap();
    resumed.restore(&state).unwrap();
    assert!(resumed.density_trace().unwrap().is_none());
}
