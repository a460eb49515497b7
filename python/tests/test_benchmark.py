"""The benchmark has the runs of the Monte Carlo study and of the command line, and tells controllers apart."""

import json

import numpy as np
import pytest
import upswing
from upswing.benchmark import Benchmark, Score, realaigym, table


@pytest.fixture(scope="module")
def benchmark(cart):
    return Benchmark(cart, samples=3, seconds=2.0)


@pytest.fixture(scope="module")
def planner(cart):
    return upswing.Planner(cart)


@pytest.fixture(scope="module")
def plans(benchmark, planner):
    return planner.replan_all(benchmark.starts)


def test_our_score_is_that_of_the_study_and_of_the_command_line(benchmark, planner, command, tmp_path):
    score = benchmark.score("ours", planner)
    for condition in score.conditions:
        study = upswing.monte_carlo(planner, 3, condition=condition["condition"], seconds=2.0)
        assert condition["results"] == study["results"] and condition["succeeded"] == 3
    assert "| ours | everyday | 3 of 3 |" in table([score])
    benchmark.export(tmp_path / "benchmark.json")
    expected = command("bench", "score", str(tmp_path / "benchmark.json"), "--json")
    assert json.loads(score.to_json()) == expected
    assert table([Score.of_json(json.dumps(expected))]) == table([score])


def test_a_benchmark_of_the_command_line_is_the_same(benchmark, command, tmp_path):
    path = tmp_path / "benchmark.json"
    command("bench", "export", str(path), "--system", "cart-pole", "--samples", "3", "--seconds", "2", "--json")
    again = Benchmark.read(path)
    assert np.array_equal(again.starts, benchmark.starts) and again.conditions == benchmark.conditions
    assert (again.seed, again.seconds) == (benchmark.seed, benchmark.seconds)


def test_plans_of_others_are_run_from_arrays_and_from_files(benchmark, planner, plans, command, tmp_path):
    given = [plans[0], None, plans[2]]
    upswing.export_plans(given, tmp_path / "plans.json")
    arguments = ["--system", "cart-pole", "--samples", "3", "--seconds", "2", "--plans", str(tmp_path / "plans.json")]
    expected = command("montecarlo", "closed-loop", *arguments, "--json")["conditions"][0]
    got = upswing.monte_carlo(planner, 3, seconds=2.0, plans=given)
    assert [run["failure"] for run in got["results"]] == [None, "no plan", None]
    assert [run["end"] for run in got["results"]] == [run["end"] for run in expected["results"]]
    assert [run["failure"] for run in got["results"]] == [run["failure"] for run in expected["results"]]
    benchmark.export(tmp_path / "benchmark.json")
    files = [str(tmp_path / "benchmark.json"), "--plans", str(tmp_path / "plans.json")]
    score = command("bench", "score", *files, "--json")
    assert score["conditions"][0]["results"] == expected["results"]
    by_start = {tuple(start): plan for start, plan in zip(benchmark.starts.tolist(), plans)}
    mine = benchmark.score("mine", planner, plan=lambda start: by_start[tuple(start)])
    assert [condition["succeeded"] for condition in mine.conditions] == [3, 3]
    with pytest.raises(upswing.InputError, match="`plans`: expected 3, one for each start, got 1"):
        upswing.monte_carlo(planner, 3, plans=plans[:1])


def test_an_idle_controller_has_no_success(benchmark, planner):
    idle = benchmark.score("idle", planner, controller=lambda plan: lambda t, x, x_d, u_d: np.zeros(1))
    assert [condition["succeeded"] for condition in idle.conditions] == [0, 0]
    assert idle.conditions[0]["t_f"] is None and idle.conditions[0]["results"][0]["reasons"]
    assert "| idle | nominal | 0 of 3 | - |" in table([idle])

    def refuse(start):
        raise upswing.NoPlan("none here")

    none = benchmark.score("none", planner, plan=refuse)
    assert none.conditions[1]["results"][1]["reasons"] == ["no plan: none here"]
    assert none.conditions[1]["failures"] == {"no plan": 3}


def test_our_law_in_python_succeeds(benchmark, planner):
    model = benchmark.system.model

    def law(plan):
        return lambda t, x, x_d, u_d: model.torque(x, plan.input(t, x))

    # Without our disturbance observer, friction moves the cart off its place.
    assert [condition["succeeded"] for condition in benchmark.score("law", planner, controller=law).conditions] == [3, 0]


def test_an_exception_of_another_kind_ends_the_benchmark(benchmark, planner):
    with pytest.raises(ZeroDivisionError):
        benchmark.score("bad", planner, plan=lambda start: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        benchmark.score("bad", planner, controller=lambda plan: lambda t, x, x_d, u_d: 1 / 0)


def test_a_file_has_all_digits(benchmark, tmp_path):
    path = tmp_path / "benchmark.json"
    benchmark.export(path)
    again = Benchmark.read(path)
    assert np.array_equal(again.starts, benchmark.starts) and again.conditions == benchmark.conditions
    text = path.read_text()
    path.write_text(text.replace(benchmark.system.model.fingerprint, "0" * 16))
    with pytest.raises(upswing.InputError, match="expected the model 0000"):
        Benchmark.read(path)
    document = json.loads(text)
    document["starts"][1][0] += 1e-15
    path.write_text(json.dumps(document))
    with pytest.raises(upswing.InputError, match="expected start 1 of seed 0, got another one"):
        Benchmark.read(path)


def test_our_performance_is_the_published_one():
    # bench/README.md has these scores of `bench/realaigym/run`.
    for name, expected in (("acrobot", 0.678), ("pendubot", 0.629)):
        result = realaigym(upswing.System.load(name), "performance")
        assert result["success"] and round(result["score"], 3) == expected
        assert 0.5 < result["time"] < 2.0


def test_a_controller_of_python_is_scored():
    pendubot = upswing.System.load("pendubot")
    asked = []

    def new():
        def controller(t, x):
            asked.append(t)
            return 0.0

        return controller

    idle = realaigym(pendubot, "performance", new)
    assert not idle["success"] and idle["score"] == 0.0 and idle["energy"] == 0.0
    assert asked[:2] == [0.0, 0.002] and len(asked) == 5000
    asked.clear()
    uptime = realaigym(pendubot, "uptime", new)
    # 15 resets of 0.2 s, in which the controller is not asked; some leave the pendulum above the line for a moment.
    assert len(asked) == pytest.approx(30_000 - 15 * 100, abs=20)
    assert uptime["score"] == uptime["uptime"] / 60 < 0.1

    calls = []
    with pytest.raises(ZeroDivisionError):
        realaigym(pendubot, "robustness", lambda: lambda t, x: 1 / 0, progress=lambda *numbers: calls.append(numbers))
    assert calls[-1][1] == 10 * 21 + 2 * 21 * 10 + 2 * 21 + 50
    with pytest.raises(upswing.InputError, match="expected one finite torque"):
        realaigym(pendubot, "performance", lambda: lambda t, x: [0.0, 1.0])
    with pytest.raises(upswing.InputError, match="`controller`: expected one for \"uptime\""):
        realaigym(pendubot, "uptime")
    with pytest.raises(upswing.InputError, match="expected \"performance\""):
        realaigym(pendubot, "speed")
    with pytest.raises(upswing.InputError, match="expected a double pendulum"):
        realaigym(upswing.System.load("iiwa-pendulum"), "performance")
