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
    SIZE = 312
    OFFSETS = {
        "seq": 0,
        "t_ns": 8,
        "joints": 16,
        "actuated": 24,
        "q": 32,
        "tau_measured": 160,
        "status": 288,
        "clock": 296,
        "period_ns": 304,
    }
    _fields_ = [
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("q", (c_double * 16)),
        ("tau_measured", (c_double * 16)),
        ("status", c_uint64),
        ("clock", c_uint64),
        ("period_ns", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Measurement.v2"


class Command(Structure):
    SIZE = 176
    OFFSETS = {
        "seq": 0,
        "t_ns": 8,
        "measurement_seq": 16,
        "joints": 24,
        "actuated": 32,
        "tau": 40,
        "brake": 168,
    }
    _fields_ = [
        ("seq", c_uint64),
        ("t_ns", c_uint64),
        ("measurement_seq", c_uint64),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("tau", (c_double * 16)),
        ("brake", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Command.v2"


class Telemetry(Structure):
    SIZE = 1160
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
        "joints": 80,
        "actuated": 88,
        "q": 96,
        "qd": 224,
        "q_d": 352,
        "qd_d": 480,
        "u_d": 608,
        "u": 736,
        "tau": 864,
        "tau_measured": 992,
        "wake_ns": 1120,
        "read_ns": 1128,
        "compute_ns": 1136,
        "write_ns": 1144,
        "clock": 1152,
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
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("q", (c_double * 16)),
        ("qd", (c_double * 16)),
        ("q_d", (c_double * 16)),
        ("qd_d", (c_double * 16)),
        ("u_d", (c_double * 16)),
        ("u", (c_double * 16)),
        ("tau", (c_double * 16)),
        ("tau_measured", (c_double * 16)),
        ("wake_ns", c_uint64),
        ("read_ns", c_uint64),
        ("compute_ns", c_uint64),
        ("write_ns", c_uint64),
        ("clock", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Telemetry.v4"


class TelemetryBatch(Structure):
    SIZE = 74256
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
        return "upswing.TelemetryBatch.v4"


class PlanHeader(Structure):
    SIZE = 72
    OFFSETS = {
        "id": 0,
        "fingerprint": 8,
        "activation_ns": 16,
        "replaces": 24,
        "t_f": 32,
        "joints": 40,
        "actuated": 48,
        "intervals": 56,
        "checksum": 64,
    }
    _fields_ = [
        ("id", c_uint64),
        ("fingerprint", c_uint64),
        ("activation_ns", c_uint64),
        ("replaces", c_uint64),
        ("t_f", c_double),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("intervals", c_uint64),
        ("checksum", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.Plan.v4"


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


class Name(Structure):
    SIZE = 32
    OFFSETS = {
        "bytes": 0,
    }
    _fields_ = [
        ("bytes", (c_uint8 * 32)),
    ]

    @staticmethod
    def type_name():
        return "upswing.Name.v1"


class ManoeuvreRequest(Structure):
    SIZE = 168
    OFFSETS = {
        "name": 0,
        "number": 32,
        "given": 40,
    }
    _fields_ = [
        ("name", Name),
        ("number", c_uint64),
        ("given", (c_double * 16)),
    ]

    @staticmethod
    def type_name():
        return "upswing.ManoeuvreRequest.v1"


class PlannerRequest(Structure):
    SIZE = 488
    OFFSETS = {
        "kind": 0,
        "from_now": 8,
        "known_seq": 16,
        "joints": 24,
        "actuated": 32,
        "q": 40,
        "qd": 168,
        "manoeuvre": 296,
        "iterations": 464,
        "budget_ms": 472,
        "publish": 480,
    }
    _fields_ = [
        ("kind", c_uint64),
        ("from_now", c_uint64),
        ("known_seq", c_uint64),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("q", (c_double * 16)),
        ("qd", (c_double * 16)),
        ("manoeuvre", ManoeuvreRequest),
        ("iterations", c_uint64),
        ("budget_ms", c_uint64),
        ("publish", c_uint64),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlannerRequest.v4"


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
    SIZE = 344
    OFFSETS = {
        "kind": 0,
        "joints": 8,
        "actuated": 16,
        "q": 24,
        "qd": 152,
        "seq": 280,
        "fault": 288,
        "joint": 296,
        "amount": 304,
        "cycles": 312,
        "impulse": 320,
    }
    _fields_ = [
        ("kind", c_uint64),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("q", (c_double * 16)),
        ("qd", (c_double * 16)),
        ("seq", c_uint64),
        ("fault", c_uint64),
        ("joint", c_uint64),
        ("amount", c_double),
        ("cycles", c_uint64),
        ("impulse", (c_double * 3)),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlantRequest.v3"


class PlantResponse(Structure):
    SIZE = 680
    OFFSETS = {
        "accepted": 0,
        "seq": 8,
        "joints": 16,
        "actuated": 24,
        "q": 32,
        "qd": 160,
        "brakes_closed": 288,
        "tau_peak": 296,
        "reason": 424,
    }
    _fields_ = [
        ("accepted", c_uint64),
        ("seq", c_uint64),
        ("joints", c_uint64),
        ("actuated", c_uint64),
        ("q", (c_double * 16)),
        ("qd", (c_double * 16)),
        ("brakes_closed", c_uint64),
        ("tau_peak", (c_double * 16)),
        ("reason", Text),
    ]

    @staticmethod
    def type_name():
        return "upswing.PlantResponse.v2"


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
    Plan = 0
    Status = 1


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

# Room of an array with a value per joint.
MOST_JOINTS = 16

# Blackboards: each start of a writer has its own service, CHANNEL/EPOCH.
MEASUREMENT_CHANNEL = "measurement"
COMMAND_CHANNEL = "command"
MAX_READERS = 8
MAX_NODES = 24

# Publish and subscribe: service, payload, samples that wait for a slow subscriber.
TELEMETRY = ("telemetry", TelemetryBatch, 256)

# The same with a header and a slice of c_double.
PLAN = ("plan", PlanHeader, 2)

# Request and response: service, request, response.
CONTROL = ("control", ControlRequest, ControlResponse)
PLANNER = ("planner", PlannerRequest, PlannerResponse)
PLANT = ("plant", PlantRequest, PlantResponse)

# Longest name of a domain, characters.
MAX_DOMAIN = 32
