//! The cameras of the page: held-out views, then training views; photos; the direction that is up.

use std::collections::HashMap;

use base64::Engine;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use serde::ser::{Serialize, SerializeStruct, Serializer};

use crate::base::error::{Error, Result};
use crate::capture::{Camera, Dataset, View};
use crate::run::record::FinalRecord;
use crate::run::report::gallery::picture;

/// Largest number of held-out photos in a page.
pub const MAX_PHOTOS: usize = 24;

/// Largest number of training cameras in a page.
const MAX_TRAINING: usize = 1000;

/// Quality of the photos, of 100: their own errors are below those of renders.
const JPEG_QUALITY: u8 = 85;

/// A camera of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneView {
    /// Name of the view.
    pub name: String,
    /// Camera in the local frame.
    pub camera: Camera,
    /// True if the view was not trained on.
    pub held_out: bool,
    /// PSNR in dB and SSIM of the view's render, if it has been scored.
    pub scores: Option<[f64; 2]>,
    /// The photo as a data URI ([`photo_uri`]), if it is to be in the page.
    pub photo: Option<String>,
}

impl SceneView {
    fn new(view: &View, held_out: bool) -> Self {
        Self {
            name: view.name.clone(),
            camera: view.camera,
            held_out,
            scores: None,
            photo: None,
        }
    }
}

impl Serialize for SceneView {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        let c = &self.camera;
        // Single precision is what the shaders have.
        let rows = c.rotation.transpose().to_cols_array().map(|v| v as f32);
        let center = c.center().to_array().map(|v| v as f32);
        let lens = [c.fx, c.fy, c.cx, c.cy].map(|v| v as f32);
        let mut out = to.serialize_struct("view", 9)?;
        out.serialize_field("name", &self.name)?;
        out.serialize_field("held_out", &self.held_out)?;
        out.serialize_field("size", &[c.width, c.height])?;
        out.serialize_field("lens", &lens)?;
        out.serialize_field("rotation", &rows)?;
        out.serialize_field("center", &center)?;
        out.serialize_field("psnr", &self.scores.map(|s| s[0]))?;
        out.serialize_field("ssim", &self.scores.map(|s| s[1]))?;
        out.serialize_field("photo", &self.photo)?;
        out.end()
    }
}

/// The views of a dataset for its page, without scores and photos: the held-out ones, then the training views, of more than 1000 of
/// which some are left out evenly. The second value says so.
#[must_use]
pub fn scene_views(dataset: &Dataset) -> (Vec<SceneView>, Option<String>) {
    let held_out = dataset.test.iter().map(|v| SceneView::new(v, true));
    let (all, shown) = (dataset.train.len(), dataset.train.len().min(MAX_TRAINING));
    let training = (0..shown).map(|k| SceneView::new(&dataset.train[k * all / shown], false));
    let remark = (shown < all).then(|| format!("{shown} of {all} training cameras are listed."));
    (held_out.chain(training).collect(), remark)
}

/// Adds the scores of an evaluation to held-out views, and takes those away that they had.
pub fn add_scores(views: &mut [SceneView], scores: Option<&FinalRecord>) {
    let scores = scores.iter().flat_map(|f| &f.per_view);
    let scores: HashMap<&str, [f64; 2]> = scores
        .map(|v| (v.view.as_str(), [v.scores.psnr, v.scores.ssim]))
        .collect();
    for view in views.iter_mut().filter(|v| v.held_out) {
        view.scores = scores.get(view.name.as_str()).copied();
    }
}

/// An 8-bit RGB image as a JPEG data URI, reduced to at most 640 pixels on the longest side.
///
/// # Errors
/// [`Error::Numerics`] when the bytes do not match the size or cannot be encoded.
pub fn photo_uri(name: &str, rgb: &[u8], width: u32, height: u32) -> Result<String> {
    let image = picture(name, rgb, width, height)?;
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
        .encode(
            image.as_raw(),
            image.width(),
            image.height(),
            ExtendedColorType::Rgb8,
        )
        .map_err(|e| Error::numerics(format!("photo {name}"), e))?;
    let text = base64::engine::general_purpose::STANDARD.encode(jpeg);
    Ok(format!("data:image/jpeg;base64,{text}"))
}
