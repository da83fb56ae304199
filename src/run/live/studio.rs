//! Pictures of a scene, made by the thread that has the device.

use crate::base::error::Result;
use crate::capture::Camera;
use crate::capture::photo::Photo;
use crate::pipeline::forward::{Quantity, Rendered};
use crate::run::live::ask::{Ask, Mode};
use crate::run::live::paint::Property;
use crate::run::report::gallery::{colormap, error_map};

/// Steps of the colour map for depths.
const STEPS: usize = 256;

/// A scene on a device, and the photos of its views.
pub trait Scenery {
    /// Renders the scene as it is now.
    ///
    /// # Errors
    /// More tile intersections than are affordable, or the driver's.
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered>;

    /// Renders the scene in colours that show a property; nothing if it is not trained, or has no such property.
    ///
    /// # Errors
    /// Those of [`Scenery::render`].
    fn painted(&mut self, _camera: &Camera, _property: Property) -> Result<Option<Rendered>> {
        Ok(None)
    }

    /// The camera and the photo of a view by its number; no photo if there is none.
    ///
    /// # Errors
    /// A photo that cannot be read.
    fn photo(&mut self, view: usize) -> Result<Option<(Camera, Photo)>>;

    /// Background of the renders, RGB in \[0, 1\].
    fn background(&self) -> [f32; 3];

    /// Length that is neither near nor far in the scene.
    fn reach(&self) -> f64;
}

/// A picture, interleaved RGB8.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Picture {
    pub width: u32,
    pub height: u32,
    pub rgb: Vec<u8>,
}

/// Reply to a question.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Reply {
    Picture(Picture),
    /// Mean depth, local units; none where little is drawn.
    Depth(Option<f64>),
    /// A view without a photo, or a property that the scene does not have.
    Missing,
}

/// Answers a question by a scene.
pub(super) fn reply(ask: &Ask, scenery: &mut dyn Scenery) -> Result<Reply> {
    let picture = |camera: &Camera, rgb| {
        Reply::Picture(Picture {
            width: camera.width,
            height: camera.height,
            rgb,
        })
    };
    Ok(match ask {
        Ask::Frame { camera, mode } => {
            let rgb = match mode {
                Mode::Depth => nearness(&scenery.render(camera, Quantity::Depth)?, scenery.reach()),
                Mode::Painted(property) => match scenery.painted(camera, *property)? {
                    Some(image) => image.rgb8(),
                    None => return Ok(Reply::Missing),
                },
                _ => scenery.render(camera, Quantity::Color)?.rgb8(),
            };
            picture(camera, rgb)
        }
        Ask::Error { view } => {
            let Some((camera, photo)) = scenery.photo(*view)? else {
                return Ok(Reply::Missing);
            };
            let render = scenery.render(&camera, Quantity::Color)?.rgb8();
            let compared = photo.rgb_over(scenery.background());
            picture(&camera, error_map(&photo.counted(render), &compared)?)
        }
        Ask::Photo { view } => match scenery.photo(*view)? {
            Some((camera, photo)) => picture(&camera, photo.shown(scenery.background())),
            None => Reply::Missing,
        },
        Ask::Depth { camera, at: [x, y] } => {
            let image = scenery.render(camera, Quantity::Depth)?;
            let i = *y as usize * image.width + *x as usize;
            let depth = image.mean_depths().get(i).copied();
            Reply::Depth(depth.filter(|z| *z > 0.0))
        }
    })
}

/// Picture of depths: what is near is bright, black where little is drawn; the same colours whatever else is in the picture.
fn nearness(image: &Rendered, reach: f64) -> Vec<u8> {
    let table: Vec<[u8; 3]> = (0..=STEPS)
        .map(|k| colormap(k as f64 / STEPS as f64))
        .collect();
    let color = |z: f64| match z > 0.0 {
        true => table[((reach / (reach + z)) * STEPS as f64) as usize],
        false => [0; 3],
    };
    image.mean_depths().into_iter().flat_map(color).collect()
}
