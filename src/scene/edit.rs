//! [`Edit`]: one Gaussian that density control writes.

/// One Gaussian to be written: the row `src` is copied to `dst`, then position, log-scale, opacity and maybe the colour are
/// replaced, and both optimiser moments of `dst` are zeroed. `dst == src` changes the row in place; `dst ≥ N` appends.
///
/// Within one step no row is named twice as `dst`, and a row that another edit names as `src` is itself a `dst` only
/// with `src == dst` (so the order of the edits does not matter). The layout is that of `Edit` in `kernels/common.clh`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Edit {
    /// Row to copy from.
    pub src: u32,
    /// Row to write.
    pub dst: u32,
    /// New position, local units.
    pub position: [f32; 3],
    /// New log-scale.
    pub log_scale: [f32; 3],
    /// New opacity logit.
    pub opacity_logit: f32,
    /// New colour; without one, the SH coefficients are those of `src`.
    pub color: OptionalColor,
}

impl Edit {
    /// The numbers of the edit, integers in their bits.
    #[must_use]
    pub fn to_bits(&self) -> [f32; 13] {
        let ([x, y, z], [a, b, c]) = (self.position, self.log_scale);
        let [src, dst, colored] = [self.src, self.dst, self.color.present].map(f32::from_bits);
        let [red, green, blue] = self.color.value;
        [
            src,
            dst,
            x,
            y,
            z,
            a,
            b,
            c,
            self.opacity_logit,
            colored,
            red,
            green,
            blue,
        ]
    }

    /// The edit that [`Edit::to_bits`] gave.
    #[must_use]
    pub fn of_bits(numbers: &[f32; 13]) -> Self {
        let [
            src,
            dst,
            x,
            y,
            z,
            a,
            b,
            c,
            opacity_logit,
            colored,
            red,
            green,
            blue,
        ] = *numbers;
        Self {
            src: src.to_bits(),
            dst: dst.to_bits(),
            position: [x, y, z],
            log_scale: [a, b, c],
            opacity_logit,
            color: OptionalColor {
                present: u32::from(colored.to_bits() != 0),
                value: [red, green, blue],
            },
        }
    }
}

/// SH coefficients of band 0, the higher bands being zero, or none: an `Option` whose layout OpenCL knows.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OptionalColor {
    present: u32,
    value: [f32; 3],
}

impl OptionalColor {
    /// No colour.
    pub const NONE: Self = Self {
        present: 0,
        value: [0.0; 3],
    };

    /// This colour.
    #[must_use]
    pub const fn some(value: [f32; 3]) -> Self {
        Self { present: 1, value }
    }

    /// The colour, if there is one.
    #[must_use]
    pub fn get(self) -> Option<[f32; 3]> {
        (self.present != 0).then_some(self.value)
    }
}
