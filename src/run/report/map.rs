//! A map of the cameras, seen from above, with the scores of the held-out ones.

use std::fmt::Write;

use glam::{DVec2, DVec3};

use crate::capture::up_axis;
use crate::chart::text::{escape, fixed};
use crate::run::report::gallery::colormap;
use crate::run::viewer::SceneView;

/// Width and largest height of the drawing, and the room around the cameras in it.
const WIDTH: f64 = 380.0;
const HEIGHT: f64 = 300.0;
const ROOM: f64 = 16.0;

/// Length of the line that tells where a camera looks.
const SIGHT: f64 = 11.0;

/// PSNR of the two ends of the colours, dB.
const BEST: f64 = 35.0;
const WORST: f64 = 15.0;

/// Writes the map, unless there are no scores or all cameras are in one place.
pub(super) fn section(out: &mut String, views: &[SceneView]) {
    let scored = |v: &&SceneView| v.held_out && v.scores.is_some();
    if views.iter().find(scored).is_none() {
        return;
    }
    let up = up_axis(views.iter().map(|v| &v.camera));
    let Some(places) = places(views, up) else {
        return;
    };
    let (low, high) = places
        .iter()
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), p| {
            (l.min(p.at), h.max(p.at))
        });
    let span = high - low;
    let scale = ((WIDTH - 2.0 * ROOM) / span.x).min((HEIGHT - 2.0 * ROOM) / span.y.max(1e-9));
    let height = span.y * scale + 2.0 * ROOM;
    let middle = 0.5 * (low + high);
    let pixel = |at: DVec2| (at - middle) * scale + 0.5 * DVec2::new(WIDTH, height);
    let _ = write!(
        out,
        "<h2>Cameras from above</h2><p class=note>Held-out views are coloured by their PSNR ({BEST} dB dark, {WORST} dB bright); grey: \
         training views.</p><div class=charts><figure class=\"chart map\"><svg viewBox=\"0 0 {WIDTH} {height:.1}\" role=\"img\" \
         aria-label=\"Cameras from above\">"
    );
    // Held-out views are drawn last, over the others.
    for held_out in [false, true] {
        for (view, place) in views.iter().zip(&places) {
            if view.held_out == held_out {
                mark(out, view, pixel(place.at), place.sight);
            }
        }
    }
    out.push_str("</svg></figure></div>\n");
}

/// A camera on the map, in the plane's own axes with y pointing down the page.
struct Place {
    at: DVec2,
    /// Direction of view, a unit vector seen from above and shortened where it points up or down.
    sight: DVec2,
}

/// The cameras in the plane to which `up` is normal, the longer side across; `None` if they are all in one place.
fn places(views: &[SceneView], up: DVec3) -> Option<Vec<Place>> {
    let across = up.any_orthonormal_vector();
    let along = up.cross(across);
    // Seen from above: y of the page grows downwards.
    let flat = |v: DVec3| DVec2::new(v.dot(across), -v.dot(along));
    let centers: Vec<DVec2> = views.iter().map(|v| flat(v.camera.center())).collect();
    let mean = centers.iter().sum::<DVec2>() / centers.len().max(1) as f64;
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for d in centers.iter().map(|c| c - mean) {
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    let size = ((xx + yy) / centers.len().max(1) as f64).sqrt();
    if !(size.is_finite() && size > 1e-6) {
        return None;
    }
    let main = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
    let turned = |v: DVec2| DVec2::new(v.dot(main), v.dot(main.perp()));
    let place = |(view, center): (&SceneView, &DVec2)| Place {
        at: turned(center - mean),
        sight: turned(flat(view.camera.rotation.row(2))),
    };
    Some(views.iter().zip(&centers).map(place).collect())
}

fn mark(out: &mut String, view: &SceneView, at: DVec2, sight: DVec2) {
    let to = at + sight * SIGHT;
    let (class, radius, fill, score) = match view.scores.filter(|_| view.held_out) {
        Some([psnr, _]) => {
            let [r, g, b] = colormap((BEST - psnr) / (BEST - WORST));
            let fill = format!(" style=\"fill:rgb({r} {g} {b})\"");
            ("held", 5, fill, format!(": {} dB", fixed(psnr, 2)))
        }
        None => ("seen", 2, String::new(), String::new()),
    };
    let _ = write!(
        out,
        "<g class={class}><title>{}{score}</title><path d=\"M{:.1} {:.1}L{:.1} {:.1}\"/><circle cx=\"{:.1}\" cy=\"{:.1}\" \
         r=\"{radius}\"{fill}/></g>",
        escape(&view.name),
        at.x,
        at.y,
        to.x,
        to.y,
        at.x,
        at.y
    );
}
