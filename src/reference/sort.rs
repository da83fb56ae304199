//! Twin of `kernels/sort.cl`.

/// Positions of the keys in ascending order, equal keys in their old order.
#[must_use]
pub fn sort(keys: &[u32]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|i| keys[*i as usize]);
    order
}
