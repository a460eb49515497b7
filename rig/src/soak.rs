//! Soak test of the whole system: repeated rounds of swing-up, balance, push, swing-down and hold from random starts, while
//! processes are killed at random times and restarted.

mod cycles;
mod health;

pub use cycles::CycleCounts;
pub use health::{ResourceGrowth, ResourceSample};

use crate::course::SETTLE;
use crate::montecarlo::{NoStart, RandomStarts, shown_pose};
use crate::session::{Role, Session, SessionError};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use upswing_ipc::operator::{OperatorError, OperatorRequest};
use upswing_ipc::{
    Clock, ControlResponse, ManoeuvreRequest, Mode, OtherChain, PlantKind, PlantRequest, Telemetry,
};
use upswing_model::{Posture, State};

/// Time in Balance before and after the push, and time in Hold after the swing-down, s.
const BALANCE: (f64, f64) = (0.5, 2.0);
const HOLD: f64 = 0.5;
/// Approximate duration of a round, s; the time of a kill is drawn from 0 to this.
const ROUND: f64 = 7.5;
/// Impulse of the push, N s, and its duration, cycles.
const IMPULSE: f64 = 0.01;
const PUSH_CYCLES: u64 = 80;
/// Tilt up to which the rod counts as upright, deg.
const UPRIGHT_DEG: f64 = 2.0;
/// Longest wait for telemetry, and for the recovery of the system.
const PATIENCE: Duration = Duration::from_secs(30);
/// Time between two samples of memory and handles.
const HEALTH: Duration = Duration::from_secs(5);

/// A round that failed although no process was killed in it.
#[derive(Clone, Debug, Serialize)]
pub struct FailedRound {
    /// Number of the round.
    pub round: u64,
    /// Phase of the round at the failure: settle, swing-up, balance, swing-down or hold.
    pub phase: &'static str,
    /// Reason of the failure.
    pub reason: String,
}

/// A process that the soak test killed, and the recovery.
#[derive(Clone, Debug, Serialize)]
pub struct Kill {
    /// Number of the round.
    pub round: u64,
    /// Role of the process: daemon, planner or plant.
    pub role: &'static str,
    /// Phase of the round at the kill.
    pub phase: &'static str,
    /// Time until the system was ready again, s.
    pub recovered_s: f64,
}

/// Result of a soak test.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SoakOutcome {
    /// Number of rounds started.
    pub rounds: u64,
    /// Number of rounds completed: balanced after the push, swung down, and in Hold at the end.
    pub completed: u64,
    /// Kills of processes.
    pub kills: Vec<Kill>,
    /// Rounds that failed without a kill; the system recovered.
    pub losses: Vec<FailedRound>,
    /// Number of daemons shut down by SIGTERM and restarted during a recovery.
    pub orderly_restarts: u64,
    /// Counts of cycles, late cycles and missed measurements.
    #[serde(flatten)]
    pub cycles: CycleCounts,
    /// The daemon's description of the last late cycle, for each completed round with late cycles.
    pub late_causes: Vec<String>,
    /// Memory and handles of the processes over time.
    pub samples: Vec<ResourceSample>,
}

/// Cause of the early end of a round: a kill, a failure of a running system, or a broken system.
enum RoundEnd {
    Killed(Role),
    Failed(RoundFailure),
    Broken(SessionError),
}

/// Error that ends a soak test.
#[derive(Debug, thiserror::Error)]
pub enum SoakError {
    /// No random start of the round is suitable.
    #[error(transparent)]
    NoStart(#[from] NoStart),
    /// The system could not be started, recovered or shut down.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Failure of a round in a running system.
#[derive(Debug, thiserror::Error)]
enum RoundFailure {
    /// A process refused a request.
    #[error(transparent)]
    Refused(SessionError),
    /// The pendulum does not stand.
    #[error("the pendulum is {deg:.2} deg from the end of the plan after the push")]
    Tilted { deg: f64 },
    /// The telemetry has another number of joints than the model.
    #[error(transparent)]
    Chain(#[from] OtherChain),
    /// The daemon sends no telemetry.
    #[error("no telemetry for {PATIENCE:.0?}")]
    Silent,
    /// The daemon is in another mode than the expected one.
    #[error(
        "mode {} instead of {expected}: {}{}{}", status.mode_text(), status.reason,
        if status.overrun.as_str() == Ok("") { "" } else { "; last late cycle: " }, status.overrun
    )]
    Mode { expected: Mode, status: Box<ControlResponse> },
}

impl From<SessionError> for RoundEnd {
    fn from(e: SessionError) -> Self {
        match e {
            // A running system may refuse; any other error means that the system no longer runs.
            SessionError::Plant(_)
            | SessionError::Mode { .. }
            | SessionError::Operator(OperatorError::Daemon { .. } | OperatorError::Planner(_)) => {
                RoundFailure::Refused(e).into()
            }
            e => Self::Broken(e),
        }
    }
}

impl From<RoundFailure> for RoundEnd {
    fn from(e: RoundFailure) -> Self {
        Self::Failed(e)
    }
}

/// A soak test: the system, its random starts and its result so far.
pub struct Soak<'a> {
    /// The three processes under test.
    pub session: Session,
    /// Random starts of the rounds; also the source of their random numbers.
    pub starts: RandomStarts<'a>,
    /// Clock of the plant.
    pub clock: Clock,
    /// Probability that a process is killed in a round, 0 to 1.
    pub kills: f64,
    /// Result so far.
    pub record: SoakOutcome,
    begin: Instant,
    looked: Option<Instant>,
    newest: Option<Telemetry>,
    phase: &'static str,
    /// Process to kill in this round, and the time left until then, s.
    kill: Option<(Role, f64)>,
}

impl<'a> Soak<'a> {
    /// A soak test of a system that has just been started; `kills`: probability of a kill per round, 0 to 1.
    pub fn new(session: Session, starts: RandomStarts<'a>, clock: Clock, kills: f64) -> Self {
        Self {
            session,
            starts,
            clock,
            kills,
            record: SoakOutcome::default(),
            begin: Instant::now(),
            looked: None,
            newest: None,
            phase: "start",
            kill: None,
        }
    }

    /// Runs rounds until `seconds` (s) have passed or `stop` is true. `progress` is called before each round with the elapsed time, s.
    ///
    /// # Errors
    /// [`SoakError`] if a round has no start, or the system could not be recovered.
    pub fn run(&mut self, seconds: f64, stop: &AtomicBool, progress: &dyn Fn(f64)) -> Result<(), SoakError> {
        while self.begin.elapsed().as_secs_f64() < seconds && !stop.load(Ordering::Acquire) {
            progress(self.begin.elapsed().as_secs_f64());
            let round = self.record.rounds;
            self.record.rounds += 1;
            let start = self.starts.start(round)?;
            let overruns = self.session.status()?.overruns;
            let ended = self.round(round, &start, overruns);
            let (phase, begin) = (self.phase, Instant::now());
            let killed = match ended {
                Ok(()) => {
                    self.record.completed += 1;
                    None
                }
                Err(RoundEnd::Killed(role)) => Some(role.name()),
                Err(RoundEnd::Failed(failure)) => {
                    let reason = failure.to_string();
                    self.record.losses.push(FailedRound { round, phase, reason });
                    None
                }
                Err(RoundEnd::Broken(e)) => return Err(e.into()),
            };
            self.recover()?;
            if let Some(role) = killed {
                let recovered_s = begin.elapsed().as_secs_f64();
                self.record.kills.push(Kill { round, role, phase, recovered_s });
            }
        }
        Ok(())
    }

    /// The first manoeuvre of the settings from a posture; the planner refuses what has no name.
    fn from(&self, start: Posture) -> ManoeuvreRequest {
        let name = self.starts.config.first_manoeuvre(start).unwrap_or_default();
        ManoeuvreRequest::new(name, &[]).unwrap_or_default()
    }

    fn round(&mut self, round: u64, start: &State, overruns: u64) -> Result<(), RoundEnd> {
        let mut shares = self.starts.shares(round);
        let mut share = || shares.next().unwrap_or_default();
        let role = Role::ALL[((share() * 3.0) as usize).min(2)];
        self.kill = (share() < self.kills).then(|| (role, share() * ROUND));
        let angle = std::f64::consts::TAU * share();

        self.phase = "settle";
        let order = self.starts.config.model.order();
        let reset = PlantRequest::reset_state(order, start);
        self.session.plant(&reset)?;
        self.pass(SETTLE)?;
        self.session.request(OperatorRequest::Enable)?;
        self.pass(SETTLE)?;
        self.expect(Mode::Hold)?;

        self.phase = "swing-up";
        let plan = self.session.start_manoeuvre(&self.from(Posture::Hanging))?;
        self.pass(plan.t_f + BALANCE.0)?;
        self.expect(Mode::Balance)?;

        self.phase = "balance";
        let impulse = [IMPULSE * libm::cos(angle), IMPULSE * libm::sin(angle), 0.0];
        let push = PlantRequest { cycles: PUSH_CYCLES, impulse, ..PlantRequest::new(PlantKind::Push) };
        self.session.plant(&push)?;
        self.pass(BALANCE.1)?;
        self.expect(Mode::Balance)?;
        if let Some(record) = &self.newest {
            let vectors = record.vectors(order).map_err(RoundFailure::Chain)?;
            // In Balance the reference is the end of the plan.
            let deg = (vectors.x.q_u() - vectors.x_d.q_u()).amax().to_degrees();
            if !(deg <= UPRIGHT_DEG) {
                return Err(RoundFailure::Tilted { deg }.into());
            }
        }

        self.phase = "swing-down";
        let plan = self.session.start_manoeuvre(&self.from(Posture::Standing))?;
        self.pass(plan.t_f)?;
        self.phase = "hold";
        self.pass(HOLD)?;
        let status = self.expect(Mode::Hold)?;
        if status.overruns > overruns {
            self.record.late_causes.push(status.overrun.to_string());
        }
        Ok(())
    }

    /// Waits for `seconds` (s) of recorded control cycles and executes the kill of this round when it is due. A killed planner is
    /// restarted at once, and the round continues: the daemon does not need the planner meanwhile.
    fn pass(&mut self, seconds: f64) -> Result<(), RoundEnd> {
        /// Time between two checks for a kill, s.
        const SLICE: f64 = 0.05;
        let period = self.starts.config.daemon.cycle.period.seconds();
        let mut left = seconds;
        while left > 0.0 {
            let slice = left.min(SLICE);
            left -= slice;
            let before = self.record.cycles.cycles;
            let cycles = (slice / period).ceil() as u64;
            let begin = Instant::now();
            while self.record.cycles.cycles < before + cycles {
                self.look()?;
                if begin.elapsed() > PATIENCE {
                    return Err(RoundFailure::Silent.into());
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            self.kill_in(slice)?;
        }
        Ok(())
    }

    fn kill_in(&mut self, slice: f64) -> Result<(), RoundEnd> {
        let Some((role, time)) = &mut self.kill else { return Ok(()) };
        *time -= slice;
        if *time > 0.0 {
            return Ok(());
        }
        let role = *role;
        self.kill = None;
        self.session.kill(role);
        if role != Role::Planner {
            return Err(RoundEnd::Killed(role));
        }
        let begin = Instant::now();
        self.session.restart(role)?;
        let (round, role, phase) = (self.record.rounds - 1, role.name(), self.phase);
        let recovered_s = begin.elapsed().as_secs_f64();
        self.record.kills.push(Kill { round, role, phase, recovered_s });
        Ok(())
    }

    /// Collects telemetry, checks that all processes run, and samples memory and handles every [`HEALTH`].
    fn look(&mut self) -> Result<(), SessionError> {
        self.session.collect()?;
        self.session.check()?;
        let records = std::mem::take(&mut self.session.records);
        self.record.cycles.count(&records, self.clock);
        self.newest = records.last().copied().or(self.newest);
        if self.looked.is_none_or(|looked| looked.elapsed() >= HEALTH) {
            self.looked = Some(Instant::now());
            let sample = ResourceSample::take(&self.session, self.begin.elapsed().as_secs_f64());
            self.record.samples.push(sample);
        }
        Ok(())
    }

    fn expect(&mut self, mode: Mode) -> Result<ControlResponse, RoundEnd> {
        let status = self.session.status()?;
        if status.mode() == Ok(mode) {
            return Ok(status);
        }
        Err(RoundFailure::Mode { expected: mode, status: Box::new(status) }.into())
    }

    /// Brings the system to Idle with closed brakes and all processes running, ready for the next round.
    fn recover(&mut self) -> Result<(), SessionError> {
        let begin = Instant::now();
        if self.session.pid(Role::Plant).is_none() {
            self.session.restart(Role::Plant)?;
            // The daemon detects the loss of the plant and closes the brakes.
            while !self.is_braked()? && begin.elapsed() < PATIENCE {
                self.look()?;
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        if self.session.pid(Role::Daemon).is_some() && !self.is_braked()? {
            self.session.end_process(Role::Daemon)?;
            self.record.orderly_restarts += 1;
        }
        if self.session.pid(Role::Daemon).is_none() {
            self.session.restart(Role::Daemon)?;
        }
        loop {
            self.look()?;
            let status = self.session.status()?;
            match status.mode() {
                Ok(Mode::Fault) => match self.session.request(OperatorRequest::Reset) {
                    // A reset that is refused is repeated.
                    Ok(_) | Err(SessionError::Operator(OperatorError::Daemon { .. })) => {}
                    Err(e) => return Err(e),
                },
                // Ready: the brakes of the plant are closed, and a further cycle of the daemon arrives.
                Ok(Mode::Idle) if self.session.plant_status()?.brakes_closed == 1 => {
                    let before = self.record.cycles.cycles;
                    while self.record.cycles.cycles == before && begin.elapsed() < PATIENCE {
                        self.look()?;
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    if self.record.cycles.cycles > before {
                        return Ok(());
                    }
                }
                _ => {}
            }
            if begin.elapsed() > PATIENCE {
                let what = format!("the system to be ready again, mode code {}", status.mode);
                return Err(SessionError::Timeout { what, waited: begin.elapsed(), log: String::new() });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// True if the daemon is in Idle or Fault, where it commands closed brakes.
    fn is_braked(&mut self) -> Result<bool, SessionError> {
        let mode = self.session.status()?.mode();
        Ok(matches!(mode, Ok(Mode::Idle | Mode::Fault)))
    }

    /// Start pose of the first round: positions of the actuated joints, deg or m, comma-separated.
    ///
    /// # Errors
    /// [`NoStart`] if no random pose is suitable.
    pub fn first_start(starts: &RandomStarts<'_>) -> Result<String, NoStart> {
        let pose = shown_pose(&starts.config.model, &starts.start(0)?);
        Ok(pose.iter().map(f64::to_string).collect::<Vec<_>>().join(","))
    }
}
