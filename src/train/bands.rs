//! The SH degree in use: one band more at every interval, up to the configuration's (3DGS).

use crate::base::error::Result;
use crate::device::{Array, Device};
use crate::scene::Plane;
use crate::train::Trainer;

impl Trainer {
    /// Adds a band of spherical harmonics if one is due before the next iteration.
    pub(super) fn update_sh_degree(&mut self) -> Result<()> {
        let (at, every) = (self.iteration, self.schedule.sh_interval());
        let due = at > 0 && at.is_multiple_of(every) && self.sh_updated != Some(at);
        if !due || self.scene.sh_degree >= self.config.sh_degree {
            return Ok(());
        }
        // Nothing before this iteration can be repeated any more.
        self.settle()?;
        self.set_degree(self.scene.sh_degree + 1)?;
        self.sh_updated = Some(at);
        Ok(())
    }

    /// Makes room for the planes of more bands, which are zero, as are their moments.
    fn set_degree(&mut self, degree: u32) -> Result<()> {
        let (from, stride) = (self.scene.sh_degree, self.scene.stride);
        for array in [&mut self.scene.params, &mut self.moment1, &mut self.moment2] {
            *array = resized(&self.device, array, [from, degree], stride)?;
        }
        self.scene.sh_degree = degree;
        Ok(())
    }
}

/// The planes of an array of the scene's shape for a higher SH degree: new ones are zero.
fn resized(
    device: &Device,
    old: &Array<f32>,
    degrees: [u32; 2],
    stride: usize,
) -> Result<Array<f32>> {
    let [from, to] = degrees.map(Plane::count);
    let new = Array::zeros(device, old.name(), to * stride)?;
    new.copy_from(0, old, 0, from * stride)?;
    Ok(new)
}
