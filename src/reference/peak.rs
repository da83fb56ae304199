//! Twin of `kernels/peak.cl`.

/// Sum of `chains` chains that go x → a·x + b `steps` times from 1, 2, 3 …
#[must_use]
pub fn fma_chains(chains: u32, steps: u32, a: f64, b: f64) -> f64 {
    (1..=chains)
        .map(|c| (0..steps).fold(f64::from(c), |x, _| a.mul_add(x, b)))
        .sum()
}
