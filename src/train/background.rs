//! Background behind the scene.

use rayon::prelude::*;

use crate::base::error::Result;
use crate::capture::{Alpha, Dataset, PhotoSource};
use crate::config::{Background, TrainConfig};
use crate::train::reasons::{Decided, Why};
use crate::train::sizes;

/// Parts of the full range that a mean colour is rounded to, so that it can be written in few digits.
const STEPS: f64 = 1000.0;

/// The fixed background, or the one that the run began with: the colour that is asked for, or of photos that are neither transparent nor
/// masked their mean colour. What is far is not covered by Gaussians for long, and what no photo shows never is: both are nearer to that
/// than to black (docs/results/background.md).
///
/// # Errors
/// A photo that cannot be read.
pub(super) fn background(
    dataset: &Dataset,
    config: &TrainConfig,
    alpha: Alpha,
    begun: Option<[f32; 3]>,
) -> Result<Decided<[f32; 3]>> {
    let asked = config.background;
    let named = begun.unwrap_or(asked.named());
    Ok(match (asked, alpha, begun) {
        (Background::Auto, Alpha::Transparency, _) => Decided::new(named, Why::Transparent),
        (Background::Auto, Alpha::Mask, _) => Decided::new(named, Why::Masked),
        (Background::Auto, Alpha::None, Some([0.0, 0.0, 0.0])) => {
            Decided::new(named, Why::Checkpoint)
        }
        (Background::Auto, Alpha::None, _) => {
            let photos = dataset.train.iter().map(|view| &view.photo);
            let mean = || mean_color(&photos.collect::<Vec<_>>());
            let color = begun.map_or_else(mean, Ok)?;
            Decided::new(color, Why::MeanColor(color))
        }
        (Background::Random, ..) => {
            Decided::new(named, Why::Criterion("evaluations are over black"))
        }
        _ => Decided::new(named, Why::OneColor(asked)),
    })
}

/// Mean colour of photos without alpha, of a sample of them; RGB in \[0, 1\], black of none.
///
/// # Errors
/// A photo that cannot be read.
fn mean_color(photos: &[&PhotoSource]) -> Result<[f32; 3]> {
    let of_photo = |number: usize| {
        let photo = photos[number].load()?;
        let pixels = (photo.width as usize * photo.height as usize).max(1);
        let plane = |c: usize| photo.data[c * pixels..][..pixels].iter();
        let sum = |c: usize| plane(c).map(|v| u64::from(*v)).sum::<u64>();
        Ok([sum(0), sum(1), sum(2), pixels as u64])
    };
    let sample: Vec<usize> = sizes::sample(photos.len()).collect();
    let all: Vec<[u64; 4]> = sample
        .into_par_iter()
        .map(of_photo)
        .collect::<Result<_>>()?;
    let total = |k: usize| all.iter().map(|sums| sums[k]).sum::<u64>();
    let pixels = total(3).max(1) as f64;
    let mean = |c: usize| total(c) as f64 / (255.0 * pixels);
    Ok(std::array::from_fn(|c| {
        ((mean(c) * STEPS).round() / STEPS) as f32
    }))
}

#[cfg(test)]
mod tests {
    use super::mean_color;
    use crate::capture::{Alpha, Photo, PhotoSource};

    #[test]
    fn the_mean_color_is_that_of_all_pixels() {
        let photo = |width: u32, rgb: [u8; 3]| {
            let plane = |v: u8| vec![v; 4 * width as usize];
            let photo = Photo {
                width,
                height: 4,
                alpha: Alpha::None,
                data: rgb.map(plane).concat(),
            };
            PhotoSource::from(photo)
        };
        let (small, large) = (photo(5, [255, 0, 51]), photo(15, [51, 0, 255]));
        assert_eq!(mean_color(&[&small, &large]).unwrap(), [0.4, 0.0, 0.8]);
        assert_eq!(mean_color(&[]).unwrap(), [0.0; 3]);
    }
}
