//! Births in image space, at pixels in which photo and render differ.
//!
//! A copy lands about as far from its source as that is large, so that an empty region, the sky above all, is reached by chance alone, if at
//! all. Here a pixel is drawn ∝ its error; the birth lies beyond the rendered surface with a probability that follows the
//! pixel's remaining transmittance, else at the rendered mean depth, if another picture shows the same surface there and none
//! sees through it: what one camera alone has right before it has large errors, too, and a birth there would thicken it. Not in
//! \[MH\]; acceptance is that of the other phases, with the pixel's error for the importance.

use rayon::prelude::*;

use crate::base::math::{logit, sigmoid};
use crate::base::rng::{Philox, Stream};
use crate::config::MhConfig;
use crate::density::control::StepContext;
use crate::density::draw::{Categorical, Weights};
use crate::density::mh::accept;
use crate::density::mh::proposal::Proposal;
use crate::density::picture::Picture;
use crate::scene::Edit;
use crate::scene::OptionalColor;
use crate::scene::sh::C0;

/// Pixels of all pictures, one after the other; the weights of the draw are e·(τ + s·(1−τ)).
struct Pixels<'a> {
    pictures: &'a [Picture<'a>],
    /// First pixel of each picture, and the number of all.
    starts: Vec<usize>,
    /// s: share of a rendered surface that births may lie on.
    surface: f64,
    mean: f64,
    deviation: f64,
    /// Share of all error that the weights of the draw keep, Σ e·(τ + s·(1−τ)) / Σ e; 0 if there is no error.
    share: f64,
}

impl<'a> Pixels<'a> {
    /// The pixels of some pictures, of which the share `surface` of what is rendered counts.
    fn new(pictures: &'a [Picture<'a>], surface: f64) -> Self {
        let mut starts = vec![0];
        for picture in pictures {
            let [width, height] = picture.size;
            starts.push(starts[starts.len() - 1] + width * height);
        }
        let mut pixels = Self {
            pictures,
            starts,
            surface,
            mean: 0.0,
            deviation: 0.0,
            share: 0.0,
        };
        // One order of summation, whatever the number of threads.
        let (mut all, mut kept) = (0.0, 0.0);
        for [errors, left] in pixels.rows(0, pixels.count()) {
            for (e, t) in errors.iter().zip(left) {
                all += f64::from(*e);
                kept += pixels.weight(*e, *t);
            }
        }
        let n = pixels.count().max(1) as f64;
        let mean = all / n;
        let mut variance = 0.0;
        for [errors, _] in pixels.rows(0, pixels.count()) {
            for e in errors {
                let apart = f64::from(*e) - mean;
                variance += apart * apart;
            }
        }
        let sum = mean * pixels.count() as f64;
        if sum > 0.0 {
            pixels.share = (kept / sum).clamp(0.0, 1.0);
        }
        (pixels.mean, pixels.deviation) = (mean, (variance / n).sqrt() + 1e-6);
        pixels
    }

    /// Errors and remaining transmittances of `count` pixels from `first` on, row by row.
    fn rows(&self, first: usize, count: usize) -> impl Iterator<Item = [&'a [f32]; 2]> {
        let (mut next, end) = (first, first + count);
        std::iter::from_fn(move || {
            let (picture, pixel) = self.find(next).filter(|_| next < end)?;
            let width = picture.size[0];
            let (from, len) = (picture.at(pixel), (width - pixel % width).min(end - next));
            next += len;
            Some([&picture.error, &picture.transmittance].map(|plane| &plane[from..][..len]))
        })
    }

    /// Weight of a pixel of error `e` and remaining transmittance `t`.
    fn weight(&self, e: f32, t: f32) -> f64 {
        f64::from(e) * reached(f64::from(t), self.surface)
    }

    /// The picture that holds a pixel, and the pixel's number there; `None` beyond the last.
    fn find(&self, pixel: usize) -> Option<(&'a Picture<'a>, usize)> {
        let k = self
            .starts
            .partition_point(|s| *s <= pixel)
            .checked_sub(1)?;
        Some((self.pictures.get(k)?, pixel - self.starts[k]))
    }

    /// σ of an error's deviation from the mean, in standard deviations: the counterpart of a Gaussian's I.
    fn importance(&self, error: f32) -> f64 {
        sigmoid((f64::from(error) - self.mean) / self.deviation)
    }
}

impl Weights for Pixels<'_> {
    fn count(&self) -> usize {
        self.starts[self.pictures.len()]
    }

    fn write(&self, first: usize, mut out: &mut [f64]) {
        for [errors, left] in self.rows(first, out.len()) {
            let (row, rest) = std::mem::take(&mut out).split_at_mut(errors.len());
            for (out, (e, t)) in row.iter_mut().zip(errors.iter().zip(left)) {
                *out = self.weight(*e, *t);
            }
            out = rest;
        }
    }
}

/// Share of a pixel's light in which births may lie: the remaining transmittance, and the part `surface` of the rest.
fn reached(left: f64, surface: f64) -> f64 {
    left + surface * (1.0 - left)
}

/// Up to `wanted` proposals at drawn pixels; `src` is any row: its rotation is copied, which does not matter, because a birth is round.
pub(super) fn propose(
    config: &MhConfig,
    context: &StepContext<'_>,
    src: u32,
    wanted: usize,
) -> Vec<Proposal> {
    let pixels = &Pixels::new(context.pictures, config.pixel_surface);
    let wanted = (wanted as f64 * pixels.share).round() as usize;
    let stream = |purpose: Stream| purpose.stream(context.iteration);
    let (place, accept) = (stream(Stream::PixelPlace), stream(Stream::PixelAccept));
    let drawn =
        Categorical::new(pixels).draw_unique(wanted, context.seed, stream(Stream::PixelDraw));
    let proposal = |pixel: usize| {
        let (picture, at) = pixels.find(pixel)?;
        let u = Philox::uniform(context.seed, place, pixel as u64);
        let importance = pixels.importance(*picture.error.get(picture.at(at))?);
        Some(Proposal {
            edit: birth(config, (context.pictures, picture), at, u, src)?,
            source_edit: None,
            importance,
            change: None,
            ln_gain: accept::ln_gain(config.acceptance, importance),
            u: Philox::uniform(context.seed, accept, pixel as u64)[0],
        })
    };
    drawn.into_par_iter().filter_map(proposal).collect()
}

/// The birth at pixel `at` of one of all pictures; `None` if its position or size is not finite, or the pictures do not agree
/// about the surface that it is to lie on.
fn birth(
    config: &MhConfig,
    (all, picture): (&[Picture<'_>], &Picture<'_>),
    at: usize,
    u: [f64; 4],
    src: u32,
) -> Option<Edit> {
    let [across, down, kind, far] = u;
    let [left, depth] = picture.surface(at)?.map(f64::from);
    let rendered = if depth.is_finite() { depth } else { 0.0 };
    let beyond = kind * reached(left, config.pixel_surface) < left;
    let z = if beyond {
        let [from, to] = config.pixel_far;
        (from * (to / from).powf(far)).max(rendered)
    } else {
        rendered
    };
    let width = picture.size[0];
    let pixel = [at % width, at / width].map(|v| v as f64);
    let position = picture.point([pixel[0] + across, pixel[1] + down], z);
    let log_scale = (config.pixel_scale * picture.footprint(z)).ln();
    // The same view may come twice, and views from one place agree about everything.
    let mut others = all.iter().filter(|other| other.center != picture.center);
    let real = beyond || confirmed(config.pixel_tolerance, &mut others, position);
    let placed = z > 0.0 && z >= config.pixel_near && real;
    let good = placed && log_scale.is_finite() && position.iter().all(|v| v.is_finite());
    let opacity = config.pixel_opacity;
    let color = || picture.photo.at(at).map(|c| (f64::from(c) - 0.5) / C0);
    good.then(|| Edit {
        src,
        dst: src,
        position: position.map(|v| v as f32),
        log_scale: [log_scale as f32; 3],
        opacity_logit: logit(opacity) as f32,
        color: OptionalColor::some(color().map(|v| v as f32)),
    })
}

/// True if a surface at `position` is rendered in one of the pictures and none sees through it: rendered depths within
/// `tolerance`, a share of the depth, are the same; a smaller one is something in front, and says nothing, nor does a masked
/// pixel. 0: always true.
fn confirmed(
    tolerance: f64,
    pictures: &mut dyn Iterator<Item = &Picture<'_>>,
    position: [f64; 3],
) -> bool {
    let mut seen = tolerance == 0.0;
    for picture in pictures.take_while(|_| tolerance > 0.0) {
        let Some((z, pixel)) = picture.project(position) else {
            continue;
        };
        if picture.photo.is_masked(pixel) {
            continue;
        }
        let depth = picture
            .surface(pixel)
            .map_or(f64::NAN, |[_, depth]| depth.into());
        // Nothing is rendered at an empty pixel.
        if !depth.is_finite() || depth > z * (1.0 + tolerance) {
            return false;
        }
        seen |= depth >= z * (1.0 - tolerance);
    }
    seen
}
