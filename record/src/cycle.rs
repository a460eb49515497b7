//! The message of a control cycle: all fields of [`Telemetry`], in the order of that type.

use super::cdr;
use std::fmt::Write;
use std::mem::offset_of;
use upswing_ipc::{Clock, Mode, Telemetry};
use upswing_model::{NQ, NU};

/// ROS type of the message.
pub const TYPE: &str = "upswing_msgs/msg/Cycle";
const WORD: usize = size_of::<u64>();

/// A field of the message of a cycle.
#[derive(Clone, Copy, Debug)]
pub struct CycleField {
    /// Name of the field in [`Telemetry`].
    pub name: &'static str,
    /// Count of numbers in the field: 1, or the length of the array.
    pub length: usize,
    /// Whether the numbers are integers.
    pub integer: bool,
    /// Offset from the start of the message, words of 8 bytes.
    pub offset: usize,
    /// Unit; empty if the field has none.
    pub unit: &'static str,
    /// Meaning of the field.
    pub meaning: &'static str,
}

/// Types of fields.
trait FieldValue {
    const LENGTH: usize;
    const INTEGER: bool;
}

impl FieldValue for u64 {
    const LENGTH: usize = 1;
    const INTEGER: bool = true;
}

impl FieldValue for f64 {
    const LENGTH: usize = 1;
    const INTEGER: bool = false;
}

impl<const N: usize> FieldValue for [f64; N] {
    const LENGTH: usize = N;
    const INTEGER: bool = false;
}

macro_rules! fields {
    ($($name:ident: $kind:ty, $unit:literal, $meaning:literal;)+) => {
        /// All fields in the order of their bytes.
        pub const FIELDS: &[CycleField] = &[$({
            // Does not compile if the field of `Telemetry` has another type.
            const _: fn(&Telemetry) -> &$kind = |t| &t.$name;
            CycleField {
                name: stringify!($name),
                length: <$kind as FieldValue>::LENGTH,
                integer: <$kind as FieldValue>::INTEGER,
                offset: offset_of!(Telemetry, $name) / WORD,
                unit: $unit,
                meaning: $meaning,
            }
        }),+];
    };
}

fields! {
    seq: u64, "", "cycle number of the daemon since its start, from 1";
    t_ns: u64, "ns", "start of the cycle";
    measurement_seq: u64, "", "number of the measurement used";
    mode: u64, "", "mode at the end of the cycle";
    fault: u64, "", "latched fault, 0: none";
    warnings: u64, "", "limits beyond their warning level, one bit each";
    degraded: u64, "", "refused of the real-time set-up, one bit each";
    plan_id: u64, "", "running plan, 0: none";
    flags: u64, "", "1 overrun, 2 stale measurement, 4 torque limited, 8 brakes closed";
    t_plan: f64, "s", "time since the start of the plan";
    q: [f64; NQ], "rad", "measured positions of joints 1-9";
    qd: [f64; NQ], "rad/s", "estimated velocities";
    q_d: [f64; NQ], "rad", "desired positions";
    qd_d: [f64; NQ], "rad/s", "desired velocities";
    u_d: [f64; NU], "rad/s^2", "desired accelerations of joints 1-7";
    u: [f64; NU], "rad/s^2", "the same after feedback";
    tau: [f64; NU], "N m", "commanded torques";
    tau_measured: [f64; NU], "N m", "measured torques";
    wake_ns: u64, "ns", "lateness of the wake-up";
    read_ns: u64, "ns", "reading the measurement";
    compute_ns: u64, "ns", "computing the command";
    write_ns: u64, "ns", "writing the command";
    clock: u64, "", "clock of the plant";
}

// The fields are contiguous and complete.
const _: () = {
    let mut words = 0;
    let mut i = 0;
    while i < FIELDS.len() {
        assert!(FIELDS[i].offset == words);
        words += FIELDS[i].length;
        i += 1;
    }
    assert!(words * WORD == size_of::<Telemetry>());
};

/// Definition of the message in the language of ROS 2.
pub fn definition() -> String {
    definition_of(FIELDS)
}

/// Definition of the message in the first version of recordings, which lacks the last field, `clock`.
pub fn first_definition() -> String {
    definition_of(&FIELDS[..FIELDS.len() - 1])
}

fn definition_of(fields: &[CycleField]) -> String {
    let mut text = String::from("# One control cycle of upswing. Joints run from the base to the tip.\n");
    for field in fields {
        // Foxglove shows the names of constants that stand before a field.
        let names: Vec<String> = match field.name {
            "mode" => Mode::ALL.iter().map(Mode::to_string).collect(),
            "clock" => Clock::ALL.iter().map(Clock::to_string).collect(),
            _ => Vec::new(),
        };
        for (code, name) in names.iter().enumerate() {
            let _ = writeln!(text, "uint64 {}={code}", name.to_uppercase());
        }
        let kind = if field.integer { "uint64" } else { "float64" };
        let array = if field.length > 1 { format!("[{}]", field.length) } else { String::new() };
        let unit = if field.unit.is_empty() { String::new() } else { format!(", {}", field.unit) };
        let _ = writeln!(text, "{kind}{array} {}  # {}{unit}", field.name, field.meaning);
    }
    text
}

/// The lines of a definition without its comments.
pub fn layout_of(definition: &str) -> Vec<&str> {
    let code = definition.lines().map(|line| line.split('#').next().unwrap_or("").trim());
    code.filter(|line| !line.is_empty()).collect()
}

/// Encodes a record as a message.
pub fn encode(record: &Telemetry) -> Vec<u8> {
    cdr::of_words(record.words())
}

/// Decodes the record in a message; `None` if the message has another size or header.
pub fn decode(message: &[u8]) -> Option<Telemetry> {
    Telemetry::from_words(&cdr::words(message)?)
}
