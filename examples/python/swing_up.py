"""Asks a running system for a swing-up, collects the telemetry and plots it.

    python swing_up.py --domain upswing --seconds 3 --plot swing-up.svg
"""

import argparse
import sys
import time

import numpy as np
import upswing_layouts as layouts
from upswing_ipc import Node, Refused, manoeuvre, text
from upswing_layouts import ControlKind, Mode

# For the daemon to load a plan, or to settle on its hold.
PATIENCE_S = 30.0
SETTLE_S = 0.25
# Control period, `cycle.period_us` of daemon.toml.
PERIOD_S = 125e-6


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


def swing_up(node, seconds):
    """Enables, plans from the present state, swings up and balances; returns the plan's answer and the telemetry."""
    control, planner = node.client(layouts.CONTROL), node.client(layouts.PLANNER)
    telemetry = Telemetry(node)

    def ask(kind, plan_id=0):
        answer = control.call(layouts.ControlRequest(kind=kind, plan_id=plan_id))
        if not answer.accepted:
            raise Refused(f"the daemon refused {kind.name}: {text(answer.reason)}")
        return answer

    def wait(duration):
        """In cycles: a plant that is slower than real time has not come as far as the clock on the wall."""
        telemetry.collect()
        begin, end = telemetry.cycle, time.monotonic() + PATIENCE_S
        while telemetry.cycle < begin + duration / PERIOD_S:
            if time.monotonic() > end + 100 * duration:
                raise Refused("time stands still: no telemetry from the daemon")
            time.sleep(0.02)
            telemetry.collect()

    if ask(ControlKind.Status).mode == Mode.Idle:
        ask(ControlKind.Enable)
    wait(SETTLE_S)
    plan = planner.call(layouts.PlannerRequest(manoeuvre=manoeuvre("swing-up"), from_now=1, publish=1))
    if plan.plan_id == 0:
        raise Refused(f"the planner refused: {text(plan.reason)}")
    end = time.monotonic() + PATIENCE_S
    # The plan has arrived, and the moment that its first state was predicted for has come.
    while (answer := ask(ControlKind.Status)).plan_id != plan.plan_id or answer.t_ns < plan.activation_ns:
        if time.monotonic() > end:
            raise Refused(f"the daemon did not load the plan: {text(answer.reason)}")
        telemetry.collect()
        time.sleep(0.001)
    ask(ControlKind.Start, plan.plan_id)
    while (mode := Mode(ask(ControlKind.Status).mode)) is Mode.Track:
        wait(0.1)
    if mode is not Mode.Balance:
        raise Refused(f"the swing-up ended in mode {mode.name}: {text(ask(ControlKind.Status).reason)}")
    wait(seconds)
    return plan, telemetry


def plot(records, path):
    """Angles, torques and mode over time; desired angles dashed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    records = records[::8]
    t = (records["seq"] - records["seq"][0]) * PERIOD_S
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9, 8), layout="constrained")
    colors = plt.get_cmap("tab10").colors
    for i, (q, q_d) in enumerate(zip(of_joints(records, "q").T, of_joints(records, "q_d").T)):
        color = colors[i % len(colors)]
        axes[0].plot(t, np.degrees(q), color=color, label=f"$q_{{{i + 1}}}$")
        axes[0].plot(t, np.degrees(q_d), color=color, linestyle="--", linewidth=0.8)
    for i, tau in enumerate(of_actuated(records, "tau").T):
        axes[1].plot(t, tau, color=colors[i % len(colors)], label=rf"$\tau_{{{i + 1}}}$")
    axes[0].set_ylabel("angle in deg, desired dashed")
    axes[1].set_ylabel("torque in N m")
    axes[2].step(t, records["mode"], where="post", color="black")
    axes[2].set_yticks(list(Mode), [mode.name for mode in Mode])
    axes[2].set_xlabel("time in s")
    for axis in axes[:2]:
        axis.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(path)


def tilt_deg(q):
    """Angle between the rod and where a plan of this robot ends, upright; its two joints, the last ones, are nearly orthogonal there."""
    return np.degrees(np.hypot(np.abs(q[..., -2]) - np.pi, q[..., -1]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", default="upswing")
    parser.add_argument("--seconds", type=float, default=3.0, help="of balance [%(default)s]")
    parser.add_argument("--plot", metavar="FILE", help="picture to write (.svg, .png, .pdf)")
    args = parser.parse_args()
    try:
        plan, telemetry = swing_up(Node(args.domain, "python client"), args.seconds)
    except Refused as refusal:
        print(f"error: {refusal}", file=sys.stderr)
        return 1
    records = telemetry.array()
    q = of_joints(records, "q")
    error = np.abs(q - of_joints(records, "q_d"))[records["mode"] == Mode.Track].max()
    print(f"plan      {plan.t_f:.3f} s long, made in {plan.time_total_us * 1e-3:.0f} ms")
    print(f"tracking  within {error:.3f} rad")
    print(f"balance   rod within {tilt_deg(q[-round(1 / PERIOD_S) :]).max():.2f} deg of upright in the last second")
    print(f"cycles    {len(records)} received, {telemetry.dropped} lost")
    if args.plot:
        plot(records, args.plot)
        print(f"picture   {args.plot}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
