"""Asks a running system for a manoeuvre, collects the telemetry and plots it.

    python manoeuvre.py swing-up --system cart-pole --domain upswing --seconds 3 --plot swing-up.svg
    python manoeuvre.py move --system cart-pole --to cart=0.2
"""

import argparse
import sys
import time

import numpy as np
import upswing_layouts as layouts
from upswing_ipc import Node, Refused, manoeuvre, text
from upswing_layouts import ControlKind, Mode
from upswing_settings import Settings, add_system_options

# For the daemon to load a plan, or to settle on its hold.
PATIENCE_S = 30.0
SETTLE_S = 0.25


class Telemetry:
    """Every cycle since it was made, in plain arrays."""

    def __init__(self, node):
        self.subscriber = node.subscribe(layouts.TELEMETRY)
        self.dropped, self.cycle = 0, 0
        self._raw = bytearray()

    def collect(self):
        """Takes what has arrived; call it at least every second, the buffer holds two."""
        while (sample := self.subscriber.receive()) is not None:
            batch = sample.payload().contents
            count = min(batch.count, layouts.TelemetryBatch.records.size // layouts.Telemetry.SIZE)
            self.dropped = batch.dropped
            self.cycle = batch.records[count - 1].seq if count > 0 else self.cycle
            self._raw += bytes(batch.records)[: count * layouts.Telemetry.SIZE]
            sample.delete()

    def array(self):
        """A structured array with the fields of Telemetry."""
        return np.frombuffer(bytes(self._raw), dtype=np.dtype(layouts.Telemetry))


def of_joints(records, field):
    """The values of the joints in a field with one per joint, q .. qd_d: an array cycles x joints, from base to tip."""
    return records[field][:, : min(records["joints"].max(initial=0), layouts.MOST_JOINTS)]


def of_actuated(records, field):
    """As `of_joints`, of a field with one value per actuated joint, u_d .. tau_measured."""
    return records[field][:, : min(records["actuated"].max(initial=0), layouts.MOST_JOINTS)]


def fly(node, name, given, seconds, period):
    """Enables, plans a manoeuvre from the present state, executes it and stays at its end for `seconds`.

    `given`: where joints end, rad or m, in the order of the manoeuvre's target; `period`: of control, s. Returns the answer of the
    planner, the plan, and the telemetry."""
    control, planner = node.client(layouts.CONTROL), node.client(layouts.PLANNER)
    telemetry, plans = Telemetry(node), node.subscribe_plans()

    def ask(kind, plan_id=0):
        answer = control.call(layouts.ControlRequest(kind=kind, plan_id=plan_id))
        if not answer.accepted:
            raise Refused(f"the daemon refused {kind.name}: {text(answer.reason)}")
        return answer

    def wait(duration):
        """In cycles: a plant that is slower than real time has not come as far as the clock on the wall."""
        telemetry.collect()
        begin, end = telemetry.cycle, time.monotonic() + PATIENCE_S
        while telemetry.cycle < begin + duration / period:
            if time.monotonic() > end + 100 * duration:
                raise Refused("time stands still: no telemetry from the daemon")
            time.sleep(0.02)
            telemetry.collect()

    if ask(ControlKind.Status).mode == Mode.Idle:
        ask(ControlKind.Enable)
    wait(SETTLE_S)
    request = layouts.PlannerRequest(manoeuvre=manoeuvre(name, given), from_now=1, publish=1)
    request.known_seq = ask(ControlKind.Status).seq
    answer = planner.call(request)
    if answer.plan_id == 0:
        raise Refused(f"the planner refused: {text(answer.reason)}")
    end = time.monotonic() + PATIENCE_S
    # The plan has arrived, and the moment that its first state was predicted for has come.
    while (status := ask(ControlKind.Status)).plan_id != answer.plan_id or status.t_ns < answer.activation_ns:
        if time.monotonic() > end:
            raise Refused(f"the daemon did not load the plan: {text(status.reason)}")
        telemetry.collect()
        time.sleep(0.001)
    ask(ControlKind.Start, answer.plan_id)
    while Mode(ask(ControlKind.Status).mode) is Mode.Track:
        wait(0.1)
    wait(seconds)
    status = ask(ControlKind.Status)
    modes = telemetry.array()["mode"]
    # After a stop the daemon holds again.
    if (tripped := modes[np.isin(modes, [Mode.Stop, Mode.Fault])]).size > 0:
        raise Refused(f"the manoeuvre ended in mode {Mode(tripped[0]).name}: {text(status.reason)}")
    while (plan := plans.take()) is not None and plan.header.id != answer.plan_id:
        pass
    return answer, plan, telemetry


def plot(records, joints, period, path):
    """Positions, torques and mode over time; desired positions dashed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    records = records[::8]
    t = (records["seq"] - records["seq"][0]) * period
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9, 8), layout="constrained")
    colors = dict(zip((joint.name for joint in joints), plt.get_cmap("tab20").colors))
    for joint, q, q_d in zip(joints, of_joints(records, "q").T, of_joints(records, "q_d").T):
        axes[0].plot(t, joint.shown(q), color=colors[joint.name], label=f"{joint.name}, {joint.unit}")
        axes[0].plot(t, joint.shown(q_d), color=colors[joint.name], linestyle="--", linewidth=0.8)
    actuated = [joint for joint in joints if joint.actuated]
    for joint, tau in zip(actuated, of_actuated(records, "tau").T):
        axes[1].plot(t, tau, color=colors[joint.name], label=f"{joint.name}, {'N' if joint.prismatic else 'N m'}")
    axes[0].set_ylabel("position, desired dashed")
    axes[1].set_ylabel("torque or force")
    axes[2].step(t, records["mode"], where="post", color="black")
    axes[2].set_yticks(list(Mode), [mode.name for mode in Mode])
    axes[2].set_xlabel("time in s")
    for axis in axes[:2]:
        axis.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("manoeuvre", nargs="?", help="its name in manoeuvres.toml [the first one]")
    parser.add_argument("--to", nargs="+", default=[], metavar="JOINT=VALUE", help="where joints end, deg or m [the last position of the database]")
    add_system_options(parser)
    parser.add_argument("--domain", default="upswing")
    parser.add_argument("--seconds", type=float, default=3.0, help="at the end [%(default)s]")
    parser.add_argument("--plot", metavar="FILE", help="picture to write (.svg, .png, .pdf)")
    parser.add_argument("--save", metavar="FILE", help="records to write, a structured array of NumPy (.npy)")
    args = parser.parse_args()
    try:
        settings = Settings(args.system, args.program)
        name = args.manoeuvre or settings.manoeuvres[0]["name"]
        given = settings.given(name)
        for joint, _, value in (item.partition("=") for item in args.to):
            if joint not in given:
                raise ValueError(f"--to: `{name}` takes values of the joints {', '.join(given) or 'none'}; got `{joint}`")
            given[joint] = next(j for j in settings.joints if j.name == joint).position(float(value))
        period = settings.period_ns * 1e-9
        answer, plan, telemetry = fly(Node(args.domain, "python client"), name, list(given.values()), args.seconds, period)
    except (Refused, ValueError) as refusal:
        print(f"error: {refusal}", file=sys.stderr)
        return 1
    records = telemetry.array()
    q = of_joints(records, "q")
    error = np.abs(q - of_joints(records, "q_d"))[records["mode"] == Mode.Track].max(axis=0)
    last = q[-round(min(1, args.seconds) / period) :]
    distance = np.abs(last - plan.x[-1, : q.shape[1]]).max(axis=0)
    print(f"plan      {answer.t_f:.3f} s long, made in {answer.time_total_us * 1e-3:.0f} ms")
    print(f"{'joint':<16}{'tracking within':>18}{'end':>16}{'that of the plan within':>26}   in the last second")
    for joint, *values in zip(settings.joints, error, last.mean(axis=0), distance):
        shown = [f"{joint.shown(value):.{4 if joint.prismatic else 2}f} {joint.unit}" for value in values]
        print(f"{joint.name:<16}{shown[0]:>18}{shown[1]:>16}{shown[2]:>26}")
    print(f"cycles    {len(records)} received, {telemetry.dropped} lost")
    if args.plot:
        plot(records, settings.joints, period, args.plot)
        print(f"picture   {args.plot}")
    if args.save:
        np.save(args.save, records)
    return 0


if __name__ == "__main__":
    sys.exit(main())
