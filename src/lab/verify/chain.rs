//! Every stage once, in order, on one device and in one precision, with every intermediate result read back.

use crate::base::constants::{FILTER_CHUNKS, NEAR, SUMS};
use crate::base::error::Result;
use crate::capture::{Camera, Photo};
use crate::device::tuning::{Tuning, status};
use crate::device::{Array, CameraArg, Defines, Device, Kernels, Projected, Real};
use crate::lab::verify::readback::{crop, widen};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock};
use crate::pipeline::forward::{Quantity, RenderOptions, Renderer};
use crate::pipeline::stage::adam::{Adam, LearningRates, Step};
use crate::pipeline::stage::edit::Edit;
use crate::pipeline::stage::exposure::Exposure;
use crate::pipeline::stage::filter::Filter;
use crate::pipeline::stage::importance::Importance;
use crate::pipeline::stage::live::Live;
use crate::pipeline::stage::loss::{ImagePair, Loss};
use crate::pipeline::stage::metrics::Metrics;
use crate::pipeline::stage::noise::Noise;
use crate::pipeline::stage::project_grad::ProjectGrad;
use crate::pipeline::stage::screen_grad::ScreenGrad;
use crate::pipeline::stage::seen::Seen;
use crate::pipeline::stage::splat_grad::SplatGrad;
use crate::scene::{self, Gaussians, Plane};

/// Inputs of a passage through all stages.
#[derive(Debug, Clone)]
pub struct Case {
    /// Name of the case.
    pub name: String,
    /// GaussianBuffers (f32 values, so that both precisions start from the same numbers).
    pub splats: Gaussians,
    /// Camera.
    pub camera: Camera,
    /// Photo, of the camera's size.
    pub photo: Photo,
    /// Cameras whose sampling rates the 3D filter goes by; none: no anti-aliasing.
    pub filter_views: Vec<Camera>,
    /// Background colour.
    pub background: [f32; 3],
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// SH degree in use.
    pub sh_degree: u32,
    /// λ, λ_o, λ_s.
    pub lambdas: [f64; 3],
    /// Learning rates of the optimiser step.
    pub rates: LearningRates,
    /// Rows written after the step.
    pub edits: Vec<scene::Edit>,
    /// Gaussians whose own numbers are not compared, because their parameters are none. What they do to others is.
    pub spoilt: Vec<usize>,
    /// A bound of its own on the loss's error maps in f32, where the case needs one.
    pub error_map_bound: Option<f64>,
}

/// Adam's constants in every case: β₁, β₂, ε. Exact in f32, as those of a configuration are: 1 − β₂ of a rounded 0.999 is off by
/// 1.3e-5 of itself, and every second moment with it.
pub const ADAM: [f64; 3] = [0.9_f32 as f64, 0.999_f32 as f64, 1e-15];

/// What the stages gave, as f64 whatever the precision. Images are without padding.
#[derive(Debug, Clone, Default)]
pub struct Outputs {
    /// project: record of each Gaussian, none when culled.
    pub records: Vec<Option<Projected<f64>>>,
    /// filter: standard deviation of each Gaussian; empty without anti-aliasing.
    pub filter: Vec<f64>,
    /// bin, scan and sort: Gaussians of each tile, front to back.
    pub tiles: Vec<Vec<u32>>,
    /// Sum of the counts of bin, which must equal the number of pairs.
    pub counted: usize,
    /// splat: \[3, height, width\].
    pub image: Vec<f64>,
    /// splat: \[height, width\].
    pub transmittance: Vec<f64>,
    /// loss: mean |x − y| and mean SSIM.
    pub loss: [f64; 2],
    /// loss: \[3, height, width\].
    pub dimage: Vec<f64>,
    /// loss: 1 − SSIM and |x − y|, channel means \[2, height, width\].
    pub error_maps: Vec<f64>,
    /// exposure: of the image and its gradient.
    pub exposure: ExposureOutputs,
    /// splat_grad: nine sums of each Gaussian.
    pub sums: Vec<[f64; SUMS]>,
    /// project_grad: planes.
    pub grads: Vec<Vec<f64>>,
    /// adam: parameters and moments after two steps with the same gradient.
    pub adam: [Vec<Vec<f64>>; 3],
    /// Non-finite gradients that adam counted.
    pub non_finite: u32,
    /// noise: displacement of each Gaussian, x, y and z.
    pub noise: Vec<Vec<f64>>,
    /// screen_grad: sums of norms, iterations (twice the same one).
    pub screen_grad: [Vec<f64>; 2],
    /// importance: sums of 1 − SSIM and L1, views (twice the same view).
    pub cues: [Vec<f64>; 3],
    /// seen: 1 for each Gaussian that the view shows, or that counted as seen before.
    pub seen: Vec<f64>,
    /// metrics: squared error over the image.
    pub squared_error: f64,
    /// metrics: 1 − SSIM (of the render before it is clamped) over the pixels, as far as they count.
    pub dissimilarity: f64,
    /// edit: parameters and moments afterwards.
    pub edited: [Vec<Vec<f64>>; 3],
    /// Seconds of device time per stage.
    pub seconds: Vec<(&'static str, f64)>,
}

/// What the exposure stage gave, as f64 whatever the precision. Images are without padding.
#[derive(Debug, Clone, Default)]
pub struct ExposureOutputs {
    /// A x + b \[3, height, width\].
    pub image: Vec<f64>,
    /// dL/dx \[3, height, width\], the loss stage's gradient being that by the corrected image.
    pub dimage: Vec<f64>,
    /// dL/d\[A | b\].
    pub grads: Vec<f64>,
    /// Transforms and moments \[views · 12\] after two steps with the same gradient.
    pub adam: [Vec<f64>; 3],
}

pub(super) struct Stages {
    live: Option<Live>,
    pub(super) loss: Loss,
    pub(super) splat_grad: SplatGrad,
    pub(super) exposure: Exposure,
    project_grad: ProjectGrad,
    adam: Adam,
    pub(super) noise: Noise,
    pub(super) screen_grad: ScreenGrad,
    pub(super) seen: Seen,
    pub(super) importance: Importance,
    pub(super) metrics: Metrics,
    edit: Edit,
}

impl Stages {
    fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        Ok(Self {
            live: Live::if_asked::<R>(kernels)?,
            loss: Loss::new::<R>(kernels)?,
            exposure: Exposure::new::<R>(kernels)?,
            splat_grad: SplatGrad::new::<R>(kernels)?,
            project_grad: ProjectGrad::new::<R>(kernels)?,
            adam: Adam::new::<R>(kernels)?,
            noise: Noise::new::<R>(kernels)?,
            screen_grad: ScreenGrad::new::<R>(kernels)?,
            seen: Seen::new::<R>(kernels)?,
            importance: Importance::new::<R>(kernels)?,
            metrics: Metrics::new::<R>(kernels)?,
            edit: Edit::new::<R>(kernels)?,
        })
    }
}

/// Runs every stage in precision `R` on `case`.
pub fn run<R: Real>(device: &Device, tuning: Tuning, case: &Case) -> Result<Outputs> {
    let defines = Defines {
        alpha_min: case.alpha_min,
        sh_degree: case.sh_degree,
        alpha: case.photo.alpha,
        anti_alias: !case.filter_views.is_empty(),
        ..Defines::new(tuning)
    };
    let stages = Stages::new::<R>(&Kernels::new(device, defines))?;
    let mut renderer = Renderer::<R>::new(device, defines, case.sh_degree, true)?;
    let mut scene = GaussianBuffers::<R>::upload(device, &case.splats, 0)?;
    if defines.anti_alias {
        scene = scene.with_filter(device)?;
    }
    let photo = Array::from_slice(device, "photo", &case.photo.data)?;
    let camera = CameraArg::<R>::new(&case.camera, NEAR);
    let options = RenderOptions {
        sh_degree: case.sh_degree,
        background: case.background,
        quantity: Quantity::Color,
        active_only: false,
    };
    // The first pass may be repeated with more room for pairs; times are of one that is not.
    if defines.anti_alias {
        filter(&Kernels::new(device, defines), &scene, &renderer, case)?;
    }
    renderer.render(&scene, &camera, &options)?;
    device.collect_times(usize::MAX)?;
    device.reset_times();
    renderer.render(&scene, &camera, &options)?;

    let mut out = Outputs::default();
    read_forward(&renderer, &scene, &camera, &mut out)?;
    if defines.anti_alias {
        out.filter = widen(scene.filter.read(0, scene.count)?);
    }
    let mut run = Run {
        device,
        stages,
        renderer,
        scene,
        photo,
        camera,
        case,
    };
    run.loss_and_gradient(&mut out)?;
    run.gradient_and_update(&mut out)?;
    run.sampler_stages(&mut out)?;
    run.seen(&mut out)?;
    run.importance_and_metrics(&mut out)?;
    device.collect_times(usize::MAX)?;
    out.seconds = device
        .times()
        .into_iter()
        .map(|(s, t)| (s, t.seconds))
        .collect();
    Ok(out)
}

/// Fills in the 3D filter of the scene.
fn filter<R: Real>(
    kernels: &Kernels,
    scene: &GaussianBuffers<R>,
    renderer: &Renderer<R>,
    case: &Case,
) -> Result<()> {
    let device = kernels.device();
    let cameras: Vec<_> = case
        .filter_views
        .iter()
        .map(|c| CameraArg::<R>::new(c, NEAR))
        .collect();
    let cameras = Array::from_slice(device, "cameras", &cameras)?;
    let largest = Array::zeros(device, "largest", FILTER_CHUNKS as usize)?;
    Filter::new::<R>(kernels)?.run(scene, &renderer.frame, &cameras, &largest)
}

/// A passage under way: what is on the device, and the stages.
pub(super) struct Run<'a, R: Real> {
    pub(super) device: &'a Device,
    pub(super) stages: Stages,
    pub(super) renderer: Renderer<R>,
    pub(super) scene: GaussianBuffers<R>,
    photo: Array<u8>,
    pub(super) camera: CameraArg<R>,
    case: &'a Case,
}

impl<R: Real> Run<'_, R> {
    pub(super) fn pair(&self) -> ImagePair<'_, R> {
        let frame = &self.renderer.frame;
        let background = self.case.background;
        ImagePair {
            blank: self.stages.live.is_some().then(|| frame.blank()),
            ..ImagePair::new(&frame.image, &self.photo, &self.camera, background)
        }
    }

    /// The scene again, so that its parameters can be changed.
    pub(super) fn copy_of_scene(&self) -> Result<GaussianBuffers<R>> {
        let params = &self.scene.params;
        let copy = Array::zeros(self.device, "params", params.len())?;
        copy.copy_from(0, params, 0, params.len())?;
        Ok(GaussianBuffers {
            params: copy,
            filter: Array::zeros(self.device, "filter", 0)?,
            ..self.scene
        })
    }

    pub(super) fn planes(&self, array: &Array<R>) -> Result<Vec<Vec<f64>>> {
        (0..self.scene.planes())
            .map(|p| Ok(widen(array.read(p * self.scene.stride, self.scene.count)?)))
            .collect()
    }

    fn loss_and_gradient(&mut self, out: &mut Outputs) -> Result<()> {
        let (device, s, case) = (self.device, &self.stages, self.case);
        if let Some(live) = &s.live {
            live.run(&self.photo, &self.camera, self.renderer.active_tiles())?;
        }
        let pair = self.pair();
        let ([w, h], plane) = (pair.size, pair.plane());
        let maps = Array::zeros(device, "maps", 3 * plane)?;
        let dimage = Array::zeros(device, "dimage", 3 * plane)?;
        let partial = Array::zeros(device, "partial", s.loss.partial_len(w, h))?;
        let loss = Array::zeros(device, "losses", 2)?;
        s.loss
            .gradient(&pair, case.lambdas[0], &maps, &partial, &dimage)?;
        s.loss.sum(&pair, &partial, &loss, 0)?;
        let sums = widen(loss.to_vec()?);
        out.loss = [sums[0], sums[1]];
        out.dimage = crop(&widen(dimage.to_vec()?), &self.camera, 0..3);
        out.exposure = self.exposure(&dimage, plane)?;

        s.splat_grad
            .run(&self.renderer.frame, &self.camera, &dimage)?;
        out.sums = self.read_sums()?;
        Ok(())
    }

    /// The nine sums of each Gaussian, added over its pairs.
    fn read_sums(&self) -> Result<Vec<[f64; SUMS]>> {
        let f = &self.renderer.frame;
        let (counts, starts) = (
            f.isect_counts.read(0, self.scene.count)?,
            f.isect_start.read(0, self.scene.count)?,
        );
        let all = widen(f.sums.to_vec()?);
        Ok(counts
            .iter()
            .zip(&starts)
            .map(|(n, first)| {
                let mut total = [0.0; SUMS];
                for p in 0..*n as usize {
                    for (k, t) in total.iter_mut().enumerate() {
                        *t += all[(*first as usize + p) * SUMS + k];
                    }
                }
                total
            })
            .collect())
    }

    fn gradient_and_update(&mut self, out: &mut Outputs) -> Result<()> {
        let (device, s, case) = (self.device, &self.stages, self.case);
        let f = &self.renderer.frame;
        let len = self.scene.planes() * self.scene.stride;
        let [grads, m, v] = [
            Array::zeros(device, "grads", len)?,
            Array::zeros(device, "moment1", len)?,
            Array::zeros(device, "moment2", len)?,
        ];
        let [_, lambda_opacity, lambda_scale] = case.lambdas;
        let block = GradientBlock {
            values: &grads,
            planes: Plane::count(case.sh_degree),
            stride: self.scene.stride,
            rows: 0..self.scene.count,
        };
        let lambdas = [lambda_opacity, lambda_scale];
        s.project_grad
            .run(&self.scene, f, &self.camera, lambdas, &block)?;
        out.grads = self.planes(&grads)?;
        // The optimiser and the edits change the parameters that the later stages read.
        let copy = self.copy_of_scene()?;
        for t in 1..=2 {
            let step = Step {
                rate: case.rates,
                constants: ADAM,
                t,
            };
            s.adam.run(&copy, [&m, &v], &block, &step, f)?;
        }
        let state = || -> Result<_> {
            Ok([
                self.planes(&copy.params)?,
                self.planes(&m)?,
                self.planes(&v)?,
            ])
        };
        out.adam = state()?;
        out.non_finite = f.status.read(status::NON_FINITE as usize, 1)?[0];
        let edits = Array::from_slice(device, "edits", &case.edits)?;
        s.edit.run(&copy, [&m, &v], &edits)?;
        out.edited = state()?;
        Ok(())
    }
}

fn read_forward<R: Real>(
    renderer: &Renderer<R>,
    scene: &GaussianBuffers<R>,
    camera: &CameraArg<R>,
    out: &mut Outputs,
) -> Result<()> {
    let f = &renderer.frame;
    let keys = f.keys.read(0, scene.count)?;
    let records = f.records.read(0, scene.count)?;
    out.records = keys
        .iter()
        .zip(records)
        .map(|(key, r)| {
            (*key != crate::device::tuning::KEY_CULLED).then(|| Projected {
                x: r.x.into(),
                y: r.y.into(),
                a: r.a.into(),
                r: r.r.into(),
                c: r.c.into(),
                lo: r.lo.into(),
                rgb: r.rgb.map(Into::into),
                depth: r.depth.into(),
                bx: r.bx,
                by: r.by,
            })
        })
        .collect();
    let pairs = f.status.read(status::INTERSECTIONS as usize, 1)?[0] as usize;
    let visible = f.status.read(status::VISIBLE as usize, 1)?[0] as usize;
    out.counted = f.counts.read(0, visible)?.iter().map(|c| *c as usize).sum();
    let order = f.order.sorted_values().read(0, pairs)?;
    let owner = f.isect_owner.read(0, pairs)?;
    let start = f.tile_start.read(0, camera.tile_count() + 1)?;
    out.tiles = start
        .windows(2)
        .map(|w| {
            order[w[0] as usize..w[1] as usize]
                .iter()
                .map(|slot| owner[*slot as usize])
                .collect()
        })
        .collect();
    let planes = widen(f.image.read(0, 4 * camera.plane())?);
    out.image = crop(&planes, camera, 0..3);
    out.transmittance = crop(&planes, camera, 3..4);
    Ok(())
}
