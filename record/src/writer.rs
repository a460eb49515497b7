//! Writer of recordings.

use super::{CHUNK, CYCLE_TOPIC, DETAILS, JOINTS, RecordingError, STEP_TOPIC, Tally, cycle, messages};
use crate::robot::Robot;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use upswing_config::Config;
use upswing_ipc::{PlanMessage, RecordedStep, Telemetry};
use upswing_model::Order;

/// Rate of the topics for the display of the robot, Hz: higher than the refresh rate of most screens.
const VIEW_RATE: f64 = 125.0;

/// Writer of a recording. The file is complete after [`Recorder::finish`], and readable up to its last chunk before that.
pub struct Recorder {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: Channels,
    robot: Robot,
    joint_names: Vec<String>,
    order: Order,
    view_every: u64,
    tally: Tally,
    /// Time of the last message, ns.
    last_ns: u64,
}

/// Channel ids of the topics.
struct Channels {
    cycle: u16,
    step: u16,
    plan: u16,
    joint_states: u16,
    transforms: u16,
    description: u16,
}

impl Recorder {
    /// Creates the file, which must not exist yet, with the settings as attachments and the `details` that identify the run.
    ///
    /// # Errors
    /// [`RecordingError`] if the file cannot be created or written, or the settings or their URDF cannot be read.
    pub fn create(
        path: &Path,
        config: &Config,
        details: impl IntoIterator<Item = (&'static str, String)>,
    ) -> Result<Self, RecordingError> {
        let robot = Robot::from_urdf(&config.urdf, &config.model)
            .map_err(|cause| RecordingError::Robot { path: path.to_owned(), cause })?;
        let texts = config.texts()?;
        let file = File::create_new(path)
            .map_err(|cause| RecordingError::Create { path: path.to_owned(), cause })?;
        let period = config.daemon.cycle.period.seconds();
        let mut all = BTreeMap::from([
            ("version".into(), env!("CARGO_PKG_VERSION").into()),
            ("model_fingerprint".into(), format!("{:016x}", config.model.fingerprint())),
            ("period_us".into(), (period * 1e6).to_string()),
            (JOINTS.into(), messages::joint_names(&config.model)),
        ]);
        all.extend(details.into_iter().map(|(key, value)| (key.to_owned(), value)));
        let (writer, channels) = begin(file, texts, all)
            .map_err(|cause| RecordingError::Write { path: path.to_owned(), cause: cause.into() })?;
        Ok(Self {
            path: path.to_owned(),
            writer,
            channels,
            robot,
            joint_names: config.model.joint_names().map(str::to_owned).collect(),
            order: *config.model.order(),
            view_every: ((1.0 / (VIEW_RATE * period)) as u64).max(1),
            tally: Tally::default(),
            last_ns: 0,
        })
    }

    /// Appends cycles.
    ///
    /// # Errors
    /// [`RecordingError::Write`], for example if the disk is full; [`RecordingError::OtherChain`] if a cycle is of another robot.
    pub fn write(&mut self, records: &[Telemetry]) -> Result<(), RecordingError> {
        for record in records {
            record.vectors(&self.order)?;
            self.append(record).map_err(|cause| self.error(cause))?;
        }
        Ok(())
    }

    /// Appends inputs of the controller; a measurement in them may be of another robot, which the controller then refused.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn write_steps(&mut self, steps: &[RecordedStep]) -> Result<(), RecordingError> {
        let mut put = |step: &RecordedStep| {
            let t_ns = step.measurement.t_ns;
            self.put(self.channels.step, step.number, t_ns, &cycle::STEP.encode(step.words()))
        };
        steps.iter().try_for_each(&mut put).map_err(|cause| self.error(cause))
    }

    /// Appends a plan; call it before the step that loads the plan is written.
    ///
    /// # Errors
    /// [`RecordingError::Write`]; [`RecordingError::Plan`] if the plan has other sizes than its header states.
    pub fn write_plan(&mut self, plan: &PlanMessage) -> Result<(), RecordingError> {
        let message = messages::plan(plan)?;
        self.put(self.channels.plan, plan.header.id, self.last_ns, &message)
            .map_err(|cause| self.error(cause))
    }

    fn error(&self, cause: mcap::McapError) -> RecordingError {
        RecordingError::Write { path: self.path.clone(), cause: cause.into() }
    }

    fn append(&mut self, record: &Telemetry) -> mcap::McapResult<()> {
        self.tally.count(record);
        let Telemetry { seq, t_ns, .. } = *record;
        if self.tally.cycles == 1 {
            self.put(self.channels.description, seq, t_ns, &messages::description(&self.robot.urdf))?;
        }
        self.put(self.channels.cycle, seq, t_ns, &cycle::CYCLE.encode(record.words()))?;
        if record.seq.is_multiple_of(self.view_every) {
            let states = messages::joint_states(&self.joint_names, &self.order, record);
            self.put(self.channels.joint_states, seq, t_ns, &states)?;
            let transforms = messages::transforms(&self.robot, record);
            self.put(self.channels.transforms, seq, t_ns, &transforms)?;
        }
        if self.tally.cycles.is_multiple_of(CHUNK as u64) {
            self.writer.flush()?;
        }
        Ok(())
    }

    fn put(&mut self, channel_id: u16, number: u64, t_ns: u64, data: &[u8]) -> mcap::McapResult<()> {
        self.last_ns = t_ns;
        let header =
            MessageHeader { channel_id, sequence: number as u32, log_time: t_ns, publish_time: t_ns };
        self.writer.write_to_known_channel(&header, data)
    }

    /// Numbers of cycles recorded and lost so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Completes the file with its index, and returns the numbers of cycles.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn finish(mut self) -> Result<Tally, RecordingError> {
        let result = self.writer.finish();
        result.map_err(|cause| RecordingError::Write { path: self.path, cause: cause.into() })?;
        Ok(self.tally)
    }
}

/// Writes the part of a recording before the first cycle: details, settings, schemas and channels.
fn begin(
    file: File,
    texts: Vec<(String, String)>,
    details: BTreeMap<String, String>,
) -> mcap::McapResult<(Writer<BufWriter<File>>, Channels)> {
    let mut writer = WriteOptions::new()
        .profile("ros2")
        .library(concat!("upswing ", env!("CARGO_PKG_VERSION")))
        // `append` ends the chunks; one thread is enough and leaves the other CPUs to the control loop.
        .chunk_size(None)
        .compression_threads(0)
        .compression_level(1)
        .create(BufWriter::new(file))?;
    writer.write_metadata(&Metadata { name: DETAILS.into(), metadata: details })?;
    for (name, text) in texts {
        let media_type = if name.ends_with(".urdf") { "application/xml" } else { "application/toml" };
        writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name,
            media_type: media_type.into(),
            data: Cow::Borrowed(text.as_bytes()),
        })?;
    }
    let mut channel = |topic: &str, kind: &str, definition: &str| {
        let schema = writer.add_schema(kind, "ros2msg", definition.as_bytes())?;
        writer.add_channel(schema, topic, "cdr", &BTreeMap::new())
    };
    let mut known = |t: &messages::Topic| channel(t.name, t.kind, t.definition);
    let plan = known(&messages::PLANS)?;
    let (joint_states, transforms, description) =
        (known(&messages::JOINT_STATES)?, known(&messages::TRANSFORMS)?, known(&messages::DESCRIPTION)?);
    let mut of_fields = |topic, kind: &cycle::MessageType| channel(topic, kind.name, &kind.definition());
    let (cycle, step) = (of_fields(CYCLE_TOPIC, &cycle::CYCLE)?, of_fields(STEP_TOPIC, &cycle::STEP)?);
    // From here on the file is readable if the process is killed.
    writer.flush()?;
    Ok((writer, Channels { cycle, step, plan, joint_states, transforms, description }))
}
