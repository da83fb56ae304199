//! `scene.html`: a scene in a page that shows it, with nothing to load. The page is `page.html` with style, script
//! and shaders (WebGL2) in its places; the shaders' formulas are those of `kernels/projection.clh`, `project.cl` and `splat.cl`.
//!
//! Lengths are local units, axes those of the dataset, so that directions, and with them SH coefficients, are those of
//! `scene.ply`.

mod page;
mod payload;
mod views;

pub(crate) use page::{MOVES, VIEWER_STYLE, pieces};
pub use page::{SCENE_PAGE, ScenePage, write_scene_page};
pub use payload::MAX_BYTES;
pub use views::{MAX_PHOTOS, SceneView, add_scores, photo_uri, scene_views};
