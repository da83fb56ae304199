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
/// 30,000; residuals in docs/results/budgets.md.
const LONG: f64 = 0.27;
const SHORT: f64 = 1500.0;
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

/// Iterations that are measured together.
#[derive(Debug, Clone, Copy)]
struct Window {
    /// Iterations and seconds when it began.
    from: u32,
    since: f64,
    /// Iterations done at the last call, and the cost of those since it began.
    done: u32,
    cost: f64,
}

impl Window {
    fn new(done: u32, seconds: f64) -> Self {
        Self {
            from: done,
            since: seconds,
            done,
            cost: 0.0,
        }
    }
}

/// Seconds of an iteration of cost 1. They are of either clock, wall or CPU, the same in all calls.
#[derive(Debug, Clone)]
pub(super) struct CostMeter {
    first: First,
    /// Largest share of the run that was done at a call: what is past does not come again, be it that the run is lengthened.
    share: f64,
    /// Weight of the beginning in [`CostMeter::now`].
    beginning: f64,
    /// Seconds after which the first measurement is made, if fewer iterations have been done by then.
    latest: f64,
    /// Shortest time that a measurement is of, seconds.
    shortest: f64,
    /// Seconds of an iteration of cost 1 in the present phase of the run; `None` before the first measurement.
    now: Option<f64>,
    /// Iterations done at the middle of what [`CostMeter::now`] was measured in.
    at: f64,
    /// The present measurement; `None` until the next call.
    window: Option<Window>,
    /// Number of measurements, and of those with photos of the present size.
    measured: u32,
    here: u32,
    /// The last [`CostMeter::now`] of photos of another size; `None` before.
    elsewhere: Option<f64>,
}

impl CostMeter {
    /// A meter of a run of which a share is done, whose first measurement is made after `latest` seconds at the latest.
    pub fn new(first: First, share: f64, latest: f64) -> Self {
        Self {
            first,
            share,
            beginning: 0.0,
            latest,
            shortest: 0.0,
            now: None,
            at: 0.0,
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
        let enough = match self.now {
            Some(_) if !grows => (length / MEASUREMENTS).max(1),
            _ => FIRST,
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
                let middle = 0.5 * f64::from(window.from + done);
                self.measure(took.max(1e-9) / window.cost, middle);
                over = true;
            }
        }
        if grows {
            self.grew();
        }
        // What came before the first call, reading photos and building kernels, is no cost of iterations.
        if over || grows {
            self.window = Some(Window::new(done, seconds));
        }
    }

    /// Takes in the seconds of an iteration of cost 1 in a window with its middle at an iteration.
    fn measure(&mut self, one: f64, middle: f64) {
        self.here += 1;
        let begins = f64::from(u8::from(self.share < BEGINNING));
        // The geometric mean with the one before: a window is short, and other programs run beside it. That of another size counts once: it is
        // less sure, and in the first window Gaussians are still as large as smaller photos left them.
        let old = match (self.now, self.elsewhere) {
            (Some(mean), Some(other)) if self.here == 2 => Some(mean * mean / other),
            (now, _) => now,
        };
        (self.now, self.at, self.beginning) = match old {
            None => (Some(one), middle, begins),
            Some(old) => (
                Some((old * one).sqrt()),
                0.5 * (self.at + middle),
                0.5 * (self.beginning + begins),
            ),
        };
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

    /// Seconds of an iteration of cost 1 in the rest of a run of a length; `None` before the first measurement.
    pub fn unit(&self, length: u32) -> Option<f64> {
        let n = f64::from(length.max(1));
        // What is past does not come again, whatever the length becomes.
        let share = if self.share < EVEN { self.at / n } else { EVEN };
        let long = 1.0 + LONG * (n / SHORT).ln().max(0.0) * (1.0 - share / EVEN).max(0.0);
        let later = match self.first {
            First::Sparse => AFTER_SPARSE.powf(self.beginning).max(long),
            First::Random => AFTER_RANDOM.powf(self.beginning) * long,
            First::Found => long,
        };
        Some(later * self.now?)
    }

    /// Number of measurements so far.
    pub fn measured(&self) -> u32 {
        self.measured
    }
}

#[cfg(test)]
mod tests {
    use super::{AFTER_RANDOM, AFTER_SPARSE, CostMeter, First};

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
            same(unit(first, 1000, 80, |_| 0.5), 0.5 * later.sqrt());
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
        ] {
            let factor = later(length, share);
            assert!(
                (least..most).contains(&factor),
                "{length} {share}: {factor}"
            );
        }
    }

    #[test]
    fn a_run_that_is_lengthened_or_goes_on_has_no_second_beginning() {
        for first in [First::Sparse, First::Random, First::Found] {
            let mut meter = CostMeter::new(first, 0.0, 1e9);
            run(&mut meter, [0, 300], 1000, |_| 0.5);
            meter.disturbed();
            run(&mut meter, [300, 1000], 100_000, |_| 0.5);
            same(meter.unit(100_000).unwrap(), 0.5);
            let mut resumed = CostMeter::new(first, 0.3, 1e9);
            run(&mut resumed, [300, 400], 100_000, |_| 0.5);
            same(resumed.unit(100_000).unwrap(), 0.5);
        }
    }

    /// A length that is only asked about is judged by its own share.
    #[test]
    fn other_lengths_have_other_beginnings() {
        let mut meter = CostMeter::new(First::Sparse, 0.0, 1e9);
        run(&mut meter, [0, 20], 30_000, |_| 0.5);
        same(meter.unit(1000).unwrap(), 0.5 * AFTER_SPARSE);
        assert!(meter.unit(30_000).unwrap() > 0.5 * 1.5);
    }

    /// What has been done of a window counts where photos grow, and none has photos of both sizes.
    #[test]
    fn windows_end_where_photos_grow() {
        let mut meter = CostMeter::new(First::Found, 1.0, 1e9);
        run(&mut meter, [0, 100], 5000, |_| 0.5);
        let [before, measured] = [meter.unit(5000).unwrap(), f64::from(meter.measured())];
        meter.disturbed();
        let mut seconds = 0.0;
        let mut at = |done, seconds, cost: f64, grows| {
            meter.iterated((done, 5000), seconds, cost, grows);
            (meter.unit(5000).unwrap(), f64::from(meter.measured()))
        };
        for done in 100..130 {
            at(done, seconds, 1.0, false);
            seconds += 0.5;
        }
        let grown = at(130, seconds, 1.0, true);
        same(grown.0, before);
        same(grown.1, measured + 1.0);
        // The same unit with photos of four times the cost.
        for done in 130..=230 {
            same(at(done, seconds, 4.0, false).0, before);
            seconds += 2.0;
        }
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
