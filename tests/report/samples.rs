//! A made-up run.

use mhsplat::config::{Background, Init, Sampler, TrainConfig};
use mhsplat::density::DensityStats;
use mhsplat::evaluate::{Scores, ViewScore};
use mhsplat::run::*;
use mhsplat::run::{Item, PlanRecord};

pub fn scores(psnr: f64, ssim: f64, flip: f64) -> Scores {
    Scores {
        psnr,
        ssim,
        flip: Some(flip),
        ..Scores::default()
    }
}

pub fn item(what: &str, why: &str) -> Item {
    Item {
        what: what.into(),
        why: why.into(),
    }
}

fn plan() -> PlanRecord {
    PlanRecord {
        kept: vec![
            item("sort", "order by depth within each tile"),
            item("SH degree 3", "84 views see each point from many sides"),
        ],
        left_out: vec![
            item("alpha loss", "no photo has an alpha channel"),
            item("masks", "the dataset has none"),
            item(
                "photos on the device",
                "84 photos take 73 MiB; the device shares the host's memory, so nothing is copied",
            ),
        ],
    }
}

fn stages() -> Vec<StageRecord> {
    let stages = [
        ("project", 61.2),
        ("scan", 4.1),
        ("bin", 33.0),
        ("sort", 71.8),
        ("splat", 389.4),
        ("loss", 118.9),
        ("splat_grad", 566.1),
        ("project_grad", 72.3),
        ("adam", 63.5),
        ("importance", 8.8),
        ("density (host)", 21.2),
    ];
    stages
        .map(|(name, seconds)| StageRecord {
            name: name.into(),
            seconds,
            calls: 7000,
        })
        .to_vec()
}

pub fn record() -> RunRecord {
    let config = TrainConfig {
        seed: u64::MAX,
        iterations: 7000,
        time_budget: Some(600.0),
        background: Background::White,
        init: Init::File("a b/scene.ply".into()),
        sampler: Sampler::Mh,
        ..TrainConfig::default()
    };
    let mut record = RunRecord::new(
        config,
        DatasetRecord {
            path: "scenes/plush".into(),
            layout: "colmap-bin".into(),
            train_views: 84,
            test_views: 13,
            width: 640,
            height: 478,
            missing: Vec::new(),
            outliers: Vec::new(),
            masked_out: Vec::new(),
            fingerprint: Some("0123456789abcdef".into()),
            capture: None,
        },
        DeviceRecord {
            name: "cpu-znver3-AMD EPYC 7B13".into(),
            vendor: "AuthenticAMD".into(),
            platform: "Portable Computing Language".into(),
            driver: "3.1".into(),
            compute_units: Some(8),
            ranks: None,
            cores: Some(4),
            tuning: None,
        },
        plan(),
    );
    record.iterations = 7000;
    record.gaussians = 412_345;
    (record.train_seconds, record.wall_seconds) = (1432.6, 1503.2);
    (record.cpu_seconds, record.peak_rss_bytes) = (2715.4, 1_234_567_890);
    record.stages = stages();
    record.density = density()
        .iter()
        .fold(DensityStats::default(), |mut sum, r| {
            sum.proposed += r.stats.proposed;
            sum.accepted += r.stats.accepted;
            sum.relocated += r.stats.relocated;
            sum
        });
    record.final_scores = Some(FinalRecord {
        mean: scores(27.314_159, 0.871_23, 0.0912),
        per_view: vec![
            ViewScore {
                view: "IMG_0008.jpg".into(),
                scores: scores(26.9, 0.86, 0.0951),
            },
            ViewScore {
                view: "IMG_0016.jpg".into(),
                scores: scores(27.7, 0.88, 0.0873),
            },
        ],
    });
    record
}

pub fn row(iteration: u32) -> MetricsRow {
    let t = f64::from(iteration) / 7000.0;
    MetricsRow {
        iteration,
        train_seconds: 1432.6 * t.powf(1.2),
        wall_seconds: 1503.2 * t.powf(1.2),
        cpu_seconds: 2715.4 * t.powf(1.2),
        loss: (iteration > 0).then_some(0.03 + 0.2 * (-6.0 * t).exp()),
        psnr: Some(27.4 - 14.0 * (-7.0 * t).exp()),
        ssim: Some(0.872 - 0.4 * (-5.0 * t).exp()),
        gaussians: 20_000 + (392_000.0 * t.sqrt()) as u64,
        ..MetricsRow::default()
    }
}

pub fn rows() -> Vec<MetricsRow> {
    (0..=14).map(|i| row(i * 500)).collect()
}

pub fn density() -> Vec<DensityRow> {
    let steps = (2..=35).map(|i| {
        let (iteration, x) = (i * 100, f64::from(i));
        let wave = (x * 1.7).sin();
        let coarse = [
            4500 - 100 * u64::from(i),
            (1100.0 + 60.0 * wave - 22.0 * x) as u64,
        ];
        let fine = [
            16_000 - 300 * u64::from(i),
            (7900.0 + 300.0 * wave - 120.0 * x) as u64,
        ];
        DensityRow {
            iteration,
            train_seconds: 1432.6 * (f64::from(iteration) / 7000.0).powf(1.2),
            gaussians: 20_000 + (392_000.0 * (f64::from(iteration) / 7000.0).sqrt()) as u64,
            stats: DensityStats {
                proposed: coarse[0] + fine[0],
                accepted: coarse[1] + fine[1],
                relocated: (400.0 + 12.0 * x + 90.0 * wave) as u64,
                pruned: 0,
                coarse,
                fine,
                occupied_voxels: (9000.0 + 1900.0 * x) as u64,
                mean_prior: 0.21 + 0.3 * (-x / 9.0).exp(),
                ..DensityStats::default()
            },
        }
    });
    steps.collect()
}

pub fn view(name: &str, phase: f64) -> GalleryItem {
    let (width, height) = (160u32, 120u32);
    let (mut photo, mut render) = (Vec::new(), Vec::new());
    for y in 0..height {
        for x in 0..width {
            let (u, v) = (f64::from(x) / 160.0, f64::from(y) / 120.0);
            let ball = (u - 0.5).hypot((v - 0.55) * 0.75) < 0.22;
            let fine = 14.0 * (40.0 * u + phase).sin() * (31.0 * v).cos();
            let base = if ball {
                [190.0, 90.0, 60.0]
            } else {
                [90.0 + 60.0 * v, 120.0, 150.0 - 50.0 * u]
            };
            for c in base {
                photo.push((c + fine) as u8);
                let blur = if (u - 0.8).hypot(v - 0.3) < 0.12 {
                    34.0
                } else {
                    0.3 * fine
                };
                render.push((c + blur) as u8);
            }
        }
    }
    let error = error_map(&render, &photo).unwrap();
    GalleryItem {
        view: name.into(),
        training: false,
        psnr: 27.31,
        ssim: 0.8712,
        width,
        height,
        render,
        photo,
        error,
    }
}
