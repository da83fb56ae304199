//! [`threads`]: ranks that are threads of one process.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::base::error::{Error, Result};
use crate::ranks::exchange::{Exchange, Meter, Part, check_number, nothing_begun};

/// Messages on their way between threads.
#[derive(Debug)]
struct Hub {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    /// Messages from each rank to each, the oldest first.
    queues: Vec<Vec<VecDeque<Vec<u32>>>>,
    /// The first rank that has failed, and why.
    failed: Option<(usize, String)>,
}

/// One thread's end of a [`Hub`].
#[derive(Debug)]
struct Thread {
    rank: usize,
    ranks: usize,
    hub: Arc<Hub>,
    meter: Meter,
    /// Kinds of the messages that have not been waited for, the oldest first.
    begun: Mutex<VecDeque<Part>>,
}

/// An exchange for each of so many threads.
#[must_use]
pub fn threads(ranks: usize) -> Vec<Arc<dyn Exchange>> {
    let hub = Arc::new(Hub {
        state: Mutex::new(State {
            queues: vec![vec![VecDeque::new(); ranks]; ranks],
            failed: None,
        }),
        changed: Condvar::new(),
    });
    let end = |rank| {
        Arc::new(Thread {
            rank,
            ranks,
            hub: hub.clone(),
            meter: Meter::default(),
            begun: Mutex::default(),
        }) as Arc<dyn Exchange>
    };
    (0..ranks).map(end).collect()
}

impl Hub {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// The oldest message from each rank to one; `None` while any is missing.
    fn take(&mut self, rank: usize) -> Option<Vec<Vec<u32>>> {
        let there = self.queues.iter().all(|from| !from[rank].is_empty());
        let queues = there.then_some(&mut self.queues)?;
        queues
            .iter_mut()
            .map(|from| from[rank].pop_front())
            .collect()
    }
}

impl Exchange for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.ranks
    }

    fn apart(&self) -> bool {
        false
    }

    fn begin(&self, part: Part, messages: Vec<Vec<u32>>) -> Result<()> {
        check_number(&messages, self.ranks)?;
        self.meter.send(self.rank, part, &messages);
        let mut begun = self.begun.lock().unwrap_or_else(PoisonError::into_inner);
        begun.push_back(part);
        let mut state = self.hub.state();
        for (queue, message) in state.queues[self.rank].iter_mut().zip(messages) {
            queue.push_back(message);
        }
        self.hub.changed.notify_all();
        Ok(())
    }

    fn wait(&self) -> Result<Vec<Vec<u32>>> {
        let mut begun = self.begun.lock().unwrap_or_else(PoisonError::into_inner);
        let part = begun.pop_front().ok_or_else(nothing_begun)?;
        let since = Instant::now();
        let mut state = self.hub.state();
        loop {
            if let Some(got) = state.take(self.rank) {
                self.meter.wait(part, since);
                return Ok(got);
            }
            if let Some((rank, why)) = &state.failed {
                return Err(Error::numerics(format!("rank {rank}"), why.clone()));
            }
            state = self
                .hub
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn meter(&self) -> &Meter {
        &self.meter
    }

    fn fail(&self, why: &str) {
        let mut state = self.hub.state();
        state.failed.get_or_insert((self.rank, why.to_owned()));
        self.hub.changed.notify_all();
    }

    fn end(&self) {}
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::threads;
    use crate::ranks::exchange::{Exchange, Part};

    #[test]
    fn every_rank_gets_what_each_has_sent_to_it() {
        let ends = threads(3);
        let trade = |end: &dyn Exchange, round: u32| {
            let from = end.rank() as u32;
            let sent = (0..3).map(|to| vec![round; (10 * from + to) as usize]);
            let got = end.trade(Part::Records, sent.collect()).unwrap();
            for (rank, message) in got.iter().enumerate() {
                assert_eq!(message.len(), 10 * rank + from as usize);
                assert!(message.iter().all(|v| *v == round));
            }
        };
        thread::scope(|scope| {
            for end in &ends {
                scope.spawn(move || (0..20).for_each(|round| trade(end.as_ref(), round)));
            }
        });
        // To itself it sends nothing.
        let records = ends[1].meter().sent()[Part::Records as usize];
        assert_eq!(records, 20 * 4 * (10 + 12));
    }

    #[test]
    fn messages_that_are_on_their_way_come_in_their_order() {
        let ends = threads(2);
        assert!(ends[0].wait().is_err(), "nothing has begun");
        for word in [1, 2] {
            ends[0]
                .begin(Part::Records, vec![vec![word], vec![10 * word]])
                .unwrap();
        }
        for word in [3, 4] {
            ends[1]
                .begin(Part::Records, vec![vec![10 * word], vec![word]])
                .unwrap();
        }
        assert_eq!(ends[0].wait().unwrap(), [[1], [30]]);
        assert_eq!(ends[0].wait().unwrap(), [[2], [40]]);
        assert_eq!(ends[1].wait().unwrap(), [[10], [3]]);
        let waited = ends[1].meter().waited();
        assert!(waited[Part::Records as usize] > 0.0 && waited[Part::Sums as usize] == 0.0);
    }

    #[test]
    fn a_rank_that_fails_ends_the_others() {
        let ends = threads(2);
        ends[1].fail("no memory");
        let said = ends[0]
            .trade(Part::Sums, vec![vec![1], vec![2]])
            .unwrap_err();
        assert_eq!(said.to_string(), "rank 1: no memory");
        assert!(ends[0].trade(Part::Sums, vec![vec![1]]).is_err());
    }
}
