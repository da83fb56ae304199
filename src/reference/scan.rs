//! Twin of `kernels/scan.cl`.

/// Exclusive prefix sums and the total.
#[must_use]
pub fn scan(values: &[u32]) -> (Vec<u32>, u64) {
    let mut total = 0u64;
    let sums = values
        .iter()
        .map(|v| {
            let before = total as u32;
            total += u64::from(*v);
            before
        })
        .collect();
    (sums, total)
}
