//! Comparison of training photos with their renders, on which exposure compensation is decided.

use crate::base::error::Result;
use crate::capture::photo::colors;
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::RenderOptions;
use crate::pipeline::pass::Pipeline;
use crate::train::brightness::{GainSpread, compared, gain};
use crate::train::views::Views;

/// Compares some training views with their renders after `iteration` iterations of a run of `iterations`.
///
/// # Errors
/// A photo that cannot be read, more than the device can allocate, or the driver's.
pub fn compare(
    pipeline: &mut Pipeline,
    scene: &GaussianBuffers,
    views: &Views,
    iteration: u32,
    iterations: u32,
) -> Result<GainSpread> {
    let numbers = compared(views.len(), iterations);
    let mut gains = Vec::with_capacity(numbers.len());
    for number in numbers {
        let view = views.view(iteration, iteration, number, &[])?;
        let options = RenderOptions {
            sh_degree: scene.sh_degree,
            background: view.background,
            ..RenderOptions::default()
        };
        let forward = &mut pipeline.forward;
        forward.render(scene, &view.camera, &options)?;
        let render = forward.read_image()?;
        let (alpha, pixels) = (views.set.alpha, render.width * render.height);
        let bytes = views.photo(&view).read(0, alpha.planes() * pixels)?;
        let photo = colors(alpha, &bytes, view.background);
        gains.extend(gain(&render.rgb, &render.transmittance, &photo));
    }
    Ok(GainSpread::new(iteration, &gains))
}
