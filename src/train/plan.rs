//! [`Plan`]: what this scene needs, and what is left out because it does not.

use serde::{Deserialize, Serialize};

use crate::capture::{Alpha, Dataset, View};
use crate::config::{Background, ExposureChoice, Init, MhConfig, Sampler, TrainConfig};
use crate::train::brightness::{Decision, TRANSPARENT};
use crate::train::finish::Findings;
use crate::train::sampling_rates::AntiAlias;
use crate::train::schedule::Schedule;

/// Items that training decides.
const COLOUR: &str = "view-dependent colour";
const EXPOSURE: &str = "per-image exposure";
const UNSEEN: &str = "Gaussians that no training view shows";

/// One decision.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// What is kept or left out.
    pub what: String,
    /// Why.
    pub why: String,
}

/// Decisions taken from the dataset and the configuration before training.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Plan {
    /// What is computed.
    pub kept: Vec<Item>,
    /// What is not, and costs nothing.
    pub left_out: Vec<Item>,
}

impl Plan {
    /// Decides for a dataset and a configuration.
    #[must_use]
    pub fn new(dataset: &Dataset, config: &TrainConfig) -> Self {
        let mut plan = Self::default();
        plan.photos(dataset, config);
        plan.decide(
            config.sh_degree > 0,
            COLOUR,
            &format!("SH degree {}, one band after the other", config.sh_degree),
            "SH degree 0 asked for",
        );
        let filters = AntiAlias::decide(dataset, config);
        plan.decide(filters.on, "anti-aliasing", &filters.why, &filters.why);
        plan.decide_work(dataset, config);
        plan.sampler(config);
        plan.exposure(config, dataset.alpha());
        plan.decide(
            !dataset.test.is_empty(),
            "held-out evaluation",
            &format!("{} views are held out", dataset.test.len()),
            "no view is held out",
        );
        let points = dataset.points.positions.len();
        plan.decide(
            config.init == Init::Points && points > 0,
            "initial Gaussians from sparse points",
            &format!("{points} points"),
            if config.init == Init::Points {
                "the dataset has no points; random initialisation"
            } else {
                "another initialisation asked for"
            },
        );
        plan
    }

    /// What the photos are like.
    fn photos(&mut self, dataset: &Dataset, config: &TrainConfig) {
        self.decide(
            dataset.background_matters(),
            "photo alpha over the background",
            "photos have transparent pixels",
            "no photo is transparent",
        );
        let asked = config.background != Background::Auto;
        let one = format!("one colour asked for: {}", String::from(config.background));
        self.decide(
            config.background.changes(dataset.background_matters()),
            "a background of another colour in each iteration",
            match asked {
                true => "asked for",
                false => "photos are transparent: over one colour a scene keeps fog of it",
            },
            match asked {
                true => &one,
                false => "no photo is transparent",
            },
        );
        self.decide(
            dataset.alpha() == Alpha::Mask,
            "masks",
            "render and photo are compared where masks are not black; tiles that are get no pairs",
            "there is no mask",
        );
        self.decide(
            dataset.undistorted > 0,
            "undistortion",
            &format!("{} photos are of lenses that need it", dataset.undistorted),
            "every camera is a pinhole",
        );
        let mebibytes = |bytes: u64| format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20));
        let photos = mebibytes(dataset.photo_bytes());
        self.decide(
            dataset.photos_on_demand(),
            "photos decoded ahead of their use",
            &format!(
                "they take {photos}, and {} is their budget",
                mebibytes(dataset.image_budget)
            ),
            &format!("all photos fit in memory ({photos})"),
        );
    }

    /// The plan with what training has found out.
    #[must_use]
    pub fn observed(&self, config: &TrainConfig, findings: &Findings) -> Self {
        let mut plan = self.clone();
        if findings.finished.is_some() && config.work.remove_unseen {
            let why = format!(
                "{} removed at the end; the training views stay as they are to the bit",
                findings.removed
            );
            plan.decide(false, UNSEEN, "", &why);
        }
        plan
    }

    /// What this plan says otherwise than an earlier one; none if it is the same.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Option<String> {
        let new = |items: &[Item], old: &[Item]| -> Vec<String> {
            let fresh = items.iter().filter(|i| !old.contains(i));
            fresh.map(|i| format!("{}: {}", i.what, i.why)).collect()
        };
        let kept = new(&self.kept, &earlier.kept);
        let out = new(&self.left_out, &earlier.left_out);
        let line = |label: &str, items: &[String]| {
            let some = !items.is_empty();
            some.then(|| format!("{label}: {}", items.join("; ")))
        };
        let lines = [line("kept", &kept), line("left out", &out)];
        let lines: Vec<String> = lines.into_iter().flatten().collect();
        (!lines.is_empty()).then(|| format!("found in training: {}", lines.join("; ")))
    }

    /// What saves work: switched on is kept.
    fn decide_work(&mut self, dataset: &Dataset, config: &TrainConfig) {
        let work = &config.work;
        let schedule = Schedule::new(config);
        let first = |v: &View| {
            let size = [v.camera.width as usize, v.camera.height as usize];
            schedule.shrink_factor(0, size)
        };
        let factor = dataset.train.iter().map(first).max().unwrap_or(1);
        let coarse = match (work.resolution_levels, config.time_budget) {
            (0, _) => "work.resolution-levels is 0",
            (_, Some(_)) => "a time budget may end the run before it comes to full photos",
            _ => "the photos are too small to be halved",
        };
        self.decide(
            factor > 1,
            "coarse photos first",
            &format!(
                "1/{factor} of their size at first; measured on five scenes: most errors are reached 1.1 to 1.8 times sooner"
            ),
            coarse,
        );
        self.decide(
            work.morton_order,
            "Morton order",
            "neighbours in space share cache lines and are culled together",
            "work.morton-order is off",
        );
        self.decide(
            work.cull_chunks,
            "culling of neighbours together",
            "what a view cannot see costs it next to nothing",
            "work.cull-chunks is off",
        );
        let (alpha, blank) = match dataset.alpha() {
            Alpha::None => ("no photo is transparent or masked", false),
            _ => ("work.skip-blank is off", work.skip_blank),
        };
        self.decide(
            blank,
            "loss skipped where render and photo are blank",
            "no gradient comes from clear or masked tiles that no Gaussian reaches",
            alpha,
        );
        if !work.remove_unseen {
            let what = "removal of Gaussians that no training view shows";
            self.decide(false, what, "", "work.remove-unseen is off");
        }
    }

    /// Whether exposure is compensated, as far as the configuration and the photos say.
    fn exposure(&mut self, config: &TrainConfig, alpha: Alpha) {
        let from = Schedule::new(config).exposure_from().unwrap_or(0);
        let (on, why) = match (config.exposure, alpha) {
            (ExposureChoice::On, _) => (true, "exposure is on"),
            (ExposureChoice::Off, _) => (false, "exposure is off"),
            (ExposureChoice::Auto, Alpha::Transparency) => (false, TRANSPARENT),
            (ExposureChoice::Auto, _) if from >= config.iterations => {
                (false, "the run is too short to tell whether it is needed")
            }
            (ExposureChoice::Auto, _) => (
                false,
                "photos are compared with their renders first: on if their brightness varies",
            ),
        };
        self.decide(on, EXPOSURE, why, why);
    }

    /// What was decided on exposure on the way.
    pub(crate) fn exposure_decided(&mut self, decision: Decision) {
        let why = decision.why();
        self.decide(decision.on, EXPOSURE, &why, &why);
    }

    fn sampler(&mut self, config: &TrainConfig) {
        let errors = "importance pass";
        match config.sampler {
            Sampler::Mh => self.metropolis_hastings(&config.mh, errors),
            Sampler::Mcmc => {
                let most = config.max_gaussians.unwrap_or(config.mcmc.cap);
                let why = format!("MCMC sampler, at most {most} Gaussians");
                self.decide(true, "noise on positions, relocation, growth", &why, "");
                self.decide(false, errors, "", "the MCMC sampler draws by opacity");
            }
            Sampler::Adc => {
                let what = "gradients on the screen, clone, split, prune, opacity reset";
                self.decide(true, what, "ADC sampler", "");
                let why = "the ADC sampler goes by gradients on the screen";
                self.decide(false, errors, "", why);
            }
            Sampler::None => self.decide(
                false,
                "importance pass and density control",
                "",
                "a fixed set of Gaussians asked for",
            ),
        }
    }

    fn metropolis_hastings(&mut self, mh: &MhConfig, errors: &str) {
        let sampler = "Metropolis-Hastings sampler";
        if mh.wants_errors() {
            self.decide(true, "importance pass and density control", sampler, "");
        } else {
            self.decide(true, "density control", sampler, "");
            let why = "mh.importance is off, or no cue of errors has a weight";
            self.decide(false, errors, "", why);
        }
        if mh.probed_views() > 0 {
            let why = format!("births are judged by probes in {} views", mh.probe_views);
            self.decide(true, "probes", &why, "");
        }
        let why = "mh.noise-rate moves what is faint";
        let why_not = "mh.noise-rate is 0";
        self.decide(mh.noise_rate > 0.0, "noise on positions", why, why_not);
        let why = format!(
            "{} views are rendered for each step; of pixels that show a surface {:.0} %",
            mh.pixel_views,
            100.0 * mh.pixel_surface
        );
        let why_not = "mh.pixel-proposals is 0";
        self.decide(
            mh.pixel_proposals > 0,
            "births in image space",
            &why,
            why_not,
        );
    }

    /// Puts an item on one of the lists; what was said of it before goes.
    fn decide(&mut self, keep: bool, what: &str, why: &str, why_not: &str) {
        for list in [&mut self.kept, &mut self.left_out] {
            list.retain(|item| item.what != what);
        }
        let (list, why) = if keep {
            (&mut self.kept, why)
        } else {
            (&mut self.left_out, why_not)
        };
        list.push(Item {
            what: what.into(),
            why: why.into(),
        });
    }

    /// One line for the terminal.
    #[must_use]
    pub fn summary(&self) -> String {
        let kept: Vec<&str> = self.kept.iter().map(|i| i.what.as_str()).collect();
        let out: Vec<String> = self
            .left_out
            .iter()
            .map(|i| format!("{}, because {}", i.what, i.why))
            .collect();
        if out.is_empty() {
            format!("plan: {}", kept.join(", "))
        } else {
            format!("plan: {}; left out: {}", kept.join(", "), out.join("; "))
        }
    }
}
