//! Reads recordings, also those of a killed process, rewritten by other tools, or damaged.

use super::parts::{self, Part, Parts};
use super::{CYCLE_TOPIC, DETAILS, Elapsed, RecordingError, cdr, cycle, messages};
use mcap::records::{Record, op};
use std::collections::BTreeMap;
use std::path::Path;
use upswing_ipc::{Plan, Step, Telemetry};

/// Longest definition of a message type, and all settings together, bytes: more is none of this program.
const DEFINITION: usize = 64 << 10;
const SETTINGS: usize = 16 << 20;
/// Media types of the settings; other tools attach pictures and more.
const SETTINGS_TYPES: [&str; 2] = ["application/toml", "application/xml"];

/// A stretch of a recording, s from its first cycle, as [`Elapsed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First moment.
    pub from: f64,
    /// Last moment.
    pub to: f64,
}

impl Window {
    /// All of it.
    pub const ALL: Self = Self { from: 0.0, to: f64::INFINITY };
}

/// A message of a recording.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "hardly any are plans")]
pub enum Message {
    /// A cycle.
    Cycle(Telemetry),
    /// What the controller was given in one step.
    Step(Step),
    /// A plan that a later step may load.
    Plan(Box<Plan>),
}

/// The contents of a file but its messages.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// What identifies the run.
    pub details: BTreeMap<String, String>,
    /// Names and texts of the settings.
    pub files: Vec<(String, String)>,
    /// Why the file ends early: its process was killed, or it is damaged.
    pub cut: Option<String>,
    /// What in it cannot be read, though more follows.
    pub damage: Option<String>,
}

impl Recording {
    /// Text of one of the settings files.
    pub fn file_text(&self, name: &str) -> Option<&str> {
        self.files.iter().find(|(n, _)| n == name).map(|(_, text)| text.as_str())
    }
}

/// Reads a file with its cycles, which must fit into memory: 5 MB per second at 8 kHz.
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

/// Goes through a file, which need not fit into memory: `each` gets the messages in the order of their recording, of the
/// cycles those of the window, each with what else stands before it. `progress` is told how many bytes have been read of how many.
///
/// # Errors
/// [`RecordingError`] if it is no recording of this version or holds no cycle in the window; what `each` says. A file that
/// ends early or is damaged is no error, see [`Recording::cut`] and [`Recording::damage`].
pub fn scan<E: From<RecordingError>>(
    path: &Path,
    window: Window,
    mut progress: impl FnMut(u64, u64),
    mut each: impl FnMut(&Recording, Message) -> Result<(), E>,
) -> Result<Recording, E> {
    let unreadable = |cause| RecordingError::Read { path: path.to_owned(), cause };
    let mut file = Parts::open(path).map_err(unreadable)?.ok_or_else(|| RecordingError::NotMcap {
        path: path.to_owned(),
        cause: Box::new(mcap::McapError::BadMagic),
    })?;
    let (schemas, channels) = (BTreeMap::new(), BTreeMap::new());
    let (settings, elapsed, clock) = (0, Elapsed::default(), u64::MAX);
    let mut reader = MessageReader { path, window, schemas, channels, settings, elapsed, clock };
    let mut recording = Recording::default();
    let (mut finished, mut seen) = (false, 0_u64);
    let mut damage = Damage::default();
    while !finished {
        let part = file.next().map_err(unreadable)?;
        let cut = matches!(part, Part::Cut(_));
        // Where something else than a chunk cannot be read, its place is in doubt, too.
        let lost = cut || matches!(part, Part::Record { opcode, .. } if opcode != op::CHUNK);
        let read = match part {
            Part::End => break,
            Part::Foreign => Ok(()),
            Part::TooLong(why) | Part::Cut(why) => Err(why),
            Part::Record { opcode, body } => parts::each_record(opcode, body, |record| -> Result<(), E> {
                finished |= matches!(record, Record::Footer(_));
                if let Some(message) = reader.take(record, &mut recording)? {
                    seen += u64::from(matches!(message, Message::Cycle(_)));
                    each(&recording, message)?;
                }
                Ok(())
            })?,
        };
        let (place, length) = file.place();
        progress(place, length);
        let Err(why) = read else { continue };
        let resumed = lost && file.resume().map_err(unreadable)?;
        for (opcode, body) in file.definitions().map_err(unreadable)? {
            // Those of another version have been found before, or are found where they stand.
            let _ = mcap::parse_record(*opcode, body).map(|record| reader.take(record, &mut recording));
        }
        if cut && !resumed {
            recording.cut = Some(why);
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

/// What cannot be read.
#[derive(Default)]
struct Damage {
    parts: u64,
    first: Option<(u64, String)>,
}

impl Damage {
    fn note(&mut self, place: u64, why: String) {
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

/// What a message holds, of what is read here.
#[derive(Clone, Copy)]
enum MessageKind {
    Cycle,
    /// A cycle of the first version of the message: its clock is that of the step before it.
    CycleWithoutClock,
    Step,
    Plan,
}

/// What is known so far.
struct MessageReader<'a> {
    path: &'a Path,
    window: Window,
    /// Name and definition by id.
    schemas: BTreeMap<u16, (String, String)>,
    /// What the messages of a channel are.
    channels: BTreeMap<u16, MessageKind>,
    /// Bytes of the settings so far.
    settings: usize,
    elapsed: Elapsed,
    /// Code of the plant's clock in the newest step; a number that is no code before the first one.
    clock: u64,
}

impl MessageReader<'_> {
    /// Notes what a record says; the message, if it is one of the window.
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
                let first = &cycle::first_definition();
                if c.topic == CYCLE_TOPIC && self.check(c.schema_id, cycle::TYPE, first).is_ok() {
                    self.channels.insert(c.id, MessageKind::CycleWithoutClock);
                    return Ok(None);
                }
                let known = [
                    (CYCLE_TOPIC, MessageKind::Cycle, cycle::TYPE, cycle::definition()),
                    (
                        messages::STEPS.name,
                        MessageKind::Step,
                        messages::STEPS.kind,
                        messages::STEPS.definition.into(),
                    ),
                    (
                        messages::PLANS.name,
                        MessageKind::Plan,
                        messages::PLANS.kind,
                        messages::PLANS.definition.into(),
                    ),
                ];
                if let Some((_, kind, name, definition)) = known.iter().find(|(topic, ..)| c.topic == *topic)
                {
                    self.check(c.schema_id, name, definition)?;
                    self.channels.insert(c.id, *kind);
                }
            }
            Record::Message { header, data } => {
                let Some(kind) = self.channels.get(&header.channel_id) else { return Ok(None) };
                let mut words = cdr::words(&data);
                if let (MessageKind::CycleWithoutClock, Some(words)) = (kind, &mut words) {
                    words.push(self.clock);
                }
                let words = words.as_deref();
                let what = || format!("message {} has {} bytes", header.sequence, data.len());
                let other = || self.other_version(what());
                return match kind {
                    MessageKind::Cycle | MessageKind::CycleWithoutClock => {
                        let cycle = words.and_then(Telemetry::from_words).ok_or_else(other)?;
                        let t = self.elapsed.until(cycle.t_ns) as f64 * 1e-9;
                        let inside = t >= self.window.from && t <= self.window.to;
                        Ok(inside.then_some(Message::Cycle(cycle)))
                    }
                    MessageKind::Step => {
                        let step = words.and_then(Step::from_words).ok_or_else(other)?;
                        self.clock = step.measurement.clock;
                        Ok(Some(Message::Step(step)))
                    }
                    MessageKind::Plan => {
                        let plan = words.and_then(Plan::from_words).ok_or_else(other)?;
                        Ok(Some(Message::Plan(plan)))
                    }
                };
            }
            _ => {}
        }
        Ok(None)
    }

    /// Whether the messages of a schema have the name and the fields of this version.
    fn check(&self, schema: u16, expected_name: &str, expected: &str) -> Result<(), RecordingError> {
        let (name, got) = self.schemas.get(&schema).map_or(("", ""), |(n, text)| (n.as_str(), text.as_str()));
        let (expected, got) = (cycle::layout_of(expected), cycle::layout_of(got));
        if name != expected_name || expected != got {
            let differing = expected.iter().zip(&got).find(|(e, g)| e != g);
            let differing = differing.map_or_else(
                || format!("{} fields, expected {}", got.len(), expected.len()),
                |(e, g)| format!("`{g}`, expected `{e}`"),
            );
            return Err(self.other_version(format!(
                "the messages are `{name}` with {differing}, expected `{expected_name}`"
            )));
        }
        Ok(())
    }

    fn other_version(&self, what: String) -> RecordingError {
        RecordingError::Version { path: self.path.to_owned(), what }
    }
}
