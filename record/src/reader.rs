//! Reader of recordings, also of recordings by a killed process, rewritten by other tools, or damaged.

use super::parts::{self, FilePart, FileParts, PartError};
use super::{CYCLE_TOPIC, DETAILS, Elapsed, FieldDifference, RecordingError, STEP_TOPIC, cycle, messages};
use mcap::records::{Record, op};
use std::collections::BTreeMap;
use std::path::Path;
use upswing_ipc::{PlanMessage, RecordedStep, Telemetry};
use upswing_model::Model;

/// Largest definition of a message type, bytes; larger ones are not from this program.
const DEFINITION: usize = 64 << 10;
/// Largest size of all settings together, bytes; further attachments are skipped.
const SETTINGS: usize = 16 << 20;
/// Media types of the settings; other tools attach files of other types.
const SETTINGS_TYPES: [&str; 2] = ["application/toml", "application/xml"];

/// A time window of a recording, s since its first cycle, as [`Elapsed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First moment.
    pub from: f64,
    /// Last moment.
    pub to: f64,
}

impl Window {
    /// The whole recording.
    pub const ALL: Self = Self { from: 0.0, to: f64::INFINITY };
}

/// A message of a recording.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a scan has one at a time")]
pub enum Message {
    /// The record of a cycle.
    Cycle(Telemetry),
    /// The input of the controller in one step.
    Step(RecordedStep),
    /// A plan that a later step may load.
    Plan(PlanMessage),
}

/// The contents of a recording other than its messages.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Keys and values that identify the run, from the record [`DETAILS`].
    pub details: BTreeMap<String, String>,
    /// Names and texts of the settings.
    pub files: Vec<(String, String)>,
    /// Reason why the file ends early (its process was killed, or it is damaged); `None` if it is complete.
    pub cut: Option<String>,
    /// Description of the unreadable parts before the end of the file; `None` if there are none.
    pub damage: Option<String>,
}

impl Recording {
    /// Text of the settings file `name`.
    pub fn file_text(&self, name: &str) -> Option<&str> {
        self.files.iter().find(|(n, _)| n == name).map(|(_, text)| text.as_str())
    }

    /// URDF of the recorded robot; `path` names the recording in errors.
    ///
    /// # Errors
    /// [`RecordingError::Missing`]
    pub fn urdf(&self, path: &Path) -> Result<&str, RecordingError> {
        self.file_text("robot.urdf").ok_or_else(|| RecordingError::Missing {
            path: path.to_owned(),
            expected: "an attachment robot.urdf".into(),
        })
    }

    /// Model of the recorded robot; `path` names the recording in errors.
    ///
    /// # Errors
    /// [`RecordingError`] if the recording has no URDF or there is no model of it.
    pub fn model(&self, path: &Path) -> Result<Model, RecordingError> {
        Model::from_urdf(self.urdf(path)?)
            .map_err(|cause| RecordingError::Robot { path: path.to_owned(), cause })
    }
}

/// Reads the cycles of a window and the other contents of a recording into memory: 9 MB per second at 8 kHz.
///
/// # Errors
/// As [`scan`].
pub fn read(path: &Path, window: Window) -> Result<(Vec<Telemetry>, Recording), RecordingError> {
    let mut cycles = Vec::new();
    let keep = |_: &Recording, message| -> Result<(), RecordingError> {
        if let Message::Cycle(cycle) = message {
            cycles.push(cycle);
        }
        Ok(())
    };
    let recording = scan(path, window, |_, _| (), keep)?;
    Ok((cycles, recording))
}

/// Streams a recording, which need not fit into memory: `each` gets the messages in the order of recording (all steps and plans,
/// the cycles of the window) with the other contents read so far. `progress` gets the bytes read and the length of the file.
///
/// # Errors
/// [`RecordingError`] if the file is no recording of this version or has no cycle in the window; errors of `each`. A file that
/// ends early or is damaged is no error, see [`Recording::cut`] and [`Recording::damage`].
pub fn scan<E: From<RecordingError>>(
    path: &Path,
    window: Window,
    mut progress: impl FnMut(u64, u64),
    mut each: impl FnMut(&Recording, Message) -> Result<(), E>,
) -> Result<Recording, E> {
    let unreadable = |cause| RecordingError::Read { path: path.to_owned(), cause };
    let mut file = FileParts::open(path).map_err(unreadable)?.ok_or_else(|| RecordingError::NotMcap {
        path: path.to_owned(),
        cause: Box::new(mcap::McapError::BadMagic),
    })?;
    let (schemas, channels) = (BTreeMap::new(), BTreeMap::new());
    let mut reader = MessageReader {
        path,
        window,
        schemas,
        channels,
        settings: 0,
        elapsed: Elapsed::default(),
        joints: None,
    };
    let mut recording = Recording::default();
    let (mut finished, mut seen) = (false, 0_u64);
    let mut damage = DamagedParts::default();
    while !finished {
        let part = file.next().map_err(unreadable)?;
        let cut = matches!(part, FilePart::Cut(_));
        // If a record other than a chunk is unreadable, its length is in doubt, too.
        let lost = cut || matches!(part, FilePart::Record { opcode, .. } if opcode != op::CHUNK);
        let read = match part {
            FilePart::End => break,
            FilePart::Foreign => Ok(()),
            FilePart::Skipped(why) | FilePart::Cut(why) => Err(why),
            FilePart::Record { opcode, body } => {
                parts::each_record(opcode, body, |record| -> Result<(), E> {
                    finished |= matches!(record, Record::Footer(_));
                    if let Some(message) = reader.take(record, &mut recording)? {
                        seen += u64::from(matches!(message, Message::Cycle(_)));
                        each(&recording, message)?;
                    }
                    Ok(())
                })?
            }
        };
        let (place, length) = file.place();
        progress(place, length);
        let Err(why) = read else { continue };
        let resumed = lost && file.resume().map_err(unreadable)?;
        for (opcode, body) in file.definitions().map_err(unreadable)? {
            // Errors are ignored: definitions of another version are refused at their place in the data section.
            let _ = mcap::parse_record(*opcode, body).map(|record| reader.take(record, &mut recording));
        }
        if cut && !resumed {
            recording.cut = Some(why.to_string());
            break;
        }
        damage.note(place, why);
    }
    recording.damage = damage.text();
    if !finished && recording.cut.is_none() {
        recording.cut = Some("the end is missing".into());
    }
    if seen == 0 {
        let why = recording.cut.map(|why| format!(" before the file ends ({why})"));
        let damage = recording.damage.map(|damage| format!("; {damage}"));
        let why = [why, damage].into_iter().flatten().collect::<String>();
        let expected = format!("cycles on {CYCLE_TOPIC} from {} s to {} s{why}", window.from, window.to);
        return Err(RecordingError::Missing { path: path.to_owned(), expected }.into());
    }
    Ok(recording)
}

/// Unreadable parts of a file: their number, and offset (bytes) and reason of the first.
#[derive(Default)]
struct DamagedParts {
    parts: u64,
    first: Option<(u64, PartError)>,
}

impl DamagedParts {
    fn note(&mut self, place: u64, why: PartError) {
        self.parts += 1;
        self.first.get_or_insert((place, why));
    }

    fn text(&self) -> Option<String> {
        let (place, why) = self.first.as_ref()?;
        Some(match self.parts {
            1 => format!("a part is left out, at byte {place}: {why}"),
            n => format!("{n} parts are left out, the first at byte {place}: {why}"),
        })
    }
}

/// Kind of a message that the reader decodes.
#[derive(Clone, Copy)]
enum MessageKind {
    Cycle,
    Step,
    Plan,
}

/// Decoder of messages, with the schemas and channels read so far.
struct MessageReader<'a> {
    path: &'a Path,
    window: Window,
    /// Names and definitions of message types by schema id.
    schemas: BTreeMap<u16, (String, String)>,
    /// Kinds of the messages by channel id.
    channels: BTreeMap<u16, MessageKind>,
    /// Size of the settings read so far, bytes.
    settings: usize,
    elapsed: Elapsed,
    /// Numbers of joints, all and actuated, of the cycles read so far.
    joints: Option<(u64, u64)>,
}

impl MessageReader<'_> {
    /// Stores the contents of a record; returns the message if it is a step, a plan, or a cycle of the window.
    fn take(&mut self, record: Record<'_>, into: &mut Recording) -> Result<Option<Message>, RecordingError> {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match record {
            Record::Metadata(m) if m.name == DETAILS => into.details = m.metadata,
            Record::Attachment { header, data, .. }
                if SETTINGS_TYPES.contains(&header.media_type.as_str())
                    && data.len() <= SETTINGS - self.settings =>
            {
                self.settings += data.len();
                into.files.push((header.name, text(&data)));
            }
            Record::Schema { header, data } if data.len() <= DEFINITION => {
                self.schemas.insert(header.id, (header.name, text(&data)));
            }
            Record::Channel(c) => {
                let (cycle, step, plan) = (&cycle::CYCLE, &cycle::STEP, &messages::PLANS);
                let known = [
                    (CYCLE_TOPIC, MessageKind::Cycle, cycle.name, cycle.definition()),
                    (STEP_TOPIC, MessageKind::Step, step.name, step.definition()),
                    (plan.name, MessageKind::Plan, plan.kind, plan.definition.into()),
                ];
                if let Some((_, kind, name, definition)) = known.iter().find(|(topic, ..)| c.topic == *topic)
                {
                    self.check(c.schema_id, name, definition)?;
                    self.channels.insert(c.id, *kind);
                }
            }
            Record::Message { header, data } => {
                let Some(kind) = self.channels.get(&header.channel_id) else { return Ok(None) };
                let (number, bytes) = (header.sequence, data.len());
                let other = || RecordingError::MessageLength { path: self.path.to_owned(), number, bytes };
                return match kind {
                    MessageKind::Cycle => {
                        let words = cycle::CYCLE.decode(&data);
                        let cycle = words.and_then(|w| Telemetry::from_words(&w)).ok_or_else(other)?;
                        let got = (cycle.joints, cycle.actuated);
                        let expected = *self.joints.get_or_insert(got);
                        if got != expected {
                            let path = self.path.to_owned();
                            return Err(RecordingError::Joints { path, number, got, expected });
                        }
                        let t = self.elapsed.until(cycle.t_ns) as f64 * 1e-9;
                        let inside = t >= self.window.from && t <= self.window.to;
                        Ok(inside.then_some(Message::Cycle(cycle)))
                    }
                    MessageKind::Step => {
                        let words = cycle::STEP.decode(&data);
                        let step = words.and_then(|w| RecordedStep::from_words(&w)).ok_or_else(other)?;
                        Ok(Some(Message::Step(step)))
                    }
                    MessageKind::Plan => {
                        Ok(Some(Message::Plan(messages::read_plan(&data).ok_or_else(other)?)))
                    }
                };
            }
            _ => {}
        }
        Ok(None)
    }

    /// Fails unless the messages of a schema have the name and the fields of this version.
    fn check(&self, schema: u16, expected_name: &'static str, expected: &str) -> Result<(), RecordingError> {
        let (name, got) = self.schemas.get(&schema).map_or(("", ""), |(n, text)| (n.as_str(), text.as_str()));
        let (expected, got) = (cycle::layout_of(expected), cycle::layout_of(got));
        if name != expected_name || expected != got {
            let difference = match expected.iter().zip(&got).find(|(e, g)| e != g) {
                Some((e, g)) => FieldDifference::Field { got: (*g).into(), expected: (*e).into() },
                None => FieldDifference::Count { got: got.len(), expected: expected.len() },
            };
            let (path, name) = (self.path.to_owned(), name.to_owned());
            return Err(RecordingError::Definition { path, name, difference, expected: expected_name });
        }
        Ok(())
    }
}
