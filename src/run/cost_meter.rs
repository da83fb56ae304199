//! [`CostMeter`]: the time of an iteration of cost 1, measured while a run goes on.

/// Iterations before the first measurement.
const FIRST: u32 = 20;

/// The cost of an iteration is measured so many times in a run, evenly spread.
const MEASUREMENTS: u32 = 50;

/// Share of a run in which iterations are those of its [`First`] Gaussians, and cost of a later one over theirs: sparse points are faint and far
/// apart, random ones large.
const BEGINNING: f64 = 0.07;
const AFTER_SPARSE: f64 = 1.2;
const AFTER_RANDOM: f64 = 0.62;

/// An iteration of a run of n iterations costs less at its beginning than one of as many pixels and Gaussians later on, by a factor of
/// 1 + [`LONG`] · ln(n / [`SHORT`]), which falls to 1 at a share [`EVEN`] of the run. Fitted at ten runs of 1500 iterations, five of 7000 and four of
/// 30,000, which is taken for all that are longer (docs/results/budgets.md, "Density steps apart, long runs").
const LONG: f64 = 0.27;
const SHORT: f64 = 1500.0;
const LONGEST: f64 = 30_000.0;
const EVEN: f64 = 0.15;

/// Gaussians that a run begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum First {
    /// Sparse points of a capture.
    Sparse,
    /// Points found in the photos, or a scene.
    Found,
    Random,
}

/// Mean of measurements.
#[derive(Debug, Clone, Copy)]
struct Mean {
    /// Seconds of an iteration of cost 1.
    one: f64,
    /// Iterations done in the middle of it, and their share of the run.
    at: f64,
    share: f64,
    /// Weight of the beginning of the run.
    beginning: f64,
}

impl Mean {
    /// The mean with a measurement of the same weight: a geometric one of the seconds.
    fn with(self, new: Self) -> Self {
        Self {
            one: (self.one * new.one).sqrt(),
            at: 0.5 * (self.at + new.at),
            share: 0.5 * (self.share + new.share),
            beginning: 0.5 * (self.beginning + new.beginning),
        }
    }

    /// That of which [`Mean::with`] made this one from `other`.
    fn without(self, other: Self) -> Self {
        Self {
            one: self.one * self.one / other.one,
            at: 2.0 * self.at - other.at,
            share: 2.0 * self.share - other.share,
            beginning: 2.0 * self.beginning - other.beginning,
        }
    }
}

/// Iterations that are measured together.
#[derive(Debug, Clone, Copy)]
struct Window {
    /// Iterations, their share of the run and seconds when it began.
    from: u32,
    share: f64,
    since: f64,
    /// Iterations done at the last call, and the cost of those since it began.
    done: u32,
    cost: f64,
}

/// Seconds of an iteration of cost 1. They are of either clock, wall or CPU, the same in all calls.
#[derive(Debug, Clone)]
pub(super) struct CostMeter {
    first: First,
    /// Largest share of the run that was done at a call: what is past does not come again, be it that the run is lengthened.
    share: f64,
    /// Seconds after which the first measurement is made, if fewer iterations have been done by then.
    latest: f64,
    /// Shortest time that a measurement is of, seconds.
    shortest: f64,
    /// `None` before the first measurement.
    now: Option<Mean>,
    /// The present measurement; `None` until the next call.
    window: Option<Window>,
    /// Number of measurements, and of those with photos of the present size.
    measured: u32,
    here: u32,
    /// The last [`CostMeter::now`] of photos of another size; `None` before.
    elsewhere: Option<Mean>,
}

impl CostMeter {
    /// A meter of a run of which a share is done, whose first measurement is made after `latest` seconds at the latest.
    pub fn new(first: First, share: f64, latest: f64) -> Self {
        Self {
            first,
            share,
            latest,
            shortest: 0.0,
            now: None,
            window: None,
            measured: 0,
            here: 0,
            elsewhere: None,
        }
    }

    /// The same with measurements of so many seconds at least.
    pub fn with_shortest(self, shortest: f64) -> Self {
        Self { shortest, ..self }
    }

    /// Takes note of the seconds of training after so many iterations of a run of a length, and of the cost of an iteration since the last call;
    /// `grows` is true if photos have another size from now on.
    pub fn iterated(&mut self, (done, length): (u32, u32), seconds: f64, cost: f64, grows: bool) {
        self.share = self.share.max(f64::from(done) / f64::from(length.max(1)));
        // No window has photos of two sizes: it is closed if it is long enough.
        let often = (length / MEASUREMENTS).max(1);
        let enough = match (self.now, grows) {
            (None, false) => FIRST,
            (Some(_), false) => often,
            (_, true) => FIRST.min(often),
        };
        let mut over = self.window.is_none();
        if let Some(window) = &mut self.window {
            // An overflow of tile intersections takes training back by an iteration or two.
            window.cost += (f64::from(done) - f64::from(window.done)) * cost;
            window.done = done;
            let window = *window;
            let (passed, took) = (done.saturating_sub(window.from), seconds - window.since);
            // Where an iteration takes seconds there is no time for so many.
            let late = self.now.is_none() && took >= self.latest;
            if passed > 0 && took >= self.shortest && (passed >= enough || late) {
                let share = 0.5 * (window.share + self.share);
                self.measure(Mean {
                    one: took.max(1e-9) / window.cost,
                    at: 0.5 * f64::from(window.from + done),
                    share,
                    beginning: f64::from(u8::from(share < BEGINNING)),
                });
                over = true;
            }
        }
        if grows {
            self.grew();
        }
        // What came before the first call, reading photos and building kernels, is no cost of iterations.
        if over || grows {
            self.window = Some(Window {
                from: done,
                share: self.share,
                since: seconds,
                done,
                cost: 0.0,
            });
        }
    }

    /// Takes in a measurement.
    fn measure(&mut self, new: Mean) {
        self.here += 1;
        // The mean with the one before: a window is short, and other programs run beside it. That of another size counts once: it is
        // less sure, and in the first window Gaussians are still as large as smaller photos left them.
        let old = match (self.now, self.elsewhere) {
            (Some(mean), Some(other)) if self.here == 2 => Some(mean.without(other)),
            (now, _) => now,
        };
        self.now = Some(old.map_or(new, |old| old.with(new)));
        self.measured += 1;
    }

    /// Has measurements begin anew with photos of another size.
    pub fn grew(&mut self) {
        (self.here, self.elsewhere) = (0, self.now);
        self.disturbed();
    }

    /// Has the present measurement begin anew: something else than iterations has taken time.
    pub fn disturbed(&mut self) {
        self.window = None;
    }

    /// Leaves so many seconds since the last call out of the present measurement.
    pub fn leave_out(&mut self, seconds: f64) {
        if let Some(window) = &mut self.window {
            window.since += seconds;
        }
    }

    /// Seconds of an iteration of cost 1 in the rest of a run of a length; `None` before the first measurement. Does not fall with the length.
    pub fn unit(&self, length: u32) -> Option<f64> {
        let (now, n) = (self.now?, f64::from(length.max(1)));
        // What is past does not come again, whatever the length becomes.
        let share = now.share.max(now.at / n);
        let length = (n.min(LONGEST) / SHORT).ln().max(0.0);
        let long = 1.0 + LONG * length * (1.0 - share / EVEN).max(0.0);
        let later = match self.first {
            First::Sparse => AFTER_SPARSE.powf(now.beginning).max(long),
            First::Random => AFTER_RANDOM.powf(now.beginning) * long,
            First::Found => long,
        };
        Some(later * now.one)
    }

    /// Number of measurements so far.
    pub fn measured(&self) -> u32 {
        self.measured
    }
}

#[cfg(test)]
mod tests {
    use super::{AFTER_RANDOM, AFTER_SPARSE, CostMeter, EVEN, First, LONG, SHORT};

    /// Iterations of a run of a length, each of cost 1 and of seconds by its number.
    fn run(meter: &mut CostMeter, [from, to]: [u32; 2], length: u32, each: impl Fn(u32) -> f64) {
        let mut seconds = 0.0;
        for done in from..=to {
            meter.iterated((done, length), seconds, 1.0, false);
            seconds += each(done);
        }
    }

    fn unit(first: First, length: u32, to: u32, each: impl Fn(u32) -> f64) -> f64 {
        let mut meter = CostMeter::new(first, 0.0, 1e9);
        run(&mut meter, [0, to], length, each);
        meter.unit(length).unwrap()
    }

    #[track_caller]
    fn same(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-3 * b, "{a} {b}");
    }

    #[test]
    fn first_gaussians_cost_otherwise_than_later_ones() {
        for (first, later) in [
            (First::Sparse, AFTER_SPARSE),
            (First::Random, AFTER_RANDOM),
            (First::Found, 1.0),
        ] {
            for at in [20, 40, 60] {
                same(unit(first, 1000, at, |_| 0.5), 0.5 * later);
            }
            // Windows with their middles at 6.8 and at 7.1 %, both of which end beyond 7.
            same(unit(first, 1100, 86, |_| 0.5), 0.5 * later);
            same(unit(first, 950, 77, |_| 0.5), 0.5 * later.sqrt());
            same(unit(first, 1000, 900, |_| 0.5), 0.5);
        }
    }

    /// In the first seventh, the more the longer the run.
    #[test]
    fn iterations_of_long_runs_cost_more_later() {
        let later = |length: u32, share: f64| {
            let to = (f64::from(length) * share) as u32;
            unit(First::Found, length, to, |_| 1.0)
        };
        for (length, share, least, most) in [
            (1500, 0.05, 0.999, 1.001),
            (7000, 0.05, 1.25, 1.45),
            (7000, 0.1, 1.1, 1.3),
            (7000, 0.2, 0.999, 1.001),
            (30_000, 0.05, 1.5, 1.8),
            (30_000, 0.1, 1.2, 1.6),
            (60_000, 0.05, 1.5, 1.8),
        ] {
            let factor = later(length, share);
            assert!(
                (least..most).contains(&factor),
                "{length} {share}: {factor}"
            );
        }
    }

    /// Costs that follow the law are known all along: nothing jumps where the first seventh ends.
    #[test]
    fn what_the_law_says_is_told_without_a_jump() {
        for length in [1500, 7000, 30_000] {
            let (n, mut seconds) = (f64::from(length), 0.0);
            let mut meter = CostMeter::new(First::Found, 0.0, 1e9);
            for done in 0..length / 2 {
                meter.iterated((done, length), seconds, 1.0, false);
                let share = f64::from(done) / n;
                if share > 0.02 {
                    let unit = meter.unit(length).unwrap();
                    assert!((unit - 1.0).abs() < 0.06, "{length} {share}: {unit}");
                }
                seconds += 1.0 / (1.0 + LONG * (n / SHORT).ln() * (1.0 - share / EVEN).max(0.0));
            }
        }
    }

    /// Lengthened tenfold after 14 and after 16 % of it.
    #[test]
    fn a_run_that_is_lengthened_or_goes_on_has_no_second_beginning() {
        for first in [First::Sparse, First::Random, First::Found] {
            for done in [140, 160] {
                let mut meter = CostMeter::new(first, 0.0, 1e9);
                run(&mut meter, [0, done], 1000, |_| 0.5);
                let before = meter.unit(1000).unwrap();
                let after = meter.unit(10_000).unwrap();
                assert!((before..1.15 * before).contains(&after), "{done}: {after}");
                let measured = meter.measured();
                meter.disturbed();
                run(&mut meter, [done, 5000], 10_000, |_| 0.5);
                assert!(meter.measured() > measured + 10);
                let after = meter.unit(10_000).unwrap();
                assert!((0.499..0.525).contains(&after), "{done}: {after}");
            }
            let mut resumed = CostMeter::new(first, 0.3, 1e9);
            run(&mut resumed, [300, 5000], 100_000, |_| 0.5);
            same(resumed.unit(100_000).unwrap(), 0.5);
        }
    }

    /// A length that is only asked about is judged by the share that iterations so far are of it.
    #[test]
    fn other_lengths_have_other_shares() {
        let mut meter = CostMeter::new(First::Found, 0.0, 1e9);
        run(&mut meter, [0, 200], 30_000, |_| 0.5);
        same(meter.unit(1500).unwrap(), 0.5);
        let units = [1000, 3000, 10_000, 30_000, 100_000].map(|n| meter.unit(n).unwrap());
        assert!(units.is_sorted(), "{units:?}");
        assert!(units[3] > 0.5 * 1.5 && units[4] < 1.1 * units[3]);
    }

    /// Photos grow after 30 iterations of a window, which are measured, and after 5, which are not: no window has photos of both sizes. The
    /// first one of a size counts half, that of the size before once.
    #[test]
    fn windows_end_where_photos_grow() {
        for (smaller, more) in [(30, 1), (5, 0)] {
            let mut meter = CostMeter::new(First::Found, 1.0, 1e9);
            run(&mut meter, [0, 100], 5000, |_| 0.5);
            meter.disturbed();
            let (mut seconds, mut units) = (0.0, Vec::new());
            for done in 0..=smaller + 300 {
                let cost = if done > smaller { 4.0 } else { 1.0 };
                meter.iterated((100 + done, 5000), seconds, cost, done == smaller);
                units.push(meter.unit(5000).unwrap());
                if done == smaller {
                    assert_eq!(meter.measured(), 1 + more);
                }
                // Smaller photos take twice the unit of larger ones.
                seconds += if done < smaller { 0.5 } else { 1.0 };
            }
            let of = |done: u32| units[done as usize];
            same(of(smaller), 0.5);
            same(of(smaller + 100), 0.25 * 2f64.sqrt());
            same(of(smaller + 200), 0.25);
        }
    }

    /// Photos of a short run grow before twenty iterations are done.
    #[test]
    fn short_runs_are_measured_before_photos_grow() {
        let mut meter = CostMeter::new(First::Found, 0.0, 1e9);
        for done in 0..=15 {
            meter.iterated((done, 300), f64::from(done), 1.0, done == 15);
        }
        same(meter.unit(300).unwrap(), 1.0);
    }

    /// A density step that takes as long as the iterations around it.
    #[test]
    fn what_is_left_out_is_no_cost_of_iterations() {
        let mut meter = CostMeter::new(First::Found, 1.0, 1e9);
        let mut seconds = 0.0;
        for done in 0..=100 {
            if done == 50 {
                seconds += 50.0;
                meter.leave_out(50.0);
            }
            meter.iterated((done, 1000), seconds, 1.0, false);
            seconds += 0.5;
        }
        same(meter.unit(1000).unwrap(), 0.5);
    }

    /// A step at the end of a window that doubles the Gaussians changes nothing of what its iterations cost.
    #[test]
    fn iterations_count_by_the_gaussians_that_they_had() {
        let mut meter = CostMeter::new(First::Found, 1.0, 1e9);
        let mut seconds = 0.0;
        for done in 0..=100 {
            let cost = if done > 18 { 2.0 } else { 1.0 };
            meter.iterated((done, 1000), seconds, cost, false);
            seconds += if done >= 18 { 1.0 } else { 0.5 };
            if done >= 20 {
                same(meter.unit(1000).unwrap(), 0.5);
            }
        }
    }
}
