//! The page that the server sends: that of `scene.html` with a script of its own, and with `run.html` if a run is watched.

use glam::DVec3;
use serde::Serialize;
use serde_json::json;

use crate::base::constants::NEAR;
use crate::capture::{Camera, up_axis};
use crate::chart::text::escape;
use crate::run::live::http::Answer;
use crate::run::viewer::{MOVES, SceneView, VIEWER_STYLE, pieces};

/// State, curves and buttons of a run.
const RUN: &str = include_str!("run.html");
const STYLE: &str = include_str!("live.css");
const SCRIPT: &str = include_str!("live.js");

/// List of the quantities that a picture may show, and the line of the help about it.
const SHOWN: &str = "<select id=\"shown\" aria-label=\"what is shown\" title=\"what is shown (M)\"><option value=\"color\">Colour</option>\
    <option value=\"depth\">Depth</option><option value=\"error\">Error</option>";
const TRAINED: &str = "<option value=\"births\">Births</option>\
    <option value=\"importance\">Importance</option><option value=\"voxels\">Voxels</option>";
const KEYS: &str = "<dt>M</dt><dd>colour, depth (near is bright), error against the photo; of a run the last births (yellow), the rank by importance and the Gaussians per voxel (1 dark, 100 bright)</dd>\n";

/// Contents of the page.
#[derive(Debug, Clone)]
pub struct LivePage {
    /// Name of the scene.
    pub title: String,
    /// Cameras; the page begins at the first training view.
    pub views: Vec<SceneView>,
    /// True if the views have photos.
    pub photos: bool,
    /// True if a training run is watched.
    pub training: bool,
    /// Largest side of an image, pixels.
    pub largest: u32,
    /// Number of Gaussians at first.
    pub gaussians: usize,
    /// Length that is neither near nor far in the scene.
    pub reach: f64,
}

/// A camera of the page; its photo is an address.
#[derive(Serialize)]
struct PageView<'a> {
    #[serde(flatten)]
    view: &'a SceneView,
    photo: Option<String>,
}

impl LivePage {
    /// Cameras by the numbers of their views.
    pub(super) fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(|v| v.camera).collect()
    }

    /// The page as an answer; `nonce` marks the style and the script as its own.
    pub(super) fn answer(&self, token: &str, nonce: &str) -> Answer {
        let title = escape(&self.title);
        let meta = self.meta(token);
        let own = format!(" nonce=\"{nonce}\"");
        let html = pieces(|name| match name {
            "title" => vec![title.as_str()],
            "nonce" => vec![own.as_str()],
            "style" => vec![VIEWER_STYLE, STYLE],
            "script" => vec![MOVES, SCRIPT],
            "meta" => vec![meta.as_str()],
            "run" if self.training => vec![RUN],
            "shown" if self.training => vec![SHOWN, TRAINED, "</select>\n"],
            "shown" => vec![SHOWN, "</select>\n"],
            "keys" => vec![KEYS],
            // The policy is a header, and there are no data.
            _ => Vec::new(),
        })
        .concat();
        let policy = format!(
            "default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        );
        Answer {
            policy: Some(policy),
            ..Answer::of("text/html; charset=utf-8", html.into_bytes())
        }
    }

    fn meta(&self, token: &str) -> String {
        let up = up_axis(self.views.iter().map(|v| &v.camera));
        let start = self.views.iter().position(|v| !v.held_out).unwrap_or(0);
        let view = |(k, view): (usize, &SceneView)| {
            let c = &view.camera;
            let longest = f64::from(c.width.max(c.height));
            let part = (f64::from(self.largest) / longest).min(1.0);
            let [w, h] = [c.width, c.height].map(|side| (f64::from(side) * part).ceil());
            let photo = format!("photo?token={token}&view={k}&width={w}&height={h}");
            json!(PageView {
                view,
                photo: self.photos.then_some(photo),
            })
        };
        let cameras: Vec<_> = self.views.iter().enumerate().map(view).collect();
        let value = json!({
            "title": self.title,
            "token": token,
            "training": self.training,
            "largest": self.largest,
            "near": NEAR,
            "gaussians": self.gaussians,
            "reach": self.reach,
            "up": DVec3::to_array(&up),
            "start": start,
            "remarks": [],
            "cameras": cameras,
        });
        // Nothing in it can end the element that it stands in.
        value.to_string().replace('<', "\\u003c")
    }
}
