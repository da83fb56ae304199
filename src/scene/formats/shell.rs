//! The background of a scene as Gaussians, for programs that know of no background.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::base::error::Result;
use crate::base::math::logit;
use crate::scene::formats::scene_file::SceneFile;
use crate::scene::gaussians::{Gaussians, Plane};
use crate::scene::sh::C0;

/// Gaussians of a shell: eight chunks of a compressed PLY file.
const COUNT: usize = 2048;

/// Standard deviation of one, in units of the side of the square that it has of the shell: 0.3 % of what lies behind shines through at the most.
const OVERLAP: f64 = 0.85;

/// Opacity of each.
const OPACITY: f64 = 0.99;

/// Radius of the shell over the distance of the farthest Gaussian, with room for the order by depth, which is less far from the axis; and over the
/// radius of the sphere around the cameras.
const BEYOND: f64 = 1.5;
const ABOUT: f64 = 2.0;

/// Largest radius that a shell is made with: positions have single precision.
const FARTHEST: f64 = 1e30;

impl SceneFile {
    /// The scene with its background as Gaussians of one colour on a sphere beyond all others, the first ones; as it is without a background.
    ///
    /// # Errors
    /// [`crate::base::error::Error::Numerics`] for positions that are not finite.
    pub(super) fn enclosed(&self) -> Result<Self> {
        let mut whole = self.clone();
        if let Some(color) = self.background {
            whole.splats = self.shell(color)?;
            whole.splats.append(&self.splats)?;
        }
        Ok(whole)
    }

    /// The scene of a file whose first `count` Gaussians are said to be a shell of a colour: without them, if they may be one.
    pub(super) fn without_shell(mut self, said: Option<Shell>) -> Self {
        if let Some(Shell { color, count }) = said.filter(|shell| shell.begins(&self.splats)) {
            self.splats = self.splats.after(count);
            self.background = Some(color);
        }
        self
    }

    fn shell(&self, color: [f32; 3]) -> Result<Gaussians> {
        let places = |i: usize| {
            let place: [f32; 3] = self.splats.gather(Plane::POSITION, i);
            DVec3::from_array(place.map(f64::from))
        };
        let n = self.splats.len();
        let (center, about) = match self.cameras {
            Some(sphere) => (sphere.center, sphere.radius),
            None => ((0..n).map(places).sum::<DVec3>() / n.max(1) as f64, 0.5),
        };
        let farthest = (0..n).map(|i| places(i).distance(center));
        let radius = farthest.fold(0.0, f64::max) * BEYOND;
        let radius = radius.max(ABOUT * about).min(FARTHEST);
        let side = (2.0 * TAU / COUNT as f64).sqrt();
        let scale = (OVERLAP * side * radius).ln() as f32;
        let mut shell = Gaussians::zeros(self.splats.sh_degree(), COUNT);
        shell.plane_mut(Plane::OPACITY).fill(logit(OPACITY) as f32);
        for i in 0..COUNT {
            let place = center + radius * direction(i);
            shell.scatter(Plane::POSITION, i, place.as_vec3().to_array());
            shell.scatter(Plane::LOG_SCALE, i, [scale; 3]);
            shell.scatter(
                Plane::SH,
                i,
                color.map(|c| ((f64::from(c) - 0.5) / C0) as f32),
            );
        }
        Ok(shell)
    }
}

/// Unit vectors spread evenly over the sphere: a Fibonacci lattice.
fn direction(i: usize) -> DVec3 {
    let turn = PI * (3.0 - 5.0_f64.sqrt()) * i as f64;
    let z = 1.0 - (2 * i + 1) as f64 / COUNT as f64;
    let flat = (1.0 - z * z).sqrt();
    DVec3::new(flat * turn.cos(), flat * turn.sin(), z)
}

/// A shell, by the header of its file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shell {
    /// RGB in \[0, 1\].
    pub color: [f32; 3],
    /// Gaussians that it has, the first ones of the file.
    pub count: usize,
}

impl Shell {
    /// A shell from what its comment says after the mark.
    pub fn parse(text: &str) -> Option<Self> {
        let (color, vertices) = text.split_once(", the first ")?;
        let color: Option<Vec<f32>> = color.split_whitespace().map(|v| v.parse().ok()).collect();
        let color: [f32; 3] = color?.try_into().ok()?;
        let count = vertices.strip_suffix(" vertices")?.parse().ok()?;
        let good = color.iter().all(|v| (0.0..=1.0).contains(v));
        good.then_some(Self { color, count })
    }

    /// The text that [`Self::parse`] reads, of a scene's background.
    pub fn text([r, g, b]: [f32; 3]) -> String {
        format!("{r} {g} {b}, the first {COUNT} vertices")
    }

    /// True if the first Gaussians have one colour, one opacity and one size, as those of a shell: a program may have kept the comment and
    /// have taken Gaussians out.
    fn begins(&self, splats: &Gaussians) -> bool {
        let same = |plane: &Vec<f32>| plane[..self.count].windows(2).all(|v| v[0] == v[1]);
        let alike = [Plane::OPACITY, Plane::LOG_SCALE, Plane::SH, Plane::SH + 1];
        self.count <= splats.len() && alike.iter().all(|p| same(&splats.planes()[*p]))
    }
}
