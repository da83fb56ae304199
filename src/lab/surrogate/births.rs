//! Births on the device: their true loss change by rendering again, and its first-order prediction by a probe.

use crate::base::error::Result;
use crate::device::Real;
use crate::lab::surrogate::candidates::{Candidate, Shape};
use crate::lab::surrogate::instrument::{Base, Instrument};
use crate::lab::surrogate::outcome::FORMS;
use crate::pipeline::backward::GRADIENT_ROWS;
use crate::scene::Plane;
use crate::train::estimates::{change, scaled_logit};

/// A birth as it is to be measured.
#[derive(Debug, Clone, Copy)]
pub struct Birth {
    /// Row that is copied.
    pub source: u32,
    /// Position of the birth.
    pub position: [f32; 3],
    /// Shape of the birth.
    pub shape: Shape,
    /// True if the source gets that shape, too.
    pub shared: bool,
}

impl Candidate {
    /// The birth in each of [`FORMS`].
    pub(super) fn births(&self) -> [Birth; FORMS.len()] {
        [(self.copy, false), (self.split, true), (self.faint, false)].map(|(shape, shared)| Birth {
            source: self.source,
            position: self.position,
            shape,
            shared,
        })
    }
}

/// First-order prediction of a birth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Probed {
    /// First-order change of the mean loss.
    pub change: f64,
    /// For each view, true if any tile intersection is its own.
    pub touched: Vec<bool>,
}

impl<R: Real> Instrument<R> {
    /// Writes births to the rows from `first` on, their opacities times `factor`.
    fn insert(&self, first: usize, births: &[Birth], factor: f64) -> Result<()> {
        let value = |plane: usize, b: &Birth| {
            let shape = &b.shape;
            match plane {
                0..3 => f64::from(b.position[plane]),
                Plane::LOG_SCALE..Plane::ROTATION => {
                    f64::from(shape.log_scale[plane - Plane::LOG_SCALE])
                }
                Plane::OPACITY => scaled_logit(f64::from(shape.opacity_logit), factor),
                _ => f64::from(self.splats.planes()[plane][b.source as usize]),
            }
        };
        for plane in 0..self.scene.planes() {
            let values: Vec<R> = births.iter().map(|b| R::of(value(plane, b))).collect();
            self.scene
                .params
                .write(plane * self.scene.stride + first, &values)?;
        }
        Ok(())
    }

    /// Gives a source the shape of its birth, or its own back.
    fn reshape(&self, source: u32, shape: Shape) -> Result<()> {
        let at = |plane: usize| plane * self.scene.stride + source as usize;
        let write =
            |plane: usize, v: f32| self.scene.params.write(at(plane), &[R::of(f64::from(v))]);
        for k in 0..3 {
            write(Plane::LOG_SCALE + k, shape.log_scale[k])?;
        }
        write(Plane::OPACITY, shape.opacity_logit)
    }

    /// First-order changes of the loss by births (method: a birth of opacity → 0 changes nothing, but has a derivative). All are
    /// in the scene at once, ε as opaque as they would be, and one backward pass per view tells the derivatives; dL/dC is that
    /// of the ordinary render. A source that shares adds its own gradient times its change of opacity logit and log-scale.
    pub fn probe(&mut self, base: &Base, births: &[Birth]) -> Result<Vec<Probed>> {
        let (n, epsilon) = (self.splats.len(), self.setting.probe);
        self.insert(n, births, epsilon)?;
        let mut probed = vec![Probed::default(); births.len()];
        let (first, count) = (n / GRADIENT_ROWS * GRADIENT_ROWS, n + births.len());
        for view in 0..self.view_count() {
            self.render(false, view, n)?;
            self.image_gradient(view)?;
            self.render(true, view, count)?;
            let [slopes, ..] = self.gradients(true, view, first)?;
            let touched = self.faint.forward.intersected(n, count)?;
            for (k, (p, b)) in probed.iter_mut().zip(births).enumerate() {
                let logit = f64::from(b.shape.opacity_logit);
                let change = change(slopes[n - first + k], logit, epsilon);
                p.change += change / self.view_count() as f64;
                p.touched.push(touched[k]);
            }
        }
        for (p, b) in probed.iter_mut().zip(births).filter(|(_, b)| b.shared) {
            p.change += self.source_change(base, b);
        }
        Ok(probed)
    }

    fn own_shape(&self, source: u32) -> Shape {
        Shape {
            log_scale: self.splats.gather(Plane::LOG_SCALE, source as usize),
            opacity_logit: self.splats.planes()[Plane::OPACITY][source as usize],
        }
    }

    fn source_change(&self, base: &Base, b: &Birth) -> f64 {
        let (own, i) = (self.own_shape(b.source), b.source as usize);
        let change = |new: f32, old: f32| f64::from(new) - f64::from(old);
        let scales = (0..3)
            .map(|k| change(b.shape.log_scale[k], own.log_scale[k]) * base.gradients[1 + k][i]);
        change(b.shape.opacity_logit, own.opacity_logit) * base.gradients[0][i]
            + scales.sum::<f64>()
    }

    /// The true change of the mean loss by one birth; views that neither it nor a source that shares touches are left out,
    /// because nothing changes there.
    pub fn change(&mut self, base: &Base, birth: &Birth, touched: &[bool]) -> Result<f64> {
        let n = self.splats.len();
        let own = self.own_shape(birth.source);
        self.insert(n, &[*birth], 1.0)?;
        if birth.shared {
            self.reshape(birth.source, birth.shape)?;
        }
        let mut sum = 0.0;
        for (view, seen) in touched.iter().enumerate() {
            let changes = birth.shared && base.touched[view][birth.source as usize];
            if !(*seen || changes) {
                continue;
            }
            self.render(false, view, n + 1)?;
            let strips = self.strips(view)?;
            let before = base.strips[view].chunks_exact(2);
            let differences = strips.chunks_exact(2).zip(before);
            let (l1, ssim) = differences.fold((0.0, 0.0), |(l1, ssim), (new, old)| {
                (l1 + (new[0] - old[0]), ssim + (new[1] - old[1]))
            });
            sum += self.weigh(view, l1, ssim);
        }
        if birth.shared {
            self.reshape(birth.source, own)?;
        }
        Ok(sum / self.view_count() as f64)
    }
}
