//! The plant's side of a clock: when a cycle of the plant begins and ends, and under which command.

use super::Patience;
use crate::payload::{Clock, Command};
use crate::time::{monotonic_ns, sleep_until};
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_model::Period;

/// Longest sleep without a look at requests, ns.
const LONGEST_SLEEP_NS: u64 = 1_000_000;

/// The commands of the newest daemon.
pub trait Commands {
    /// The newest command, if it was not taken before and answers one of the measurements 1..=`newest`.
    fn take(&mut self, newest: u64) -> Option<Command>;

    /// Whether the process of the newest daemon has not ended.
    fn daemon_lives(&self) -> bool;
}

/// Why the loop of the plant is woken.
#[derive(Clone, Copy, Debug)]
pub enum PlantWake {
    /// A cycle begins: its measurement is to be published, see [`PlantPacing::publish`].
    Begin(CycleBegin),
    /// The cycle ends: the state is to move on under the command of the daemon, or none.
    End(Option<Command>),
    /// There is time for requests.
    Idle,
}

/// The beginning of a cycle of the plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleBegin {
    /// On `wall` the deadline of the cycle, CLOCK_MONOTONIC, ns: the time of its measurement even if the plant is late.
    /// `None`: the time is simulated.
    pub deadline_ns: Option<u64>,
    /// By how much the plant was too late to catch up, so that its deadlines moved, ns; 0: it was not.
    pub moved_ns: u64,
}

/// Whether a daemon answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Presence {
    /// No daemon has sent a command yet.
    Awaited,
    /// The newest daemon sends commands.
    Present,
    /// The daemon has not sent a command for so long, s, that the plant goes on without one.
    Lost {
        /// How long the plant has waited, s.
        silence: f64,
    },
}

/// Why cycles cannot be granted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GrantError {
    /// Time does not stand still on this clock.
    #[error("the {0} clock advances by itself: start the plant with --clock lockstep")]
    Unasked(Clock),
    /// A later cycle was granted before.
    #[error("cycle {granted} is granted already: expected at least that, got {got}")]
    Past {
        /// Last cycle that was granted.
        granted: u64,
        /// Cycle that was asked for.
        got: u64,
    },
}

/// How far the cycle of the plant is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CycleStage {
    /// It waits for its beginning.
    Between,
    /// Its measurement is published, with this number if it is a new one; it waits for its deadline.
    Published { shown: Option<u64> },
    /// It was due at this time, CLOCK_MONOTONIC, ns, and waits for the command that answers the measurement `shown`.
    Due { shown: u64, due_ns: u64 },
}

/// The clock of a plant.
#[derive(Debug)]
pub struct PlantPacing {
    clock: Clock,
    period: Period,
    /// On `wall`: cycles without a command after which the daemon is lost, and periods that the plant can catch up.
    watchdog_cycles: u32,
    /// Last cycle that may begin on `lockstep`.
    granted: u64,
    stage: CycleStage,
    /// Of the present stage, CLOCK_MONOTONIC, ns.
    deadline_ns: u64,
    patience: Patience,
    daemon: Presence,
    /// On `wall`: cycles since the newest command.
    silent_cycles: u32,
}

impl PlantPacing {
    /// A clock that begins now. `watchdog_cycles`: cycles without a command after which the drives close the brakes.
    pub fn new(clock: Clock, period: Period, watchdog_cycles: u32) -> Self {
        let now = monotonic_ns();
        Self {
            clock,
            period,
            watchdog_cycles,
            granted: 0,
            stage: CycleStage::Between,
            deadline_ns: now,
            patience: Patience::since(now),
            daemon: Presence::Awaited,
            silent_cycles: 0,
        }
    }

    /// Which clock this is.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Whether a daemon answers.
    pub fn daemon(&self) -> Presence {
        self.daemon
    }

    /// Whether the measurement of the present cycle is published.
    pub fn is_published(&self) -> bool {
        self.stage != CycleStage::Between
    }

    /// On `lockstep`: the plant may advance to the end of cycle `seq`.
    ///
    /// # Errors
    /// [`GrantError`] if another clock runs, or a later cycle was granted before.
    pub fn grant(&mut self, seq: u64) -> Result<(), GrantError> {
        if !self.clock.stands_still() {
            return Err(GrantError::Unasked(self.clock));
        }
        if seq < self.granted {
            return Err(GrantError::Past { granted: self.granted, got: seq });
        }
        self.granted = seq;
        Ok(())
    }

    /// The measurement of the cycle that has begun is published; `shown` is its number if the daemon finds something new.
    pub fn publish(&mut self, shown: Option<u64>) {
        self.stage = CycleStage::Published { shown };
        if self.clock.is_paced() {
            self.deadline_ns = self.deadline_ns.saturating_add(self.period.nanos());
        }
    }

    /// Waits until there is something to do; `None` once `shutdown` is raised. `seq`: number of the present cycle.
    pub fn wait(
        &mut self,
        commands: &mut impl Commands,
        seq: u64,
        shutdown: &AtomicBool,
    ) -> Option<PlantWake> {
        loop {
            if shutdown.load(Ordering::Acquire) {
                return None;
            }
            let wake = match self.stage {
                CycleStage::Between => self.begin(commands, seq),
                CycleStage::Published { shown } => self.pace(commands, seq, shown),
                CycleStage::Due { shown, due_ns } => self.answered(commands, seq, shown, due_ns),
            };
            if wake.is_some() {
                return wake;
            }
        }
    }

    /// Waits for the beginning of a cycle: the deadline of `wall`, the grant of `lockstep`.
    fn begin(&mut self, commands: &mut impl Commands, seq: u64) -> Option<PlantWake> {
        let mut begin = CycleBegin { deadline_ns: None, moved_ns: 0 };
        if self.clock.is_real_time() {
            if !self.sleep_to_deadline() {
                return Some(PlantWake::Idle);
            }
            let now = monotonic_ns();
            let behind = now.saturating_sub(self.deadline_ns);
            // Less than the watchdog's time the plant catches up.
            if behind > self.period.nanos_of(self.watchdog_cycles.into()) {
                (self.deadline_ns, begin.moved_ns) = (now, behind);
            }
            begin.deadline_ns = Some(self.deadline_ns);
            return Some(PlantWake::Begin(begin));
        }
        let completed = seq.saturating_sub(1);
        if self.clock.stands_still() && completed >= self.granted {
            return self.nap();
        }
        // A daemon that was not there a cycle ago: this cycle waits for it.
        if self.daemon != Presence::Present && commands.take(completed).is_some() {
            self.daemon = Presence::Present;
        }
        Some(PlantWake::Begin(begin))
    }

    /// Waits for the deadline of a cycle on `paced`.
    fn pace(&mut self, commands: &mut impl Commands, seq: u64, shown: Option<u64>) -> Option<PlantWake> {
        if self.clock.is_real_time() {
            return Some(PlantWake::End(self.newest(commands, seq)));
        }
        // The answer comes meanwhile: to wait for it costs one sleep.
        if self.clock.is_paced() && !self.sleep_to_deadline() {
            return Some(PlantWake::Idle);
        }
        let now = monotonic_ns();
        // The plant does not make up for what it was late itself.
        self.deadline_ns = self.deadline_ns.max(now.saturating_sub(self.period.nanos()));
        let waits = match self.daemon {
            Presence::Present => true,
            Presence::Awaited => self.clock.stands_still(),
            Presence::Lost { .. } => false,
        };
        match shown {
            Some(shown) if waits => {
                self.stage = CycleStage::Due { shown, due_ns: now };
                self.patience = Patience::since(now);
                None
            }
            _ => Some(self.end(commands, seq, shown, now, None)),
        }
    }

    /// Waits for the command that answers the measurement `shown`.
    fn answered(
        &mut self,
        commands: &mut impl Commands,
        seq: u64,
        shown: u64,
        due_ns: u64,
    ) -> Option<PlantWake> {
        if let Some(command) = commands.take(seq) {
            if self.daemon != Presence::Present {
                self.daemon = Presence::Present;
                self.patience = Patience::since(monotonic_ns());
            }
            if command.measurement_seq == shown {
                return Some(self.end(commands, seq, Some(shown), due_ns, Some(command)));
            }
        }
        if self.daemon == Presence::Present && self.patience.is_over(commands.daemon_lives()) {
            self.daemon = Presence::Lost { silence: self.patience.waited_ns as f64 * 1e-9 };
            return Some(self.end(commands, seq, Some(shown), due_ns, None));
        }
        self.nap()
    }

    /// Ends a cycle that was due at `due_ns`.
    fn end(
        &mut self,
        commands: &mut impl Commands,
        seq: u64,
        shown: Option<u64>,
        due_ns: u64,
        mut answer: Option<Command>,
    ) -> PlantWake {
        let now = monotonic_ns();
        // A late answer moves all later deadlines.
        self.deadline_ns = self.deadline_ns.saturating_add(now.saturating_sub(due_ns));
        if self.daemon != Presence::Present
            && let Some(command) = commands.take(seq)
        {
            self.daemon = Presence::Present;
            answer = Some(command).filter(|command| Some(command.measurement_seq) == shown);
        }
        self.patience = Patience::since(now);
        self.stage = CycleStage::Between;
        PlantWake::End(answer)
    }

    /// Ends a cycle on `wall`: the newest command, if it is a new one.
    fn newest(&mut self, commands: &mut impl Commands, seq: u64) -> Option<Command> {
        let command = commands.take(seq);
        self.silent_cycles = if command.is_some() { 0 } else { self.silent_cycles.saturating_add(1) };
        if command.is_some() {
            self.daemon = Presence::Present;
        } else if self.daemon == Presence::Present && self.silent_cycles >= self.watchdog_cycles {
            self.daemon = Presence::Lost { silence: self.period.seconds_of(self.silent_cycles.into()) };
        }
        self.deadline_ns = self.deadline_ns.saturating_add(self.period.nanos());
        self.stage = CycleStage::Between;
        command
    }

    /// Sleeps until the deadline, but no longer than requests can wait: whether the deadline is reached.
    fn sleep_to_deadline(&self) -> bool {
        let now = monotonic_ns();
        if now >= self.deadline_ns {
            return true;
        }
        let next_look = now.saturating_add(LONGEST_SLEEP_NS);
        sleep_until(self.deadline_ns.min(next_look));
        self.deadline_ns <= next_look
    }

    /// Pauses until the next look at the other processes; `None`: it comes at once.
    fn nap(&mut self) -> Option<PlantWake> {
        let now = monotonic_ns();
        self.patience.look(now);
        match self.patience.nap_ns(Some(self.clock), self.period) {
            0 => {
                std::hint::spin_loop();
                None
            }
            nap => {
                sleep_until(now + nap);
                Some(PlantWake::Idle)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Commands, GrantError, PlantPacing, PlantWake, Presence};
    use crate::payload::{Clock, Command};
    use std::sync::atomic::AtomicBool;
    use upswing_model::Period;

    /// A daemon that lives, and its newest command.
    #[derive(Default)]
    struct Daemon(Option<Command>);

    impl Daemon {
        fn answer(&mut self, measurement_seq: u64) {
            self.0 = Some(Command { measurement_seq, ..Command::default() });
        }
    }

    impl Commands for Daemon {
        fn take(&mut self, newest: u64) -> Option<Command> {
            self.0.take().filter(|command| (1..=newest).contains(&command.measurement_seq))
        }

        fn daemon_lives(&self) -> bool {
            true
        }
    }

    struct Plant {
        pacing: PlantPacing,
        daemon: Daemon,
        seq: u64,
    }

    impl Plant {
        fn on(clock: Clock) -> Self {
            let pacing = PlantPacing::new(clock, Period::from_micros(125), 20);
            Self { pacing, daemon: Daemon::default(), seq: 1 }
        }

        /// What it wakes up for: `begin`, `end` with the number that the command answers, `idle`.
        fn wake(&mut self) -> (&'static str, u64) {
            match self.pacing.wait(&mut self.daemon, self.seq, &AtomicBool::new(false)) {
                Some(PlantWake::Begin(_)) => {
                    self.pacing.publish(Some(self.seq));
                    ("begin", 0)
                }
                Some(PlantWake::End(command)) => {
                    self.seq += 1;
                    ("end", command.map_or(0, |command| command.measurement_seq))
                }
                Some(PlantWake::Idle) => ("idle", 0),
                None => ("shutdown", 0),
            }
        }

        /// The same, without what is idle.
        fn work(&mut self) -> (&'static str, u64) {
            loop {
                match self.wake() {
                    ("idle", _) => {}
                    work => return work,
                }
            }
        }
    }

    #[test]
    fn lockstep_waits_for_a_grant_and_then_for_the_answer() {
        let mut plant = Plant::on(Clock::Lockstep);
        assert!((0..100).all(|_| plant.wake() == ("idle", 0)));
        assert_eq!(plant.pacing.grant(2), Ok(()));
        for seq in 1..=2 {
            assert_eq!(plant.work(), ("begin", 0));
            assert!((0..100).all(|_| plant.wake() == ("idle", 0)), "also for a daemon that was never there");
            plant.daemon.answer(seq - 1);
            assert_eq!(plant.wake(), ("idle", 0), "an answer to an earlier measurement");
            plant.daemon.answer(seq);
            assert_eq!(plant.work(), ("end", seq));
        }
        assert_eq!(plant.wake(), ("idle", 0));
        assert_eq!(plant.pacing.grant(1), Err(GrantError::Past { granted: 2, got: 1 }));
    }

    #[test]
    fn a_first_daemon_is_not_lost_however_long_it_took_to_come() {
        let mut plant = Plant::on(Clock::Lockstep);
        plant.seq = 2;
        assert_eq!(plant.pacing.grant(2), Ok(()));
        assert_eq!(plant.work(), ("begin", 0));
        assert_eq!(plant.wake(), ("idle", 0));
        plant.pacing.patience.waited_ns = 3_600_000_000_000;
        // It has only seen an earlier measurement.
        plant.daemon.answer(1);
        assert_eq!(plant.wake(), ("idle", 0));
        assert_eq!(plant.pacing.daemon(), Presence::Present);
        plant.daemon.answer(2);
        assert_eq!(plant.work(), ("end", 2));
    }

    #[test]
    fn paced_keeps_its_period_and_waits_for_a_daemon_that_has_answered() {
        let mut plant = Plant::on(Clock::Paced);
        assert_eq!(plant.pacing.grant(1), Err(GrantError::Unasked(Clock::Paced)));
        // Without a daemon time passes.
        for _ in 0..3 {
            assert_eq!([plant.work(), plant.work()], [("begin", 0), ("end", 0)]);
        }
        let begin = plant.pacing.deadline_ns;
        for _ in 0..8 {
            assert_eq!(plant.work(), ("begin", 0));
            plant.daemon.answer(plant.seq);
            assert_eq!(plant.work(), ("end", plant.seq - 1));
        }
        assert_eq!(plant.pacing.daemon(), Presence::Present);
        assert!(plant.pacing.deadline_ns - begin >= 8 * 125_000, "eight periods");
        assert_eq!(plant.work(), ("begin", 0));
        assert!((0..100).all(|_| plant.wake() == ("idle", 0)), "the daemon is late");
        let late = plant.pacing.deadline_ns;
        plant.daemon.answer(plant.seq);
        assert_eq!(plant.work(), ("end", plant.seq - 1));
        assert!(plant.pacing.deadline_ns > late, "and moves the later deadlines");
    }

    #[test]
    fn wall_takes_what_is_there_and_loses_a_silent_daemon() {
        let mut plant = Plant::on(Clock::Wall);
        let begin = plant.pacing.deadline_ns;
        assert_eq!([plant.work(), plant.work()], [("begin", 0), ("end", 0)]);
        assert_eq!(plant.work(), ("begin", 0));
        plant.daemon.answer(1);
        assert_eq!(plant.work(), ("end", 1));
        for silent in 1..=20 {
            assert_eq!(plant.pacing.daemon(), Presence::Present, "{silent}");
            assert_eq!([plant.work(), plant.work()], [("begin", 0), ("end", 0)]);
        }
        assert_eq!(plant.pacing.daemon(), Presence::Lost { silence: 20.0 * 125e-6 });
        assert!(plant.pacing.deadline_ns - begin >= 22 * 125_000);
    }

    #[test]
    fn a_plant_on_wall_that_is_too_late_moves_its_deadlines() {
        let mut plant = Plant::on(Clock::Wall);
        // Twenty periods, which it could still make up for, and more.
        plant.pacing.deadline_ns -= 1_000_000_000;
        let begin = match plant.pacing.wait(&mut plant.daemon, 1, &AtomicBool::new(false)) {
            Some(PlantWake::Begin(begin)) => begin,
            other => panic!("{other:?}"),
        };
        assert!(begin.moved_ns >= 1_000_000_000 && begin.deadline_ns == Some(plant.pacing.deadline_ns));
    }
}
