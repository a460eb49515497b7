//! Supervisor of the controller: requests, trips, and the data that change with the mode.

use super::Controller;
use crate::arm::ArmReference;
use crate::modes::{ActiveMode, LoadedPlan, RunningPlan};
use crate::step::{DroppedPlan, StepRequest};
use crate::supervisor::{ModeEvent, RequestRefusal, transition};
use crate::trip::{Trip, TripCause};
use upswing_config::PlanWhileTracking;
use upswing_trajectory::Plan;

impl Controller {
    /// Returns the reason for which an enable would be refused now.
    pub(super) fn unready(&self) -> Option<RequestRefusal> {
        if !matches!(self.mode, ActiveMode::Idle) {
            return None;
        }
        let unfit = self.observer.unfit.map(RequestRefusal::Unfit);
        unfit.or((!self.observer.drives_ready).then_some(RequestRefusal::DrivesNotReady))
    }

    /// Performs a request, unless it is refused; a refused request changes nothing.
    pub(super) fn obey(&mut self, request: StepRequest) -> Result<(), RequestRefusal> {
        if let Some(event) = request.event() {
            if self.shutting_down && event != ModeEvent::Shutdown {
                return Err(RequestRefusal::ShuttingDown);
            }
            transition(self.mode(), event)?;
        }
        match request {
            StepRequest::Load(plan) => self.load(plan)?,
            StepRequest::Start(id) => self.start(id)?,
            StepRequest::Enable => {
                self.unready().map_or(Ok(()), Err)?;
                self.trip = None;
                self.enter(ModeEvent::Enable, ActiveMode::Hold(ArmReference::at_rest(&self.observer.x)));
            }
            StepRequest::Hold => {
                self.enter(ModeEvent::Hold, ActiveMode::Hold(ArmReference::at_rest(&self.observer.x)))
            }
            StepRequest::Stop => self.decelerate(ModeEvent::Stop),
            StepRequest::Reset => {
                self.trip = None;
                self.enter(ModeEvent::Reset, ActiveMode::Idle);
            }
            StepRequest::Shutdown => {
                self.shutting_down = true;
                if !self.mode.is_braked() {
                    self.decelerate(ModeEvent::Shutdown);
                }
            }
        }
        Ok(())
    }

    /// Loads a plan for the next start, in place of an earlier one; one that replaces the running plan waits for its activation.
    fn load(&mut self, plan: Box<Plan>) -> Result<(), RequestRefusal> {
        if let Some(replaced) = plan.replaces {
            return self.await_activation(plan, replaced);
        }
        if matches!(self.mode, ActiveMode::Track(_)) && self.while_tracking == PlanWhileTracking::Refuse {
            self.retire(plan);
            return Err(RequestRefusal::Tracking { running: self.mode.plan_id() });
        }
        if let Some(replaced) = self.loaded.replace(LoadedPlan { plan, since_ns: self.now_ns }) {
            self.retire(replaced.plan);
        }
        Ok(())
    }

    /// Keeps a plan that replaces the running one, of the id `replaced`, for its activation, in place of an earlier one.
    fn await_activation(&mut self, plan: Box<Plan>, replaced: u64) -> Result<(), RequestRefusal> {
        let running = if matches!(self.mode, ActiveMode::Track(_)) { self.mode.plan_id() } else { 0 };
        let activation_ns = plan.activation_ns.unwrap_or(0);
        let refusal = if running != replaced {
            RequestRefusal::NotRunning { replaced, running }
        } else if activation_ns < self.now_ns {
            RequestRefusal::AfterActivation { late: (self.now_ns - activation_ns) as f64 * 1e-9 }
        } else {
            if let Some(before) = self.replacement.replace(plan) {
                self.retire(before);
            }
            return Ok(());
        };
        self.retire(plan);
        Err(refusal)
    }

    /// Track, in the first cycle at or after the activation of a plan that waits: it replaces the running plan, whose torques blend into its
    /// own, if the measured state is close to its own. Otherwise it is dropped and the running plan goes on.
    pub(super) fn replace_plan(&mut self) {
        let ActiveMode::Track(running) = &self.mode else {
            if let Some(plan) = self.replacement.take() {
                self.retire(plan);
            }
            return;
        };
        let due = |plan: &mut Box<Plan>| plan.activation_ns.is_some_and(|ns| ns <= self.now_ns);
        let Some(plan) = self.replacement.take_if(due) else { return };
        let start_ns = plan.activation_ns.unwrap_or(self.now_ns);
        if let Err(reason) = self.check_replacement(&plan, running, start_ns) {
            self.dropped = Some(DroppedPlan { id: plan.id, reason });
            return self.retire(plan);
        }
        let posture = self.model.posture_with(&plan.end().x.q(), &mut self.work, &mut self.derivatives);
        let loaded = LoadedPlan { plan, since_ns: self.now_ns };
        let next = ActiveMode::Track(RunningPlan::new(loaded, start_ns, posture));
        if let ActiveMode::Track(replaced) = std::mem::replace(&mut self.mode, next) {
            self.retire(replaced.loaded.plan);
        }
        self.blend_cycles = self.checks.torque_steps();
    }

    /// Checks that a plan with t = 0 at the time `start_ns` may replace the `running` plan now.
    fn check_replacement(
        &self,
        plan: &Plan,
        running: &RunningPlan,
        start_ns: u64,
    ) -> Result<(), RequestRefusal> {
        let (replaced, running_id) = (plan.replaces.unwrap_or(0), running.loaded.plan.id);
        if replaced != running_id {
            return Err(RequestRefusal::NotRunning { replaced, running: running_id });
        }
        // The estimated velocities lag behind those of the plan by what the motion gains within the lag.
        let t_plan = (self.now_ns - start_ns) as f64 * 1e-9;
        let mut expected = plan.reference(t_plan).x;
        let gained = running.derivative(self.now_ns).qd() * self.velocity_lag;
        expected.qd_mut().iter_mut().zip(gained.iter()).for_each(|(v, gained)| *v -= gained);
        self.checks.start(&self.observer.x, &expected, t_plan)
    }

    /// Starts the loaded plan if it has this id; a plan that cannot be started stays loaded.
    fn start(&mut self, id: u64) -> Result<(), RequestRefusal> {
        let loaded = self.loaded.take().ok_or(RequestRefusal::NoPlan)?;
        match self.check_start(&loaded, id) {
            Ok(start_ns) => {
                self.trip = None;
                let end = loaded.plan.end().x.q();
                let posture = self.model.posture_with(&end, &mut self.work, &mut self.derivatives);
                let running = RunningPlan::new(loaded, start_ns, posture);
                self.enter(ModeEvent::Start, ActiveMode::Track(running));
                Ok(())
            }
            Err(refusal) => {
                self.loaded = Some(loaded);
                Err(refusal)
            }
        }
    }

    /// Checks that the loaded plan has this id and can be started now; returns the time of its t = 0, ns.
    fn check_start(&mut self, loaded: &LoadedPlan, id: u64) -> Result<u64, RequestRefusal> {
        if loaded.plan.id != id {
            return Err(RequestRefusal::OtherPlan { asked: id, loaded: loaded.plan.id });
        }
        let start_ns = self.start_time(loaded)?;
        self.checks.plan_age(loaded.age(self.now_ns))?;
        Ok(start_ns)
    }

    /// Warns of an old loaded plan if it could be started now, apart from its age.
    pub(super) fn warn_of_plan_age(&mut self) {
        if let Some(loaded) = &self.loaded
            && self.checks.is_plan_old(loaded.age(self.now_ns))
            && transition(self.mode(), ModeEvent::Start).is_ok()
            && self.start_time(loaded).is_ok()
        {
            self.checks.warn(TripCause::PlanAge);
        }
    }

    /// Returns the time of t = 0 (ns) of a loaded plan if it is started now: its activation, otherwise the current time.
    fn start_time(&self, loaded: &LoadedPlan) -> Result<u64, RequestRefusal> {
        let start_ns = loaded.plan.activation_ns.unwrap_or(self.now_ns);
        if start_ns > self.now_ns {
            return Err(RequestRefusal::BeforeActivation { wait: (start_ns - self.now_ns) as f64 * 1e-9 });
        }
        let t_plan = (self.now_ns - start_ns) as f64 * 1e-9;
        self.checks.start(&self.observer.x, &loaded.plan.reference(t_plan).x, t_plan)?;
        Ok(start_ns)
    }

    /// Trips to Fault if the table of modes has that transition. In Fault the first trip is kept.
    pub(super) fn trip_to_fault(&mut self, trip: Trip) {
        if transition(self.mode(), ModeEvent::TripToFault).is_ok() {
            self.trip = Some(trip);
            self.enter(ModeEvent::TripToFault, ActiveMode::Fault);
        }
    }

    /// Trips to Stop if the table of modes has that transition.
    pub(super) fn trip_to_stop(&mut self, trip: Trip) {
        if transition(self.mode(), ModeEvent::TripToStop).is_ok() {
            self.trip = Some(trip);
            self.decelerate(ModeEvent::TripToStop);
        }
    }

    /// Enters Stop; an arm that already decelerates continues to do so.
    fn decelerate(&mut self, event: ModeEvent) {
        let reference = match &self.mode {
            ActiveMode::Stop(reference) => *reference,
            _ => ArmReference::moving(&self.observer.x),
        };
        self.enter(event, ActiveMode::Stop(reference));
    }

    /// Changes the mode to `next`, the mode of the table of modes for `event`. A running plan becomes the loaded plan again, unless a
    /// newer one is loaded or it has replaced another one: such a plan begins in the middle of a motion.
    pub(super) fn enter(&mut self, event: ModeEvent, next: ActiveMode) {
        // Not in release builds, whose real-time path cannot panic; the tests of the table watch the modes from outside.
        debug_assert_eq!(transition(self.mode(), event), Ok(next.mode()));
        let is_start = matches!(next, ActiveMode::Track(_));
        match std::mem::replace(&mut self.mode, next) {
            ActiveMode::Track(plan) | ActiveMode::Balance(plan) => {
                if is_start || self.loaded.is_some() || plan.loaded.plan.replaces.is_some() {
                    self.retire(plan.loaded.plan);
                } else {
                    self.loaded = Some(plan.loaded);
                }
            }
            _ => {}
        }
        self.blend_cycles = self.checks.torque_steps();
        if is_start {
            // The standstill of a joint in Hold does not count for a motion that only begins.
            self.standstill.reset();
        }
    }

    /// Returns a plan to the caller, to be freed.
    fn retire(&mut self, plan: Box<Plan>) {
        // If there were more than MOST_RETIRED, leaking one would be better than freeing it here.
        let slot = self.retired.iter().position(Option::is_none).unwrap_or(0);
        std::mem::forget(self.retired[slot].replace(plan));
    }
}
