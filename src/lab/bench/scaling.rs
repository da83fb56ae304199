//! Several ranks on one scene: what an iteration takes and sends, and a model of as many nodes like this one.

use std::panic::resume_unwind;
use std::thread;
use std::time::Instant;

use serde::Serialize;

use crate::base::constants::SUMS;
use crate::base::error::{Error, Result};
use crate::base::process::process_cpu_seconds;
use crate::device::tuning::status;
use crate::device::{CameraArg, Device, DeviceKind, Helpers, Projected};
use crate::lab::bench::options::Options;
use crate::lab::bench::record::spread;
use crate::lab::bench::scene::{self, VIEWS};
use crate::lab::report::{Report, Section};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, digits, few, or_dash};
use crate::pipeline::forward::RenderOptions;
use crate::ranks::{Part, Traffic, Waits};
use crate::train::{Plan, Trainer};

/// Numbers of ranks that are measured.
const MEASURED: [usize; 3] = [1, 2, 4];
/// Order in which they are: two ranks between one and one beside another, with which they are compared.
const BY_TURNS: [usize; 3] = [1, 0, 2];
/// Numbers of ranks that the model tells.
const TOLD: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
/// Networks of the model: name, bits a second, seconds from one rank to another.
const NETWORKS: [(&str, f64, f64); 3] = [
    ("1 Gb/s", 1e9, 5e-5),
    ("10 Gb/s", 1e10, 2e-5),
    ("100 Gb/s", 1e11, 3e-6),
];
/// Trades of an iteration that are waited for one after the other: order, records, borders, loss, sums. Between processes records and sums
/// have two each, of which one passes while the device is at the other; the model leaves out what that saves.
const TRADES: f64 = 5.0;

/// Figures of an iteration by so many ranks.
#[derive(Debug, Clone, Serialize)]
pub struct Shared {
    /// Number of ranks.
    pub ranks: usize,
    /// Wall time, ms; it means something where every rank has its own cores.
    pub ms: Spread,
    /// CPU time of all ranks, ms.
    pub cpu_ms: Spread,
    /// True if every rank has its own cores.
    pub apart: bool,
    /// Bytes that one rank sends, by part.
    pub bytes: Vec<(&'static str, f64)>,
    /// Milliseconds for which the first rank waits for others, by part.
    pub waits_ms: Vec<(&'static str, f64)>,
    /// Milliseconds that a rank works on its rows and on its band, in the mean.
    pub works_ms: [f64; 2],
}

/// Caption of the table of iterations.
const SENT: &str = "An iteration; what the first rank sends to others, and, of all, what each would send if the record and the sums of every \
                    visible Gaussian travelled once.";

/// Counts of a trainer so far.
struct Counts {
    sent: Traffic,
    waited: Waits,
    worked: [f64; 2],
}

/// Figures of a scene by several numbers of ranks.
#[derive(Debug, Clone, Serialize)]
pub struct Scaling {
    /// Gaussians.
    pub gaussians: usize,
    /// Width and height, pixels.
    pub size: u32,
    /// Measured numbers of ranks.
    pub shared: Vec<Shared>,
    /// Visible Gaussians of a view, mean.
    pub visible: f64,
    /// Wall time of an iteration of one rank while another, on cores of its own, trains a scene of its own, ms. `None` where there are
    /// no two.
    pub beside_ms: Option<Spread>,
    /// Wall time of one rank over that of two, of samples that follow each other.
    pub speedup: Option<Spread>,
    /// The same of one beside another ([`Scaling::beside_ms`]): the machine takes as much from either side.
    pub speedup_beside: Option<Spread>,
}

/// So many devices: parts of one core each of the one selected, or, on a larger machine, a quarter of its cores.
fn devices(
    open: &dyn Fn(&str) -> Result<Device>,
    (device, cores): (&str, usize),
    ranks: usize,
) -> Result<Vec<Device>> {
    let parts = cores.clamp(1, MEASURED[MEASURED.len() - 1]);
    let part = match parts {
        1 => device.to_owned(),
        _ => format!("{device}/{parts}"),
    };
    // Of each list of parts there are as many as parts.
    let lists = vec![part; ranks.div_ceil(parts).max(1)];
    let all = open(&lists.join(","))?;
    let mut devices = vec![all.clone()];
    if let Helpers::Devices(others) = all.helpers() {
        devices.extend(others.iter().take(ranks - 1).cloned());
    }
    Ok(devices)
}

/// A trainer that changes nothing, by the devices.
fn trainer(devices: &[Device], (gaussians, size): (usize, u32)) -> Result<Trainer> {
    let data = scene::dataset(&scene::circle(size));
    let plan = Plan::new(&data, &scene::still(scene::SH_DEGREE))?;
    let mut trainer = Trainer::new(&devices[0], &data, &plan, &scene::cloud(gaussians))?;
    let helpers = match &devices[1..] {
        [] => Helpers::None,
        others => Helpers::Devices(others.into()),
    };
    let none = |_: &Trainer| Err(Error::numerics("bench", "processes"));
    trainer.recruit(&helpers, &data.train, data.image_budget, none)?;
    Ok(trainer)
}

/// Wall and CPU seconds of an iteration; Gaussians that are spread over ranks stay so.
fn sample(trainer: &mut Trainer, iterations: u32) -> Result<[f64; 2]> {
    let (began, cpu) = (Instant::now(), process_cpu_seconds());
    let goal = trainer.iteration() + iterations;
    while trainer.iteration() < goal {
        trainer.advance()?;
    }
    // Waits for the device.
    trainer.noted_loss()?;
    let each = f64::from(iterations);
    Ok([began.elapsed().as_secs_f64(), process_cpu_seconds() - cpu].map(|s| s / each))
}

/// Mean wall seconds of an iteration of trainers that have nothing to do with each other, at the same time; `None` without any.
fn sample_beside(trainers: &mut [Trainer], iterations: u32) -> Result<Option<f64>> {
    let each = thread::scope(|scope| {
        let spawn = |trainer| scope.spawn(move || sample(trainer, iterations));
        let threads: Vec<_> = trainers.iter_mut().map(spawn).collect();
        let join = |thread: thread::ScopedJoinHandle<_>| match thread.join() {
            Ok(sample) => sample,
            Err(panic) => resume_unwind(panic),
        };
        threads.into_iter().map(join).collect::<Result<Vec<_>>>()
    })?;
    let sum: f64 = each.iter().map(|[wall, _]| wall).sum();
    Ok((!each.is_empty()).then(|| sum / each.len() as f64))
}

/// Visible Gaussians of a view, mean.
fn visible(trainer: &mut Trainer, size: u32) -> Result<f64> {
    let (scene, renderer) = trainer.scene_and_renderer()?;
    let cameras = scene::circle(size);
    let mut all = 0;
    for camera in &cameras {
        let camera = CameraArg::<f32>::new(camera, renderer.frame.tile());
        renderer.render(scene, &camera, &RenderOptions::default())?;
        all += renderer.frame.status.read(status::VISIBLE as usize, 1)?[0];
    }
    Ok(f64::from(all) / cameras.len() as f64)
}

/// Measures the cases of the options that are large enough to be worth it, by turns of the numbers of ranks. `open` opens a list of
/// devices, and `device` is the selector of the one to be measured.
///
/// # Errors
/// A device that cannot be divided, no room, or the driver's.
pub fn measure(
    open: &dyn Fn(&str) -> Result<Device>,
    device: &str,
    options: &Options,
    note: &mut dyn FnMut(&str),
) -> Result<Vec<Scaling>> {
    let info = open(device)?.info().clone();
    let cores = match info.kind {
        DeviceKind::Cpu => info.cores as usize,
        _ => 1,
    };
    let measure_case = |case: &(usize, u32)| {
        note(&format!("{} Gaussians, {} px", case.0, case.1));
        let devices = |ranks: usize| devices(open, (device, cores), ranks);
        let make = |ranks: &usize| trainer(&devices(*ranks)?, *case);
        let mut trainers: Vec<Trainer> = MEASURED.iter().map(make).collect::<Result<_>>()?;
        let mut singles: Vec<Trainer> = match cores {
            0 | 1 => Vec::new(),
            _ => {
                let devices = devices(2)?;
                let each = devices.chunks(1).map(|device| trainer(device, *case));
                each.collect::<Result<_>>()?
            }
        };
        sample_beside(&mut singles, VIEWS)?;
        let mut iterations = VIEWS;
        for trainer in &mut trainers {
            // Every view once, for its bands; then the length of a sample.
            sample(trainer, VIEWS)?;
            let [wall, _] = sample(trainer, VIEWS)?;
            let passes = options.sample_seconds / (wall * f64::from(VIEWS)).max(1e-9);
            iterations = iterations.max(VIEWS * passes.ceil().clamp(1.0, 100.0) as u32);
        }
        let counts = |trainer: &Trainer| Counts {
            sent: trainer.traffic().unwrap_or_default(),
            waited: trainer.waits().unwrap_or_default(),
            worked: trainer.worked().unwrap_or_default(),
        };
        let before: Vec<Counts> = trainers.iter().map(counts).collect();
        let mut samples = vec![Vec::new(); trainers.len()];
        let mut beside = Vec::new();
        for _ in 0..options.samples {
            beside.extend(sample_beside(&mut singles, iterations)?);
            for k in BY_TURNS {
                samples[k].push(sample(&mut trainers[k], iterations)?);
            }
        }
        let mut shared = Vec::new();
        for (k, (trainer, before)) in trainers.iter().zip(before).enumerate() {
            let of = |which: usize| {
                let figures = samples[k].iter().map(|s| 1e3 * s[which]);
                spread("bench", figures)
            };
            let after = counts(trainer);
            let done = f64::from(iterations) * options.samples as f64;
            let bytes = |part: Part| {
                let [before, after] = [&before, &after].map(|c| c.sent[part as usize]);
                (part.name(), (after - before) as f64 / done)
            };
            let wait = |part: Part| {
                let [before, after] = [&before, &after].map(|c| c.waited[part as usize]);
                (part.name(), 1e3 * (after - before) / done)
            };
            let work = |k: usize| 1e3 * (after.worked[k] - before.worked[k]) / done;
            shared.push(Shared {
                ranks: MEASURED[k],
                ms: of(0)?,
                cpu_ms: of(1)?,
                apart: MEASURED[k] <= cores,
                bytes: Part::ALL.map(bytes).to_vec(),
                waits_ms: Part::ALL.map(wait).to_vec(),
                works_ms: [work(0), work(1)],
            });
        }
        let walls = |k: usize| samples[k].iter().map(|s| s[0]).collect::<Vec<f64>>();
        let faster = |one: &[f64]| {
            let ratios: Vec<f64> = one.iter().zip(walls(1)).map(|(a, b)| a / b).collect();
            Spread::of_ratios(&ratios).filter(|_| MEASURED[1] <= cores)
        };
        Ok(Scaling {
            gaussians: case.0,
            size: case.1,
            visible: visible(&mut trainers[0], case.1)?,
            beside_ms: Spread::of(&beside).map(|s| s.scaled(1e3)),
            speedup: faster(&walls(0)),
            speedup_beside: faster(&beside),
            shared,
        })
    };
    options.cases.iter().map(measure_case).collect()
}

/// Seconds of an iteration by so many ranks, by part.
#[derive(Debug, Clone, Copy)]
struct Predicted {
    compute: f64,
    network: f64,
    latency: f64,
}

impl Predicted {
    fn total(self) -> f64 {
        self.compute + self.network + self.latency
    }

    /// Name of the largest part.
    fn limit(self) -> &'static str {
        match self {
            p if p.compute >= p.network.max(p.latency) => "computing",
            p if p.network >= p.latency => "bandwidth",
            _ => "latency",
        }
    }
}

impl Scaling {
    fn of(&self, ranks: usize) -> Option<&Shared> {
        self.shared.iter().find(|s| s.ranks == ranks)
    }

    /// Milliseconds of CPU that one rank takes, and that each further rank adds: least squares over what was measured.
    fn compute(&self) -> [f64; 2] {
        let one = self.of(1).map_or(0.0, |s| s.cpu_ms.median);
        let more = self.shared.iter().filter(|s| s.ranks > 1);
        let points = more.map(|s| ((s.ranks - 1) as f64, s.cpu_ms.median - one));
        let (xy, xx) = points.fold((0.0, 0.0), |(xy, xx), (x, y)| (xy + x * y, xx + x * x));
        [one, if xx > 0.0 { (xy / xx).max(0.0) } else { 0.0 }]
    }

    /// Bytes that one of so many ranks sends: the share of what it has in sight ([`Scaling::bound`]) that leaves it. From four ranks on
    /// it grows with every doubling as from two to four, until all leave.
    fn bytes(&self, ranks: usize) -> f64 {
        let share = |ranks| {
            let shared = self.of(ranks);
            let sent = shared.map_or(0.0, |s| s.bytes.iter().map(|(_, bytes)| bytes).sum::<f64>());
            sent / self.bound(ranks)
        };
        let [two, four] = [2, 4].map(share);
        let doublings = (ranks as f64).log2() - 2.0;
        let leaves = match ranks {
            1 => 0.0,
            2 => two,
            3 | 4 => two + (doublings + 1.0) * (four - two),
            _ => (four * (four / two).max(1.0).powf(doublings)).clamp(four, four.max(1.0)),
        };
        leaves * self.bound(ranks)
    }

    /// Seconds of an iteration by so many ranks, each with the cores that one has here, over a network.
    fn predict(&self, ranks: usize, (_, bits, delay): (&str, f64, f64)) -> Predicted {
        let [one, more] = self.compute();
        let r = ranks as f64;
        let alone = if ranks == 1 { 0.0 } else { 1.0 };
        Predicted {
            compute: 1e-3 * (one + more * (r - 1.0)) / r,
            network: 8.0 * self.bytes(ranks) / bits,
            latency: alone * TRADES * delay * (1.0 + r.log2()),
        }
    }

    /// Bytes that one of so many ranks would send if the records and the sums of all visible Gaussians travelled once.
    fn bound(&self, ranks: usize) -> f64 {
        let each = size_of::<Projected<f32>>() + SUMS * size_of::<f32>();
        self.visible * each as f64 / ranks as f64
    }

    fn title(&self) -> String {
        format!(
            "{} Gaussians, {} × {} px",
            self.gaussians, self.size, self.size
        )
    }

    fn sections(&self) -> Vec<Section> {
        let row = |s: &Shared| {
            let bytes = |name: &str| {
                let found = s.bytes.iter().find(|(part, _)| *part == name);
                digits(found.map_or(0.0, |(_, bytes)| bytes / 1e3))
            };
            let ms = |spread: &Spread| few(spread, digits);
            vec![
                s.ranks.to_string(),
                if s.apart { ms(&s.ms) } else { "–".to_owned() },
                ms(&s.cpu_ms),
                bytes("records"),
                bytes("sums"),
                digits(self.bound(s.ranks) / 1e3),
                bytes("borders"),
                bytes("loss"),
            ]
        };
        let columns = [
            "ranks",
            "ms",
            "CPU ms of all",
            "records, kB",
            "sums, kB",
            "of all, kB",
            "borders, kB",
            "loss, kB",
        ];
        let seconds = |s: &Shared| {
            let waits = |name: &str| {
                let found = s.waits_ms.iter().find(|(part, _)| *part == name);
                digits(found.map_or(0.0, |(_, ms)| *ms))
            };
            let mut cells = vec![s.ranks.to_string()];
            cells.extend(s.works_ms.map(digits));
            cells.extend(["orders", "records", "borders", "loss", "sums"].map(waits));
            cells
        };
        let spent = [
            "ranks",
            "rows",
            "band",
            "wait: orders",
            "wait: records",
            "wait: borders",
            "wait: loss",
            "wait: sums",
        ];
        let [speedup, beside] =
            [&self.speedup, &self.speedup_beside].map(|r| or_dash(r.as_ref(), |r| few(r, digits)));
        let measured = match self.speedup {
            Some(_) => format!(
                "{}, two ranks {speedup} as fast as one, {beside} as one beside another scene",
                self.title()
            ),
            None => self.title(),
        };
        let model = |ranks: &usize| {
            let one = self.predict(1, NETWORKS[0]).total();
            let cells = NETWORKS.map(|network| {
                let p = self.predict(*ranks, network);
                format!("{} ({})", digits(one / p.total()), p.limit())
            });
            let bytes = digits(self.bytes(*ranks) / 1e3);
            [vec![ranks.to_string(), bytes], cells.to_vec()].concat()
        };
        let [a, b, c] = NETWORKS.map(|(name, ..)| name);
        vec![
            Section::Table(Table::new(
                measured,
                match &self.beside_ms {
                    Some(ms) => format!(
                        "{SENT} One rank takes {} ms while another trains a scene of its own, which takes caches, memory and clock from \
                         it, too.",
                        few(ms, digits)
                    ),
                    None => SENT.to_owned(),
                },
                &columns,
                self.shared.iter().map(row),
            )),
            Section::Table(Table::new(
                format!("{}: milliseconds of an iteration, by part", self.title()),
                "Work of a rank on its rows and on its band, in the mean; what the first rank waits for the others' messages.",
                &spent,
                self.shared.iter().filter(|s| s.ranks > 1).map(seconds),
            )),
            Section::Table(Table::new(
                format!(
                    "{}, as many nodes as ranks: model of the speed-up",
                    self.title()
                ),
                "In brackets the largest part of an iteration's time. The share of what a rank has in sight that leaves it grows from four ranks \
                 on as from two to four. Density steps and evaluations are not in the model.",
                &["ranks", "kB sent by one", a, b, c],
                TOLD.iter().map(model),
            )),
        ]
    }
}

/// The report on several ranks.
#[must_use]
pub fn report(all: &[Scaling]) -> Report {
    Report {
        title: "Several ranks".to_owned(),
        note: "One scene, trained by ranks with a core each, or as many as a quarter of the device has. CPU time is that of all ranks; \
               times by turns."
            .to_owned(),
        sections: all.iter().flat_map(Scaling::sections).collect(),
        ..Report::default()
    }
}

#[cfg(test)]
mod tests {
    use super::{NETWORKS, Part, Scaling, Shared};
    use crate::lab::stats::Spread;

    fn shared(ranks: usize, cpu: f64, bytes: f64) -> Shared {
        let spread = |v: f64| Spread::of(&[v, v, v]).unwrap();
        Shared {
            ranks,
            ms: spread(cpu / ranks as f64),
            cpu_ms: spread(cpu),
            apart: true,
            bytes: vec![(Part::Records.name(), bytes)],
            waits_ms: Vec::new(),
            works_ms: [0.0; 2],
        }
    }

    #[test]
    fn the_model_goes_through_what_was_measured() {
        // 100 ms, 2 more for each rank; 84 MB in sight, of which a tenth leaves two ranks, three tenths four.
        let bytes = |r: f64| {
            let share = [0.0, 0.1, 0.3, 0.9, 1.0][(r.log2() as usize).min(4)];
            84e6 / r * share
        };
        let of = |ranks: usize| {
            let r = ranks as f64;
            shared(
                ranks,
                98.0 + 2.0 * r,
                if ranks == 1 { 0.0 } else { bytes(r) },
            )
        };
        let scaling = Scaling {
            gaussians: 1,
            size: 1,
            shared: vec![of(1), of(2), of(4)],
            visible: 1e6,
            beside_ms: None,
            speedup: None,
            speedup_beside: None,
        };
        assert_eq!(scaling.compute(), [100.0, 2.0]);
        for ranks in [1, 2, 4, 8, 64] {
            let (got, want) = (scaling.bytes(ranks), bytes(ranks as f64));
            assert!((got - want).abs() < 1e-3, "{ranks}: {got} {want}");
        }
        let slow = scaling.predict(64, NETWORKS[0]);
        assert_eq!(slow.limit(), "bandwidth");
        let fast = scaling.predict(2, NETWORKS[2]);
        assert_eq!(fast.limit(), "computing");
        assert!((fast.compute - 0.051).abs() < 1e-9);
        assert_eq!(scaling.predict(1, NETWORKS[0]).total(), 0.1);
        // A record of 48 bytes and nine sums, of half of the visible Gaussians.
        assert_eq!(scaling.bound(2), 1e6 * (48.0 + 36.0) / 2.0);
    }
}
