//! Twin of `kernels/filter.cl` (Mip-Splatting, Yu et al. 2024, Eq. 6 to 8): what the host itself takes the filter out of a scene by.

pub use crate::model::filters as filter;
