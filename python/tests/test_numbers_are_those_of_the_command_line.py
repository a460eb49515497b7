"""Bit for bit: JSON of the command line has all digits of a float."""

import json

import numpy as np
import pytest
import upswing
from conftest import ARM_START_DEG

START = ",".join(str(q) for q in ARM_START_DEG)


@pytest.mark.parametrize("name", ["iiwa-pendulum", "cart-double", "furuta"])
def test_model(command, name):
    model = upswing.System.load(name).model
    n, n_a = len(model.joints), len(model.actuated)
    rng = np.random.default_rng(1)
    q, qd, u = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(-1, 1, n_a)
    x = np.concatenate([q, qd])
    query = json.dumps({"q": q.tolist(), "qd": qd.tolist(), "u": u.tolist()})
    expected = command("model", "eval", "--system", name, stdin=query)
    got = {
        "M": model.mass_matrix(q),
        "nle": model.nonlinear_effects(q, qd),
        "g": model.gravity(q),
        "f": model.f(x, u),
        "A": model.A(x, u),
        "B": model.B(x, u),
        "tau": model.torque(x, u),
        "tau_without_coriolis": model.torque(x, u, coriolis=False),
    }
    for key, value in got.items():
        assert value.tolist() == expected[key], key


def test_optimize(command, arm):
    start = [0.0, 0.0, 0.0, -90.0, 0.0, 0.0, 0.0]
    expected = command("optimize", "--start", ",".join(map(str, start)), "--json")
    optimum = upswing.optimize(arm, np.deg2rad(start))
    assert optimum.solved and optimum.status == expected["status"]
    assert optimum.trajectory.t_f == expected["t_f"]
    assert optimum.trajectory.x.tolist() == expected["x"]
    assert optimum.trajectory.u.tolist() == expected["u"]
    for key in ("cost", "iterations", "violation", "stationarity"):
        assert getattr(optimum, key) == expected[key], key
    assert optimum.margins == {key: expected[key] for key in optimum.margins}


def test_plan(command, arm_planner):
    expected = command("plan", "--start", START, "--json")
    plan = arm_planner.replan(np.deg2rad(ARM_START_DEG))
    assert plan.status == expected["status"]
    assert plan.trajectory.x.tolist() == expected["x"]
    assert plan.trajectory.u.tolist() == expected["u"]
    for key in ("t_f", "cost", "nearest_entry", "distance", "attempts", "iterations", "defect"):
        assert getattr(plan, key) == expected[key], key
    assert plan.margins == {key: expected[key] for key in plan.margins}


def test_given_target(command):
    crane = upswing.System.load("gantry-crane")
    name = next(name for name in crane.manoeuvres if "move" in name)
    joint = crane.actuated[0]
    start = [0.0, 0.0, 1.0]
    arguments = ["--start", ",".join(map(str, start)), "--manoeuvre", name, "--to", f"{joint}=0.3"]
    expected = command("plan", "--system", "gantry-crane", *arguments, "--json")
    plan = upswing.Planner(crane).replan(start, name, to={joint: 0.3})
    assert plan.trajectory.x.tolist() == expected["x"]
    assert plan.trajectory.x[-1, crane.joints.index(joint)] == pytest.approx(0.3)


def test_monte_carlo(command):
    planner = upswing.Planner(upswing.System.load("cart-pole"))
    arguments = ["--samples", "4", "--condition", "everyday", "--seconds", "2", "--json"]
    expected = command("montecarlo", "closed-loop", "--system", "cart-pole", *arguments)["conditions"][0]
    got = upswing.monte_carlo(planner, 4, condition="everyday", seconds=2)
    del expected["times"], got["times"]
    assert got == expected
    starts = upswing.random_starts(planner.system, 4)
    assert starts[:, : len(planner.system.actuated)].tolist() == [run["start"] for run in got["results"]]


def test_database(command, tmp_path):
    cart = upswing.System.load("cart-pole")
    grid = tmp_path / "grid.toml"
    axis = f'{{ joint = "{cart.actuated[0]}", from_m = -0.2, to_m = 0.2, points = 2 }}'
    grid.write_text(f"grid = [{axis}]\n")
    calls = []
    path = tmp_path / "python.bin"
    summary = upswing.build_database(cart, path, grid=grid, progress=lambda done, total: calls.append((done, total)))
    assert summary["solved"] == 2 and calls[-1] == (2, 2)
    other = tmp_path / "command.bin"
    command("db", "build", "--system", "cart-pole", "--grid", str(grid), "--output", str(other), "--json")
    assert path.read_bytes() == other.read_bytes()
    database = upswing.Database.load(cart, path)
    assert len(database) == 2 and database.verify() == []
    assert database.certificate(0) == database[0].certificate()
    assert database.nearest([0.19])[0][0] == 1
    planner = upswing.Planner(cart, database=path)
    assert planner.replan([0.1]).nearest_entry is not None


def test_errors(command, arm):
    text = command.error("optimize", "--start", "0,0,0,-500,0,0,0")
    with pytest.raises(upswing.InputError) as raised:
        upswing.optimize(arm, np.deg2rad([0, 0, 0, -500, 0, 0, 0]))
    reason = str(raised.value).split("`start`: ")[1]
    assert reason in text
    text = command.error("optimize", "--system", "no-such", "--start", "0")
    with pytest.raises(upswing.InputError) as raised:
        upswing.System.load("no-such")
    assert str(raised.value) in text
