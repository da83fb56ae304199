//! Training by several ranks, threads of this process or processes, with a device each. The leader trains as if it were alone; the rows of the Gaussians are
//! spread over the ranks, and gathered for what takes all of them on one device.

use std::ops::Range;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use crate::base::error::{Error, Result};
use crate::capture::View;
use crate::density::DensityControl;
use crate::device::tuning::status;
use crate::device::{Device, Helpers};
use crate::pipeline::buffers::{Shard, ViewSet};
use crate::pipeline::photos::Photos;
use crate::pipeline::share::Share;
use crate::ranks::{Exchange, LEADER, Part, Traffic, Waits, threads, to_all, to_one};
use crate::scene::Gaussians;
use crate::train::crew::{
    COUNT, Crew, DECIDE, EDIT, END, EXPOSE, GATHER, ITERATE, KEEP, LENGTH, LOOK, RAISE, SEEN,
    SMOOTH, SPREAD, Words, length_of, words_of_length,
};
use crate::train::gaussians::{Carried, GaussianRows, GaussianState};
use crate::train::plan::Plan;
use crate::train::step::{Trainer, no_gaussian};
use crate::train::trace::DensityTrace;
use crate::train::views::capacity;

/// Threads of the ranks that do not lead.
type Threads = Vec<JoinHandle<()>>;

impl Trainer {
    /// Has the device's helpers train with this trainer; the result has the same bits. Other devices get a thread each; `views` are those
    /// of this trainer, whose photos each device reads itself, within `image_budget` bytes: whole if they are in memory, else the rows that
    /// its bands need. Other processes get `beginning`, and
    /// make their trainers from that ([`Trainer::follow`]).
    ///
    /// # Errors
    /// No thread, a build failure or no room on any of the devices.
    pub fn recruit(
        &mut self,
        helpers: &Helpers,
        views: &[View],
        image_budget: u64,
        beginning: impl FnOnce(&Self) -> Result<Vec<u32>>,
    ) -> Result<()> {
        let (exchange, threads) = match helpers {
            _ if self.crew.is_some() => return Ok(()),
            Helpers::None => return Ok(()),
            Helpers::Devices(devices) => self.begin_threads(devices, views, image_budget)?,
            Helpers::Processes(exchange) => {
                let words = beginning(self)?;
                exchange.trade(Part::Orders, to_all(exchange.as_ref(), words))?;
                (exchange.clone(), Vec::new())
            }
        };
        let mut crew = Crew::new(exchange, threads);
        crew.idle = Some(self.share(crew.exchange.clone())?);
        // Everybody is ready.
        crew.order(Vec::new())?;
        crew.at_rest = true;
        self.crew = Some(crew);
        self.warm_up_shared()
    }

    /// Has all ranks run every kernel once on no Gaussians, for every SH degree.
    fn warm_up_shared(&mut self) -> Result<()> {
        let first = self.schedule.first_step();
        for degree in 0..=self.plan.sh_degree.value {
            let empty = self.gaussians.empty(&self.device, degree)?;
            let gaussians = std::mem::replace(&mut self.gaussians, empty);
            let ran = self
                .share_iteration(first, degree)
                .and_then(|()| self.iterate(first, degree))
                .and_then(|()| {
                    self.end_iteration(first);
                    self.gather()
                });
            self.gaussians = gaussians;
            ran?;
        }
        if let Some(crew) = &mut self.crew {
            crew.forget_times();
        }
        self.fit_views()
    }

    /// Begins a thread for each device that trains with this one; the exchange is the leader's end.
    fn begin_threads(
        &self,
        devices: &[Device],
        views: &[View],
        image_budget: u64,
    ) -> Result<(Arc<dyn Exchange>, Threads)> {
        let mut ends = threads(1 + devices.len()).into_iter();
        let Some(leader) = ends.next() else {
            return Err(Error::numerics("ranks", "no end of an exchange"));
        };
        let mut begun = Vec::new();
        let released = Ended(leader.clone());
        for (device, exchange) in devices.iter().zip(ends) {
            let tuning = self.device.tuning();
            if let Some(fault) = tuning.fault(device.info()) {
                let name = &device.info().name;
                let what = format!("{name} cannot have the kernels of the first device: {fault}");
                return Err(Error::device("ranks", what, "select devices of one kind"));
            }
            let device = device.clone().with_tuning(tuning);
            let plan = self.plan.clone().led_by(self.device.info().kind);
            let (views, degree) = (views.to_vec(), self.gaussians.scene.sh_degree);
            let strategy = self.control.strategy();
            let work = move || {
                let _ended = Ended(exchange.clone());
                let photos = Photos::new(&device, image_budget);
                let set = ViewSet::new(&photos, views);
                let error =
                    set.and_then(|set| Self::follow(&exchange, set, &plan, degree, strategy));
                if let Err(error) = error {
                    exchange.fail(&error.to_string());
                }
            };
            let name = format!("rank {}", begun.len() + 1);
            let thread = Builder::new().name(name).spawn(work);
            begun.push(thread.map_err(|e| {
                let what = format!("no thread can be made: {e}");
                Error::device("ranks", what, "allow more threads (ulimit -u)")
            })?);
        }
        released.forget();
        Ok((leader, begun))
    }

    /// Trains as a rank that does not lead, with views and a plan like the leader's, until that ends. `sh_degree` is the highest of the
    /// Gaussians that training begins with.
    ///
    /// # Errors
    /// Another rank's failure, no room, or the driver's.
    pub fn follow(
        exchange: &Arc<dyn Exchange>,
        set: ViewSet,
        plan: &Plan,
        sh_degree: u32,
        strategy: Arc<dyn DensityControl>,
    ) -> Result<()> {
        // Of no meaning: the leader sends this rank's rows.
        let start = Gaussians::zeros(sh_degree, 1);
        let mut trainer = Self::assemble(set, plan, &start, strategy)?;
        // The leader keeps it.
        trainer.control.trace = None;
        trainer.pipeline.share = Some(trainer.share(exchange.clone())?);
        trainer.obey(exchange.as_ref())
    }

    /// This rank's part of a view.
    fn share(&self, exchange: Arc<dyn Exchange>) -> Result<Share<f32>> {
        Share::new(&self.device, self.pipeline.defines(), exchange)
    }

    /// Bytes that this rank has sent to others so far; `None` alone.
    #[must_use]
    pub fn traffic(&self) -> Option<Traffic> {
        self.crew.as_ref().map(|crew| crew.exchange.meter().sent())
    }

    /// Seconds for which this rank has waited for others so far; `None` alone.
    #[must_use]
    pub fn waits(&self) -> Option<Waits> {
        self.crew
            .as_ref()
            .map(|crew| crew.exchange.meter().waited())
    }

    /// Seconds that a rank has worked on its rows and on its band of the views so far, in the mean; `None` alone.
    #[must_use]
    pub fn worked(&self) -> Option<[f64; 2]> {
        self.crew.as_ref().map(Crew::worked)
    }

    /// CPU seconds of other processes that train with this one, so far.
    #[must_use]
    pub fn cpu_elsewhere(&self) -> f64 {
        self.crew.as_ref().map_or(0.0, Crew::process_seconds)
    }

    /// Makes ready for an iteration of all ranks, and tells them to begin it; does nothing alone.
    pub(super) fn share_iteration(&mut self, iteration: u32, sh_degree: u32) -> Result<()> {
        if self.crew.is_none() {
            return Ok(());
        }
        self.spread()?;
        let (number, size) = self.views.size_at(iteration);
        let (Some(crew), Some(share)) = (&mut self.crew, &mut self.pipeline.share) else {
            return Ok(());
        };
        let bands = crew.bands(number, size);
        let words = [&[ITERATE, iteration, sh_degree], bands.as_slice()].concat();
        share.set_bands(bands);
        // A photo that cannot be read is an error before the others begin.
        self.views.at(iteration, Some(share))?;
        self.tell(words)
    }

    /// Notes that an iteration of all ranks has been done, and the pairs of its view, for the next bands.
    pub(super) fn end_iteration(&mut self, iteration: u32) {
        let (number, _) = self.views.size_at(iteration);
        if let (Some(crew), Some(share)) = (&mut self.crew, &self.pipeline.share) {
            crew.note_view(number, &share.pairs_by_row, &share.worked_by_rank);
            crew.at_rest = true;
        }
    }

    /// Tells the others an order while the rows are spread; what they do for it is over at [`Trainer::rest`].
    pub(super) fn tell(&mut self, words: Vec<u32>) -> Result<()> {
        match &mut self.crew {
            Some(crew) if self.pipeline.share.is_some() => {
                if !crew.at_rest {
                    let what = "the other ranks are amidst what has failed; go on from the last checkpoint";
                    return Err(Error::numerics("ranks", what));
                }
                crew.at_rest = false;
                crew.order(words)
            }
            _ => Ok(()),
        }
    }

    /// Notes that the others wait for an order.
    pub(super) fn rest(&mut self) {
        self.amidst(false);
    }

    /// Spreads the rows over the ranks, if they are not.
    pub(super) fn spread(&mut self) -> Result<()> {
        if self.pipeline.share.is_some() || self.crew.is_none() {
            return Ok(());
        }
        let all = self.gaussians.scene.count;
        let own = self.spread_others(all, |state, rows| state.read_words(rows))?;
        let room = capacity(&self.plan.config, own);
        self.gaussians.shrink(&self.device, own, room)?;
        self.gaussians.scene.shard = Some(Shard { first: 0, all });
        self.begin_sharing()
    }

    /// Spreads Gaussians in the host's memory over the ranks, with what `kept` has of them, in place of those that are trained: no device
    /// needs room for all of them. Alone this does nothing.
    ///
    /// # Errors
    /// No Gaussian, rows of another shape, another rank's failure, or no room.
    pub fn spread_from_host(&mut self, splats: &Gaussians, kept: &GaussianRows) -> Result<()> {
        if self.crew.is_none() {
            return Ok(());
        }
        if splats.is_empty() {
            return Err(no_gaussian());
        }
        self.settle()?;
        let (all, degree) = (splats.len(), splats.sh_degree());
        // Words are of as many planes as are trained.
        self.gaussians = self.gaussians.empty(&self.device, degree)?;
        // Rows that have come to some of the ranks alone are nothing to go on from.
        self.amidst(true);
        let own = self.spread_others(all, |state, rows| state.words_of((splats, kept), rows))?;
        let words = self.gaussians.words_of((splats, kept), 0..own)?;
        self.take_part(Shard { first: 0, all }, [own, degree as usize], &words)?;
        let traced = self.plan.config.trace_density;
        self.control.trace = traced.then(|| DensityTrace::new(all));
        self.begin_sharing()?;
        self.rest();
        if self.smoothing.is_some() && kept.filter.is_empty() {
            self.tell(vec![SMOOTH])?;
            self.smooth()?;
            self.rest();
        }
        Ok(())
    }

    /// Notes if the other ranks may be amidst something.
    fn amidst(&mut self, something: bool) {
        if let Some(crew) = &mut self.crew {
            crew.at_rest = !something;
        }
    }

    /// Divides so many rows and sends each other rank its part, of which `read` has the words; returns the number of those that stay. One after
    /// the other, so that there is no copy of all.
    fn spread_others(
        &mut self,
        all: usize,
        read: impl Fn(&GaussianState, Range<usize>) -> Result<Vec<u32>>,
    ) -> Result<usize> {
        let Some(crew) = &mut self.crew else {
            return Ok(all);
        };
        crew.divide_rows(all);
        let (exchange, own) = (crew.exchange.clone(), crew.rows_of(LEADER).len());
        let others: Vec<Range<usize>> = (1..exchange.ranks()).map(|r| crew.rows_of(r)).collect();
        for (rank, rows) in (1..).zip(others) {
            let mut words = self.words_before(&rows, all)?;
            words.extend(read(&self.gaussians, rows)?);
            exchange.trade(Part::Rows, to_one(exchange.as_ref(), rank, words))?;
        }
        Ok(own)
    }

    /// Goes on by the parts of the ranks.
    fn begin_sharing(&mut self) -> Result<()> {
        self.pipeline.forward.frame.release(&self.device)?;
        if let Some(idle) = self.crew.as_mut().and_then(|crew| crew.idle.take()) {
            self.pipeline.share = Some(idle);
        }
        self.forget_times();
        Ok(())
    }

    fn forget_times(&mut self) {
        if let Some(share) = &mut self.pipeline.share {
            share.forget_times();
        }
    }

    /// The words before the rows in a message that spreads some of all rows: first row, number, all rows, SH degree, the lengths of the run,
    /// the iteration from which exposure is compensated (one more; 0: not) with the transforms of the views and their moments.
    fn words_before(&self, rows: &Range<usize>, all: usize) -> Result<Vec<u32>> {
        let degree = self.gaussians.scene.sh_degree;
        let mut words = vec![SPREAD];
        words.extend([rows.start, rows.len(), all].map(|n| n as u32));
        words.push(degree);
        let lengths = &self.plan.config.lengths;
        words.push(lengths.len() as u32);
        words.extend(lengths.iter().flat_map(words_of_length));
        let exposures = self.exposures()?;
        let exposed = self
            .learned
            .exposed_from
            .filter(|_| !exposures.is_empty())
            .map_or(0, |from| from + 1);
        words.push(exposed);
        for row in exposures {
            words.push(row.len() as u32);
            words.extend(row.iter().map(|v| v.to_bits()));
        }
        Ok(words)
    }

    /// Takes the rows of a message of [`Trainer::spread_others`].
    fn take_rows(&mut self, words: &[u32]) -> Result<()> {
        let mut words = Words(words);
        let [first, count, all] = words.take()?.map(|n: u32| n as usize);
        let [degree, lengths] = words.take()?;
        for _ in 0..lengths {
            let length = length_of(words.take()?)?;
            if !self.plan.config.lengths.contains(&length) {
                self.apply_length(length);
            }
        }
        let [exposed] = words.take()?;
        if exposed > 0 {
            self.learned.exposed_from = Some(exposed - 1);
            if self.pipeline.exposure.is_none() {
                self.build_exposure()?;
            }
            let mut rows = Vec::new();
            for _ in 0..3 {
                let [len] = words.take()?;
                let row = words.some(len as usize)?.iter();
                rows.push(row.map(|v| f32::from_bits(*v)).collect());
            }
            if let Some(model) = &self.pipeline.exposure {
                model.restore(&rows)?;
            }
        }
        self.take_part(Shard { first, all }, [count, degree as usize], words.0)?;
        self.forget_times();
        Ok(())
    }

    /// Takes a part of all rows: their number, SH degree and words.
    fn take_part(
        &mut self,
        shard: Shard,
        [count, degree]: [usize; 2],
        words: &[u32],
    ) -> Result<()> {
        let scene = &self.gaussians.scene;
        if scene.sh_degree as usize != degree || scene.stride < count {
            let rows = self.gaussians.rows;
            let kept = [self.smoothing.is_some(), self.plan.config.batch > 1];
            let none = Gaussians::zeros(degree as u32, 0);
            let room = capacity(&self.plan.config, count);
            self.gaussians = GaussianState::new(&self.device, &none, room, rows, kept)?;
        }
        let scene = &mut self.gaussians.scene;
        scene.count = count;
        scene.shard = Some(shard);
        self.gaussians.write_words(0..count, words, Carried::All)
    }

    /// Gathers the rows of all ranks on this device, if they are spread.
    pub(super) fn gather(&mut self) -> Result<()> {
        if let Some(shard) = self.gaussians.scene.shard {
            // Before anything is done that nothing goes on from: whoever looks at a page may ask for it.
            self.gaussians.check_memory(&self.device, shard.all)?;
        }
        let others = self.collect()?;
        let Some(shard) = self.gaussians.scene.shard else {
            return Ok(());
        };
        if let Some(crew) = &mut self.crew {
            // Where there is no room, some planes may have moved and others not: nothing goes on from that.
            crew.at_rest = false;
            self.gaussians.grow(&self.device, shard.all)?;
            crew.at_rest = true;
            for (rank, words) in (1..).zip(&others) {
                let rows = crew.rows_of(rank);
                self.gaussians.write_words(rows, words, Carried::All)?;
            }
            crew.idle = self.pipeline.share.take();
        }
        self.gaussians.scene.count = shard.all;
        self.gaussians.scene.shard = None;
        self.fit_views()
    }

    /// Everything that belongs to the rows of each of the other ranks, as words, once all iterations have settled; nothing unless rows
    /// are spread.
    fn collect(&mut self) -> Result<Vec<Vec<u32>>> {
        self.count_non_finite()?;
        let Some(crew) = self.crew.as_ref().filter(|_| self.pipeline.share.is_some()) else {
            return Ok(Vec::new());
        };
        let exchange = crew.exchange.clone();
        self.tell(vec![GATHER])?;
        let nothing = vec![Vec::new(); exchange.ranks()];
        let mut got = exchange.trade(Part::Rows, nothing)?;
        got.remove(LEADER);
        self.rest();
        Ok(got)
    }

    /// Counts the non-finite gradient values of all ranks, once all iterations have settled.
    ///
    /// # Errors
    /// See [`Trainer::settle`]; another rank's failure.
    pub fn count_non_finite(&mut self) -> Result<()> {
        self.settle()?;
        self.tell(vec![COUNT])?;
        let got = self.tell_non_finite()?;
        if let Some(crew) = &mut self.crew {
            for (rank, told) in got.iter().enumerate().filter(|(rank, _)| *rank != LEADER) {
                crew.note_non_finite(rank, told.first().copied().unwrap_or(0).into());
            }
            let own = got.first().and_then(|told| told.first());
            if let Some(own) = own {
                self.counters.non_finite = crew.non_finite() + u64::from(*own);
            }
        }
        self.rest();
        Ok(())
    }

    /// Tells the leader the non-finite gradient values of the rows here; returns what all have told, which is nothing at the others and
    /// while rows are not spread.
    fn tell_non_finite(&self) -> Result<Vec<Vec<u32>>> {
        let Some(share) = &self.pipeline.share else {
            return Ok(Vec::new());
        };
        let counters = &self.pipeline.frame().status;
        let own = counters.read(status::NON_FINITE as usize, 1)?;
        share.tell_leader(Part::Orders, own)
    }

    /// All Gaussians with everything that belongs to them, in the host's memory, with the gradients of a batch if it is `amidst` one.
    ///
    /// # Errors
    /// Another rank's failure, the driver's, or non-finite parameters.
    pub(super) fn held(&mut self, amidst: bool) -> Result<(Gaussians, GaussianRows)> {
        let others = self.collect()?;
        self.gaussians.joined(&others, amidst)
    }

    /// Does what the leader orders, until it ends.
    fn obey(&mut self, exchange: &dyn Exchange) -> Result<()> {
        loop {
            let mut got = exchange.trade(Part::Orders, vec![Vec::new(); exchange.ranks()])?;
            let message = got.swap_remove(LEADER);
            match message.as_slice() {
                // Everybody is ready.
                [] => {}
                [ITERATE, iteration, sh_degree, bands @ ..] => {
                    if let Some(share) = &mut self.pipeline.share {
                        share.set_bands(bands.to_vec());
                    }
                    self.iterate(*iteration, *sh_degree)?;
                    self.device.flush()?;
                }
                [SPREAD, words @ ..] => self.take_rows(words)?,
                [DECIDE, iterations] => self.follow_decision(*iterations)?,
                [EDIT, iterations, words @ ..] => {
                    self.follow_edits(*iterations, exchange.ranks(), words)?;
                }
                [COUNT] => self.tell_non_finite().map(|_| ())?,
                [SEEN] => self.tell_seen().map(|_| ())?,
                [SMOOTH] => self.smooth()?,
                [KEEP, words @ ..] => self.follow_keep(words)?,
                [LOOK, words @ ..] => self.follow_look(words)?,
                [EXPOSE, from] => {
                    self.learned.exposed_from = Some(*from);
                    self.build_exposure()?;
                }
                [RAISE, degree] => self.gaussians.raise_sh_degree(&self.device, *degree)?,
                [LENGTH, words @ ..] => self.apply_length(length_of(Words(words).take()?)?),
                [GATHER] => {
                    let rows = 0..self.gaussians.scene.count;
                    let words = self.gaussians.read_words(rows)?;
                    exchange.trade(Part::Rows, to_one(exchange, LEADER, words))?;
                }
                [END] => {
                    exchange.end();
                    return Ok(());
                }
                other => {
                    let what = format!("an unknown order of {} words", other.len());
                    return Err(Error::numerics("exchange", what));
                }
            }
        }
    }
}

/// Lets the others go on to their end when a thread ends, in whatever way.
struct Ended(Arc<dyn Exchange>);

impl Ended {
    /// Nobody is to be told any more.
    fn forget(self) {
        std::mem::forget(self);
    }
}

impl Drop for Ended {
    fn drop(&mut self) {
        self.0.fail("has ended");
    }
}
