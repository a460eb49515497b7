//! The steps of a manoeuvre: hold the arm, plan from the present state, wait until the plan is loaded and due, start the plan, monitor
//! the modes. Three processes ([`SessionCourse`]) and the closed loop in one process take the same steps.

use crate::session::{NEVER, Session, SessionError};
use std::sync::atomic::{AtomicBool, Ordering};
use upswing_config::{Config, GridAxis};
use upswing_ipc::{ManoeuvreRequest, Mode, PlannerResponse};

/// Time in which the arm settles in Hold before the plan is made, s.
pub const SETTLE: f64 = 0.25;
/// Time between two checks of the mode, s.
const LOOK: f64 = 0.1;

/// A system of controller and plant that executes the steps of a manoeuvre.
pub trait Course {
    /// Error of a step: a refusal, an unexpected mode, or a system that does not respond.
    type Error;

    /// Lets `cycles` control cycles pass.
    ///
    /// # Errors
    /// [`Self::Error`] if time does not pass.
    fn advance(&mut self, cycles: u64) -> Result<(), Self::Error>;

    /// Enables the daemon and lets `cycles` control cycles pass, in which the arm settles in Hold.
    ///
    /// # Errors
    /// [`Self::Error`] if the daemon refuses, or does not stay in Hold.
    fn hold(&mut self, cycles: u64) -> Result<(), Self::Error>;

    /// Plans a manoeuvre from the present state, waits until the plan is loaded and due, and starts the plan.
    ///
    /// # Errors
    /// [`Self::Error`] if planner or daemon refuse.
    fn start(&mut self, manoeuvre: &ManoeuvreRequest) -> Result<PlannerResponse, Self::Error>;

    /// Lets `cycles` control cycles pass after the start of the plan and monitors the mode.
    ///
    /// # Errors
    /// [`Self::Error`] if the daemon leaves the modes of the manoeuvre (Hold, Track, Balance).
    fn watch(&mut self, cycles: u64) -> Result<(), Self::Error>;
}

/// The manoeuvre of a demonstration: the first one of the settings, to the last values of its database if the request has to give some.
pub fn first_manoeuvre(config: &Config) -> ManoeuvreRequest {
    let request = config.manoeuvres.first().map(|first| {
        let given: Vec<f64> = first.given().map(|axis: &GridAxis| axis.to).collect();
        ManoeuvreRequest::new(&first.name, &given)
    });
    // The planner refuses what has no name, and names what there is.
    request.and_then(Result::ok).unwrap_or_default()
}

/// Enables the daemon, lets the arm settle in Hold, executes a manoeuvre and stays at its end for `seconds` (s). `period`: control
/// period, s.
///
/// # Errors
/// [`Course::Error`]
pub fn execute_from_idle<C: Course>(
    course: &mut C,
    manoeuvre: &ManoeuvreRequest,
    period: f64,
    seconds: f64,
) -> Result<PlannerResponse, C::Error> {
    // A daemon without a measurement refuses to be enabled.
    course.advance(1)?;
    course.hold(cycles(SETTLE, period))?;
    execute(course, manoeuvre, period, seconds)
}

/// Plans a manoeuvre from the present state, starts the plan, and lets its duration t_F plus `seconds` (s) pass. `period`: control
/// period, s.
///
/// # Errors
/// [`Course::Error`]
pub fn execute<C: Course>(
    course: &mut C,
    manoeuvre: &ManoeuvreRequest,
    period: f64,
    seconds: f64,
) -> Result<PlannerResponse, C::Error> {
    let plan = course.start(manoeuvre)?;
    course.watch(cycles(plan.t_f + seconds, period))?;
    Ok(plan)
}

fn cycles(seconds: f64, period: f64) -> u64 {
    (seconds / period).ceil() as u64
}

/// A manoeuvre of three processes: daemon, planner and plant.
pub struct SessionCourse<'a> {
    /// The three processes.
    pub session: &'a mut Session,
    /// Control period, s.
    pub period: f64,
    /// Set to true to end the wait with [`SessionError::Interrupted`].
    pub interrupted: &'a AtomicBool,
    /// Called with the time since the start of the plan and the total time, s.
    pub progress: &'a dyn Fn(f64, f64),
}

impl<'a> SessionCourse<'a> {
    /// A manoeuvre without interruption and without progress reports; `period`: control period, s.
    pub fn new(session: &'a mut Session, period: f64) -> Self {
        Self { session, period, interrupted: &NEVER, progress: &|_, _| () }
    }

    fn expect_mode(&self, modes: &[Mode]) -> Result<(), SessionError> {
        let Some(last) = self.session.records.last() else { return Ok(()) };
        match last.mode() {
            Ok(mode) if modes.contains(&mode) => Ok(()),
            _ => Err(SessionError::Mode { mode: last.mode_text(), fault: upswingd::fault_text(last.fault) }),
        }
    }
}

impl Course for SessionCourse<'_> {
    type Error = SessionError;

    fn advance(&mut self, cycles: u64) -> Result<(), SessionError> {
        self.session.advance(cycles)
    }

    fn hold(&mut self, cycles: u64) -> Result<(), SessionError> {
        self.session.enable(self.interrupted)?;
        self.session.advance(cycles)?;
        self.expect_mode(&[Mode::Hold])
    }

    fn start(&mut self, manoeuvre: &ManoeuvreRequest) -> Result<PlannerResponse, SessionError> {
        self.session.start_manoeuvre(manoeuvre)
    }

    /// Waits in portions of 0.1 s, so that an interrupt or a fault ends the wait; a real-time plant runs on between them.
    fn watch(&mut self, total: u64) -> Result<(), SessionError> {
        let begin = self.session.now()?;
        let mut passed = 0;
        while passed < total {
            if self.interrupted.load(Ordering::Acquire) {
                return Err(SessionError::Interrupted);
            }
            self.session.advance_to(begin + total.min(passed + cycles(LOOK, self.period)))?;
            self.expect_mode(&[Mode::Hold, Mode::Track, Mode::Balance])?;
            passed = total.min(self.session.now()?.saturating_sub(begin));
            (self.progress)(passed as f64 * self.period, total as f64 * self.period);
        }
        Ok(())
    }
}
