//! L1 + SSIM and its gradient (`kernels/loss.cl`): 3DGS, Kerbl et al. 2023, eq. 7; SSIM, Wang et al. 2004.

use std::ops::Range;
use std::sync::OnceLock;

use crate::base::constants::{
    LOSS_DERIVATIVES, LOSS_ERRORS, LOSS_ROWS, SSIM_C, SSIM_SIGMA, SSIM_TAPS,
};
use crate::base::error::Result;
use crate::device::tuning::Tuning;
use crate::device::{Array, Device, ImageSize, Kernels, Launch, Program, Real};
use crate::pipeline::buffers::{Blank, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::photo_array::PhotoArray;
use crate::pipeline::room::image_planes;

/// A rendered image and its photo.
#[derive(Debug, Clone)]
pub struct ImagePair<'a, R: Real> {
    /// Render.
    pub image: &'a Array<R>,
    /// Photo of the same size: all of it, or the [rows](photo_rows) that the band needs.
    pub photo: &'a PhotoArray,
    /// Background under the photo's alpha.
    pub background: [f32; 3],
    /// Size of both.
    pub size: ImageSize,
    /// Rows of tiles that are compared: all, unless ranks share them.
    pub band: Range<usize>,
    /// Arrays that say what is blank in both, for kernels that skip it; `None` if nothing is to be skipped.
    pub blank: Option<Blank<'a>>,
}

impl<'a, R: Real> ImagePair<'a, R> {
    /// The image of the view rendered last and its photo, of which nothing is skipped.
    #[must_use]
    pub fn new(view: &'a ViewBuffers<R>, photo: &'a PhotoArray, background: [f32; 3]) -> Self {
        Self {
            image: &view.image,
            photo,
            background,
            size: view.camera.image(),
            band: view.band.clone(),
            blank: None,
        }
    }

    /// The pair with nothing skipped.
    #[must_use]
    pub fn everywhere(mut self) -> Self {
        self.blank = None;
        self
    }

    /// Number of colour values of each.
    fn values(&self) -> f64 {
        (3 * self.size.pixels[0] * self.size.pixels[1]) as f64
    }

    /// Adds render and all of the photo, with their size and the padded size.
    pub(super) fn images<'k>(&self, launch: Launch<'k>) -> Launch<'k> {
        launch
            .array(self.image, 3 * self.size.plane())
            .photo(self.photo, self.size)
            .ints(self.size.padded())
    }
}

/// The kernels and their scratch.
#[derive(Debug)]
pub struct Loss<R: Real> {
    device: Device,
    program: Program,
    /// SSIM derivative maps of the channel at hand, or error maps; in the group style derivative maps of each channel.
    pub maps: Array<R>,
    /// Error maps in the group style, from when they are wanted first.
    errors: OnceLock<Array<R>>,
    /// Size of the largest images.
    largest: ImageSize,
    /// Sums of |x − y| and SSIM of each channel and strip (two tiles side by side, where a work-group takes those), in turn.
    pub partial: Array<R>,
    /// An array for the arguments that say what is blank, when nothing does.
    nowhere: Array<u32>,
    /// An array for the maps and the losses that nobody wants.
    nothing: Array<R>,
}

/// Results that are wanted beside a gradient of the loss.
#[derive(Debug, Clone, Copy)]
pub struct Beside<'a, R: Real> {
    /// The array of losses and the slot of it for mean |x − y| and mean SSIM of a whole view; `None` if they are not wanted.
    pub losses: Option<(&'a Array<R>, usize)>,
    /// Error maps of the pair, of which nothing is skipped.
    pub errors: bool,
}

impl<R: Real> Beside<'_, R> {
    /// The gradient alone.
    pub const NOTHING: Self = Self {
        losses: None,
        errors: false,
    };
}

/// Numbers of parts of an image, by columns and rows: two tiles side by side if each is a work-group's, else the work-items' strips.
fn strips(program: &Program, size: ImageSize) -> [usize; 2] {
    let ([w, h], tuning) = (size.padded(), program.defines().tuning);
    if tuning.group_style {
        let [columns, rows] = size.tiles();
        [columns.div_ceil(2), rows]
    } else {
        [
            w.div_ceil(tuning.strip as usize),
            h.div_ceil(LOSS_ROWS as usize),
        ]
    }
}

/// Planes of a set of error maps, and of derivative maps.
const ERROR_PLANES: usize = 2;
const DERIVATIVE_PLANES: usize = 3;

/// Rows of strips in some rows of tiles: those themselves where a work-group takes tiles.
fn strip_rows(program: &Program, band: &Range<usize>) -> Range<usize> {
    let each = match program.defines().tuning.group_style {
        true => 1,
        false => (program.defines().tuning.tile / LOSS_ROWS) as usize,
    };
    band.start * each..band.end * each
}

/// Enqueues a sweep over the strips of some rows of tiles of a pair, or by work-groups along an axis of the channels, with `more` parts
/// beyond those of the image.
fn sweep<R: Real>(
    launch: Launch<'_>,
    program: &Program,
    (pair, band): (&ImagePair<'_, R>, &Range<usize>),
    more: usize,
) -> Result<()> {
    let ([columns, _], rows) = (strips(program, pair.size), strip_rows(program, band));
    if rows.is_empty() {
        // A launch has one work-item at least, beyond the image here.
        return Ok(());
    }
    let tuning = program.defines().tuning;
    if !tuning.group_style {
        let launch = launch.starting_at([0, rows.start]);
        return launch.over_chunks([columns, rows.len()]);
    }
    let group = tuning.tile_group();
    let launch = launch.starting_at([rows.start * columns * group, 0]);
    launch.run([(rows.len() * columns + more) * group, 3], [group, 1])
}

/// Pixel rows beside a band that the gradient of its loss sees: two windows of SSIM, one over maps of the other.
pub const HALO: usize = SSIM_TAPS - 1;

/// Rows of tiles that the loss of a band of them takes into account, one more on either side: its gradient needs their maps, and those
/// render and photo in [`HALO`] pixel rows beside the band; and strips of the band are left out only where all tiles beside them are
/// blank, too, which is known of whole tiles.
fn seen_rows(band: &Range<usize>, size: ImageSize) -> Range<usize> {
    const {
        assert!(
            HALO <= Tuning::GPU.tile as usize,
            "more rows of tiles would be seen"
        )
    };
    if band.is_empty() {
        return band.clone();
    }
    band.start.saturating_sub(1)..(band.end + 1).min(size.tiles()[1])
}

/// Pixel rows of a photo of this size that the loss of a band of rows of tiles needs, those of the rows of tiles that it takes into account. Kernels take rows beyond these
/// for outside of the image, and the maps that they make of them for nothing.
#[must_use]
pub fn photo_rows(band: &Range<usize>, size: ImageSize) -> Range<usize> {
    let (seen, height) = (seen_rows(band, size), size.pixels[1]);
    let pixels = |row: usize| (row * size.tile).min(height);
    pixels(seen.start)..pixels(seen.end)
}

/// Length of [`Loss::partial`] for an image.
fn partial_len(program: &Program, size: ImageSize) -> usize {
    3 * 2 * strips(program, size).iter().product::<usize>()
}

impl<R: Real> Loss<R> {
    /// Builds the kernels for images of at most `largest` pixels, with room for the maps that `gradients` need.
    pub fn new(kernels: &Kernels, largest: ImageSize, gradients: bool) -> Result<Self> {
        let program = kernels.build::<R>("loss")?;
        let zeros = |name, len| Array::zeros(kernels.device(), name, len);
        let planes = match (program.defines().tuning.group_style, gradients) {
            (true, true) => 3 * DERIVATIVE_PLANES,
            (false, true) => DERIVATIVE_PLANES,
            (true, false) => 0,
            (false, false) => ERROR_PLANES,
        };
        Ok(Self {
            maps: image_planes(kernels.device(), "maps", planes, largest)?,
            errors: OnceLock::new(),
            largest,
            partial: zeros("partial", partial_len(&program, largest))?,
            nowhere: Array::zeros(kernels.device(), "nowhere", 1)?,
            nothing: zeros("nothing", 2)?,
            device: kernels.device().clone(),
            program,
        })
    }

    /// True if [`Loss::gradient`] does what is wanted beside it in its own launches.
    #[must_use]
    pub fn fuses(&self) -> bool {
        self.program.defines().tuning.group_style
    }

    /// Writes the gradient of (1 − λ)·L1 + λ·(1 − SSIM) with respect to the render to `dimage`, and the sums of the strips; where it
    /// [fuses](Loss::fuses) them, what is wanted beside it, too.
    pub fn gradient(
        &self,
        pair: &ImagePair<'_, R>,
        lambda: f64,
        dimage: &Array<R>,
        beside: Beside<'_, R>,
    ) -> Result<()> {
        let weights = [1.0 - lambda, lambda].map(|weight| weight / pair.values());
        if self.fuses() {
            return self.gradient_by_groups(pair, weights, dimage, beside);
        }
        let (program, values) = (&self.program, 3 * pair.size.plane());
        let seen = seen_rows(&pair.band, pair.size);
        for channel in 0..3 {
            let forward = self.strip_maps(pair, channel, false);
            sweep(forward, program, (pair, &seen), 0)?;
            let backward = self
                .channel("loss_backward", pair, channel)
                .array(&self.maps, values)
                .reals::<R>(weights)
                .array(dimage, values);
            sweep(backward, program, (pair, &pair.band), 0)?;
        }
        Ok(())
    }

    /// [`Loss::gradient`] in two launches, all channels at once, whatever is wanted beside it.
    fn gradient_by_groups(
        &self,
        pair: &ImagePair<'_, R>,
        weights: [f64; 2],
        dimage: &Array<R>,
        beside: Beside<'_, R>,
    ) -> Result<()> {
        let (program, plane) = (&self.program, pair.size.plane());
        let seen = seen_rows(&pair.band, pair.size);
        let forward = if beside.errors {
            // Pixels that have a gradient see no maps but those that are never skipped.
            self.group_maps(&pair.clone().everywhere(), LOSS_DERIVATIVES | LOSS_ERRORS)?
        } else {
            self.group_maps(pair, LOSS_DERIVATIVES)?
        };
        sweep(forward, program, (pair, &seen), 0)?;
        let (losses, slot) = beside.losses.unwrap_or((&self.nothing, 0));
        let backward = self
            .channel("loss_backward", pair, 0)
            .array(&self.maps, 3 * DERIVATIVE_PLANES * plane)
            .reals::<R>(weights)
            .array(dimage, 3 * plane)
            .array(&self.partial, partial_len(program, pair.size))
            .reals::<R>([1.0 / pair.values()])
            .array(losses, 2 * (slot + 1))
            .uints([slot]);
        let more = usize::from(beside.losses.is_some());
        sweep(backward, program, (pair, &pair.band), more)
    }

    /// Writes thirds of 1 − SSIM and |x − y| of each channel, or their sums, to the error maps, and the sums of the strips; the time is
    /// counted as importance's.
    pub fn errors(&self, pair: &ImagePair<'_, R>) -> Result<()> {
        let launch = |launch: Launch<'_>| {
            let launch = launch.counted_as("importance");
            sweep(launch, &self.program, (pair, &pair.band), 0)
        };
        match self.fuses() {
            true => launch(self.group_maps(pair, LOSS_ERRORS)?),
            false => (0..3).try_for_each(|channel| launch(self.strip_maps(pair, channel, true))),
        }
    }

    /// Leaves the sums of the strips of a pair.
    pub fn compare(&self, pair: &ImagePair<'_, R>) -> Result<()> {
        match self.fuses() {
            true => sweep(
                self.group_maps(pair, 0)?,
                &self.program,
                (pair, &pair.band),
                0,
            ),
            false => self.errors(pair),
        }
    }

    /// The error maps of the pair whose errors were wanted last, \[[`Tuning::error_sets`], 2, rows, stride\]: 1 − SSIM and |x − y|, to be added up over the
    /// sets.
    ///
    /// # Errors
    /// No room for them.
    ///
    /// [`Tuning::error_sets`]: crate::device::tuning::Tuning::error_sets
    pub fn error_maps(&self) -> Result<&Array<R>> {
        if !self.fuses() {
            return Ok(&self.maps);
        }
        if let Some(maps) = self.errors.get() {
            return Ok(maps);
        }
        let planes = self.error_planes();
        let maps = image_planes(&self.device, "error maps", planes, self.largest)?;
        Ok(self.errors.get_or_init(|| maps))
    }

    /// Number of planes of [`Loss::error_maps`].
    #[must_use]
    pub fn error_planes(&self) -> usize {
        self.program.defines().tuning.error_sets() * ERROR_PLANES
    }

    /// Writes the means of |x − y| and SSIM, from the sums of the strips, to `out[2·slot..]`.
    pub fn sum(&self, pair: &ImagePair<'_, R>, out: &Array<R>, slot: usize) -> Result<()> {
        let len = partial_len(&self.program, pair.size);
        self.program
            .launch("loss_sum")
            .array(&self.partial, len)
            .uints([len / 2])
            .reals::<R>([1.0 / pair.values()])
            .array(out, 2 * (slot + 1))
            .uints([slot])
            .over_groups(1)
    }

    /// Places in [`Loss::partial`] of what a rank has summed up in some rows of tiles, one range for each channel.
    #[must_use]
    pub fn places(&self, size: ImageSize, band: &Range<usize>) -> [Range<usize>; 3] {
        let [columns, all] = strips(&self.program, size);
        let rows = strip_rows(&self.program, band);
        let place = |channel: usize, row: usize| 2 * columns * (channel * all + row.min(all));
        [0, 1, 2].map(|channel| place(channel, rows.start)..place(channel, rows.end))
    }

    /// Sums of |x − y| and SSIM of each strip and channel of the pair compared last, in turn; waits.
    pub fn read_strips(&self, size: ImageSize) -> Result<Vec<R>> {
        self.partial.read(0, partial_len(&self.program, size))
    }

    /// A sweep over the strips of a channel that writes its derivative maps, or adds to the error maps.
    fn strip_maps(&self, pair: &ImagePair<'_, R>, channel: usize, errors: bool) -> Launch<'_> {
        let planes = if errors {
            ERROR_PLANES
        } else {
            DERIVATIVE_PLANES
        };
        self.channel("loss_forward", pair, channel)
            .array(&self.maps, planes * pair.size.plane())
            .array(&self.partial, partial_len(&self.program, pair.size))
            .value(i32::from(errors))
    }

    /// A sweep by work-groups that writes maps of all channels.
    fn group_maps(&self, pair: &ImagePair<'_, R>, wanted: u32) -> Result<Launch<'_>> {
        let plane = pair.size.plane();
        let (derivatives, values) = match wanted & LOSS_DERIVATIVES {
            0 => (&self.nothing, 1),
            _ => (&self.maps, 3 * DERIVATIVE_PLANES * plane),
        };
        let (errors, error_values) = match wanted & LOSS_ERRORS {
            0 => (&self.nothing, 1),
            _ => (self.error_maps()?, self.error_planes() * plane),
        };
        let launch = self
            .channel("loss_forward", pair, 0)
            .array(derivatives, values)
            .array(&self.partial, partial_len(&self.program, pair.size))
            .array(errors, error_values)
            .value(wanted as i32);
        Ok(launch)
    }

    /// A sweep over a channel of both images.
    fn channel(&self, kernel: &'static str, pair: &ImagePair<'_, R>, at: usize) -> Launch<'_> {
        let launch = self
            .program
            .launch(kernel)
            .array(pair.image, 3 * pair.size.plane())
            .photo_rows(pair.photo, pair.size)
            .ints(pair.size.padded())
            .ints([at])
            .reals::<R>(pair.background.map(f64::from));
        if !self.program.defines().skips_blank() {
            return launch;
        }
        let tiles = pair.size.tile_count();
        match pair.blank {
            Some(b) => launch
                .ints([1])
                .array(b.active_tiles, tiles)
                .array(b.tile_start, tiles + 1),
            None => launch.ints([0]).arrays([&self.nowhere; 2], 1),
        }
    }
}

// Definition in f64.

/// The 11-tap Gaussian window, σ = 1.5, normalised.
fn window() -> [f64; SSIM_TAPS] {
    let raw = std::array::from_fn(|k| {
        (-(k as f64 - 5.0).powi(2) / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

/// Results of the loss stage.
#[derive(Debug, Clone, Default)]
pub struct Loss64 {
    /// Mean |x − y|.
    pub l1: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// dL/dx \[3, height, width\].
    pub gradient: Vec<f64>,
    /// Channel means of 1 − SSIM \[height, width\].
    pub ssim_error: Vec<f64>,
    /// Channel means of |x − y| \[height, width\].
    pub l1_error: Vec<f64>,
}

/// L = (1 − λ)·mean|x − y| + λ·(1 − mean SSIM) of planar images \[3, height, width\]; zero padding.
#[must_use]
pub fn loss(x: &[f64], y: &[f64], size: [usize; 2], lambda: f64) -> Loss64 {
    let [w, h] = size;
    let n = w * h;
    let total = (3 * n) as f64;
    let taps = window();
    let mut out = Loss64 {
        gradient: vec![0.0; 3 * n],
        ssim_error: vec![0.0; n],
        l1_error: vec![0.0; n],
        ..Loss64::default()
    };
    for c in 0..3 {
        let (a, b) = (&x[c * n..(c + 1) * n], &y[c * n..(c + 1) * n]);
        for at in 0..n {
            let d = a[at] - b[at];
            out.l1 += d.abs() / total;
            out.l1_error[at] += d.abs() / 3.0;
            if d != 0.0 {
                out.gradient[c * n + at] += (1.0 - lambda) * d.signum() / total;
            }
            let inside = |(i, j): (usize, usize)| -> Option<(usize, f64)> {
                let (px, py) = ((at % w + j).checked_sub(5)?, (at / w + i).checked_sub(5)?);
                (px < w && py < h).then_some((py * w + px, taps[i] * taps[j]))
            };
            let cells: Vec<(usize, f64)> =
                (0..121).filter_map(|k| inside((k / 11, k % 11))).collect();
            let (ssim, [dm, dxx, dxy]) = ssim_at(a, b, &cells);
            out.ssim += ssim / total;
            out.ssim_error[at] += (1.0 - ssim) / 3.0;
            for (p, weight) in &cells {
                let d = weight * (dm + 2.0 * a[*p] * dxx + b[*p] * dxy);
                out.gradient[c * n + p] -= lambda * d / total;
            }
        }
    }
    out
}

/// SSIM of one window and its derivatives with respect to E[x], E[x²] and E[xy]. Variances are sums of squared
/// differences to the mean; what the window has outside of the image is 0 there.
fn ssim_at(a: &[f64], b: &[f64], cells: &[(usize, f64)]) -> (f64, [f64; 3]) {
    let [c1, c2] = SSIM_C;
    let mean = |v: &[f64]| cells.iter().map(|(p, w)| w * v[*p]).sum::<f64>();
    let (mx, my) = (mean(a), mean(b));
    let outside = 1.0 - cells.iter().map(|(_, w)| w).sum::<f64>();
    let moment = |u: &[f64], mu: f64, v: &[f64], mv: f64| {
        cells
            .iter()
            .map(|(p, w)| w * (u[*p] - mu) * (v[*p] - mv))
            .sum::<f64>()
            + outside * mu * mv
    };
    let (vx, vy, cov) = (
        moment(a, mx, a, mx),
        moment(b, my, b, my),
        moment(a, mx, b, my),
    );
    let (a1, a2) = (2.0 * mx * my + c1, 2.0 * cov + c2);
    let (b1, b2) = (mx * mx + my * my + c1, vx + vy + c2);
    let ssim = a1 * a2 / (b1 * b2);
    let dxx = -ssim / b2;
    let dxy = 2.0 * a1 / (b1 * b2);
    let dm = 2.0 * my * a2 / (b1 * b2) - 2.0 * mx * ssim / b1 - 2.0 * mx * dxx - my * dxy;
    (ssim, [dm, dxx, dxy])
}
