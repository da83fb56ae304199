//! Whether a set's photos differ in brightness and colour by more than what they show: decided from a few training views,
//! each compared with its render after some iterations. A render has what all photos have in common, so that what is left is
//! the camera's automatic exposure and white balance.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::base::math::median;
use crate::capture::Alpha;
use crate::config::ExposureChoice;

/// Views that are compared at most.
const MOST_VIEWS: usize = 64;
/// A view is compared for so many iterations of the run, so that it takes about a hundredth of the time.
const ITERATIONS_PER_VIEW: u32 = 50;
/// Fewer views tell nothing of a spread.
const LEAST_VIEWS: usize = 4;
/// Gains that spread by more than this switch per-image exposure on. Measured on seven sets of photos as they are: up to 7 %,
/// where it does more harm than good; on photos brightened and darkened by up to 30 %: 17 %, where it is worth 2.6 dB.
pub const LEAST_SPREAD: f64 = 0.08;
/// Pixels count where render and photo are between these: the darker ones have next to no say in a ratio, brighter ones may be
/// clipped.
const USABLE: [f32; 2] = [0.04, 0.96];
/// Pixels count where no more transmittance than this is left: elsewhere the background is compared with itself.
const MOST_TRANSMITTANCE: f32 = 0.5;

/// Pixels that a gain needs.
const LEAST_PIXELS: usize = 50;

/// Why photos with transparent pixels have no transforms.
pub const TRANSPARENT: &str = "no camera saw the background that transparent photos are composited over, and a transform would change it, too";

/// Refuses transforms of transparent photos; `auto` leaves them off.
///
/// # Errors
/// Transforms asked for, and photos whose alpha is transparency.
pub fn check(choice: ExposureChoice, alpha: Alpha) -> Result<()> {
    if choice == ExposureChoice::On && alpha == Alpha::Transparency {
        let fix =
            "leave it to auto or off, or, if their alpha says what counts, give --alpha-is-mask";
        return Err(Error::config(
            "--exposure",
            format!("on; {TRANSPARENT}: {fix}"),
        ));
    }
    Ok(())
}

/// What was decided on per-image exposure where the configuration leaves it open.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Iterations done when it was decided.
    pub iteration: u32,
    /// Views compared.
    pub views: u32,
    /// Robust standard deviation of the gains' logarithms over the views, the mean of three channels.
    pub spread: f32,
    /// Whether exposure is compensated from then on.
    pub on: bool,
}

impl Decision {
    /// Decides from the views' gains (red, green, blue).
    #[must_use]
    pub fn new(iteration: u32, gains: &[[f64; 3]]) -> Self {
        let spread = spread(gains);
        Self {
            iteration,
            views: gains.len() as u32,
            spread: spread.unwrap_or(0.0) as f32,
            on: spread.is_some_and(|s| s > LEAST_SPREAD),
        }
    }

    /// The reason, with its figures.
    #[must_use]
    pub fn why(&self) -> String {
        format!(
            "after {} iterations the gains of {} photos over their renders spread by {:.1} %; on above {:.0} %",
            self.iteration,
            self.views,
            100.0 * f64::from(self.spread),
            100.0 * LEAST_SPREAD
        )
    }
}

/// The views that are compared, spread evenly over `views`, in a run of so many iterations.
#[must_use]
pub fn compared(views: usize, iterations: u32) -> Vec<usize> {
    let afford = (iterations / ITERATIONS_PER_VIEW) as usize;
    let count = views.min(MOST_VIEWS).min(afford.max(LEAST_VIEWS));
    (0..count).map(|k| k * views / count).collect()
}

/// Median over the pixels of photo / render by channel; both planar, render \[3, pixels\], transmittance \[pixels\]. None
/// where too few pixels can be compared.
#[must_use]
pub fn gain(render: &[f32], transmittance: &[f32], photo: &[Vec<f32>; 3]) -> Option<[f64; 3]> {
    let pixels = transmittance.len();
    let mut gains = [1.0; 3];
    for (c, gain) in gains.iter_mut().enumerate() {
        let usable = |v: f32| v > USABLE[0] && v < USABLE[1];
        let ratios: Vec<f64> = (0..pixels)
            .filter(|i| transmittance[*i] < MOST_TRANSMITTANCE)
            .map(|i| (render[c * pixels + i], photo[c][i]))
            .filter(|(x, y)| usable(*x) && usable(*y))
            .map(|(x, y)| f64::from(y) / f64::from(x))
            .collect();
        if ratios.len() < LEAST_PIXELS {
            return None;
        }
        *gain = median(ratios.into_iter())?;
    }
    Some(gains)
}

/// Robust standard deviation (1.4826 times the median of absolute deviations from the median) of ln gain over the views, the
/// mean of the channels. None for fewer than four views.
#[must_use]
pub fn spread(gains: &[[f64; 3]]) -> Option<f64> {
    if gains.len() < LEAST_VIEWS {
        return None;
    }
    let of = |c: usize| {
        let logs = || gains.iter().map(|g| g[c].ln());
        let middle = median(logs())?;
        Some(1.4826 * median(logs().map(|l| (l - middle).abs()))?)
    };
    Some((of(0)? + of(1)? + of(2)?) / 3.0)
}
