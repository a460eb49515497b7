"""The benchmark has the runs of the Monte Carlo study, and tells controllers apart."""

import json

import numpy as np
import pytest
import upswing
from upswing.benchmark import Benchmark, table


@pytest.fixture(scope="module")
def benchmark(cart):
    return Benchmark.of(cart, samples=3, seconds=2.0)


def test_our_score_is_that_of_the_study(benchmark):
    planner = upswing.Planner(benchmark.system)
    score = benchmark.score("ours", planner)
    for condition, runs in score.runs.items():
        study = upswing.monte_carlo(planner, 3, condition=condition, seconds=2.0)["results"]
        for run, expected in zip(runs, study):
            assert benchmark.starts[run.index].tolist() == expected["start"]
            assert run.success and run.t_f == expected["end"]["t_f"]
            assert run.figures == {figure: expected["end"][figure] for figure in run.figures}
    assert "| ours | everyday | 3 of 3 |" in table([score])
    assert json.loads(score.to_json())["runs"]["nominal"][2]["success"]


def test_an_idle_controller_has_no_success(benchmark):
    planner = upswing.Planner(benchmark.system)
    idle = benchmark.score("idle", planner, controller=lambda plan: lambda t, x, x_d, u_d: np.zeros(1))
    assert [idle.succeeded(condition) for condition in benchmark.conditions] == [0, 0]
    assert np.isnan(idle.median("nominal", "t_f")) and idle.runs["nominal"][0].failures

    def refuse(start):
        raise upswing.NoPlan("none here")

    none = benchmark.score("none", planner, plan=refuse)
    assert none.runs["everyday"][1].failures == ["none here"]


def test_a_file_has_all_digits(benchmark, tmp_path):
    path = tmp_path / "benchmark.json"
    benchmark.export(path)
    again = Benchmark.read(path)
    assert np.array_equal(again.starts, benchmark.starts) and again.conditions == benchmark.conditions
    path.write_text(path.read_text().replace(benchmark.system.model.fingerprint, "0" * 16))
    with pytest.raises(upswing.InputError, match="expected the model 0000"):
        Benchmark.read(path)
