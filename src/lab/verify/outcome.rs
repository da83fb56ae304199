//! [`Outcome`]: what a pass through every stage computed.

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
    /// Numbers of the device; empty if there is no such quantity.
    #[must_use]
    pub fn got(&self, stage: &str, name: &str) -> &[f64] {
        let mut all = self.quantities.iter();
        all.find(|q| q.stage == stage && q.name == name)
            .map_or(&[], |q| &q.got)
    }

    /// Gradients of all planes, one after the other.
    pub(super) fn gradients(&self) -> Vec<f64> {
        let of = self.quantities.iter().filter(|q| q.stage == "project_grad");
        of.flat_map(|q| q.got.iter().copied()).collect()
    }
}
