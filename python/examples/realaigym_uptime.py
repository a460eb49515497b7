"""Uptime score of RealAIGym with our plans and our law as a controller of Python, which plans anew whenever it has lost its plan.

    python python/examples/realaigym_uptime.py [acrobot|pendubot [LEAD]]

A plan is computed while the pendulum falls without torque, for the state to which it falls in `LEAD` seconds, 0.2 without. The simulation waits for the
plan, so that the result does not depend on the machine; how many plans took longer than that is printed.
"""

import sys
import time

import numpy as np
import upswing
from upswing.benchmark import realaigym

PERIOD = 0.002
"""Period of the benchmark, s."""
LOST = 1.0
"""Distance from the plan at which it is lost, rad; velocities count a fifth."""


def within(q):
    """The angle between -pi and pi of any number of turns."""
    return (q + np.pi) % (2 * np.pi) - np.pi


class Replanner:
    """A controller of one simulation."""

    def __init__(self, planner, lead):
        self.planner, self.model, self.lead = planner, planner.system.model, lead
        self.plan, self.begin, self.times = None, 0.0, []

    def fall(self, x):
        """The state after `lead` seconds without torque, by the classical Runge-Kutta method."""
        none, h = np.zeros(2), PERIOD

        def rate(x):
            return np.concatenate([x[2:], self.model.forward_dynamics(x[:2], x[2:], none)])

        for _ in range(round(self.lead / h)):
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
        return x

    def __call__(self, t, x):
        if t < self.begin:
            return 0.0
        x = np.concatenate([within(x[:2]), x[2:]])
        if self.plan is not None:
            x_d, _ = self.plan.desired(t - self.begin)
            away = x - x_d
            away[:2] = within(away[:2])
            if max(np.abs(away[:2]).max(), np.abs(away[2:]).max() / 5) < LOST:
                x = x_d + away
                return self.model.torque(x, self.plan.input(t - self.begin, x))
        now = time.perf_counter()
        try:
            self.plan = self.planner.replan(self.fall(x))
        except upswing.NoPlan:
            # It falls on, and tries again.
            self.plan = None
        self.times.append(time.perf_counter() - now)
        self.begin = t + self.lead
        return 0.0


def main():
    name = sys.argv[1] if len(sys.argv) > 1 else "pendubot"
    lead = float(sys.argv[2]) if len(sys.argv) > 2 else 0.2
    planner = upswing.Planner(upswing.System.load(name))
    controller = Replanner(planner, lead)
    result = realaigym(planner.system, "uptime", lambda: controller)
    print(f"{name}: {result['uptime']:.1f} s of 60 s above the line, {result['swing_ups']} times, score {result['score']:.3f}")
    times = np.array(controller.times)
    print(f"{len(times)} plans tried, {np.sum(times > lead)} of them took longer than {lead} s, {np.median(times):.3f} s (median)")


if __name__ == "__main__":
    main()
