//! Questions of the page, read from the query of a request: a camera, a quantity, a size.

use std::str::FromStr;

use glam::{DMat3, DVec3};

use crate::capture::Camera;
use crate::run::live::http::Request;
use crate::run::live::paint::Property;

/// Quantity that a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    Color,
    /// Nearness of the mean depth, as a colour.
    Depth,
    /// Difference to the photo of a view.
    Error,
    /// A property of the Gaussians of a run, in colours.
    Painted(Property),
}

/// Something that the thread with the device is asked for.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Ask {
    /// The scene through a camera: its colour, its depth or a property.
    Frame { camera: Camera, mode: Mode },
    /// The difference between a view's render and its photo.
    Error { view: usize },
    /// The photo of a view.
    Photo { view: usize },
    /// The depth of a camera's image at a pixel.
    Depth { camera: Camera, at: [u32; 2] },
}

/// Largest deviation of a rotation's rows from orthonormal ones.
const SKEW: f64 = 1e-3;

/// Reads the questions about cameras and views of a scene.
pub(super) struct Reader<'a> {
    pub request: &'a Request,
    pub cameras: &'a [Camera],
    /// Largest side of an image, pixels.
    pub largest: u32,
}

/// Answer to a question that cannot be read.
type Wrong = String;

impl Reader<'_> {
    fn number<T: FromStr>(&self, key: &str) -> Result<T, Wrong> {
        let text = self.request.value(key).unwrap_or_default();
        text.parse()
            .map_err(|_| format!("{key}: a number expected"))
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<[f64; N], Wrong> {
        let text = self.request.value(key).unwrap_or_default();
        let parts = text.split(',').map(|part| part.parse().ok());
        let values: Option<Vec<f64>> = parts.collect();
        values
            .and_then(|v| v.try_into().ok())
            .filter(|v: &[f64; N]| v.iter().all(|v| v.is_finite() && v.abs() < 1e9))
            .ok_or_else(|| format!("{key}: {N} numbers expected"))
    }

    /// Width and height that are asked for.
    pub fn size(&self) -> Result<[u32; 2], Wrong> {
        let size = [self.number("width")?, self.number("height")?];
        let most = self.largest;
        match size.iter().all(|side| (1..=most).contains(side)) {
            true => Ok(size),
            false => Err(format!("width, height: 1 to {most} pixels expected")),
        }
    }

    /// The view that is asked for, if one is.
    fn view(&self) -> Result<Option<usize>, Wrong> {
        if self.request.value("view").is_none() {
            return Ok(None);
        }
        let view = self.number("view")?;
        let n = self.cameras.len();
        match view < n {
            true => Ok(Some(view)),
            false => Err(format!("view: a number below {n} expected")),
        }
    }

    /// The photo that is asked for.
    pub fn photo(&self) -> Result<Ask, Wrong> {
        let view = self.view()?.ok_or("view: a number expected")?;
        Ok(Ask::Photo { view })
    }

    /// The frame that is asked for.
    pub fn frame(&self) -> Result<Ask, Wrong> {
        let mode = match self.request.value("mode") {
            None | Some("color") => Mode::Color,
            Some("depth") => Mode::Depth,
            Some("error") => Mode::Error,
            Some("births") => Mode::Painted(Property::Births),
            Some("importance") => Mode::Painted(Property::Importance),
            Some("voxels") => Mode::Painted(Property::Voxels),
            Some(_) => {
                let modes = "mode: color, depth, error, births, importance or voxels expected";
                return Err(modes.into());
            }
        };
        if mode == Mode::Error {
            let view = self.view()?.ok_or("view: the view of a photo expected")?;
            return Ok(Ask::Error { view });
        }
        Ok(Ask::Frame {
            camera: self.camera()?,
            mode,
        })
    }

    /// The depth that is asked for.
    pub fn depth(&self) -> Result<Ask, Wrong> {
        let (camera, at) = (self.camera()?, self.numbers::<2>("at")?);
        let inside = |v: f64, side: u32| (v.max(0.0) as u32).min(side - 1);
        Ok(Ask::Depth {
            camera,
            at: [inside(at[0], camera.width), inside(at[1], camera.height)],
        })
    }

    /// The camera of a view at a size, or one that is spelt out.
    fn camera(&self) -> Result<Camera, Wrong> {
        let [width, height] = self.size()?;
        if let Some(view) = self.view()? {
            return Ok(self.cameras[view].scaled_to(width, height));
        }
        let [fx, fy, cx, cy] = self.numbers("lens")?;
        let rotation = DMat3::from_cols_array(&self.numbers("rotation")?).transpose();
        let center = DVec3::from_array(self.numbers("center")?);
        let skew = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
        if !(skew.iter().all(|v| v.abs() < SKEW) && rotation.determinant() > 0.0) {
            return Err("rotation: three orthonormal rows expected, right-handed".into());
        }
        if !(fx > 1e-3 && fy > 1e-3) {
            return Err("lens: focal lengths above 0 expected".into());
        }
        let pose = (rotation, -(rotation * center));
        Ok(Camera::new([fx, fy, cx, cy], [width, height], pose))
    }
}
