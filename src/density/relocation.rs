//! Dead Gaussians take over alive ones (\[MH\] Eq. 17, \[MCMC\] Eq. 9), by splitting one Gaussian into N equal copies that
//! render alike (Eq. 9 of \[MCMC\] = Kheradmand et al., NeurIPS 2024).
//!
//! o′ = 1 − (1−o)^{1/N} and Σ′ = (o/F)²·Σ with F = Σ_{i=1..N} Σ_{k<i} C(i−1,k) (−1)^k o′^{k+1}/√(k+1). The alternating
//! sum loses every digit of f64 near N = 50; 1/√(k+1) = (2/√π) ∫₀^∞ e^{−(k+1)t²} dt turns it into
//!
//! F = (2/√π) ∫₀^∞ [1 − (1 − o′ e^{−t²})^N] dt,
//!
//! whose integrand is smooth, positive and falling, for any N.

use std::f64::consts::{FRAC_2_SQRT_PI, PI};
use std::sync::OnceLock;

use rayon::prelude::*;

use crate::base::math::{ln_sigmoid, logit, sigmoid, softplus};
use crate::base::rng::{Philox, Stream};
use crate::density::control::StepContext;
use crate::density::draw::Categorical;
use crate::density::state::{SceneState, gather};
use crate::scene::{Edit, OptionalColor};

/// Least opacity of copies, relative to the one at which a Gaussian is dead: copies that the next step would find dead spread
/// until nothing is alive.
const MIN_OPACITY_FACTOR: f64 = 2.0;

/// Number of rows per task.
const CHUNK: usize = 16_384;

/// Number of Gauss–Legendre nodes on the interval in which the integrand is neither 1 nor 0. 40 of them leave a relative error
/// below 1e-10 for N ≤ 10⁵; 32 leave 1e-8.
const NODES: usize = 40;
/// Value of N·o′·e^{−t²} above which the integrand is 1 within e⁻²⁵ ≈ 1e-11, because (1−z)^N ≤ e^{−Nz}.
const SATURATED: f64 = 25.0;
/// Excess of t² over ln max(1, N·o′) from which the integrand is negligible: e⁻²⁴ ≈ 4e-11.
const NEGLIGIBLE: f64 = 24.0;
/// Bound of ± logits: e^{−600} is still a normal f64, so every logarithm below stays finite.
const LOGIT_LIMIT: f64 = 600.0;

/// Parameters of each of N equal copies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// Opacity logit of each copy.
    pub opacity_logit: f64,
    /// Addend to each of the three log-scales: ln o − ln F. Never positive beyond rounding.
    pub log_scale_offset: f64,
}

/// Number of equal copies that a Gaussian can be split into so that each keeps an opacity of at least `floor` in (0, 1): the
/// largest N with 1 − (1−o)^{1/N} ≥ floor, 1 if even two are too many.
#[must_use]
pub fn most_copies(opacity_logit: f64, floor: f64) -> u32 {
    let copies = softplus(opacity_logit) / -(-floor).ln_1p();
    // Says what is good: NaN is 1, and the conversion saturates.
    if copies >= 2.0 { copies as u32 } else { 1 }
}

/// Splits a Gaussian of opacity σ(`opacity_logit`) into `copies` equal ones (\[MCMC\] Eq. 9). 0 and 1 copies leave it
/// as it is. Logits beyond ±600 are taken as ±600; a NaN stays one.
///
/// The opacity is kept: 1 − (1−o′)^N = o, computed from ln(1−o) = −softplus(logit), so that neither o → 0 nor o → 1
/// loses digits.
#[must_use]
pub fn split(opacity_logit: f64, copies: u32) -> Split {
    if copies <= 1 || opacity_logit.is_nan() {
        return Split {
            opacity_logit,
            log_scale_offset: 0.0,
        };
    }
    let logit = opacity_logit.clamp(-LOGIT_LIMIT, LOGIT_LIMIT);
    // y = −ln(1−o′); o′ = −expm1(−y); o′/(1−o′) = expm1(y) = e^y·o′.
    let y = softplus(logit) / f64::from(copies);
    let opacity = -(-y).exp_m1();
    Split {
        opacity_logit: y + opacity.ln(),
        log_scale_offset: ln_sigmoid(logit) - ln_coefficient(opacity, copies),
    }
}

/// ln F(o′, N) by quadrature of the integral form above: o′ in (0, 1], N ≥ 1; relative error of F at most 1e-9 for
/// N ≤ 10,000 (measured: below 1e-10).
#[must_use]
pub fn ln_coefficient(opacity: f64, copies: u32) -> f64 {
    let n = f64::from(copies);
    let peak = (n * opacity).ln();
    let from = (peak - SATURATED.ln()).max(0.0).sqrt();
    let to = (peak.max(0.0) + NEGLIGIBLE).sqrt();
    let half = 0.5 * (to - from);
    let sum: f64 = nodes()
        .iter()
        .map(|&(x, weight)| {
            let t = from + half * (1.0 + x);
            let z = opacity * (-t * t).exp();
            -weight * (n * (-z).ln_1p()).exp_m1()
        })
        .sum();
    (FRAC_2_SQRT_PI * (from + half * sum)).ln()
}

/// Nodes and weights of the Gauss–Legendre rule on [−1, 1]: roots of the Legendre polynomial by Newton's method.
fn nodes() -> &'static [(f64, f64); NODES] {
    static RULE: OnceLock<[(f64, f64); NODES]> = OnceLock::new();
    RULE.get_or_init(|| {
        std::array::from_fn(|i| {
            // Tricomi's first guess; five Newton steps are two more than needed at this size.
            let mut x = (PI * (i as f64 + 0.75) / (NODES as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..5 {
                let (value, derivative) = legendre(x);
                slope = derivative;
                x -= value / derivative;
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
    })
}

/// The Legendre polynomial of degree [`NODES`] and its derivative at x in (−1, 1).
fn legendre(x: f64) -> (f64, f64) {
    let (mut before, mut current) = (1.0, x);
    for k in 2..=NODES {
        let k = k as f64;
        (before, current) = (
            current,
            ((2.0 * k - 1.0) * x * current - (k - 1.0) * before) / k,
        );
    }
    let derivative = NODES as f64 * (x * current - before) / (x * x - 1.0);
    (current, derivative)
}

/// Alive and dead rows, and the edits of relocation.
#[derive(Debug, Clone)]
pub(super) struct Relocation {
    /// True for each row that was alive before the step and lives on.
    pub alive: Vec<bool>,
    /// Alive rows, rising.
    pub alive_rows: Vec<u32>,
    /// Number of dead rows that were relocated.
    pub moved: usize,
    /// One edit per changed row: sources (src == dst, rising), then the relocated rows (rising). No row appears twice as
    /// `dst`.
    pub edits: Vec<Edit>,
    sources: usize,
}

impl Relocation {
    /// Finds the dead rows and gives each the place of an alive one, drawn with replacement ∝ opacity. A source that
    /// was drawn by m dead rows is split into 1 + m equal copies, itself being one.
    ///
    /// A row is alive if its opacity is above `dead_opacity` and its position, log-scale and rotation are finite; so a row with
    /// invalid parameters is relocated like a dead one. If no row is alive, none can be relocated, and there are no edits.
    #[must_use]
    pub fn plan(context: &StepContext<'_>, scene: &SceneState<'_>, dead_opacity: f64) -> Self {
        let mut plan = Self::none(scene, dead_opacity);
        let dead_rows = plan.dead_rows();
        if !(dead_rows.is_empty() || plan.alive_rows.is_empty()) {
            plan.assign(context, scene, &dead_rows, dead_opacity.clamp(0.0, 1.0));
        }
        plan
    }

    /// Finds the alive rows like [`Relocation::plan`] and relocates none of the others.
    #[must_use]
    pub fn none(scene: &SceneState<'_>, dead_opacity: f64) -> Self {
        // The logit of the threshold: one logarithm instead of one exponential per row.
        let threshold = logit(dead_opacity.clamp(0.0, 1.0));
        let mut alive = vec![false; scene.len()];
        let chunks = alive.par_chunks_mut(CHUNK).enumerate();
        chunks.for_each(|(c, alive)| find_alive(scene, c * CHUNK, threshold, alive));
        Self {
            alive_rows: rows_where(&alive, true),
            alive,
            moved: 0,
            edits: Vec::new(),
            sources: 0,
        }
    }

    /// Makes a share of the alive rows dead: those of least opacity, ties by row.
    pub fn retire(&mut self, scene: &SceneState<'_>, share: f64) {
        let count = (share * self.alive_rows.len() as f64) as usize;
        if count == 0 {
            return;
        }
        let order = |row: u32| total_order(scene.opacity_logits[row as usize]);
        let (bound, below) = select(&self.alive_rows, order, count - 1);
        let (mut ties, mut left) = (count - below, 0);
        // Without branches: which rows die is not to be predicted.
        for at in 0..self.alive_rows.len() {
            let row = self.alive_rows[at];
            let order = order(row);
            let tie = order == bound && ties > 0;
            ties -= usize::from(tie);
            let lives = !(order < bound || tie);
            self.alive[row as usize] = lives;
            self.alive_rows[left] = row;
            left += usize::from(lives);
        }
        self.alive_rows.truncate(left);
    }

    /// The rows that were not alive, rising; empty if no row was alive.
    #[must_use]
    pub fn dead_rows(&self) -> Vec<u32> {
        if self.alive_rows.is_empty() {
            return Vec::new();
        }
        rows_where(&self.alive, false)
    }

    /// Draws a source for each dead row, and writes the edits.
    fn assign(
        &mut self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        dead_rows: &[u32],
        dead: f64,
    ) {
        let logit = |row: u32| f64::from(scene.opacity_logits[row as usize]);
        let weights: Vec<f64> = self
            .alive_rows
            .par_iter()
            .map(|&r| sigmoid(logit(r)))
            .collect();
        let categorical = Categorical::new(weights);
        let stream = Stream::Relocation.stream(context.iteration);
        // (source, dead row), by source: the dead rows of one source lie side by side.
        let mut pairs: Vec<(u32, u32)> = dead_rows
            .par_iter()
            .filter_map(|&dead| {
                let u = Philox::uniform_53(context.seed, stream, u64::from(dead))[0];
                let source = self.alive_rows.get(categorical.draw(u)?)?;
                Some((*source, dead))
            })
            .collect();
        pairs.par_sort_unstable();
        // No more of the dead that drew one source than it can be split for.
        let room = |source| most_copies(logit(source), MIN_OPACITY_FACTOR * dead) as usize - 1;
        let groups: Vec<&[(u32, u32)]> = pairs
            .chunk_by(|a, b| a.0 == b.0)
            .map(|group| &group[..group.len().min(room(group[0].0))])
            .filter(|group| !group.is_empty())
            .collect();
        let split_source = |group: &&[(u32, u32)]| -> Option<Edit> {
            let source = group.first()?.0;
            let copies = u32::try_from(group.len())
                .unwrap_or(u32::MAX)
                .saturating_add(1);
            let part = split(logit(source), copies);
            let log_scale = gather(&scene.log_scales, source as usize)?;
            Some(Edit {
                src: source,
                dst: source,
                position: gather(&scene.positions, source as usize)?,
                log_scale: log_scale.map(|s| (f64::from(s) + part.log_scale_offset) as f32),
                opacity_logit: part.opacity_logit as f32,
                color: OptionalColor::NONE,
            })
        };
        self.edits = groups.par_iter().filter_map(split_source).collect();
        self.sources = self.edits.len();
        let mut moved: Vec<Edit> = self
            .edits
            .iter()
            .zip(&groups)
            .flat_map(|(edit, group)| group.iter().map(|&(_, dst)| Edit { dst, ..*edit }))
            .collect();
        moved.par_sort_unstable_by_key(|e| e.dst);
        self.moved = moved.len();
        self.edits.append(&mut moved);
    }

    /// The edit of an alive row that was split; `None` if it was not.
    #[must_use]
    pub fn source(&self, row: u32) -> Option<&Edit> {
        let sources = self.edits.get(..self.sources)?;
        let i = sources.binary_search_by_key(&row, |e| e.dst).ok()?;
        sources.get(i)
    }

    /// The edit of a row that was split or relocated; `None` if it was neither.
    #[must_use]
    pub fn edit(&self, row: u32) -> Option<&Edit> {
        let moved = self.moved_edits();
        let at = |i: usize| moved.get(i);
        let moved = moved.binary_search_by_key(&row, |e| e.dst).ok();
        self.source(row).or_else(|| moved.and_then(at))
    }

    /// The edits of the relocated rows.
    #[must_use]
    pub fn moved_edits(&self) -> &[Edit] {
        self.edits.get(self.sources..).unwrap_or_default()
    }
}

/// A number that orders floats as [`f32::total_cmp`] does.
fn total_order(v: f32) -> u32 {
    let bits = v.to_bits();
    // A negative number is the smaller, the larger its other bits are.
    bits ^ (((bits as i32) >> 31) as u32 | 1 << 31)
}

/// The key of rank `rank`, from 0, among those of some rows, and the number of smaller ones: by counting digits, the highest first.
fn select(rows: &[u32], key: impl Fn(u32) -> u32, mut rank: usize) -> (u32, usize) {
    let (mut found, mut below) = (0, 0);
    for [low, high] in [[22, 32], [11, 22], [0, 11]] {
        let digits = 1 << (high - low);
        let mut counts = vec![0usize; digits];
        for row in rows {
            let key = key(*row);
            let same = high == 32 || key >> high == found;
            counts[(key >> low) as usize & (digits - 1)] += usize::from(same);
        }
        let mut digit = 0;
        while digit + 1 < digits && rank >= counts[digit] {
            rank -= counts[digit];
            below += counts[digit];
            digit += 1;
        }
        found = (found << (high - low)) | digit as u32;
    }
    (found, below)
}

/// Rows whose state is `wanted`, rising.
fn rows_where(states: &[bool], wanted: bool) -> Vec<u32> {
    let among = |(c, states): (usize, &[bool])| -> Vec<u32> {
        let (mut rows, mut found) = (vec![0; states.len()], 0);
        for (row, state) in ((c * CHUNK) as u32..).zip(states) {
            rows[found] = row;
            found += usize::from(*state == wanted);
        }
        rows.truncate(found);
        rows
    };
    let parts: Vec<Vec<u32>> = states.par_chunks(CHUNK).enumerate().map(among).collect();
    parts.concat()
}

/// Writes true for each row from `first` on that has an opacity logit above `threshold` and finite parameters, plane by plane.
fn find_alive(scene: &SceneState<'_>, first: usize, threshold: f64, alive: &mut [bool]) {
    for (alive, logit) in alive.iter_mut().zip(&scene.opacity_logits[first..]) {
        *alive = f64::from(*logit) > threshold && logit.is_finite();
    }
    for plane in scene.planes() {
        for (alive, value) in alive.iter_mut().zip(&plane[first..]) {
            *alive &= value.is_finite();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{select, total_order};

    #[test]
    fn selection_is_that_of_a_sort() {
        let mut values: Vec<f32> = (0..1000)
            .map(|i| (i * 37 % 101) as f32 / 7.0 - 6.0)
            .collect();
        values.extend([
            0.0,
            -0.0,
            f32::NAN,
            -f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            -1e-40,
            f32::MIN_POSITIVE,
        ]);
        let rows: Vec<u32> = (0..values.len() as u32)
            .filter(|row| row % 7 != 5)
            .collect();
        let key = |row: u32| total_order(values[row as usize]);
        let mut sorted: Vec<f32> = rows.iter().map(|row| values[*row as usize]).collect();
        sorted.sort_by(f32::total_cmp);
        for (rank, wanted) in sorted.iter().enumerate() {
            let (found, below) = select(&rows, key, rank);
            let less = sorted.iter().filter(|v| v.total_cmp(wanted).is_lt());
            assert_eq!(
                (found, below),
                (total_order(*wanted), less.count()),
                "{rank}"
            );
        }
    }
}
