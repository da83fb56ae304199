//! Trains a scene and renders its first view to a PNG: `cargo run --release --example train_and_render -- data/room-tiny 1000 view.png`

use mhsplat::train::Event;
use mhsplat::{Device, LoadOptions, Plan, TrainConfig, Trainer, load_dataset, run};

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// Loads `photos`, trains for some iterations and writes the picture.
pub fn train_and_render(photos: &str, iterations: u32, picture: &str) -> Outcome {
    let config = TrainConfig {
        iterations,
        ..TrainConfig::default()
    };
    let dataset = load_dataset(photos.as_ref(), &LoadOptions::default())?;
    let dataset = run::with_points(dataset, &config)?;
    let plan = Plan::new(&dataset, &config)?;
    let splats = run::initial_gaussians(&dataset, &plan)?;
    let mut trainer = Trainer::new(&Device::open(None)?, &dataset, &plan, &splats)?;
    while trainer.advance()? != Event::Finished {}
    let image = trainer.render(&dataset.train[0].camera)?;
    let size = (image.width as u32, image.height as u32);
    let rgb = image::RgbImage::from_raw(size.0, size.1, image.rgb8()).ok_or("no pixels")?;
    Ok(rgb.save(picture)?)
}

fn main() -> Outcome {
    let args: Vec<String> = std::env::args().collect();
    match &args[1..] {
        [photos, iterations, picture] => train_and_render(photos, iterations.parse()?, picture),
        _ => Err("give DATASET ITERATIONS PICTURE.png".into()),
    }
}
