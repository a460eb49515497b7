"""A fixed benchmark: the same starts, plants and criteria for every planner and controller, and a table for a paper.

>>> benchmark = Benchmark.of(upswing.System.load("cart-pole"), samples=20)
>>> ours = benchmark.score("ours", upswing.Planner(benchmark.system))
>>> print(table([ours]))                                                    # doctest: +SKIP
"""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, Callable, Dict, List, Optional, Sequence, Union

import numpy as np

from upswing._upswing import ClosedLoop, Plan, Planner, System, random_starts
from upswing.errors import InputError, UpswingError

Controller = Callable[[float, np.ndarray, np.ndarray, np.ndarray], Any]
_FIGURES = ("tracking_error_arm", "tracking_error_pendulum", "peak_velocity", "peak_torque", "final_error_deg")


@dataclass(frozen=True)
class Benchmark:
    """Starts and conditions of runs of the first manoeuvre of a system, and the time at its end."""

    #: The system of planner and controller.
    system: System
    #: Positions of the actuated joints at the starts, (samples, n_A), rad or m; the others hang at rest.
    starts: np.ndarray
    #: "nominal", or scenarios of the system: plants that differ from the model.
    conditions: Sequence[str]
    #: Time at the end of the plan, s; success is judged in the last second.
    seconds: float = 4.0

    @classmethod
    def of(
        cls,
        system: System,
        samples: int = 20,
        seed: int = 0,
        conditions: Sequence[str] = ("nominal", "everyday"),
        seconds: float = 4.0,
    ) -> "Benchmark":
        """The benchmark with the starts of ``upswing montecarlo`` with this seed."""
        actuated = [system.joints.index(joint) for joint in system.actuated]
        return cls(system, random_starts(system, samples, seed)[:, actuated], list(conditions), seconds)

    def export(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Writes the benchmark as JSON with all digits; the system by its name, and its model's fingerprint."""
        document = {
            "system": self.system.name,
            "model": self.system.model.fingerprint,
            "actuated": self.system.actuated,
            "starts": self.starts.tolist(),
            "conditions": list(self.conditions),
            "seconds": self.seconds,
        }
        with open(path, "w", encoding="utf-8") as file:
            json.dump(document, file, indent=1)

    @classmethod
    def read(cls, path: Union[str, "os.PathLike[str]"]) -> "Benchmark":
        """Reads what :meth:`export` wrote. Raises :class:`upswing.InputError` if the model of the system is another one."""
        with open(path, encoding="utf-8") as file:
            document = json.load(file)
        system = System.load(document["system"])
        if (got := system.model.fingerprint) != (expected := document["model"]):
            raise InputError(f"{os.fspath(path)}: expected the model {expected} of {document['system']}, got {got}")
        return cls(system, np.array(document["starts"]), document["conditions"], document["seconds"])

    def score(
        self,
        name: str,
        planner: Planner,
        *,
        plan: Optional[Callable[[np.ndarray], Plan]] = None,
        controller: Optional[Callable[[Plan], Controller]] = None,
        threads: Optional[int] = None,
    ) -> "Score":
        """Runs every start under every condition.

        ``plan(q_a)`` gives the plan for a start in place of ``planner``'s, and ``controller(plan)`` a controller, as :meth:`ClosedLoop.run`
        takes it, in place of ours. A start without a plan, or whose plan is refused, has failed.
        """
        runs: Dict[str, List[RunScore]] = {}
        for condition in self.conditions:
            plant = self.system if condition == "nominal" else self.system.with_scenario(condition)

            def run(index: int) -> RunScore:
                start = self.starts[index]
                try:
                    chosen = None
                    if plan is not None or controller is not None:
                        chosen = planner.replan(start) if plan is None else plan(start)
                    own = None if controller is None or chosen is None else controller(chosen)
                    done = ClosedLoop(planner, start, plant=plant, seed=index).run(
                        self.seconds, plan=chosen, controller=own
                    )
                except UpswingError as e:
                    return RunScore(index, False, [str(e)], None, {})
                evaluation = done.evaluation or {}
                figures = {figure: evaluation[figure] for figure in _FIGURES if figure in evaluation}
                return RunScore(index, done.success, done.failures, evaluation.get("t_f"), figures)

            with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
                runs[condition] = list(pool.map(run, range(len(self.starts))))
        return Score(name, self.system.name, runs)


@dataclass(frozen=True)
class RunScore:
    """One run: whether the system stayed at the end of the plan within all limits, and figures of the motion (rad, deg, shares of limits)."""

    index: int
    success: bool
    failures: List[str]
    #: Duration of the plan, s.
    t_f: Optional[float]
    figures: Dict[str, float]


@dataclass(frozen=True)
class Score:
    """Runs of one planner and controller, by condition."""

    name: str
    system: str
    runs: Dict[str, List[RunScore]]

    def succeeded(self, condition: str) -> int:
        """Number of successful runs."""
        return sum(run.success for run in self.runs[condition])

    def median(self, condition: str, figure: str) -> float:
        """Median of ``t_f``, or of a figure, over the successful runs; NaN without any."""
        done = [run for run in self.runs[condition] if run.success]
        values = [float(run.t_f or "nan") if figure == "t_f" else run.figures[figure] for run in done]
        return float(np.median(values)) if values else float("nan")

    def to_json(self) -> str:
        """All runs as JSON."""
        return json.dumps(asdict(self), indent=1)


def table(scores: Sequence[Score]) -> str:
    """A table in Markdown: success, and medians over the successful runs."""
    head = "| planner and controller | condition | success | t_F, s | tracking, unactuated, rad | torque, % of limit | final error, deg |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    for score in scores:
        for condition, runs in score.runs.items():
            m = {figure: score.median(condition, figure) for figure in ("t_f", *_FIGURES)}
            lines.append(
                f"| {score.name} | {condition} | {score.succeeded(condition)} of {len(runs)} | {m['t_f']:.3f} | "
                f"{m['tracking_error_pendulum']:.4f} | {100 * m['peak_torque']:.0f} | {m['final_error_deg']:.3f} |"
            )
    return "\n".join(lines)
