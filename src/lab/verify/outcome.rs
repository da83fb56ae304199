//! [`Outcome`]: the numbers of one pass, each on the device and in the reference.

/// A named array of numbers.
#[derive(Debug, Clone)]
pub struct Quantity {
    /// Stage that computed it.
    pub stage: &'static str,
    /// Name.
    pub name: &'static str,
    /// Numbers of the device.
    pub got: Vec<f64>,
    /// Numbers of the reference; empty after a pass without one.
    pub want: Vec<f64>,
    /// Least scale of relative errors.
    pub floor: f64,
}

/// Quantities and times of one pass.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// Quantities in the order of the stages.
    pub quantities: Vec<Quantity>,
    /// Non-finite gradients that the optimiser counted.
    pub non_finite: u32,
    /// Seconds of device time per stage.
    pub seconds: Vec<(&'static str, f64)>,
}

impl Outcome {
    /// Adds a quantity.
    pub(super) fn add(
        &mut self,
        stage: &'static str,
        name: &'static str,
        got: Vec<f64>,
        want: Vec<f64>,
    ) {
        self.add_floored(stage, name, got, (want, 0.0));
    }

    /// Adds a quantity whose errors are relative to no less than a floor: (numbers of the reference, floor).
    pub(super) fn add_floored(
        &mut self,
        stage: &'static str,
        name: &'static str,
        got: Vec<f64>,
        (want, floor): (Vec<f64>, f64),
    ) {
        self.quantities.push(Quantity {
            stage,
            name,
            got,
            want,
            floor,
        });
    }

    /// Numbers of the device; empty if there is no such quantity.
    #[must_use]
    pub fn got(&self, stage: &str, name: &str) -> &[f64] {
        let mut all = self.quantities.iter();
        all.find(|q| q.stage == stage && q.name == name)
            .map_or(&[], |q| &q.got)
    }
}
