//! One pass of a case through every stage, in order, on one device and in one precision.
//!
//! A quantity is named here and nowhere else: with what the device computed, what the reference did, and the floor of its errors.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::tuning::{Tuning, status};
use crate::device::{Array, CameraArg, Defines, Device, Kernels, Real};
use crate::lab::verify::cases::{ADAM, Case};
use crate::lab::verify::definition::{
    EXPOSURE_RATE, EXPOSURES, NOISE, NOISE_KEYS, Reference, VIEW, edited, flat, largest_sum, lists,
    seen_before,
};
use crate::lab::verify::outcome::Outcome;
use crate::lab::verify::readback::{counted, crop, records, sums, tiles, widen};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock};
use crate::pipeline::exposure::ExposureModel;
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::pass::{Pipeline, Target};
use crate::pipeline::stage::adam::{Adam, Step};
use crate::pipeline::stage::edit::Edit;
use crate::pipeline::stage::exposure::{apply, backward};
use crate::pipeline::stage::filter::Filter;
use crate::pipeline::stage::importance::Importance;
use crate::pipeline::stage::loss::ImagePair;
use crate::pipeline::stage::metrics::{Metrics, squared_error, sum_counted};
use crate::pipeline::stage::noise::Noise;
use crate::pipeline::stage::screen_grad::ScreenGrad;
use crate::pipeline::stage::seen::Seen;
use crate::scene::Plane;

/// Runs every stage in precision `R` on a case, and its definition if there is a reference.
pub fn run<R: Real>(
    device: &Device,
    tuning: Tuning,
    case: &Case,
    reference: Option<&Reference>,
) -> Result<Outcome> {
    let mut pass = Pass::<R>::new(device, tuning, case, reference)?;
    pass.render()?;
    let mut out = Outcome::default();
    pass.forward(&mut out)?;
    let error_sums = pass.loss(&mut out)?;
    let grads = pass.gradients(&mut out)?;
    let state = pass.optimiser(&grads, &mut out)?;
    pass.noise(&mut out)?;
    pass.screen_gradients(&mut out)?;
    pass.seen(&mut out)?;
    pass.importance(&error_sums, &mut out)?;
    pass.edit(state, &mut out)?;
    pass.metrics(&mut out)?;
    pass.filter(&mut out)?;
    pass.exposure(&mut out)?;
    device.collect_times(usize::MAX)?;
    let times = device.times().into_iter();
    out.seconds = times.map(|(stage, t)| (stage, t.seconds)).collect();
    Ok(out)
}

/// Parameters and both moments.
type State = [Vec<Vec<f64>>; 3];

/// Copy of the scene with its moments, after the optimiser's steps.
struct Optimised<R: Real> {
    scene: GaussianBuffers<R>,
    moments: [Array<R>; 2],
    /// State of the reference.
    want: State,
}

/// A pass under way.
struct Pass<'a, R: Real> {
    device: &'a Device,
    kernels: Kernels,
    pipeline: Pipeline<R>,
    scene: GaussianBuffers<R>,
    photo: Array<u8>,
    camera: CameraArg<R>,
    case: &'a Case,
    reference: Option<&'a Reference>,
}

impl<'a, R: Real> Pass<'a, R> {
    fn new(
        device: &'a Device,
        tuning: Tuning,
        case: &'a Case,
        reference: Option<&'a Reference>,
    ) -> Result<Self> {
        let defines = Defines {
            alpha_min: case.alpha_min,
            sh_degree: case.sh_degree,
            alpha: case.photo.alpha,
            anti_alias: !case.filter_views.is_empty(),
            ..Defines::new(tuning)
        };
        let mut scene = GaussianBuffers::<R>::upload(device, &case.splats, 0)?;
        if defines.anti_alias {
            scene = scene.with_filter(device)?;
        }
        let camera = CameraArg::<R>::new(&case.camera);
        Ok(Self {
            pipeline: Pipeline::new(device, defines, [case.sh_degree; 2], camera.image())?,
            kernels: Kernels::new(device, defines),
            photo: Array::from_slice(device, "photo", &case.photo.data)?,
            device,
            scene,
            camera,
            case,
            reference,
        })
    }

    /// A value of the reference; empty without one.
    fn want<T: Default>(&self, of: impl FnOnce(&Reference) -> T) -> T {
        self.reference.map(of).unwrap_or_default()
    }

    fn image(&self, planes: &Array<R>, of: std::ops::Range<usize>) -> Result<Vec<f64>> {
        Ok(crop(&widen(planes.to_vec()?), &self.camera, of))
    }

    /// Planes of an array of the scene's shape.
    fn planes(&self, array: &Array<R>) -> Result<Vec<Vec<f64>>> {
        (0..self.scene.planes())
            .map(|p| Ok(widen(array.read(p * self.scene.stride, self.scene.count)?)))
            .collect()
    }

    fn copy(&self, array: &Array<R>) -> Result<Array<R>> {
        let copy = Array::zeros(self.device, array.name(), array.len())?;
        copy.copy_from(0, array, 0, array.len())?;
        Ok(copy)
    }

    /// The scene again, so that its parameters can be changed.
    fn copy_of_scene(&self) -> Result<GaussianBuffers<R>> {
        Ok(GaussianBuffers {
            params: self.copy(&self.scene.params)?,
            filter: Array::zeros(self.device, "filter", 0)?,
            ..self.scene
        })
    }

    /// Renders twice: the first pass may be repeated with more room for pairs; times are of one that is not.
    fn render(&mut self) -> Result<()> {
        let (device, forward) = (self.device, &mut self.pipeline.forward);
        if self.kernels.defines().anti_alias {
            let views = self.case.filter_views.iter();
            let cameras: Vec<_> = views.map(|c| CameraArg::<R>::new(c)).collect();
            let cameras = Array::from_slice(device, "cameras", &cameras)?;
            let largest = Array::zeros(device, "largest", FILTER_CHUNKS as usize)?;
            let stage = Filter::new::<R>(&self.kernels)?;
            stage.run(&self.scene, &forward.frame, &cameras, &largest)?;
        }
        let options = RenderOptions {
            sh_degree: self.case.sh_degree,
            background: self.case.background,
            quantity: Quantity::Color,
            active_only: false,
        };
        forward.render(&self.scene, &self.camera, &options)?;
        device.collect_times(usize::MAX)?;
        device.reset_times();
        forward.render(&self.scene, &self.camera, &options)
    }

    fn forward(&self, out: &mut Outcome) -> Result<()> {
        let f = &self.pipeline.forward.frame;
        let got = records(f, self.scene.count)?;
        let want = self.want(Reference::records);
        for (name, numbers) in [
            ("mean", 0..2),
            ("quadratic form", 2..5),
            ("opacity, depth, colour", 5..10),
            ("pixel bounds", 10..14),
        ] {
            let part = |all: &[[f64; 14]]| -> Vec<f64> {
                all.iter()
                    .flat_map(|r| r[numbers.clone()].to_vec())
                    .collect()
            };
            out.add("project", name, part(&got), part(&want));
        }
        let tiles = tiles(f, &self.camera)?;
        let emitted: usize = tiles.iter().map(Vec::len).sum();
        let pairs = self.want(|r| vec![r.pairs()]);
        out.add("scan", "pairs counted", vec![counted(f)?], pairs.clone());
        out.add("bin", "pairs emitted", vec![emitted as f64], pairs);
        let want = self.want(|r| lists(&r.pass.tiles));
        out.add("sort", "tile lists", lists(&tiles), want);
        let want = self.want(|r| r.pass.image.clone());
        out.add("splat", "image", self.image(&f.image, 0..3)?, want);
        let want = self.want(|r| r.pass.transmittance.clone());
        out.add("splat", "transmittance", self.image(&f.image, 3..4)?, want);
        Ok(())
    }

    fn pair(&self) -> Result<ImagePair<'_, R>> {
        let target = Target {
            view: 0,
            photo: &self.photo,
            background: self.case.background,
            skip_blank: true,
        };
        self.pipeline.pair(&self.camera, target)
    }

    /// Loss, its gradient and the error maps; returns the error statistics of the Gaussians after the same view twice.
    fn loss(&self, out: &mut Outcome) -> Result<Array<R>> {
        let pipeline = &self.pipeline;
        pipeline.mark_tiles(&self.photo, &self.camera)?;
        let pair = self.pair()?;
        let losses = Array::zeros(self.device, "losses", 2)?;
        pipeline.loss_gradient(0, &pair, self.case.lambdas[0])?;
        pipeline.record_loss(&pair, &losses, 0)?;
        let want = self.want(|r| vec![r.pass.loss.l1, r.pass.loss.ssim]);
        out.add("loss", "L1, SSIM", widen(losses.to_vec()?), want);
        let got = self.image(pipeline.image_gradient(), 0..3)?;
        // Where render and photo agree it is nothing, of terms of this size: the sign of L1 over all values.
        let floor = 1.0 / got.len() as f64;
        let want = self.want(|r| r.pass.loss.gradient.clone());
        out.add_floored("loss", "gradient", got, (want, floor));

        let stage = Importance::new::<R>(&self.kernels)?;
        let sums = Array::zeros(self.device, "cues", 3 * self.scene.stride)?;
        for first_view in [true, false] {
            let (scene, camera) = (&self.scene, &self.camera);
            pipeline.add_errors(&stage, scene, camera, &pair, first_view, &sums)?;
        }
        let want = self.want(|r| {
            let loss = &r.pass.loss;
            [loss.ssim_error.as_slice(), &loss.l1_error].concat()
        });
        let got = self.image(pipeline.error_maps(), 0..2)?;
        out.add("loss", "error maps", got, want);
        Ok(sums)
    }

    /// Sums of the Gaussians and the gradients of their parameters, which are returned.
    fn gradients(&self, out: &mut Outcome) -> Result<Gradients<R>> {
        let (pipeline, scene, case) = (&self.pipeline, &self.scene, self.case);
        pipeline.splat_gradient(&self.camera)?;
        let got = sums(&pipeline.forward.frame, scene.count)?;
        out.add("splat_grad", "sums", got, self.want(Reference::sums));

        let values = Array::zeros(self.device, "grads", scene.planes() * scene.stride)?;
        let [_, opacity, scale] = case.lambdas;
        let degree = case.sh_degree;
        let block = self.block(&values);
        pipeline.parameter_gradient(scene, &self.camera, degree, [opacity, scale], &block)?;
        let planes = self.planes(&values)?;
        // A saturated opacity has no gradient; the regulariser's alone is up to λ_o/4N.
        let saturated = 0.25 * opacity / scene.count.max(1) as f64;
        let turn = self.want(Reference::turn_floor);
        for (name, of, floor) in [
            ("position", Plane::POSITION..Plane::LOG_SCALE, 0.0),
            ("log-scale", Plane::LOG_SCALE..Plane::ROTATION, 0.0),
            ("rotation", Plane::ROTATION..Plane::OPACITY, turn),
            ("opacity", Plane::OPACITY..Plane::SH, saturated),
            ("SH", Plane::SH..planes.len(), 0.0),
        ] {
            let want = self.want(|r| r.gradient(of.clone()));
            out.add_floored("project_grad", name, flat(&planes[of]), (want, floor));
        }
        Ok(Gradients { values, planes })
    }

    fn block<'b>(&self, values: &'b Array<R>) -> GradientBlock<'b, R> {
        GradientBlock {
            values,
            planes: Plane::count(self.case.sh_degree),
            stride: self.scene.stride,
            rows: 0..self.scene.count,
        }
    }

    /// Two steps with the same gradients, on a copy of the scene.
    fn optimiser(&self, grads: &Gradients<R>, out: &mut Outcome) -> Result<Optimised<R>> {
        let frame = &self.pipeline.forward.frame;
        let stage = Adam::new::<R>(&self.kernels)?;
        let zeros = |name| Array::zeros(self.device, name, grads.values.len());
        let state = Optimised {
            scene: self.copy_of_scene()?,
            moments: [zeros("moment1")?, zeros("moment2")?],
            want: self.want(|r| r.optimised(self.case, &grads.planes)),
        };
        let ([m, v], block) = (&state.moments, self.block(&grads.values));
        for t in 1..=2 {
            let step = Step {
                rate: self.case.rates,
                constants: ADAM,
                t,
            };
            stage.run(&state.scene, [m, v], &block, &step, frame)?;
        }
        let names = ["parameters", "first moments", "second moments"];
        let got = [&state.scene.params, m, v];
        for ((name, got), want) in names.into_iter().zip(got).zip(&state.want) {
            out.add("adam", name, flat(&self.planes(got)?), flat(want));
        }
        out.non_finite = frame.status.read(status::NON_FINITE as usize, 1)?[0];
        Ok(state)
    }

    /// Displacements by the noise, on a copy of the scene.
    fn noise(&self, out: &mut Outcome) -> Result<()> {
        let moved = self.copy_of_scene()?;
        let (stage, frame) = (
            Noise::new::<R>(&self.kernels)?,
            &self.pipeline.forward.frame,
        );
        stage.run(&moved, frame, &NOISE, NOISE_KEYS[0], NOISE_KEYS[1])?;
        let position = |scene: &GaussianBuffers<R>| -> Result<Vec<f64>> {
            Ok(flat(&self.planes(&scene.params)?[..Plane::LOG_SCALE]))
        };
        let (before, after) = (position(&self.scene)?, position(&moved)?);
        let got = after.iter().zip(&before).map(|(a, b)| a - b).collect();
        out.add(
            "noise",
            "displacement",
            got,
            self.want(Reference::displacements),
        );
        Ok(())
    }

    fn screen_gradients(&self, out: &mut Outcome) -> Result<()> {
        let (stage, frame) = (
            ScreenGrad::new::<R>(&self.kernels)?,
            &self.pipeline.forward.frame,
        );
        let (stride, count) = (self.scene.stride, self.scene.count);
        let sums = Array::zeros(self.device, "cues", 2 * stride)?;
        for _ in 0..2 {
            stage.run(&self.scene, frame, &self.camera, &sums)?;
        }
        let [norms, iterations] = self.want(|r| {
            r.screen_gradients(out.got("splat_grad", "sums"), out.got("sort", "tile lists"))
        });
        let row = |k: usize| Ok(widen(sums.read(k * stride, count)?));
        out.add("screen_grad", "norms", row(0)?, norms);
        out.add("screen_grad", "iterations", row(1)?, iterations);
        Ok(())
    }

    /// Flags of the Gaussians that the view shows, if some were seen before.
    fn seen(&self, out: &mut Outcome) -> Result<()> {
        let frame = &self.pipeline.forward.frame;
        let before: Vec<u32> = seen_before(self.scene.count).collect();
        let seen = Array::from_slice(self.device, "seen", &before)?;
        let shown = Array::zeros(self.device, "shown", frame.intersection_capacity())?;
        Seen::new::<R>(&self.kernels)?.run(frame, &self.camera, &shown, &seen)?;
        let got = seen.to_vec()?.into_iter().map(f64::from).collect();
        out.add("seen", "Gaussians", got, self.want(Reference::seen));
        Ok(())
    }

    fn importance(&self, sums: &Array<R>, out: &mut Outcome) -> Result<()> {
        let (stride, count) = (self.scene.stride, self.scene.count);
        let row = |k: usize| Ok(widen(sums.read(k * stride, count)?));
        let got = [row(0)?, row(1)?, row(2)?].concat();
        let want = self.want(|r| r.error_sums(out.got("loss", "error maps")));
        out.add("importance", "cues", got, want);
        Ok(())
    }

    fn edit(&self, state: Optimised<R>, out: &mut Outcome) -> Result<()> {
        let (scene, [m, v]) = (&state.scene, &state.moments);
        let edits = Array::from_slice(self.device, "edits", &self.case.edits)?;
        Edit::new::<R>(&self.kernels)?.run(scene, [m, v], &edits)?;
        let planes = |a: &Array<R>| Ok(flat(&self.planes(a)?));
        let got = [planes(&scene.params)?, planes(m)?, planes(v)?].concat();
        let want = self.want(|_| edited(self.case, &state.want));
        out.add("edit", "rows", got, want);
        Ok(())
    }

    /// Scores of the render; 1 − SSIM is the sum of the device's own error map.
    fn metrics(&self, out: &mut Outcome) -> Result<()> {
        let stage = Metrics::new::<R>(&self.kernels)?;
        // The stage clamps the render in place.
        let image = self.copy(&self.pipeline.forward.frame.image)?;
        let pair = ImagePair {
            image: &image,
            ..self.pair()?
        };
        let [w, h] = pair.size.0;
        let rows = Array::zeros(self.device, "score", 3 * h)?;
        stage.dissimilarity(&pair, self.pipeline.error_maps(), &rows)?;
        stage.run(&pair, &rows)?;
        let sum =
            |k: usize| -> Result<Vec<f64>> { Ok(vec![widen(rows.read(k * h, h)?).iter().sum()]) };
        let want = self.want(|r| vec![squared_error(&r.pass.image, &r.photo, r.mask.as_deref())]);
        out.add("metrics", "squared error", sum(0)?, want);
        let want = self.want(|r| {
            let map = &out.got("loss", "error maps")[..r.camera.pixels()];
            vec![sum_counted(map, r.mask.as_deref())]
        });
        // Of pictures that agree it is nothing but rounding.
        let floor = 1e-3 * (w * h) as f64;
        out.add_floored("metrics", "1 - SSIM", sum(2)?, (want, floor));
        Ok(())
    }

    fn filter(&self, out: &mut Outcome) -> Result<()> {
        if self.kernels.defines().anti_alias {
            let got = widen(self.scene.filter.read(0, self.scene.count)?);
            let want = self.want(|r| r.scene.filter.clone().unwrap_or_default());
            out.add("filter", "standard deviation", got, want);
        }
        Ok(())
    }

    /// Exposure of the render and of the loss gradient, as the stages before gave them.
    fn exposure(&self, out: &mut Outcome) -> Result<()> {
        let (frame, plane) = (&self.pipeline.forward.frame, self.camera.image().plane());
        let model = ExposureModel::<R>::new(&self.kernels, EXPOSURES.len(), plane, 0)?;
        let start: Vec<R> = EXPOSURES.as_flattened().iter().map(|v| R::of(*v)).collect();
        let zeros = vec![R::of(0.0); start.len()];
        model.restore(&[start, zeros.clone(), zeros])?;
        let gradient = self.copy(self.pipeline.image_gradient())?;
        model.stage.apply(&frame.image, plane, VIEW)?;
        model.stage.backward(&frame.image, plane, VIEW, &gradient)?;
        for iteration in 0..2 {
            let step = Step {
                rate: EXPOSURE_RATE,
                constants: ADAM,
                t: iteration,
            };
            model.step(VIEW, step, &frame.status)?;
        }
        let transform = widen(model.gradient()?);
        let (image, dimage) = (out.got("splat", "image"), out.got("loss", "gradient"));
        let exposed = self.want(|_| apply(image, &EXPOSURES[VIEW]));
        let ((by_render, by_transform), floor) = self.want(|_| {
            let (by_render, by_transform) = backward(image, &EXPOSURES[VIEW], dimage);
            let floor = largest_sum(image, dimage);
            ((by_render, by_transform.to_vec()), floor)
        });
        let steps = self.want(|r| r.transforms(&transform));
        out.add(
            "exposure",
            "image",
            self.image(&model.stage.corrected, 0..3)?,
            exposed,
        );
        let got = self.image(&gradient, 0..3)?;
        out.add("exposure", "gradient by the render", got, by_render);
        let want = (by_transform, floor);
        out.add_floored("exposure", "gradient by the transform", transform, want);
        let names = ["transforms", "first moments", "second moments"];
        for ((name, got), want) in names.into_iter().zip(model.rows()?).zip(steps) {
            out.add("exposure", name, widen(got), want);
        }
        Ok(())
    }
}

/// Gradients of the raw parameters, on the device and as planes.
struct Gradients<R: Real> {
    values: Array<R>,
    planes: Vec<Vec<f64>>,
}
