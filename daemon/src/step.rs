//! Input and output of one step of the controller, and the recorded form of the input.

use crate::supervisor::{ModeEvent, RequestRefusal};
use crate::trip::Trip;
use std::fmt;
use upswing_ipc::{Command, Measurement, RecordedStep, Telemetry, UnknownCode};
use upswing_trajectory::Plan;

/// A request that the controller executes in a step: of an operator, or of the daemon itself.
#[derive(Clone, Debug, PartialEq)]
pub enum StepRequest {
    /// Release the brakes and hold the arm.
    Enable,
    /// Hold the current pose of the arm.
    Hold,
    /// Track the loaded plan, if it has this id.
    Start(u64),
    /// Decelerate the arm, then hold it.
    Stop,
    /// Leave Fault.
    Reset,
    /// Bring the arm to rest, close the brakes, and refuse all later requests.
    Shutdown,
    /// Keep this plan, which has passed the checks, for the next start; one that replaces the running plan for its activation.
    Load(Box<Plan>),
}

impl StepRequest {
    /// The event of the request in the table of modes; `None` if it does not change the mode.
    pub const fn event(&self) -> Option<ModeEvent> {
        match self {
            Self::Enable => Some(ModeEvent::Enable),
            Self::Hold => Some(ModeEvent::Hold),
            Self::Start(_) => Some(ModeEvent::Start),
            Self::Stop => Some(ModeEvent::Stop),
            Self::Reset => Some(ModeEvent::Reset),
            Self::Shutdown => Some(ModeEvent::Shutdown),
            Self::Load(_) => None,
        }
    }

    /// Name of the request for operators.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Enable => "enable",
            Self::Hold => "hold",
            Self::Start(_) => "start",
            Self::Stop => "stop",
            Self::Reset => "reset",
            Self::Shutdown => "shutdown",
            Self::Load(_) => "load",
        }
    }
}

impl fmt::Display for StepRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Input of one step of the controller. Equal sequences of inputs give equal outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct StepInput {
    /// The newest measurement, whether or not it is new.
    pub measurement: Measurement,
    /// Planned time of the cycle on the wall clock, CLOCK_MONOTONIC, ns; ignored on the other clocks, whose time advances by
    /// one period per measurement.
    pub now_ns: u64,
    /// Number of consecutive overruns before this cycle.
    pub late_cycles: u64,
    /// Number of cycles for which no measurement has come, in the step in which they count as lost; otherwise 0. Only the
    /// caller can tell on a clock on which the daemon waits for measurements.
    pub lost_cycles: u64,
    /// Whether the plant is another one than in the previous step, or has restarted.
    pub restarted: bool,
    /// A request of an operator or of the daemon itself.
    pub request: Option<StepRequest>,
}

impl StepInput {
    /// Creates the input of a step without overruns and lost measurements. `now_ns`: planned time of the cycle, as in
    /// [`StepInput::now_ns`].
    pub const fn new(measurement: Measurement, now_ns: u64, request: Option<StepRequest>) -> Self {
        Self { measurement, now_ns, late_cycles: 0, lost_cycles: 0, restarted: false, request }
    }

    /// Converts the input of step `number`, in the cycle `cycle`, to its recorded form, which contains only the id of a plan.
    pub fn to_payload(&self, number: u64, cycle: u64) -> RecordedStep {
        let (request, plan_id) = match &self.request {
            None => (0, 0),
            Some(StepRequest::Load(plan)) => (1, plan.id),
            Some(StepRequest::Enable) => (2, 0),
            Some(StepRequest::Hold) => (3, 0),
            Some(StepRequest::Start(plan_id)) => (4, *plan_id),
            Some(StepRequest::Stop) => (5, 0),
            Some(StepRequest::Reset) => (6, 0),
            Some(StepRequest::Shutdown) => (7, 0),
        };
        RecordedStep {
            number,
            cycle,
            now_ns: self.now_ns,
            late: self.late_cycles,
            lost: self.lost_cycles,
            restarted: self.restarted.into(),
            request,
            plan_id,
            measurement: self.measurement,
        }
    }

    /// Converts the recorded `step` to the input. `plan` returns the checked plan with an id.
    ///
    /// # Errors
    /// [`UnknownCode`] for an unknown request, otherwise the error of `plan`.
    pub fn from_payload<E: From<UnknownCode>>(
        step: &RecordedStep,
        plan: impl FnOnce(u64) -> Result<Box<Plan>, E>,
    ) -> Result<Self, E> {
        let request = match step.request {
            0 => None,
            1 => Some(StepRequest::Load(plan(step.plan_id)?)),
            2 => Some(StepRequest::Enable),
            3 => Some(StepRequest::Hold),
            4 => Some(StepRequest::Start(step.plan_id)),
            5 => Some(StepRequest::Stop),
            6 => Some(StepRequest::Reset),
            7 => Some(StepRequest::Shutdown),
            got => return Err(UnknownCode { what: "recorded request", got, max: 7 }.into()),
        };
        Ok(Self {
            measurement: step.measurement,
            now_ns: step.now_ns,
            late_cycles: step.late,
            lost_cycles: step.lost,
            restarted: step.restarted != 0,
            request,
        })
    }
}

/// Output of one step of the controller.
#[derive(Debug)]
pub struct StepOutput {
    /// The command for the drives.
    pub command: Command,
    /// Mode, reference, torque and limits of this cycle.
    pub record: CycleRecord,
    /// The answer to the request of this step, if there was one.
    pub answer: Option<Result<(), RequestRefusal>>,
    /// Plans that the controller no longer needs, to be freed outside of the real-time thread.
    pub retired: [Option<Box<Plan>>; MOST_RETIRED],
}

/// Most plans that the controller can need no longer after one step: one that waited and for which a newer one has come, the one that
/// this newer one replaces, and the newer one itself if the mode ends.
pub const MOST_RETIRED: usize = 3;

/// A plan that was to replace the running one and was dropped at its activation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DroppedPlan {
    /// Id of the plan.
    pub id: u64,
    /// Reason.
    pub reason: RequestRefusal,
}

/// Published and recorded values of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct CycleRecord {
    /// The published telemetry.
    pub telemetry: Telemetry,
    /// The recorded input of the step.
    pub step: RecordedStep,
    /// Trip that led to the last Fault or Stop; kept until the next enable, start or reset.
    pub trip: Option<Trip>,
    /// The plan that was dropped at its activation in this step; the running plan goes on.
    pub dropped: Option<DroppedPlan>,
    /// Reason for which an enable would be refused; `None` if it would not be, or outside Idle.
    pub unready: Option<RequestRefusal>,
    /// Number of overruns since the start of the daemon; the controller, which reads no clock, returns 0.
    pub overruns: u64,
}
