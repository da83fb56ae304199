//! PSNR, SSIM and ꟻLIP of rendered views against their photos (after clamping to [0, 1]; mean over RGB).
//!
//! With a mask m in [0, 1] render x and photo y are compared as m·x and m·y, so that nothing that lies under a mask changes a
//! score. PSNR is that of the mean squared error Σ (m·x − m·y)² / Σ m; SSIM and ꟻLIP are the means of their maps over the
//! pixels that count, Σ m·s / Σ m. A window reaches past the mask's edge, where both pictures are black and agree.

pub mod color;

use serde::{Deserialize, Serialize};

use crate::base::error::Result;
use crate::device::{Defines, Device};
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::forward::Renders;
use crate::pipeline::scoring::{PairErrors, Scoring};
use crate::pipeline::stage::loss::ImagePair;

/// Scores of a held-out view, or their means over views.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Scores {
    /// PSNR in dB.
    pub psnr: f64,
    /// SSIM.
    pub ssim: f64,
    /// ꟻLIP, 0 (equal) to 1; taken at the end of a run and by `eval` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flip: Option<f64>,
    /// PSNR in dB after an affine fit of the render's colours to the photo's; only at the end of a run that compensates exposure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cc_psnr: Option<f64>,
    /// SSIM after that fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cc_ssim: Option<f64>,
}

impl Scores {
    /// The scores with their names in JSON.
    #[must_use]
    pub fn named(&self) -> [(&'static str, Option<f64>); 5] {
        [
            ("psnr", Some(self.psnr)),
            ("ssim", Some(self.ssim)),
            ("flip", self.flip),
            ("cc_psnr", self.cc_psnr),
            ("cc_ssim", self.cc_ssim),
        ]
    }
}

/// Scores of one held-out view.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ViewScore {
    /// Name of the view.
    pub view: String,
    /// Its scores.
    #[serde(flatten)]
    pub scores: Scores,
}

/// PSNR of two equal images (mean squared error below 1e-10).
pub const MAX_PSNR: f64 = 100.0;

/// Held-out views and the stages that score them.
#[derive(Debug)]
pub struct Evaluator {
    views: ViewSet,
    scoring: Scoring,
}

impl Evaluator {
    /// An evaluator of these views. `defines` must be the renderer's.
    pub fn new(device: &Device, defines: Defines, views: ViewSet) -> Result<Self> {
        let defines = Defines {
            alpha: views.alpha,
            ..defines
        };
        Ok(Self {
            scoring: Scoring::new(device, defines, views.largest)?,
            views,
        })
    }

    /// The views.
    #[must_use]
    pub fn views(&self) -> &ViewSet {
        &self.views
    }

    /// Has the device compile all that scoring takes, and make room for it.
    ///
    /// # Errors
    /// No room for the scratch, or the driver's.
    pub(crate) fn warm_up(&self) -> Result<()> {
        self.scoring.warm_up()
    }

    /// Renders and scores one view; `None` if its mask is 0 everywhere. The clamped image stays in the renderer. `next` are the views
    /// to be scored after it.
    ///
    /// # Errors
    /// Those of [`Renders::render_view`] and [`ViewSet::photo`].
    pub fn score(
        &self,
        view: usize,
        next: &[usize],
        scene: &mut dyn Renders,
        background: [f32; 3],
    ) -> Result<Option<ViewScore>> {
        self.score_by(view, next, scene, background, false)
    }

    /// [`Evaluator::score`], with ꟻLIP if that is wanted.
    fn score_by(
        &self,
        view: usize,
        next: &[usize],
        scene: &mut dyn Renders,
        background: [f32; 3],
        with_flip: bool,
    ) -> Result<Option<ViewScore>> {
        let photo = self.views.photo(view, next)?;
        let camera = &self.views.cameras[view];
        let errors = self.scoring.view(scene, camera, &photo, background)?;
        if errors.counted <= 0.0 {
            return Ok(None);
        }
        let flip = || {
            let pair = ImagePair::new(&scene.renderer().frame, &photo, background);
            self.scoring.flip(&pair, errors.counted)
        };
        let [psnr, ssim] = psnr_and_ssim(&errors);
        let scores = Scores {
            psnr,
            ssim,
            flip: with_flip.then(flip).transpose()?,
            ..Scores::default()
        };
        let view = self.views.names[view].clone();
        Ok(Some(ViewScore { view, scores }))
    }

    /// The photo that a view's render is compared with, planar \[3, pixels\] in \[0, 1\], and its mask (empty without one).
    fn compared(&self, view: usize, background: [f32; 3]) -> Result<(Vec<f32>, Vec<f32>)> {
        let photo = self.views.read_photo(view)?;
        let bytes = photo.rgb_over(background);
        let channel = |c: usize| bytes.iter().skip(c).step_by(3);
        let planes = (0..3).flat_map(|c| channel(c).map(|v| f32::from(*v) / 255.0));
        Ok((planes.collect(), photo.counts()))
    }

    /// Scores all views whose masks are not 0 everywhere by PSNR and SSIM and, if `with_flip`, by ꟻLIP.
    ///
    /// # Errors
    /// Those of [`Renders::render_view`] and [`ViewSet::photo`].
    pub fn score_all(
        &self,
        scene: &mut dyn Renders,
        background: [f32; 3],
        with_flip: bool,
    ) -> Result<Vec<ViewScore>> {
        let all: Vec<usize> = (0..self.views.len()).collect();
        let mut scores = Vec::with_capacity(all.len());
        for v in 0..all.len() {
            scores.extend(self.score_by(v, &all[v + 1..], scene, background, with_flip)?);
        }
        Ok(scores)
    }
}

/// PSNR and SSIM of a pair; those of equal images if no pixel counts.
fn psnr_and_ssim(errors: &PairErrors) -> [f64; 2] {
    let counted = errors.counted;
    let each = if counted > 0.0 { 1.0 / counted } else { 0.0 };
    let ssim = 1.0 - errors.dissimilarity * each;
    [psnr(errors.squared * each / 3.0), ssim]
}

/// PSNR of a mean squared error of values in [0, 1].
#[must_use]
pub fn psnr(mse: f64) -> f64 {
    (-10.0 * mse.log10()).min(MAX_PSNR)
}
