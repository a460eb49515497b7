//! The supervisor of the controller: requests, trips and what a change of the mode takes along.

use super::Controller;
use crate::arm::ArmReference;
use crate::modes::{ActiveMode, LoadedPlan, RunningPlan};
use crate::step::Request;
use crate::supervisor::{Event, Refusal, transition};
use crate::trip::{Trip, TripCause};
use upswing_config::PlanWhileTracking;
use upswing_trajectory::Plan;

impl Controller {
    /// Why the robot cannot be enabled now.
    pub(super) fn unready(&self) -> Option<Refusal> {
        if !matches!(self.mode, ActiveMode::Idle) {
            return None;
        }
        let unfit = self.observer.unfit.map(Refusal::Unfit);
        unfit.or((!self.observer.drives_ready).then_some(Refusal::DrivesNotReady))
    }

    /// Does what a request asks, unless it is refused: then it changes nothing.
    pub(super) fn obey(&mut self, request: Request) -> Result<(), Refusal> {
        if let Some(event) = request.event() {
            if self.shutting_down && event != Event::Shutdown {
                return Err(Refusal::ShuttingDown);
            }
            transition(self.mode(), event)?;
        }
        match request {
            Request::Load(plan) => self.load(plan)?,
            Request::Start(id) => self.start(id)?,
            Request::Enable => {
                self.unready().map_or(Ok(()), Err)?;
                self.trip = None;
                self.enter(Event::Enable, ActiveMode::Hold(ArmReference::at_rest(&self.observer.x)));
            }
            Request::Hold => {
                self.enter(Event::Hold, ActiveMode::Hold(ArmReference::at_rest(&self.observer.x)))
            }
            Request::Stop => self.decelerate(Event::Stop),
            Request::Reset => {
                self.trip = None;
                self.enter(Event::Reset, ActiveMode::Idle);
            }
            Request::Shutdown => {
                self.shutting_down = true;
                if !self.mode.is_braked() {
                    self.decelerate(Event::Shutdown);
                }
            }
        }
        Ok(())
    }

    /// Keeps a plan for the next start, in the place of an earlier one.
    fn load(&mut self, plan: Box<Plan>) -> Result<(), Refusal> {
        if matches!(self.mode, ActiveMode::Track(_)) && self.while_tracking == PlanWhileTracking::Refuse {
            self.retire(plan);
            return Err(Refusal::Tracking { running: self.mode.plan_id() });
        }
        if let Some(replaced) = self.loaded.replace(LoadedPlan { plan, since_ns: self.now_ns }) {
            self.retire(replaced.plan);
        }
        Ok(())
    }

    /// Starts the loaded plan, if it is the one of this id; it stays loaded if it cannot be started.
    fn start(&mut self, id: u64) -> Result<(), Refusal> {
        let loaded = self.loaded.take().ok_or(Refusal::NoPlan)?;
        match self.check_start(&loaded, id) {
            Ok(start_ns) => {
                self.trip = None;
                let running = RunningPlan::new(loaded, start_ns, &self.model);
                self.enter(Event::Start, ActiveMode::Track(running));
                Ok(())
            }
            Err(refusal) => {
                self.loaded = Some(loaded);
                Err(refusal)
            }
        }
    }

    /// Whether the loaded plan is the one of this id and can be started now: the time of its t = 0, ns.
    fn check_start(&mut self, loaded: &LoadedPlan, id: u64) -> Result<u64, Refusal> {
        if loaded.plan.id != id {
            return Err(Refusal::OtherPlan { asked: id, loaded: loaded.plan.id });
        }
        let start_ns = self.start_time(loaded)?;
        self.checks.plan_age(loaded.age(self.now_ns))?;
        Ok(start_ns)
    }

    /// Warns of a loaded plan that is old where it could be started; elsewhere its age does not matter.
    pub(super) fn warn_of_plan_age(&mut self) {
        if let Some(loaded) = &self.loaded
            && self.checks.is_plan_old(loaded.age(self.now_ns))
            && transition(self.mode(), Event::Start).is_ok()
            && self.start_time(loaded).is_ok()
        {
            self.checks.warn(TripCause::PlanAge);
        }
    }

    /// The time of a loaded plan's t = 0 (ns) if it is started now: its activation, otherwise this moment.
    fn start_time(&self, loaded: &LoadedPlan) -> Result<u64, Refusal> {
        let start_ns = loaded.plan.activation_ns.unwrap_or(self.now_ns);
        if start_ns > self.now_ns {
            return Err(Refusal::BeforeActivation { wait: (start_ns - self.now_ns) as f64 * 1e-9 });
        }
        let t_plan = (self.now_ns - start_ns) as f64 * 1e-9;
        self.checks.start(&self.observer.x, &loaded.plan.reference(t_plan).x, t_plan)?;
        Ok(start_ns)
    }

    /// Trips to Fault, where the table of modes has that transition. In Fault the first trip stays.
    pub(super) fn trip_to_fault(&mut self, trip: Trip) {
        if transition(self.mode(), Event::TripToFault).is_ok() {
            self.trip = Some(trip);
            self.enter(Event::TripToFault, ActiveMode::Fault);
        }
    }

    /// Trips to Stop, where the table of modes has that transition.
    pub(super) fn trip_to_stop(&mut self, trip: Trip) {
        if transition(self.mode(), Event::TripToStop).is_ok() {
            self.trip = Some(trip);
            self.decelerate(Event::TripToStop);
        }
    }

    /// Enters Stop; an arm that decelerates already goes on.
    fn decelerate(&mut self, event: Event) {
        let reference = match &self.mode {
            ActiveMode::Stop(reference) => *reference,
            _ => ArmReference::moving(&self.observer.x),
        };
        self.enter(event, ActiveMode::Stop(reference));
    }

    /// Changes the mode to `next`, which is that of the table of modes for `event`. A plan that ran is loaded again, unless a newer one
    /// is.
    pub(super) fn enter(&mut self, event: Event, next: ActiveMode) {
        debug_assert_eq!(transition(self.mode(), event), Ok(next.mode()));
        let is_start = matches!(next, ActiveMode::Track(_));
        match std::mem::replace(&mut self.mode, next) {
            ActiveMode::Track(plan) | ActiveMode::Balance(plan) => {
                if is_start || self.loaded.is_some() {
                    self.retire(plan.loaded.plan);
                } else {
                    self.loaded = Some(plan.loaded);
                }
            }
            _ => {}
        }
        self.blend_cycles = self.checks.torque_steps();
        if is_start {
            // How long a joint has stood in Hold says nothing of a motion that only begins.
            self.standstill.reset();
        }
    }

    /// Hands a plan back to the caller.
    fn retire(&mut self, plan: Box<Plan>) {
        // A request retires at most one plan, and so does the end of a mode. If there were a third, leaking it would be better than
        // freeing it here.
        let slot = usize::from(self.retired[0].is_some());
        std::mem::forget(self.retired[slot].replace(plan));
    }
}
