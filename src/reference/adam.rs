//! Twin of `kernels/adam.cl` (Kingma and Ba 2015).

/// Constants of one step of one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Learning rate.
    pub rate: f64,
    /// β₁, β₂, ε.
    pub constants: [f64; 3],
    /// Step, from 1.
    pub t: u32,
}

/// One step of one plane; a gradient that is not finite (or whose square would not be, in f32) counts as 0. Returns how
/// many did.
pub fn adam(grads: &[f64], step: &Step, params: &mut [f64], m: &mut [f64], v: &mut [f64]) -> u32 {
    let [beta1, beta2, epsilon] = step.constants;
    let t = f64::from(step.t);
    let mut bad = 0;
    for (i, raw) in grads.iter().enumerate() {
        let good = raw.abs() < 1e18;
        bad += u32::from(!good);
        let g = if good { *raw } else { 0.0 };
        m[i] = beta1 * m[i] + (1.0 - beta1) * g;
        v[i] = beta2 * v[i] + (1.0 - beta2) * g * g;
        let m_hat = m[i] / (1.0 - beta1.powf(t));
        let v_hat = v[i] / (1.0 - beta2.powf(t));
        params[i] -= step.rate * m_hat / (v_hat.sqrt() + epsilon);
    }
    bad
}
