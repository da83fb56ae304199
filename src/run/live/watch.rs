//! [`Watch`]: a training run that is looked at. Pictures are made between two iterations, with the run's own Gaussians, and rarely
//! enough that training hardly notices.

use std::time::{Duration, Instant};

use crate::base::error::Result;
use crate::capture::Camera;
use crate::capture::photo::Photo;
use crate::evaluate::Evaluator;
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::forward::{Quantity, Rendered};
use crate::run::live::paint::{self, Property};
use crate::run::live::server::Server;
use crate::run::live::studio::Scenery;
use crate::run::progress::Progress;
use crate::run::table::MetricsRow;
use crate::run::viewer::SceneView;
use crate::train::Trainer;

/// Share of the time of training that pictures take at most, as long as one takes less than a second. Encoding and sending them takes as long again on another core.
const SHARE: f64 = 0.025;

/// Longest time without a picture, whatever the last one took: whoever asks alone has an answer within a minute.
const MOST_REST: Duration = Duration::from_secs(30);

/// Time between two points of the loss.
const SAMPLING: Duration = Duration::from_secs(2);

/// Largest side of pictures of a run, pixels.
pub const LARGEST_LIVE: u32 = 1024;

/// Tile intersections that a picture may have whatever training needs: they take some 60 bytes each, on GPUs 90.
const INTERSECTIONS: usize = 1 << 20;

/// Longest time between two looks at a paused run's signals.
const GLANCE: Duration = Duration::from_millis(100);

/// A run that is looked at.
pub(crate) struct Watch {
    server: Server,
    views: Vec<SceneView>,
    training: ViewSet,
    /// No picture before that.
    free: Instant,
    /// No point of the loss before that.
    sample: Instant,
}

/// The Gaussians of a run, and the photos of the views that its page lists.
struct RunScenery<'a> {
    trainer: &'a mut Trainer,
    evaluator: Option<&'a Evaluator>,
    views: &'a [SceneView],
    training: &'a ViewSet,
}

impl Scenery for RunScenery<'_> {
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered> {
        self.trainer.glimpse(camera, quantity, INTERSECTIONS)
    }

    fn painted(&mut self, camera: &Camera, property: Property) -> Result<Option<Rendered>> {
        let colors = paint::colors(self.trainer, property)?;
        let trainer = &mut *self.trainer;
        let image = colors.map(|c| trainer.glimpse_colored(camera, &c, INTERSECTIONS));
        image.transpose()
    }

    fn photo(&mut self, view: usize) -> Result<Option<(Camera, Photo)>> {
        let SceneView {
            name,
            camera,
            held_out,
            ..
        } = &self.views[view];
        let set = match held_out {
            true => self.evaluator.map(Evaluator::views),
            false => Some(self.training),
        };
        let at = |set: &ViewSet| set.names.iter().position(|n| n == name);
        let found = set.and_then(|set| Some((set, at(set)?)));
        let photo = found.map(|(set, at)| set.read_photo(at)).transpose()?;
        Ok(photo.map(|photo| (*camera, photo)))
    }

    fn background(&self) -> [f32; 3] {
        self.trainer.schedule().fixed_background()
    }

    fn reach(&self) -> f64 {
        1.0
    }
}

impl Watch {
    /// A run with its evaluations so far.
    pub fn new(
        server: Server,
        views: Vec<SceneView>,
        training: ViewSet,
        rows: &[MetricsRow],
    ) -> Self {
        server.desk().tell(|told| {
            let curves = &mut told.curves;
            for row in rows {
                let at = row.iteration;
                curves.gaussians.push(at, row.gaussians as f64);
                row.loss.iter().for_each(|v| curves.loss.push(at, *v));
                row.psnr.iter().for_each(|v| curves.psnr.push(at, *v));
            }
        });
        let now = Instant::now();
        Self {
            server,
            views,
            training,
            free: now,
            sample: now,
        }
    }

    /// True if there is anything to do between two iterations.
    pub fn due(&self) -> bool {
        let (now, desk) = (Instant::now(), self.server.desk());
        now >= self.sample || (now >= self.free && desk.asked()) || desk.paused()
    }

    /// Tells the state of the run, and its loss now and then.
    pub fn tell(
        &mut self,
        progress: &Progress,
        saved: Option<u32>,
        trainer: &mut Trainer,
    ) -> Result<()> {
        let now = Instant::now();
        let sampled = now >= self.sample;
        let mut loss = None;
        if sampled {
            loss = trainer.noted_loss()?;
            self.sample = now + SAMPLING;
        }
        self.server.desk().tell(|told| {
            let at = progress.iteration;
            if sampled {
                told.curves.gaussians.push(at, progress.gaussians as f64);
                loss.iter().for_each(|v| told.curves.loss.push(at, *v));
            }
            if told.progress.psnr != progress.psnr {
                let psnr = progress.psnr.iter();
                psnr.for_each(|v| told.curves.psnr.push(at, *v));
            }
            told.progress.clone_from(progress);
            told.saved = saved;
        });
        Ok(())
    }

    /// Tells that training is done.
    pub fn ending(&self) {
        self.server.desk().tell(|told| told.ending = true);
    }

    /// Makes a picture, if one is asked for and the last one is long enough ago.
    pub fn show(&mut self, trainer: &mut Trainer, evaluator: Option<&Evaluator>) {
        let desk = self.server.desk();
        if Instant::now() < self.free && !desk.paused() {
            return;
        }
        let mut scenery = RunScenery {
            trainer,
            evaluator,
            views: &self.views,
            training: &self.training,
        };
        if let Some(took) = desk.answer(&mut scenery) {
            let rest = took.mul_f64(1.0 / SHARE - 1.0);
            self.free = Instant::now() + rest.min(MOST_REST);
        }
    }

    /// True while the run is to wait.
    pub fn paused(&self) -> bool {
        self.server.desk().paused() && !self.stops()
    }

    /// True if the run is to end as it does on Ctrl-C.
    pub fn stops(&self) -> bool {
        self.server.desk().stops()
    }

    /// True once for every wish of a checkpoint.
    pub fn takes_checkpoint(&self) -> bool {
        self.server.desk().takes_checkpoint()
    }

    /// Waits for the next question or wish for a moment.
    pub fn wait(&self) {
        self.server.desk().wait(GLANCE);
    }
}
