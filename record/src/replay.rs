//! Replay: runs a controller on the recorded inputs of every step and compares its output with the recorded cycles.

use crate::cycle::CycleNumber;
use crate::{JOINTS, Message, Recording, RecordingError, Window, messages, scan};
use std::collections::BTreeMap;
use std::path::Path;
use upswing_config::{Config, ConfigError};
use upswing_ipc::{OtherChain, RecordedStep, Telemetry, UnknownCode};
use upswingd::controller::Controller;
use upswingd::os::flush_to_zero;
use upswingd::plan::{PlanRefusal, accept};
use upswingd::step::StepInput;

/// Fields that describe the timing of the real-time thread, not the controller; they are not compared.
const OF_THE_THREAD: [&str; 5] = ["degraded", "wake_ns", "read_ns", "compute_ns", "write_ns"];

/// A recorded run in memory: 19 MB per second at 8 kHz.
#[derive(Clone, Debug, Default)]
pub struct RecordedRun {
    /// The cycles, in the order of their recording; at least one.
    pub cycles: Vec<Telemetry>,
    /// The inputs of the controller, in the order of their recording: steps and plans.
    pub inputs: Vec<Message>,
    /// The other contents of the recording.
    pub recording: Recording,
}

impl RecordedRun {
    /// Reads the whole recording at `path`.
    ///
    /// # Errors
    /// As [`scan`].
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let (mut cycles, mut inputs) = (Vec::new(), Vec::new());
        let keep = |_: &Recording, message| -> Result<(), RecordingError> {
            match message {
                Message::Cycle(cycle) => cycles.push(cycle),
                input => inputs.push(input),
            }
            Ok(())
        };
        let recording = scan(path, Window::ALL, |_, _| (), keep)?;
        Ok(Self { cycles, inputs, recording })
    }
}

/// Error of a replay.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The recording has no steps.
    #[error("expected steps to replay, got none: the recording is of an older version")]
    NoSteps,
    /// The recording is of another robot than the settings.
    #[error("expected a recording of a robot with the joints {expected}, got one with {got}")]
    OtherRobot {
        /// Names of the joints of the settings.
        expected: String,
        /// Names of the joints in the recording.
        got: String,
    },
    /// The recording is of a robot with other numbers of joints than the settings.
    #[error(transparent)]
    OtherChain(#[from] OtherChain),
    /// Earlier steps are missing, so that the state of the controller is unknown.
    #[error(
        "expected step {expected}, got step {got}: a replay needs all steps from the start of the daemon; record with \
         `upswing demo --record`, or begin `upswing record` before the daemon"
    )]
    Gap {
        /// Number of the step that is missing.
        expected: u64,
        /// Number of the step found in its place.
        got: u64,
    },
    /// The request of a step does not exist, or its plan is missing or refused.
    #[error("step {number}: request {code} with plan {plan_id} cannot be given: {reason}")]
    Request {
        /// Number of the step.
        number: u64,
        /// Code of the request.
        code: u64,
        /// Plan to be loaded or started.
        plan_id: u64,
        /// Error of the request.
        #[source]
        reason: RecordedRequestError,
    },
    /// A settings file is missing in the recording.
    #[error("expected the settings file {0} in the recording, got none")]
    NoSettings(&'static str),
    /// The settings in the recording cannot be used.
    #[error(transparent)]
    Settings(#[from] ConfigError),
    /// The settings cannot be unpacked to a temporary folder.
    #[error("cannot unpack the settings: {0}")]
    Unpack(#[from] std::io::Error),
}

/// Error of the request in a recorded step.
#[derive(Debug, thiserror::Error)]
pub enum RecordedRequestError {
    /// No request has this code.
    #[error(transparent)]
    Unknown(#[from] UnknownCode),
    /// The recording does not contain the requested plan before the step.
    #[error("no such plan before it")]
    NoPlan,
    /// This version of the daemon refuses the plan.
    #[error(transparent)]
    Refused(#[from] PlanRefusal),
}

/// A number that differs between recording and replay.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Difference {
    /// Number of the cycle.
    pub cycle: u64,
    /// Name of the field; for a list with the name of the joint, like `tau of joint_4`.
    pub field: String,
    /// Value in the recording.
    pub recorded: String,
    /// Value in the replay.
    pub replayed: String,
}

/// Result of a replay: its cycles and their first differences from the recording.
#[derive(Clone, Debug, Default)]
pub struct Replay {
    /// Number of steps given to the controller.
    pub steps: u64,
    /// Number of compared cycles.
    pub compared: u64,
    /// The first number that is not bit for bit the same.
    pub difference: Option<Difference>,
    /// The first difference in mode or fault.
    pub decision: Option<Difference>,
    /// The replayed cycles.
    pub cycles: Vec<Telemetry>,
}

/// Replays a recorded run with the given settings; [`settings`] reads those of the recording.
///
/// # Errors
/// [`ReplayError`] if the recording does not contain the complete input of the controller.
pub fn replay(recorded: &RecordedRun, config: &Config) -> Result<Replay, ReplayError> {
    // Flush-to-zero as in the real-time thread, so that the replay rounds alike; in its own thread, so that the caller's is unchanged.
    std::thread::scope(|threads| {
        let run = threads.spawn(|| {
            flush_to_zero();
            run(recorded, config)
        });
        run.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn run(run: &RecordedRun, config: &Config) -> Result<Replay, ReplayError> {
    let expected = messages::joint_names(&config.model);
    if let Some(got) = run.recording.details.get(JOINTS).filter(|got| **got != expected) {
        return Err(ReplayError::OtherRobot { expected, got: got.clone() });
    }
    for cycle in &run.cycles {
        cycle.vectors(config.model.order())?;
    }
    let mut numbers = CycleNumber::all(&config.model);
    numbers.retain(|number| !OF_THE_THREAD.contains(&number.field));
    // In the order of daemons and cycles: a recording may continue over restarts of the daemon.
    let mut recorded = run.cycles.iter().peekable();
    let mut plans = BTreeMap::new();
    let mut controller = Controller::new(config);
    let mut replay = Replay::default();
    let (mut number, mut cycle) = (0, 0);
    for input in &run.inputs {
        let step = match input {
            Message::Plan(plan) => {
                plans.insert(plan.header.id, plan);
                continue;
            }
            Message::Step(step) => step,
            Message::Cycle(_) => continue,
        };
        if step.number == 1 && number > 0 {
            // Another daemon: skip the remaining recorded cycles of the previous daemon.
            (controller, number, cycle) = (Controller::new(config), 0, 0);
            while recorded.peek().is_some_and(|record| record.seq > step.cycle) {
                recorded.next();
            }
        }
        if step.number != number + 1 {
            return Err(ReplayError::Gap { expected: number + 1, got: step.number });
        }
        number = step.number;
        replay.steps += 1;
        // Plans are checked as by the daemon.
        let plan = |id| Ok(accept(plans.get(&id).ok_or(RecordedRequestError::NoPlan)?, config)?);
        let input = StepInput::from_payload(step, plan).map_err(|reason| {
            let RecordedStep { number, request: code, plan_id, .. } = *step;
            ReplayError::Request { number, code, plan_id, reason }
        })?;
        let telemetry = controller.step(input).record.telemetry;
        if telemetry.seq == cycle {
            continue;
        }
        cycle = telemetry.seq;
        replay.cycles.push(telemetry);
        if let Some(record) = recorded.next_if(|record| record.seq == cycle) {
            replay.compared += 1;
            compare(&numbers, record, &telemetry, &mut replay);
        }
    }
    if replay.steps == 0 { Err(ReplayError::NoSteps) } else { Ok(replay) }
}

/// Compares the `numbers` of two records of the same cycle and stores the first differences in `replay`.
fn compare(numbers: &[CycleNumber], recorded: &Telemetry, replayed: &Telemetry, replay: &mut Replay) {
    let mut recorded = *recorded;
    recorded.flags &= !Telemetry::OVERRUN;
    let words = |record: &Telemetry| record.words().collect::<Vec<_>>();
    let (old, new) = (words(&recorded), words(replayed));
    for number in numbers.iter().filter(|number| number.bits(&old) != number.bits(&new)) {
        let difference = Difference {
            cycle: replayed.seq,
            field: match &number.joint {
                Some(joint) => format!("{} of {joint}", number.field),
                None => number.field.to_owned(),
            },
            recorded: number.text(&old),
            replayed: number.text(&new),
        };
        if matches!(number.field, "mode" | "fault") {
            replay.decision.get_or_insert(difference.clone());
        }
        replay.difference.get_or_insert(difference);
    }
}

/// Reads the settings in a recording.
///
/// # Errors
/// [`ReplayError`] if a settings file is missing, or cannot be used by this version.
pub fn settings(recording: &Recording) -> Result<Config, ReplayError> {
    let folder = tempfile::tempdir()?;
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text);
    for name in Config::FILES {
        let text = recording.file_text(name).ok_or(ReplayError::NoSettings(name))?;
        write(name, text)?;
    }
    // A second robot description, of the plant.
    for (name, text) in
        recording.files.iter().filter(|(name, _)| name.ends_with(".urdf") && !name.contains('/'))
    {
        write(name, text)?;
    }
    Ok(Config::from_dir(folder.path())?)
}
