"""What crosses the shared memory of upswing: payloads, codes, services.

Generated from the Rust definitions; ipc/src/payload/ says what each field means, and in which unit:

    cargo run --release -p upswing-ipc --example python_layouts > examples/python/upswing_layouts.py
"""

from ctypes import Structure, c_double, c_uint8, c_uint64
from enum import IntEnum


class Text(Structure):
    SIZE = 256
    OFFSETS = {
        "len": 0,
        "bytes": 8,
    }
    _fields_ = [
        ("len", c_uint64),
        ("bytes", (c_uint8 * 248)),
    ]

    @staticmethod
    def type_name():
        return "upswing.Text.v1"


class Percentiles(Structure):
    SIZE = 48
    OFFSETS = {
        "count": 0,
        "p50": 8,
        "p99": 16,
        "p99_9": 24,
        "p99_99": 32,
        "max": 40,
    }
    _fields_ = [
        ("count", c_uint64),
        ("p50", c_uint64),
        ("p99", c_uint64),
        ("p99_9", c_uint64),
        ("p99_99", c_uint64),
        ("max", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Percentiles.v1"


class Measurement(Structure):
    SIZE = 168
    OFFSETS = {
        "seq": 0,
        "t_ns": 8,
        "q": 16,
        "tau_measured": 88,
        "status": 144,
        "clock": 152,
        "period_ns": 160,
    }
    _fields_ = [
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("q", (c_double * 9)),
        ("tau_measured", (c_double * 7)),
        ("status", c_uint64),
        ("clock", c_uint64),
        ("period_ns", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Measurement.v1"


class Command(Structure):
    SIZE = 88
    OFFSETS = {
        "seq": 0,
        "t_ns": 8,
        "measurement_seq": 16,
        "tau": 24,
        "brake": 80,
    }
    _fields_ = [
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("measurement_seq", c_uint64),
        ("tau", (c_double * 7)),
        ("brake", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Command.v1"


class Telemetry(Structure):
    SIZE = 632
    OFFSETS = {
        "seq": 0,
        "t_ns": 8,
        "measurement_seq": 16,
        "mode": 24,
        "fault": 32,
        "warnings": 40,
        "degraded": 48,
        "plan_id": 56,
        "flags": 64,
        "t_plan": 72,
        "q": 80,
        "qd": 152,
        "q_d": 224,
        "qd_d": 296,
        "u_d": 368,
        "u": 424,
        "tau": 480,
        "tau_measured": 536,
        "wake_ns": 592,
        "read_ns": 600,
        "compute_ns": 608,
        "write_ns": 616,
        "clock": 624,
    }
    _fields_ = [
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("measurement_seq", c_uint64),
        ("mode", c_uint64),
        ("fault", c_uint64),
        ("warnings", c_uint64),
        ("degraded", c_uint64),
        ("plan_id", c_uint64),
        ("flags", c_uint64),
        ("t_plan", c_double),
        ("q", (c_double * 9)),
        ("qd", (c_double * 9)),
        ("q_d", (c_double * 9)),
        ("qd_d", (c_double * 9)),
        ("u_d", (c_double * 7)),
        ("u", (c_double * 7)),
        ("tau", (c_double * 7)),
        ("tau_measured", (c_double * 7)),
        ("wake_ns", c_uint64),
        ("read_ns", c_uint64),
        ("compute_ns", c_uint64),
        ("write_ns", c_uint64),
        ("clock", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Telemetry.v3"


class TelemetryBatch(Structure):
    SIZE = 40464
    OFFSETS = {
        "count": 0,
        "dropped": 8,
        "records": 16,
    }
    _fields_ = [
        ("count", c_uint64),
        ("dropped", c_uint64),
        ("records", (Telemetry * 64)),
    ]

    @staticmethod
    def type_name():
        return "upswing.TelemetryBatch.v3"


class PlanMessage(Structure):
    SIZE = 137600
    OFFSETS = {
        "id": 0,
        "fingerprint": 8,
        "activation_ns": 16,
        "t_f": 24,
        "x": 32,
        "u": 14576,
        "f": 20232,
        "k": 34776,
        "k_final": 136584,
        "checksum": 137592,
    }
    _fields_ = [
        ("id", c_uint64),
        ("fingerprint", c_uint64),
        ("activation_ns", c_uint64),
        ("t_f", c_double),
        ("x", ((c_double * 18) * 101)),
        ("u", ((c_double * 7) * 101)),
        ("f", ((c_double * 18) * 101)),
        ("k", (((c_double * 18) * 7) * 101)),
        ("k_final", ((c_double * 18) * 7)),
        ("checksum", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Plan.v2"


class ControlRequest(Structure):
    SIZE = 16
    OFFSETS = {
        "kind": 0,
        "plan_id": 8,
    }
    _fields_ = [
        ("kind", c_uint64),
        ("plan_id", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.ControlRequest.v2"


class ControlResponse(Structure):
    SIZE = 952
    OFFSETS = {
        "accepted": 0,
        "mode": 8,
        "readiness": 16,
        "fault": 24,
        "warnings": 32,
        "plan_id": 40,
        "running_plan": 48,
        "seq": 56,
        "t_ns": 64,
        "degraded": 72,
        "overruns": 80,
        "wake": 88,
        "compute": 136,
        "overrun": 184,
        "reason": 440,
        "next": 696,
    }
    _fields_ = [
        ("accepted", c_uint64),
        ("mode", c_uint64),
        ("readiness", c_uint64),
        ("fault", c_uint64),
        ("warnings", c_uint64),
        ("plan_id", c_uint64),
        ("running_plan", c_uint64),
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("degraded", c_uint64),
        ("overruns", c_uint64),
        ("wake", Percentiles),
        ("compute", Percentiles),
        ("overrun", Text),
        ("reason", Text),
        ("next", Text),
    ]

    @staticmethod
    def type_name():
        return "upswing.ControlResponse.v5"


class PlannerRequest(Structure):
    SIZE = 184
    OFFSETS = {
        "kind": 0,
        "from_now": 8,
        "start": 16,
        "iterations": 160,
        "budget_ms": 168,
        "publish": 176,
    }
    _fields_ = [
        ("kind", c_uint64),
        ("from_now", c_uint64),
        ("start", (c_double * 18)),
        ("iterations", c_uint64),
        ("budget_ms", c_uint64),
        ("publish", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlannerRequest.v1"


class PlannerResponse(Structure):
    SIZE = 376
    OFFSETS = {
        "status": 0,
        "plan_id": 8,
        "activation_ns": 16,
        "t_f": 24,
        "nearest_entry": 32,
        "distance": 40,
        "iterations": 48,
        "defect": 56,
        "margin_q": 64,
        "margin_qd": 72,
        "margin_tau": 80,
        "time_nearest_us": 88,
        "time_qp_us": 96,
        "time_lqr_us": 104,
        "time_total_us": 112,
        "reason": 120,
    }
    _fields_ = [
        ("status", c_uint64),
        ("plan_id", c_uint64),
        ("activation_ns", c_uint64),
        ("t_f", c_double),
        ("nearest_entry", c_uint64),
        ("distance", c_double),
        ("iterations", c_uint64),
        ("defect", c_double),
        ("margin_q", c_double),
        ("margin_qd", c_double),
        ("margin_tau", c_double),
        ("time_nearest_us", c_double),
        ("time_qp_us", c_double),
        ("time_lqr_us", c_double),
        ("time_total_us", c_double),
        ("reason", Text),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlannerResponse.v3"


class PlantRequest(Structure):
    SIZE = 216
    OFFSETS = {
        "kind": 0,
        "q": 8,
        "qd": 80,
        "seq": 152,
        "fault": 160,
        "joint": 168,
        "amount": 176,
        "cycles": 184,
        "impulse": 192,
    }
    _fields_ = [
        ("kind", c_uint64),
        ("q", (c_double * 9)),
        ("qd", (c_double * 9)),
        ("seq", c_uint64),
        ("fault", c_uint64),
        ("joint", c_uint64),
        ("amount", c_double),
        ("cycles", c_uint64),
        ("impulse", (c_double * 3)),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlantRequest.v2"


class PlantResponse(Structure):
    SIZE = 480
    OFFSETS = {
        "accepted": 0,
        "seq": 8,
        "q": 16,
        "qd": 88,
        "brakes_closed": 160,
        "tau_peak": 168,
        "reason": 224,
    }
    _fields_ = [
        ("accepted", c_uint64),
        ("seq", c_uint64),
        ("q", (c_double * 9)),
        ("qd", (c_double * 9)),
        ("brakes_closed", c_uint64),
        ("tau_peak", (c_double * 7)),
        ("reason", Text),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlantResponse.v1"


class Clock(IntEnum):
    Wall = 0
    Paced = 1
    Lockstep = 2


class Mode(IntEnum):
    Idle = 0
    Hold = 1
    Track = 2
    Balance = 3
    Stop = 4
    Fault = 5


class Readiness(IntEnum):
    Ready = 0
    NoMeasurement = 1
    DrivesNotReady = 2
    Unfit = 3


class ControlKind(IntEnum):
    Enable = 0
    Hold = 1
    Stop = 2
    Reset = 3
    Status = 4
    Start = 5


class Degradation(IntEnum):
    Memory = 0
    Scheduler = 1
    Cpu = 2
    TimerSlack = 3
    DmaLatency = 4


class PlannerKind(IntEnum):
    SwingUp = 0
    Status = 1
    SwingDown = 2


class PlannerStatus(IntEnum):
    Solved = 0
    BadRequest = 1
    StartOutsideLimits = 2
    Infeasible = 3
    NotReady = 4
    Deadline = 5
    OpenDefect = 6


class PlantKind(IntEnum):
    ResetState = 0
    AdvanceTo = 1
    SetFault = 2
    ClearFaults = 3
    Status = 4
    Push = 5


# Bits of Measurement.status.
BRAKES_CLOSED = 1
DRIVES_READY = 2
SATURATED = 4
DRIVE_FAULT = 8
LOAD_SENSED = 16

# Bits of Telemetry.flags.
OVERRUN = 1
STALE = 2
LIMITED = 4
BRAKE = 8

# Blackboards: each start of a writer has its own service, CHANNEL/EPOCH.
MEASUREMENT_CHANNEL = "measurement"
COMMAND_CHANNEL = "command"
MAX_READERS = 8
MAX_NODES = 24

# Publish and subscribe: service, payload, samples that wait for a slow subscriber.
PLAN = ("plan", PlanMessage, 2)
TELEMETRY = ("telemetry", TelemetryBatch, 256)

# Request and response: service, request, response.
CONTROL = ("control", ControlRequest, ControlResponse)
PLANNER = ("planner", PlannerRequest, PlannerResponse)
PLANT = ("plant", PlantRequest, PlantResponse)

# Longest name of a domain, characters.
MAX_DOMAIN = 32
