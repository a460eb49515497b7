//! The layouts as the compiler made them, in Python.

use iceoryx2::prelude::ZeroCopySend;
use std::fmt::{Debug, Write};
use std::mem::offset_of;
use upswing_ipc::{
    BlackboardPayload, Clock, Command, ControlKind, ControlRequest, ControlResponse, Degradation, Domain,
    MAX_NODES, MAX_READERS, ManoeuvreRequest, Measurement, Mode, Name, Percentiles, PlanHeader, PlanMessage,
    PlannerKind, PlannerRequest, PlannerResponse, PlannerStatus, PlantKind, PlantRequest, PlantResponse,
    Readiness, RequestPayload, Telemetry, TelemetryBatch, Text, TopicPayload,
};
use upswing_model::MOST_JOINTS;

const HEAD: &str = r#""""What crosses the shared memory of upswing: payloads, codes, services.

Generated from the Rust definitions; ipc/src/payload/ says what each field means, and in which unit:

    cargo run --release -p upswing-ipc --example python_layouts > examples/python/upswing_layouts.py
"""

from ctypes import Structure, c_double, c_uint8, c_uint64
from enum import IntEnum
"#;

/// A Rust type and its name in ctypes.
trait Ctype {
    fn ctype() -> String;
}

macro_rules! plain {
    ($($rust:ty => $python:literal),+) => {
        $(impl Ctype for $rust {
            fn ctype() -> String {
                $python.to_owned()
            }
        })+
    };
}

plain!(u64 => "c_uint64", f64 => "c_double", u8 => "c_uint8");
plain!(Text => "Text", Percentiles => "Percentiles", Telemetry => "Telemetry");
plain!(Name => "Name", ManoeuvreRequest => "ManoeuvreRequest");

impl<T: Ctype, const N: usize> Ctype for [T; N] {
    fn ctype() -> String {
        format!("({} * {N})", T::ctype())
    }
}

fn ctype_of<S, F: Ctype>(_: fn(&S) -> &F) -> String {
    F::ctype()
}

/// A class; the compiler refuses a list of fields that is not complete.
macro_rules! class {
    ($out:ident, $rust:ident { $($field:ident),+ $(,)? }) => {{
        let _complete = |all: &$rust| { let $rust { $($field: _),+ } = all; };
        let mut fields = vec![
            $((offset_of!($rust, $field), stringify!($field), ctype_of(|all: &$rust| &all.$field))),+
        ];
        fields.sort_unstable();
        class::<$rust>($out, stringify!($rust), &fields);
    }};
}

/// Offsets and size are written down as well, so that Python can check that ctypes laid the fields out in the same way.
fn class<T: ZeroCopySend>(out: &mut String, name: &str, fields: &[(usize, &str, String)]) {
    // SAFETY: the name is only printed.
    let type_name = unsafe { <T as ZeroCopySend>::type_name() };
    let list: String =
        fields.iter().map(|(_, field, ctype)| format!("        (\"{field}\", {ctype}),\n")).collect();
    let offsets: String =
        fields.iter().map(|(offset, field, _)| format!("        \"{field}\": {offset},\n")).collect();
    let size = size_of::<T>();
    let _ = write!(
        out,
        "\n\nclass {name}(Structure):\n    SIZE = {size}\n    OFFSETS = {{\n{offsets}    }}\n    _fields_ = [\n{list}    ]\n\n    \
         @staticmethod\n    def type_name():\n        return \"{type_name}\"\n"
    );
}

/// Numbers of an enumeration, which are its indices.
fn codes<T: Debug>(out: &mut String, name: &str, all: &[T]) {
    let _ = write!(out, "\n\nclass {name}(IntEnum):\n");
    for (code, variant) in all.iter().enumerate() {
        let _ = writeln!(out, "    {variant:?} = {code}");
    }
}

fn constants(out: &mut String, constants: &[(&str, u64)]) {
    for (name, value) in constants {
        let _ = writeln!(out, "{name} = {value}");
    }
}

/// The whole module.
pub fn module() -> String {
    let mut text = HEAD.to_owned();
    let out = &mut text;
    class!(out, Text { len, bytes });
    class!(out, Percentiles { count, p50, p99, p99_9, p99_99, max });
    class!(out, Measurement { seq, t_ns, joints, actuated, q, tau_measured, status, clock, period_ns });
    class!(out, Command { seq, t_ns, measurement_seq, joints, actuated, tau, brake });
    class!(
        out,
        Telemetry {
            seq,
            t_ns,
            measurement_seq,
            mode,
            fault,
            warnings,
            degraded,
            plan_id,
            flags,
            t_plan,
            joints,
            actuated,
            q,
            qd,
            q_d,
            qd_d,
            u_d,
            u,
            tau,
            tau_measured,
            wake_ns,
            read_ns,
            compute_ns,
            write_ns,
            clock
        }
    );
    class!(out, TelemetryBatch { count, dropped, records });
    class!(
        out,
        PlanHeader { id, fingerprint, activation_ns, replaces, t_f, joints, actuated, intervals, checksum }
    );
    class!(out, ControlRequest { kind, plan_id });
    class!(
        out,
        ControlResponse {
            accepted,
            mode,
            readiness,
            fault,
            warnings,
            plan_id,
            running_plan,
            seq,
            t_ns,
            degraded,
            overruns,
            wake,
            compute,
            overrun,
            reason,
            next
        }
    );
    class!(out, Name { bytes });
    class!(out, ManoeuvreRequest { name, number, given });
    class!(
        out,
        PlannerRequest {
            kind,
            from_now,
            known_seq,
            joints,
            actuated,
            q,
            qd,
            manoeuvre,
            iterations,
            budget_ms,
            publish
        }
    );
    class!(
        out,
        PlannerResponse {
            status,
            plan_id,
            activation_ns,
            t_f,
            nearest_entry,
            distance,
            iterations,
            defect,
            margin_q,
            margin_qd,
            margin_tau,
            time_nearest_us,
            time_qp_us,
            time_lqr_us,
            time_total_us,
            reason,
        }
    );
    class!(out, PlantRequest { kind, joints, actuated, q, qd, seq, fault, joint, amount, cycles, impulse });
    class!(out, PlantResponse { accepted, seq, joints, actuated, q, qd, brakes_closed, tau_peak, reason });
    codes(out, "Clock", Clock::ALL);
    codes(out, "Mode", Mode::ALL);
    codes(out, "Readiness", Readiness::ALL);
    codes(out, "ControlKind", ControlKind::ALL);
    codes(out, "Degradation", Degradation::ALL);
    codes(out, "PlannerKind", PlannerKind::ALL);
    codes(out, "PlannerStatus", PlannerStatus::ALL);
    codes(out, "PlantKind", PlantKind::ALL);
    out.push_str("\n\n# Bits of Measurement.status.\n");
    let status = [
        ("BRAKES_CLOSED", Measurement::BRAKES_CLOSED),
        ("DRIVES_READY", Measurement::DRIVES_READY),
        ("SATURATED", Measurement::SATURATED),
        ("DRIVE_FAULT", Measurement::DRIVE_FAULT),
        ("LOAD_SENSED", Measurement::LOAD_SENSED),
    ];
    constants(out, &status);
    out.push_str("\n# Bits of Telemetry.flags.\n");
    let flags = [
        ("OVERRUN", Telemetry::OVERRUN),
        ("STALE", Telemetry::STALE),
        ("LIMITED", Telemetry::LIMITED),
        ("BRAKE", Telemetry::BRAKE),
    ];
    constants(out, &flags);
    out.push_str("\n# Room of an array with a value per joint.\n");
    constants(out, &[("MOST_JOINTS", MOST_JOINTS as u64)]);
    services(out);
    text
}

fn services(out: &mut String) {
    out.push_str("\n# Blackboards: each start of a writer has its own service, CHANNEL/EPOCH.\n");
    let _ = writeln!(out, "MEASUREMENT_CHANNEL = \"{}\"", Measurement::CHANNEL);
    let _ = writeln!(out, "COMMAND_CHANNEL = \"{}\"", Command::CHANNEL);
    constants(out, &[("MAX_READERS", MAX_READERS as u64), ("MAX_NODES", MAX_NODES as u64)]);
    out.push_str("\n# Publish and subscribe: service, payload, samples that wait for a slow subscriber.\n");
    let _ = writeln!(
        out,
        "TELEMETRY = (\"{}\", TelemetryBatch, {})",
        TelemetryBatch::SERVICE,
        TelemetryBatch::BUFFER
    );
    out.push_str("\n# The same with a header and a slice of c_double.\n");
    let _ = writeln!(out, "PLAN = (\"{}\", PlanHeader, {})", PlanMessage::SERVICE, PlanMessage::BUFFER);
    out.push_str("\n# Request and response: service, request, response.\n");
    let _ = writeln!(out, "CONTROL = (\"{}\", ControlRequest, ControlResponse)", ControlRequest::SERVICE);
    let _ = writeln!(out, "PLANNER = (\"{}\", PlannerRequest, PlannerResponse)", PlannerRequest::SERVICE);
    let _ = writeln!(out, "PLANT = (\"{}\", PlantRequest, PlantResponse)", PlantRequest::SERVICE);
    let _ = writeln!(out, "\n# Longest name of a domain, characters.\nMAX_DOMAIN = {}", Domain::MAX_NAME);
}
