//! Messages of the control cycles and of the controller's steps: the fields of [`Telemetry`] and of [`RecordedStep`], with a list in
//! place of each array of values of joints.

use super::cdr::{Cdr, CdrReader};
use std::fmt::Write;
use std::mem::offset_of;
use upswing_ipc::{Clock, Mode, RecordedStep, Telemetry};
use upswing_model::{JointKind, MOST_JOINTS, Model};

const WORD: usize = size_of::<u64>();

/// Quantity of the values of joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Position,
    Velocity,
    Acceleration,
    Force,
}

impl Quantity {
    const fn unit(self, joint: JointKind) -> &'static str {
        match (self, joint) {
            (Self::Position, JointKind::Prismatic) => "m",
            (Self::Velocity, JointKind::Prismatic) => "m/s",
            (Self::Acceleration, JointKind::Prismatic) => "m/s^2",
            (Self::Force, JointKind::Prismatic) => "N",
            (Self::Position, _) => "rad",
            (Self::Velocity, _) => "rad/s",
            (Self::Acceleration, _) => "rad/s^2",
            (Self::Force, _) => "N m",
        }
    }
}

/// Contents of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    /// An integer with a unit, which may be empty.
    Integer(&'static str),
    /// A number with a unit.
    Number(&'static str),
    /// One number per joint, in the chain's order.
    Joints(Quantity),
    /// One number per actuated joint, in the chain's order.
    Actuated(Quantity),
}

/// A field of a message.
struct Field {
    name: &'static str,
    content: Content,
    meaning: &'static str,
    /// Index of its first word in the payload.
    word: usize,
}

impl Field {
    /// Number of values of a field of a robot with `joints` joints, of which `actuated` are actuated.
    const fn length(&self, joints: usize, actuated: usize) -> usize {
        match self.content {
            Content::Integer(_) | Content::Number(_) => 1,
            Content::Joints(_) => joints,
            Content::Actuated(_) => actuated,
        }
    }
}

/// A type of messages.
pub struct MessageType {
    /// ROS type.
    pub name: &'static str,
    heading: &'static str,
    /// In the order of the payload.
    fields: &'static [Field],
    /// Number of words of the payload.
    words: usize,
    /// Index of the word with the number of joints; that of the actuated joints follows.
    sizes: usize,
}

macro_rules! payload_type {
    (Integer) => {
        u64
    };
    (Number) => {
        f64
    };
    (Joints) => {
        [f64; MOST_JOINTS]
    };
    (Actuated) => {
        [f64; MOST_JOINTS]
    };
}

macro_rules! message_type {
    ($payload:ident, $name:literal, $heading:literal, sizes: $($sizes:ident).+;
     $($field:ident: $($path:ident).+, $content:ident($unit:expr), $meaning:literal;)+) => {{
        const TYPE: MessageType = MessageType {
            name: $name,
            heading: $heading,
            fields: &[$({
                // Does not compile if the field of the payload has another type.
                const _: fn(&$payload) -> &payload_type!($content) = |payload| &payload.$($path).+;
                Field {
                    name: stringify!($field),
                    content: Content::$content($unit),
                    meaning: $meaning,
                    word: offset_of!($payload, $($path).+) / WORD,
                }
            }),+],
            words: size_of::<$payload>() / WORD,
            sizes: offset_of!($payload, $($sizes).+) / WORD,
        };
        const _: () = TYPE.assert_complete();
        TYPE
    }};
}

/// Message of a control cycle, [`Telemetry`].
pub const CYCLE: MessageType = message_type! {
    Telemetry, "upswing_msgs/msg/Cycle",
    "One control cycle of upswing. Joints run from the base to the tip; their names are in the metadata and in /joint_states.",
    sizes: joints;
    seq: seq, Integer(""), "cycle number of the daemon since its start, from 1";
    t_ns: t_ns, Integer("ns"), "start of the cycle";
    measurement_seq: measurement_seq, Integer(""), "number of the measurement used";
    mode: mode, Integer(""), "mode at the end of the cycle";
    fault: fault, Integer(""), "latched fault, 0: none";
    warnings: warnings, Integer(""), "limits beyond their warning level, one bit each";
    degraded: degraded, Integer(""), "refused of the real-time set-up, one bit each";
    plan_id: plan_id, Integer(""), "running plan, 0: none";
    flags: flags, Integer(""), "1 overrun, 2 stale measurement, 4 torque limited, 8 brakes closed";
    t_plan: t_plan, Number("s"), "time since the start of the plan";
    q: q, Joints(Quantity::Position), "measured positions of all joints";
    qd: qd, Joints(Quantity::Velocity), "estimated velocities";
    q_d: q_d, Joints(Quantity::Position), "desired positions";
    qd_d: qd_d, Joints(Quantity::Velocity), "desired velocities";
    u_d: u_d, Actuated(Quantity::Acceleration), "desired accelerations of the actuated joints";
    u: u, Actuated(Quantity::Acceleration), "the same after feedback";
    tau: tau, Actuated(Quantity::Force), "commanded torques";
    tau_measured: tau_measured, Actuated(Quantity::Force), "measured torques";
    wake_ns: wake_ns, Integer("ns"), "lateness of the wake-up";
    read_ns: read_ns, Integer("ns"), "reading the measurement";
    compute_ns: compute_ns, Integer("ns"), "computing the command";
    write_ns: write_ns, Integer("ns"), "writing the command";
    clock: clock, Integer(""), "clock of the plant";
};

/// Message of a step of the controller, [`RecordedStep`].
pub const STEP: MessageType = message_type! {
    RecordedStep, "upswing_msgs/msg/Step",
    "Input of the controller of upswing in one step. Joints run from the base to the tip.",
    sizes: measurement.joints;
    number: number, Integer(""), "number of the step, from 1";
    cycle: cycle, Integer(""), "number of the cycle that it is, or that came before it";
    now_ns: now_ns, Integer("ns"), "planned time of the cycle on the wall clock";
    late: late, Integer(""), "cycles in a row that had ended late";
    lost: lost, Integer(""), "cycles after which measurements counted as lost, 0: they had come";
    restarted: restarted, Integer(""), "1: the measurements of another plant begin";
    order: request, Integer(""), "0: none, 1: load a plan, 2: enable, 3: hold, 4: start, 5: stop, 6: reset, 7: shutdown";
    plan_id: plan_id, Integer(""), "plan to load or start, 0: none";
    measurement_seq: measurement.seq, Integer(""), "number of the newest measurement";
    measurement_t_ns: measurement.t_ns, Integer("ns"), "its time";
    q: measurement.q, Joints(Quantity::Position), "measured positions of all joints";
    tau_measured: measurement.tau_measured, Actuated(Quantity::Force), "measured torques of the actuated joints";
    status: measurement.status, Integer(""), "1 brakes closed, 2 drives ready, 4 torque cut, 8 drive fault, 16 load sensed";
    clock: measurement.clock, Integer(""), "clock of the plant";
    period_ns: measurement.period_ns, Integer("ns"), "period of the plant";
};

impl MessageType {
    /// Fails unless the fields are all words of the payload, in their order.
    const fn assert_complete(&self) {
        let (mut words, mut i) = (0, 0);
        while i < self.fields.len() {
            if words == self.sizes {
                words += 2;
            }
            assert!(self.fields[i].word == words);
            words += self.fields[i].length(MOST_JOINTS, MOST_JOINTS);
            i += 1;
        }
        assert!(words == self.words);
    }

    /// Definition of the message in the language of ROS 2.
    pub fn definition(&self) -> String {
        let mut text = format!("# {}\n", self.heading);
        for Field { name, content, meaning, .. } in self.fields {
            // Foxglove shows the names of constants that stand before a field.
            let codes: Vec<String> = match *name {
                "mode" => Mode::ALL.iter().map(Mode::to_string).collect(),
                "clock" => Clock::ALL.iter().map(Clock::to_string).collect(),
                _ => Vec::new(),
            };
            for (code, name) in codes.iter().enumerate() {
                let _ = writeln!(text, "uint64 {}={code}", name.to_uppercase());
            }
            let (kind, unit) = match content {
                Content::Integer(unit) => ("uint64", (*unit).to_owned()),
                Content::Number(unit) => ("float64", (*unit).to_owned()),
                Content::Joints(quantity) | Content::Actuated(quantity) => {
                    let [turning, sliding] =
                        [JointKind::Revolute, JointKind::Prismatic].map(|kind| quantity.unit(kind));
                    ("float64[]", format!("{turning} or {sliding}"))
                }
            };
            let comma = if unit.is_empty() { "" } else { ", " };
            let _ = writeln!(text, "{kind} {name}  # {meaning}{comma}{unit}");
        }
        text
    }

    /// Encodes the words of a payload as a message.
    pub fn encode(&self, payload: impl Iterator<Item = u64>) -> Vec<u8> {
        let payload: Vec<u64> = payload.collect();
        let number = |word: usize| usize::try_from(payload[word]).map_or(MOST_JOINTS, |n| n.min(MOST_JOINTS));
        let (joints, actuated) = (number(self.sizes), number(self.sizes + 1));
        let mut cdr = Cdr::new();
        for field in self.fields {
            let length = field.length(joints, actuated);
            if let Content::Joints(_) | Content::Actuated(_) = field.content {
                cdr.length(length);
            }
            payload[field.word..field.word + length].iter().for_each(|word| cdr.u64(*word));
        }
        cdr.bytes()
    }

    /// Decodes the words of the payload in a message; `None` if the message has another length or header, more than [`MOST_JOINTS`]
    /// joints, or lists of different lengths.
    pub fn decode(&self, message: &[u8]) -> Option<Vec<u64>> {
        let mut cdr = CdrReader::new(message)?;
        let mut payload = vec![0; self.words];
        let mut sizes = [None; 2];
        for field in self.fields {
            let size = match field.content {
                Content::Integer(_) | Content::Number(_) => None,
                Content::Joints(_) => Some(&mut sizes[0]),
                Content::Actuated(_) => Some(&mut sizes[1]),
            };
            let length = match size {
                None => 1,
                Some(size) => {
                    let length = cdr.length().filter(|length| *length <= MOST_JOINTS)?;
                    (*size.get_or_insert(length) == length).then_some(length)?
                }
            };
            for word in &mut payload[field.word..field.word + length] {
                *word = cdr.u64()?;
            }
        }
        for (word, size) in payload[self.sizes..].iter_mut().zip(sizes) {
            *word = size? as u64;
        }
        cdr.is_empty().then_some(payload)
    }
}

/// The lines of a definition without its comments.
pub fn layout_of(definition: &str) -> Vec<&str> {
    let code = definition.lines().map(|line| line.split('#').next().unwrap_or("").trim());
    code.filter(|line| !line.is_empty()).collect()
}

/// One of the numbers in the record of a cycle of a robot.
#[derive(Clone, Debug)]
pub struct CycleNumber {
    /// Name of the field in [`Telemetry`].
    pub field: &'static str,
    /// Name of the joint; `None` if the field is one number.
    pub joint: Option<String>,
    /// Unit; empty if the number has none.
    pub unit: &'static str,
    is_integer: bool,
    word: usize,
}

impl CycleNumber {
    /// All numbers in the records of the cycles of a robot, in their order.
    pub fn all(model: &Model) -> Vec<Self> {
        let sizes = model.sizes();
        let numbers = CYCLE.fields.iter().flat_map(|field| {
            (0..field.length(sizes.joints(), sizes.actuated())).map(move |i| {
                let of_joint = |coordinate, quantity: Quantity| {
                    let name = model.joint_name(coordinate).to_owned();
                    (Some(name), quantity.unit(model.joint_kind(coordinate)))
                };
                let (joint, unit) = match field.content {
                    Content::Integer(unit) | Content::Number(unit) => (None, unit),
                    Content::Joints(quantity) => of_joint(model.order().coordinate(i), quantity),
                    // The order of the actuated joints is the same in the chain and in sorted vectors.
                    Content::Actuated(quantity) => of_joint(i, quantity),
                };
                let is_integer = matches!(field.content, Content::Integer(_));
                Self { field: field.name, joint, unit, is_integer, word: field.word + i }
            })
        });
        numbers.collect()
    }

    /// The bits of the number in the record with these words ([`Telemetry::words`]).
    pub fn bits(&self, record: &[u64]) -> u64 {
        record[self.word]
    }

    /// The number in the record with these words as text.
    pub fn text(&self, record: &[u64]) -> String {
        let bits = self.bits(record);
        if self.is_integer { bits.to_string() } else { f64::from_bits(bits).to_string() }
    }
}
