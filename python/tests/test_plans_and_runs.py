"""Trajectories, plans, the plant and the closed loop."""

import signal
import threading
import time

import numpy as np
import pytest
import upswing
from conftest import ARM_START_DEG


@pytest.fixture(scope="module")
def cart_planner(cart):
    return upswing.Planner(cart)


@pytest.fixture(scope="module")
def plan(arm_planner):
    return arm_planner.replan(np.deg2rad(ARM_START_DEG))


def test_a_plan_of_arrays_is_the_plan(arm, plan):
    again = upswing.Trajectory(arm, plan.t_f, plan.trajectory.x, plan.trajectory.u)
    assert np.array_equal(again.x, plan.trajectory.x) and again.defect == plan.defect
    gains, end = upswing.lqr(again)
    assert np.array_equal(gains, plan.gains) and np.array_equal(end, plan.gain_end)
    given = upswing.Plan(again, plan.gains, plan.gain_end)
    x = plan.trajectory.x[0] + 0.01
    assert np.array_equal(given.input(0.1, x), plan.input(0.1, x))


def test_the_input_is_that_of_the_gains(plan):
    t = plan.trajectory.t[10]
    x_d, u_d = plan.desired(t)
    dx = np.linspace(-0.01, 0.01, len(x_d))
    assert np.allclose(plan.input(t, x_d + dx), u_d + plan.gains[10] @ dx)
    assert np.allclose(plan.trajectory.state(t), plan.trajectory.x[10])
    assert plan.trajectory.state([[0.0], [t]]).shape == (2, 1, len(x_d))


def test_the_target_is_met(arm, plan):
    rows, values = arm.target()
    assert np.allclose(rows @ plan.trajectory.x[-1], values, atol=1e-6)


def test_the_multipliers_make_the_lagrangian_stationary(arm):
    optimum = upswing.optimize(arm, np.deg2rad(ARM_START_DEG))
    model, m = arm.model, optimum.multipliers
    x, u, t_f = optimum.trajectory.x, optimum.trajectory.u, optimum.trajectory.t_f
    intervals, h, width = len(x) - 1, t_f / (len(x) - 1), x.shape[1]
    f, a, b = model.f(x, u), model.A(x, u), model.B(x, u)
    # w_k = lambda_{k-1} + lambda_k: f_k is part of the defects on both sides of a knot.
    padded = np.zeros((intervals + 2, width))
    padded[1:-1] = m["defects"]
    w = padded[:-1] + padded[1:]
    with np.errstate(all="raise"):
        # Second derivatives of mu . tau are of no use here: first ones of tau, by central differences of the torque law.
        step = 1e-6
        z = np.concatenate([x, u], axis=1)
        moved = z[:, None, :] + step * np.stack([np.eye(z.shape[1]), -np.eye(z.shape[1])])[:, None].reshape(1, -1, z.shape[1])
        tau = model.torque(moved[..., :width], moved[..., width:]).reshape(len(z), 2, z.shape[1], -1)
        by_torque = ((tau[:, 0] - tau[:, 1]) / (2 * step)) @ m["torque"][..., None]
    rows, _ = arm.target()
    by_x = padded[:-1] - padded[1:] - h / 2 * np.einsum("kij,ki->kj", a, w) + m["x"] + by_torque[:, :width, 0]
    by_x[-1] += m["target"] @ rows
    r = 2 * (optimum.cost - t_f) / (h * np.sum(u**2))
    by_u = h * r * u - h / 2 * np.einsum("kij,ki->kj", b, w) + by_torque[:, width:, 0]
    by_t = 1 + r / 2 * np.sum(u**2) / intervals - np.sum(w * f) / 2 / intervals + m["t_f"]
    # The tolerance of the optimisation, and central differences.
    assert max(np.abs(by_x[1:]).max(), np.abs(by_u).max(), abs(by_t)) < 1e-5
    # Velocities are at their limits of plans, and nothing else of the arm: signs say which of the two.
    limit = arm.planning_limits["qd_max"]
    n = len(arm.joints)
    pull, qd = m["x"][:, n:], x[:, n:]
    held = np.abs(pull) > 1e-3
    assert held.any() and (np.sign(pull) == np.sign(qd))[held].all() and (np.abs(qd) > 0.99 * limit)[held].all()
    assert (m["x"][0] == 0).all() and m["torque"].shape == u.shape


def test_other_weights_give_other_gains(plan):
    gains, _ = upswing.lqr(plan.trajectory)
    other, _ = upswing.lqr(plan.trajectory, r=10.0)
    assert np.abs(other).max() < np.abs(gains).max()
    with pytest.raises(upswing.InputError, match="`r`: expected a finite number above 0"):
        upswing.lqr(plan.trajectory, r=-1.0)


def test_a_batch_has_the_plans_of_single_calls(arm, arm_planner):
    starts = upswing.random_starts(arm, 4, seed=3)
    outside = starts[0].copy()
    calls = []
    plans = arm_planner.replan_all(starts, progress=lambda *numbers: calls.append(numbers))
    assert calls[-1] == (4, 4)
    for start, plan in zip(starts, plans):
        assert np.array_equal(plan.trajectory.x, arm_planner.replan(start).trajectory.x)
    # A start from which no plan keeps the limits is an exception in its place.
    outside[len(arm.joints)] = 100.0
    bad, good = arm_planner.replan_all([outside, starts[1]], optimise=False)
    assert isinstance(bad, upswing.NoPlan) and isinstance(good, upswing.Plan)


def test_no_plan_says_why(arm, arm_planner):
    x = arm.start_state(np.deg2rad(ARM_START_DEG))
    x[len(arm.joints)] = 100.0
    with pytest.raises(upswing.NoPlan, match="none of the"):
        arm_planner.replan(x, iterations=1)


def test_the_plant_falls_as_the_model_says(cart):
    plant = upswing.Plant(cart, [0.1])
    start = plant.x
    plant.step(np.zeros(1), cycles=8)
    assert plant.t == pytest.approx(8 * cart.period)
    assert np.abs(plant.x - start).max() < 1e-3
    plant.step_acceleration([1.0], cycles=400)
    assert plant.x[len(cart.joints)] > 0.01
    plant.x = start
    assert np.array_equal(plant.x, start)
    with pytest.raises(upswing.InputError, match="`start`"):
        plant.x = np.full(len(start), 1e9)


def test_a_run_succeeds_and_is_recorded(cart_planner, tmp_path):
    run = upswing.ClosedLoop(cart_planner, [0.0]).run(2.0)
    assert run.success and run.failures == [] and run.aborted is None
    assert run.evaluation["success"]
    recording = upswing.Recording.of(run)
    assert recording.q.shape == (len(run), len(recording.joints))
    path = tmp_path / "run.mcap"
    run.save(path)
    read = upswing.Recording.read(path)
    assert np.array_equal(read.q, recording.q) and np.array_equal(read.tau, recording.tau)
    assert read.joints == recording.joints and "robot.urdf" in read.files
    page = upswing.report(path)
    assert page.html.startswith("<!") and "srcdoc" in page._repr_html_()
    assert len(upswing.report(run).html) > 1000
    pandas = pytest.importorskip("pandas")
    table = recording.to_pandas(every=10)
    assert isinstance(table, pandas.DataFrame) and f"q_{recording.joints[0]}" in table


def test_equal_runs_have_equal_bits(cart, cart_planner):
    everyday = cart.with_scenario("everyday")
    one, two = (upswing.ClosedLoop(cart_planner, [0.1], plant=everyday, seed=5).run(2.0) for _ in range(2))
    other = upswing.ClosedLoop(cart_planner, [0.1], plant=everyday, seed=6).run(2.0)
    assert np.array_equal(one.records["q"], two.records["q"])
    assert not np.array_equal(one.records["q"], other.records["q"])


def test_our_law_in_python_balances_as_ours_does(cart, cart_planner):
    plan = cart_planner.replan([0.0])
    model, calls = cart.model, []

    def controller(t, x, x_d, u_d):
        calls.append(t)
        return model.torque(x, plan.input(t, x))

    loop = upswing.ClosedLoop(cart_planner, [0.0])
    run = loop.run(2.0, plan=plan, controller=controller)
    ours = loop.run(2.0, plan=plan)
    assert run.success and ours.success and calls
    # Ours also compensates disturbances: a few ticks of the encoders, 0.0015 rad each.
    assert np.abs(run.records["q"] - ours.records["q"]).max() < 5e-3


def test_a_bad_controller_fails_the_run(cart_planner):
    loop = upswing.ClosedLoop(cart_planner, [0.0])
    idle = loop.run(2.0, controller=lambda t, x, x_d, u_d: np.zeros(1))
    assert not idle.success and idle.failures
    with pytest.raises(ZeroDivisionError):
        loop.run(2.0, controller=lambda t, x, x_d, u_d: 1 / 0)
    with pytest.raises(upswing.InputError, match="torque of the controller"):
        loop.run(2.0, controller=lambda t, x, x_d, u_d: [1.0, 2.0])
    broken = loop.run(2.0, controller=lambda t, x, x_d, u_d: [np.nan])
    assert "expected a finite number" in broken.aborted


def test_a_strong_push_is_told(cart_planner):
    run = upswing.ClosedLoop(cart_planner, [0.0]).run(2.0, pushes=[(0.2, (50.0, 0.0, 0.0), 0.01)])
    assert not run.success and run.failures


def test_step_by_step(cart_planner):
    loop = upswing.ClosedLoop(cart_planner, [0.0])
    assert loop.mode == "idle"
    loop.advance(0.01)
    loop.enable()
    loop.advance(0.25)
    assert loop.mode == "hold"
    plan = cart_planner.replan(loop.x)
    loop.start(plan)
    loop.advance(plan.t_f + 0.5)
    assert loop.mode == "balance" and loop.trip is None
    with pytest.raises(upswing.UpswingError, match="enable was refused"):
        loop.enable()
    loop.stop()
    assert len(loop.records["t_ns"]) > 0


def test_other_threads_run_meanwhile(arm_planner, arm):
    starts = upswing.random_starts(arm, 8, seed=1)
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    arm_planner.replan_all(starts)
    done.set()
    thread.join()
    assert len(ticks) > 10


@pytest.fixture
def interrupts():
    """Ctrl-C raises KeyboardInterrupt, also where a shell started the tests in the background: such programs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
@pytest.mark.parametrize("long", ["build", "study", "advance"])
def test_an_interrupt_ends_a_long_computation(arm, arm_planner, tmp_path, long):
    calls = {
        "build": lambda: upswing.build_database(arm, tmp_path / "paper.bin", grid="paper"),
        "study": lambda: upswing.monte_carlo(arm_planner, 100_000),
        "advance": lambda: upswing.ClosedLoop(arm_planner).advance(50_000.0),
    }
    main = threading.main_thread().ident
    timer = threading.Timer(0.5, lambda: signal.pthread_kill(main, signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        calls[long]()


def test_a_progress_that_raises_ends_the_computation(arm_planner):
    def progress(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        upswing.monte_carlo(arm_planner, 100_000, progress=progress)
