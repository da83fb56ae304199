//! The page as a file.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use base64::Engine;
use glam::DVec3;
use serde_json::json;

use crate::base::constants::{ALPHA_MAX, ALPHA_MIN, COLOR_MAX, NEAR, blur};
use crate::base::error::{Error, Result};
use crate::base::files;
use crate::capture::up_axis;
use crate::chart::text::escape;
use crate::run::viewer::payload::{CHUNK, Packed, pack, widths};
use crate::run::viewer::views::SceneView;
use crate::scene::Gaussians;

/// Name of the page in the run folder.
pub const SCENE_PAGE: &str = "scene.html";

/// Frame of every page that shows a scene; names between at signs are places.
const TEMPLATE: &str = include_str!("page.html");
pub(crate) const VIEWER_STYLE: &str = include_str!("viewer.css");
/// Movements of a camera, in every page that shows a scene.
pub(crate) const MOVES: &str = include_str!("moves.js");
const SCRIPT: &str = include_str!("viewer.js");

/// SHA-256 of the style in base64, and of the script, [`MOVES`] and [`SCRIPT`], by which the page's content policy lets these in and no
/// others. Test: viewer.
const STYLE_HASH: &str = "hzOXd0FbRbQrEwPbWbXYHVTt96u5UoxPCKYaxII59tU=";
const SCRIPT_HASH: &str = "Hcpm7YeescyT7nV7jSHC4Q4ovQU0bZvsOS8+u13xhUA=";

/// Shaders with the names under which the script finds them.
const SHADERS: [(&str, &str); 4] = [
    ("splat.vert", include_str!("splat.vert")),
    ("splat.frag", include_str!("splat.frag")),
    ("show.vert", include_str!("show.vert")),
    ("show.frag", include_str!("show.frag")),
];

/// Text of a page that shows a scene, in pieces; `place` has those for each name between at signs.
pub(crate) fn pieces<'a>(place: impl Fn(&str) -> Vec<&'a str>) -> Vec<&'a str> {
    // Text and names of places in turn.
    let parts = TEMPLATE.split('@').enumerate();
    parts
        .flat_map(|(k, part)| match k % 2 == 0 {
            true => vec![part],
            false => place(part),
        })
        .collect()
}

/// Contents of the page.
#[derive(Debug, Clone, Copy)]
pub struct ScenePage<'a> {
    /// Name of the scene.
    pub title: &'a str,
    /// The Gaussians in the local frame. Of an anti-aliased scene: after the 3D filter ([`Gaussians::filtered`]).
    pub splats: &'a Gaussians,
    /// True if they are to be drawn with the 2D filter of anti-aliasing.
    pub anti_aliased: bool,
    /// Colour behind the scene, RGB in \[0, 1\].
    pub background: [f32; 3],
    /// Cameras; the page begins at the first training view.
    pub views: &'a [SceneView],
    /// Sentences about the page that its reader should know.
    pub remarks: &'a [String],
    /// Bytes that the Gaussians may take ([`super::MAX_BYTES`]); fewer SH bands and then fewer Gaussians are shown if they need more.
    pub max_bytes: usize,
}

/// Writes the page atomically. Returns its remarks: those given, and what is left out.
///
/// # Errors
/// [`Error::Numerics`] without cameras or for a number that is not finite, [`Error::Io`] when writing fails.
pub fn write_scene_page(path: &Path, page: &ScenePage) -> Result<Vec<String>> {
    let wrong = |what: &str| Error::numerics(SCENE_PAGE, what);
    if page.views.is_empty() {
        return Err(wrong("no camera; at least one view expected"));
    }
    let packed = pack(page.splats, page.max_bytes);
    let remarks = [page.remarks, &packed.remarks].concat();
    let meta = meta(page, &packed, &remarks).ok_or_else(|| wrong("a camera is not finite"))?;
    let data = base64::engine::general_purpose::STANDARD.encode(&packed.bytes);
    let (title, shaders, policy) = (escape(page.title), shaders(), policy());
    let pieces = pieces(|name| match name {
        "policy" => vec![policy.as_str()],
        "title" => vec![title.as_str()],
        "style" => vec![VIEWER_STYLE],
        "script" => vec![MOVES, SCRIPT],
        "meta" => vec![meta.as_str()],
        "data" => vec![
            shaders.as_str(),
            "<script id=\"data\" type=\"text/plain\">",
            data.as_str(),
            "</script>\n",
        ],
        // A nonce, and what only the page of a server has.
        _ => Vec::new(),
    });
    files::write(path, |out| {
        let mut pieces = pieces.iter();
        pieces.try_for_each(|piece| out.write_all(piece.as_bytes()))
    })?;
    Ok(remarks)
}

/// The content policy as an element: nothing is loaded, and no script but this one runs.
fn policy() -> String {
    format!(
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none';style-src 'sha256-{STYLE_HASH}';\
         script-src 'sha256-{SCRIPT_HASH}';img-src data:;worker-src blob:\"/>\n"
    )
}

fn shaders() -> String {
    SHADERS
        .iter()
        .fold(String::new(), |mut out, (name, source)| {
            let _ = writeln!(
                out,
                "<script id=\"{name}\" type=\"x-shader\">\n{source}</script>"
            );
            out
        })
}

/// Everything but the Gaussians as JSON that may stand in HTML; `None` for a number that is not finite.
fn meta(page: &ScenePage, packed: &Packed, remarks: &[String]) -> Option<String> {
    let up = up_axis(page.views.iter().map(|v| &v.camera));
    let finite = |v: &SceneView| {
        let c = &v.camera;
        c.rotation.is_finite()
            && c.center().is_finite()
            && [c.fx, c.fy, c.cx, c.cy].iter().all(|v| v.is_finite())
            && v.scores.iter().flatten().all(|v| v.is_finite())
    };
    if !page.views.iter().all(finite) {
        return None;
    }
    let start = page.views.iter().position(|v| !v.held_out).unwrap_or(0);
    let value = json!({
        "title": page.title,
        "gaussians": page.splats.len(),
        "packed": {
            "count": packed.count,
            "degree": packed.degree,
            "chunk": CHUNK,
            "widths": widths(packed.degree),
        },
        "constants": {
            "near": NEAR,
            "blur": blur(page.anti_aliased),
            "alpha_max": ALPHA_MAX,
            "alpha_min": ALPHA_MIN,
            "color_max": COLOR_MAX,
        },
        "anti_aliased": page.anti_aliased,
        "background": page.background,
        "up": DVec3::to_array(&up),
        "start": start,
        "remarks": remarks,
        "cameras": page.views,
    });
    // Nothing in it can end the element that it stands in.
    Some(value.to_string().replace('<', "\\u003c"))
}
