//! Bands of spherical harmonics: none before the error says that colours depend on the view, then one more when it is due; at the
//! end those go that nothing misses.

use serde::{Deserialize, Serialize};

use crate::base::error::Result;
use crate::device::{Array, Device};
use crate::pipeline::buffers::Scene;
use crate::pipeline::stage::loss::ImagePair;
use crate::pipeline::stage::metrics::Metrics;
use crate::scene::Plane;
use crate::scene::refit::{Sight, with_fewer_bands};
use crate::train::Trainer;

/// What a band must be worth at the end of a run: this much PSNR of the training views, dB.
pub const BAND_WORTH: f64 = 0.02;

/// What the first band must be worth of the views set aside, dB: in its first interval it learns little of what it is worth
/// later (0.01 to 0.1 dB, after one of thirty intervals, in scenes that it is worth 0.2 to 3 dB in the end). The others are
/// not tried: after their first intervals they show −0.02 to 0.04 dB of views set aside whether or not they are worth 0.3 dB in
/// the end.
pub const TRIAL_WORTH: f64 = 0.005;

/// While the first band is on trial every n-th training view is set aside, to judge it by: others learn it by heart.
pub const SET_ASIDE_EVERY: usize = 8;

/// Views on which a band is judged at most.
const JUDGING_VIEWS: usize = 32;

/// Rounds in which they are looked at, until it is clear what they say.
const ROUNDS: usize = 4;

/// Views that are looked at before anything is clear.
const LEAST_VIEWS: usize = 8;

/// Standard errors by which it must be, at any of the rounds.
const DOUBT: f64 = 2.0;

/// Intervals that pass after the first band was found to be worth nothing, before it is tried again; twice as many the next
/// time, and no more than the second of these.
const WAITS: [u32; 2] = [2, 4];

/// A band that was judged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BandTrial {
    /// Iteration.
    pub iteration: u32,
    /// Degree of the band.
    pub degree: u32,
    /// PSNR with the band, minus that without it, the bands below taking over what they can, dB: of the views set aside, or,
    /// at the end of a run, of training views; of no more of them than it takes to tell (at least 8 or all, at most 32).
    pub gain: f64,
    /// Whether it was worth having.
    pub kept: bool,
}

/// Where the trial of bands stands; the number of bands in use is the scene's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bands {
    /// Every judgement so far.
    pub trials: Vec<BandTrial>,
    /// Whether the first band is still to be judged.
    pub on_trial: bool,
    /// Interval from which a band may come.
    next: u32,
    /// Intervals to wait after the next trial that finds it worth nothing.
    wait: u32,
    /// Iteration at which the bands were looked after last: repeating an iteration must not repeat that.
    handled: u32,
}

impl Default for Bands {
    fn default() -> Self {
        Self {
            trials: Vec::new(),
            on_trial: false,
            next: 0,
            wait: WAITS[0],
            handled: 0,
        }
    }
}

impl Bands {
    /// Whether a view of `views` is set aside now.
    fn sets_aside(&self, view: usize, views: usize) -> bool {
        let turn = self.trials.len() % SET_ASIDE_EVERY;
        self.on_trial && views >= SET_ASIDE_EVERY && view % SET_ASIDE_EVERY == turn
    }

    /// The view to train on in the place of one that is set aside; any other is itself.
    pub(super) fn instead(&self, view: usize, views: usize) -> usize {
        if !self.sets_aside(view, views) {
            view
        } else if view + 1 < views {
            view + 1
        } else {
            view - 1
        }
    }
}

impl Trainer {
    /// Adds a band where one is due before the next iteration; the first after it was judged, if it is on trial.
    pub(super) fn look_after_bands(&mut self) -> Result<()> {
        let (at, most) = (self.iteration, self.config.sh_degree);
        let every = self.schedule.sh_interval();
        let due = at > 0 && at.is_multiple_of(every);
        if most == 0 || !due || self.findings.bands.handled == at {
            return Ok(());
        }
        // Nothing before this iteration can be repeated any more.
        self.settle()?;
        let interval = at / every;
        if self.findings.bands.on_trial {
            let n = self.views.len();
            let aside = |v: &usize| self.findings.bands.sets_aside(*v, n);
            let judges: Vec<usize> = (0..n).filter(aside).collect();
            let kept = self.judge_band(&spread(&judges), TRIAL_WORTH)?;
            let bands = &mut self.findings.bands;
            bands.on_trial = false;
            if !kept {
                bands.next = interval.saturating_add(bands.wait);
                bands.wait = bands.wait.saturating_mul(2).min(WAITS[1]);
            }
        }
        let by_need = self.config.work.sh_by_need && self.views.len() >= SET_ASIDE_EVERY;
        if self.scene.sh_degree < most && interval >= self.findings.bands.next {
            self.set_degree(self.scene.sh_degree + 1)?;
            self.findings.bands.on_trial = by_need && self.scene.sh_degree == 1;
        }
        self.findings.bands.handled = at;
        Ok(())
    }

    /// Takes bands away from the top as long as the training views lose less than [`BAND_WORTH`] each time.
    pub(super) fn drop_bands(&mut self) -> Result<()> {
        self.findings.bands.on_trial = false;
        let all: Vec<usize> = (0..self.views.len()).collect();
        while self.scene.sh_degree > 0 && !self.judge_band(&spread(&all), BAND_WORTH)? {}
        Ok(())
    }

    /// Drops the highest band if it is worth less than `least` dB in some training views, at the size that they have now; the
    /// bands below it then take over what they can of it in the directions of all training views. Whether it is kept.
    /// Where bands do not come and go by need nothing judges them.
    fn judge_band(&mut self, views: &[usize], least: f64) -> Result<bool> {
        let Some(judge) = self.judge.metrics.clone() else {
            return Ok(true);
        };
        let degree = self.scene.sh_degree.max(1);
        let sights: Vec<Sight> = (0..self.views.len()).map(|v| self.sight(v)).collect();
        let fewer = with_fewer_bands(&self.scene.download()?, degree - 1, &sights)?;
        let mut fewer = Scene::upload(&self.device, &fewer, self.scene.stride)?;
        self.copy_filter(&mut fewer)?;
        let gain = self.band_gain(&judge, &mut fewer, views, least)?;
        let kept = gain >= least;
        self.findings.bands.trials.push(BandTrial {
            iteration: self.iteration,
            degree,
            gain,
            kept,
        });
        if !kept {
            self.scene = fewer;
            self.resize_moments(degree, degree - 1)?;
        }
        Ok(kept)
    }

    /// PSNR that the scene has over another in some training views, dB: in as many of them, a quarter after the other, as it
    /// takes to tell on which side of `least` it is.
    fn band_gain(
        &mut self,
        (metrics, rows): &(Metrics, Array<f32>),
        other: &mut Scene,
        views: &[usize],
        least: f64,
    ) -> Result<f64> {
        let squared_error = |_: &Self, pair: &ImagePair<'_, f32>| {
            metrics.run(pair, rows)?;
            let sums = rows.read(0, pair.size[1])?;
            Ok(sums.into_iter().map(f64::from).sum::<f64>())
        };
        let mut errors = Vec::with_capacity(views.len());
        let round =
            |turn| -> Vec<usize> { views.iter().skip(turn).step_by(ROUNDS).copied().collect() };
        for turn in 0..ROUNDS {
            let last = turn + 1 == ROUNDS;
            let (now, next) = (round(turn), if last { Vec::new() } else { round(turn + 1) });
            let with = self.over_views(&now, &now, squared_error)?;
            std::mem::swap(&mut self.scene, other);
            let without = self.over_views(&now, &next, squared_error);
            std::mem::swap(&mut self.scene, other);
            errors.extend(without?.into_iter().zip(with));
            if is_clear(&errors, least) {
                break;
            }
        }
        Ok(pooled_gain(&errors))
    }

    /// Views of `count` iterations from `iteration` on, none of them set aside.
    pub(super) fn upcoming(&self, iteration: u32, count: usize) -> Vec<usize> {
        let views = self.views.len();
        let order = self.schedule.upcoming(iteration, count, views);
        let bands = &self.findings.bands;
        order.into_iter().map(|v| bands.instead(v, views)).collect()
    }

    /// Where a training view looks from.
    fn sight(&self, view: usize) -> Sight {
        let camera = &self.views.cameras[view];
        let w = camera.w.map(f64::from);
        Sight {
            rotation: [[w[0], w[1], w[2]], [w[3], w[4], w[5]], [w[6], w[7], w[8]]],
            center: camera.center.map(f64::from),
            intrinsics: camera.intrinsics.map(f64::from),
            size: camera.size.map(f64::from),
        }
    }

    /// Makes room for the planes of more bands, which are zero, as are their moments.
    fn set_degree(&mut self, degree: u32) -> Result<()> {
        let (from, stride) = (self.scene.sh_degree, self.scene.stride);
        let params = resized(&self.device, &self.scene.params, [from, degree], stride)?;
        self.scene.params = params;
        self.scene.sh_degree = degree;
        self.resize_moments(from, degree)
    }

    fn resize_moments(&mut self, from: u32, to: u32) -> Result<()> {
        for moment in [&mut self.moment1, &mut self.moment2] {
            *moment = resized(&self.device, moment, [from, to], self.scene.stride)?;
        }
        Ok(())
    }
}

/// The planes of an array of the scene's shape for another SH degree: new ones are zero.
fn resized(
    device: &Device,
    old: &Array<f32>,
    degrees: [u32; 2],
    stride: usize,
) -> Result<Array<f32>> {
    let [from, to] = degrees.map(Plane::count);
    let new = Array::zeros(device, old.name(), to * stride)?;
    new.copy_from(0, old, 0, from.min(to) * stride)?;
    Ok(new)
}

/// At most [`JUDGING_VIEWS`] of some views, evenly.
pub(super) fn spread(views: &[usize]) -> Vec<usize> {
    let n = views.len();
    let count = n.min(JUDGING_VIEWS);
    (0..count).map(|k| views[k * n / count]).collect()
}

/// PSNR that views with the second of these squared errors have over views with the first, dB; 0 where nothing is left to
/// explain.
fn pooled_gain(errors: &[(f64, f64)]) -> f64 {
    let (without, with) = errors
        .iter()
        .fold((0.0, 0.0), |(a, b), e| (a + e.0, b + e.1));
    let gain = 10.0 * (without / with).log10();
    Some(gain).filter(|g| g.is_finite()).unwrap_or(0.0)
}

/// Whether squared errors without a band and with it say, beyond [`DOUBT`] standard errors over the views, if it is worth `least`
/// dB: the pooled gain is where the sum of what each view has beyond that is positive.
fn is_clear(errors: &[(f64, f64)], least: f64) -> bool {
    let n = errors.len() as f64;
    let factor = 10f64.powf(least / 10.0);
    let beyond = |e: &(f64, f64)| e.0 - factor * e.1;
    let sum: f64 = errors.iter().map(beyond).sum();
    let spread: f64 = errors.iter().map(|e| (beyond(e) - sum / n).powi(2)).sum();
    errors.len() >= LEAST_VIEWS && sum.abs() > DOUBT * (spread * n / (n - 1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::{BAND_WORTH, Bands, LEAST_VIEWS, is_clear, pooled_gain};

    #[test]
    fn a_gain_is_clear_where_all_views_agree() {
        let gains = |of: &dyn Fn(usize) -> f64, views: usize| -> Vec<(f64, f64)> {
            let error = |k: usize| 1.0 + (k % 5) as f64;
            let pair = |k| (error(k) * 10f64.powf(of(k) / 10.0), error(k));
            (0..views).map(pair).collect()
        };
        let (much, none) = (gains(&|_| 0.3, 8), gains(&|_| 0.001, 8));
        assert!(is_clear(&much, BAND_WORTH) && is_clear(&none, BAND_WORTH));
        assert!((pooled_gain(&much) - 0.3).abs() < 1e-9);
        // Too few views; views that disagree.
        assert!(!is_clear(&much[..LEAST_VIEWS - 1], BAND_WORTH));
        let mixed = gains(&|k| if k % 2 == 0 { 0.3 } else { -0.2 }, 8);
        assert!(!is_clear(&mixed, BAND_WORTH));
        // Nothing is left to explain.
        assert!(!is_clear(&[(0.0, 0.0); 8], BAND_WORTH));
        assert_eq!(pooled_gain(&[(0.0, 0.0); 8]), 0.0);
        assert!(!is_clear(&[], BAND_WORTH));
    }

    #[test]
    fn what_is_set_aside_is_not_trained_on_in_the_place_of_another() {
        for views in 1..40 {
            let mut bands = Bands::default();
            assert!((0..views).all(|v| bands.instead(v, views) == v));
            bands.on_trial = true;
            let trained = |v: usize| bands.instead(v, views);
            assert!((0..views).all(|v| trained(v) < views));
            assert!(
                (0..views).all(|v| !bands.sets_aside(trained(v), views)),
                "{views}"
            );
        }
    }
}
