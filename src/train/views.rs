//! [`Views`]: the training views at the size and over the background of an iteration.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use crate::base::error::Result;
use crate::config::TrainConfig;
use crate::device::{CameraArg, ImageSize, PhotoScale};
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::pass::Target;
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::photos::AHEAD;
use crate::pipeline::share::Share;
use crate::pipeline::stage::loss::photo_rows;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;
use crate::train::sizes::Sizes;

/// A training view as an iteration takes it.
#[derive(Debug)]
pub struct TrainingView {
    /// Number of the view.
    pub number: usize,
    /// Camera at the photo's size.
    pub camera: CameraArg<f32>,
    /// Background colour.
    pub background: [f32; 3],
    /// The photo at its size of this iteration: all of it, or the rows that this rank's band needs.
    pub photo: Arc<PhotoArray>,
}

/// Training views with their order, sizes and backgrounds.
#[derive(Debug)]
pub struct Views {
    /// Cameras and photos at full size.
    pub set: ViewSet,
    pub(super) schedule: Schedule,
    sizes: Sizes,
    random_background: bool,
    skip_blank: bool,
    /// Bands of this rank when a view was seen last, by view and rows of tiles; those to come are near them.
    bands: BTreeMap<(usize, usize), Range<usize>>,
}

impl Views {
    /// Views of a set in the order and at the sizes of a plan.
    #[must_use]
    pub fn new(set: ViewSet, plan: &Plan) -> Self {
        Self {
            schedule: plan.schedule(),
            sizes: Sizes::new(&plan.detail.value, &plan.config.work),
            random_background: plan.random_background.value,
            skip_blank: plan.skip_blank.value,
            bands: BTreeMap::new(),
            set,
        }
    }

    /// Number of views.
    #[must_use]
    pub fn len(&self) -> usize {
        self.set.len()
    }

    /// True if there is no view.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.set.is_empty()
    }

    /// Numbers of the views of `count` iterations from `iteration` on.
    #[must_use]
    pub fn upcoming(&self, iteration: u32, count: usize) -> Vec<usize> {
        self.schedule.upcoming(iteration, count, self.len())
    }

    /// Number of the view of an iteration, and its size then.
    #[must_use]
    pub fn size_at(&self, iteration: u32) -> (usize, ImageSize) {
        let number = self.upcoming(iteration, 1)[0];
        (number, self.size_of(iteration, number))
    }

    /// Size of a view at an iteration.
    fn size_of(&self, iteration: u32, number: usize) -> ImageSize {
        let scale = self.scale(iteration, number);
        self.set.cameras[number].shrunk(scale).image()
    }

    /// Size of a view's photo at an iteration over its full size.
    fn scale(&self, iteration: u32, number: usize) -> PhotoScale {
        let full = self.set.cameras[number].image().pixels;
        self.schedule.scale_of(&self.sizes, iteration, full)
    }

    /// The view of an iteration; photos of the iterations after it are fetched meanwhile. Where ranks share it, of each photo the rows that
    /// this rank's band needs: the band that is set now, and for those to come that of the last time, at first an even one.
    ///
    /// # Errors
    /// A photo that cannot be read, or the driver's.
    pub fn at(&mut self, iteration: u32, share: Option<&Share<f32>>) -> Result<TrainingView> {
        let order = self.upcoming(iteration, 1 + AHEAD);
        let key = |number: usize, size: ImageSize| (number, size.tiles()[1]);
        if let Some(share) = share {
            let size = self.size_of(iteration, order[0]);
            self.bands.insert(key(order[0], size), share.own_band());
        }
        let rows = |number: usize| {
            let (share, size) = (share?, self.size_of(iteration, number));
            let band = self.bands.get(&key(number, size)).cloned();
            let band = band.unwrap_or_else(|| share.even_band(size));
            Some(photo_rows(&band, size))
        };
        self.taken([iteration; 2], order[0], &order[1..], rows)
    }

    /// A view by its number, with all of its photo, at the size of iteration `size_of` and over the background of iteration
    /// `background_of`.
    ///
    /// # Errors
    /// See [`Views::at`].
    pub fn view(
        &self,
        size_of: u32,
        background_of: u32,
        number: usize,
        next: &[usize],
    ) -> Result<TrainingView> {
        self.taken([size_of, background_of], number, next, |_| None)
    }

    fn taken(
        &self,
        [size_of, background_of]: [u32; 2],
        number: usize,
        next: &[usize],
        rows: impl Fn(usize) -> Option<Range<usize>>,
    ) -> Result<TrainingView> {
        let scale = |number| self.scale(size_of, number);
        let part = |number| (scale(number), rows(number));
        Ok(TrainingView {
            number,
            camera: self.set.cameras[number].shrunk(scale(number)),
            background: self
                .schedule
                .background(background_of, self.random_background),
            photo: self.set.photo_at(number, next, part)?,
        })
    }

    /// The same view over the background that does not change, for scores.
    #[must_use]
    pub fn over_fixed_background(&self, view: TrainingView) -> TrainingView {
        TrainingView {
            background: self.schedule.fixed_background(),
            ..view
        }
    }

    /// Photo and background of a view, for the loss.
    #[must_use]
    pub fn target<'a>(&self, view: &'a TrainingView) -> Target<'a> {
        Target {
            view: view.number,
            photo: &view.photo,
            background: view.background,
            skip_blank: self.skip_blank,
        }
    }

    /// The photos' sizes over the run.
    #[must_use]
    pub fn sizes(&self) -> &Sizes {
        &self.sizes
    }

    /// Number of times that photos are halved at an iteration.
    #[must_use]
    pub fn halvings(&self, iteration: u32) -> u32 {
        self.schedule.halvings(&self.sizes, iteration)
    }

    /// First iteration that takes photos at the largest size of the run.
    #[must_use]
    pub fn full_size_from(&self) -> u32 {
        self.schedule
            .full_size_from(&self.sizes, self.set.largest.pixels)
    }
}

/// Gaussians to make room for at the start: no more where the set never changes.
#[must_use]
pub fn capacity(config: &TrainConfig, count: usize) -> usize {
    match config.density_times() {
        None => count,
        Some(_) => crate::pipeline::buffers::GaussianBuffers::<f32>::grown_stride(count),
    }
}
