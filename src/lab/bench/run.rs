//! The bench of a device, from its peak to its precisions.

use std::collections::BTreeMap;
use std::path::Path;

use crate::base::error::{Error, Result};
use crate::capture::{Camera, Frame};
use crate::device::Device;
use crate::lab::bench::case::{Subject, measure as measure_case};
use crate::lab::bench::growth::growth;
use crate::lab::bench::options::Options;
use crate::lab::bench::peak::measure as measure_peak;
use crate::lab::bench::precision::measure as measure_precision;
use crate::lab::bench::record::{BenchRecord, Failure, Outcome};
use crate::lab::bench::scene;
use crate::lab::tune::{SizeClass, suited};
use crate::scene::formats::{self, SceneFile};
use crate::scene::{Gaussians, orbit};

/// Width and height at which a scene from a file is seen, pixels.
const SCENE_SIZE: u32 = 800;

/// Measures one device; `note` receives the name of each case before it is measured. A case that the device cannot hold is listed among the failures.
///
/// # Errors
/// A scene file that cannot be read, a failure of the micro-benchmarks, or no case that could be measured.
pub fn run(device: &Device, options: &Options, note: &mut dyn FnMut(&str)) -> Result<BenchRecord> {
    let trained = options.scene.as_deref().map(read_scene).transpose()?;
    note("peak");
    let peak = measure_peak(device, options)?;
    let (mut cases, mut failed, mut last) = (Vec::new(), Vec::new(), None);
    let mut by_size: BTreeMap<SizeClass, Device> = BTreeMap::new();
    let mut measure = |name: &str, splats: &Gaussians, cameras: &[Camera], anti_alias: bool| {
        let subject = Subject {
            name,
            splats,
            dataset: scene::dataset(cameras),
            anti_alias,
        };
        note(&subject.title());
        let Camera { width, height, .. } = cameras[0];
        let size = SizeClass::of(splats.len(), width as usize * height as usize);
        let device = match by_size.get(&size) {
            Some(known) => Ok(known.clone()),
            None => suited(device, size, note).inspect(|device| {
                by_size.insert(size, device.clone());
            }),
        };
        match device.and_then(|device| measure_case(&device, &peak, &subject, options)) {
            Ok(case) => cases.push(case),
            Err(e) => {
                failed.push(Failure::new(&subject.title(), &e));
                last = Some(e);
            }
        }
    };
    for (n, size) in &options.cases {
        let circle = scene::circle(*size);
        measure(scene::SYNTHETIC, &scene::cloud(*n), &circle, false);
    }
    if let Some((name, splats, anti_alias)) = &trained {
        let [x, y, z] = [0, 1, 2].map(|k| splats.planes()[k].as_slice());
        let around = orbit([x, y, z], scene::VIEWS, [SCENE_SIZE; 2]);
        measure(name, splats, &around, *anti_alias);
    }
    if let (true, Some(error)) = (cases.is_empty(), last) {
        return Err(error);
    }
    let precision = measure_precision(device, options, note, &mut failed);
    Ok(BenchRecord {
        device: device.info().name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        about: device.info().clone(),
        peak,
        growth: growth(&cases),
        cases,
        precision,
        failed,
    })
}

/// Name and Gaussians of a scene, and whether its header says that it was trained with anti-aliasing.
fn read_scene(path: &Path) -> Result<(String, Gaussians, bool)> {
    let SceneFile {
        splats,
        anti_aliased,
        ..
    } = formats::read(path, &Frame::IDENTITY)?;
    if splats.is_empty() {
        let fix = "give a scene that `mhsplat train` wrote";
        return Err(Error::input(path, "holds no Gaussian", fix));
    }
    let name = path.file_name().unwrap_or(path.as_os_str());
    let name = name.to_string_lossy();
    let name = match anti_aliased {
        true => format!("{name} with anti-aliasing"),
        false => name.into_owned(),
    };
    Ok((name, splats, anti_aliased))
}

/// Measures several devices (name, selector for `open`), one after the other. A device that fails does not keep
/// the others from being measured.
pub fn run_all(
    devices: &[(String, Option<String>)],
    open: impl Fn(Option<&str>) -> Result<Device>,
    options: &Options,
    note: &mut dyn FnMut(&str),
) -> Vec<Outcome> {
    let measure = |(name, selector): &(String, Option<String>)| match open(selector.as_deref())
        .and_then(|device| run(&device, options, note))
    {
        Ok(record) => Outcome::Done(Box::new(record)),
        Err(error) => Outcome::Failed {
            device: name.clone(),
            error: error.to_string(),
        },
    };
    devices.iter().map(measure).collect()
}
