"""Batches, orders and derivatives of the model."""

import numpy as np
import pytest
import upswing


@pytest.fixture(params=["iiwa-pendulum", "cart-triple", "acrobot", "xy-spherical"])
def model(request):
    return upswing.System.load(request.param).model


@pytest.fixture
def point(model):
    rng = np.random.default_rng(2)
    n, n_a = len(model.joints), len(model.actuated)
    return rng.uniform(-1, 1, (5, 40, 2 * n)), rng.uniform(-1, 1, (5, 40, n_a))


def test_a_batch_has_the_bits_of_single_calls(model, point):
    x, u = point
    n = len(model.joints)
    q, qd = x[..., :n], x[..., n:]
    for whole, single in [
        (model.f(x, u), lambda i: model.f(x[i], u[i])),
        (model.A(x, u), lambda i: model.A(x[i], u[i])),
        (model.mass_matrix(q), lambda i: model.mass_matrix(q[i])),
        (model.nonlinear_effects(q, qd), lambda i: model.nonlinear_effects(q[i], qd[i])),
        (model.forward_kinematics(q), lambda i: model.forward_kinematics(q[i])),
        (model.energy(x), lambda i: model.energy(x[i])),
    ]:
        assert whole.shape[:2] == (5, 40)
        assert np.array_equal(whole[3, 17], single((3, 17)))


def test_one_vector_serves_a_whole_batch(model, point):
    x, u = point
    assert np.array_equal(model.f(x, u[0, 0])[2, 3], model.f(x[2, 3], u[0, 0]))


def test_any_layout_and_type_is_read(model, point):
    x, u = (values[0, 0] for values in point)
    expected = model.f(x, u)
    assert np.array_equal(model.f(x.tolist(), tuple(u)), expected)
    assert np.array_equal(model.f(np.repeat(x, 2)[::2], u), expected)
    both = np.asfortranarray(np.stack([x, x]))
    assert np.array_equal(model.f(both, u)[1], expected)
    assert model.f(x.astype(np.float32), u).dtype == np.float64


def test_dynamics_fit_together(model, point):
    x, u = (values[0, 0] for values in point)
    n = len(model.joints)
    q, qd = x[:n], x[n:]
    qdd = model.f(x, u)[n:]
    # (1): the actuated joints have the torques of the torque law, the others none.
    tau = model.mass_matrix(q) @ qdd + model.nonlinear_effects(q, qd)
    actuated = [model.joints.index(joint) for joint in model.actuated]
    expected = np.zeros(n)
    expected[actuated] = model.torque(x, u)
    friction_free = np.allclose(model.inverse_dynamics(q, qd, qdd), tau)
    assert friction_free
    assert np.allclose(qdd[actuated], u)
    assert np.allclose(tau[actuated], expected[actuated])
    assert np.allclose(model.forward_dynamics(q, qd, tau), qdd)


def test_derivatives_are_those_of_differences(model, point):
    x, u = (values[0, 0] for values in point)
    h = 1e-6
    a = np.stack([(model.f(x + h * e, u) - model.f(x - h * e, u)) / (2 * h) for e in np.eye(len(x))], axis=1)
    b = np.stack([(model.f(x, u + h * e) - model.f(x, u - h * e)) / (2 * h) for e in np.eye(len(u))], axis=1)
    # Central differences: the truncation is h^2 times third derivatives, the rounding 1e-16 / h times the values.
    scale = 1 + np.abs(a).max()
    assert np.abs(model.A(x, u) - a).max() < 1e-6 * scale
    assert np.abs(model.B(x, u) - b).max() < 1e-6 * scale


def test_hessian_is_that_of_differences(model, point):
    x, u = (values[0, 0] for values in point)
    n, n_a = len(model.joints), len(model.actuated)
    unactuated = [i for i, joint in enumerate(model.joints) if joint not in model.actuated]
    w, mu = np.linspace(0.5, 1, n - n_a), np.linspace(-0.3, 0.4, n_a)

    def value(z):
        x, u = z[: 2 * n], z[2 * n :]
        return w @ model.f(x, u)[n:][unactuated] + mu @ model.torque(x, u)

    z, h = np.concatenate([x, u]), 1e-4
    steps = h * np.eye(len(z))
    expected = np.array(
        [[(value(z + a + b) - value(z + a - b) - value(z - a + b) + value(z - a - b)) / (4 * h * h) for b in steps] for a in steps]
    )
    got = model.hessian(x, u, w, mu)
    assert np.array_equal(got, got.T) or np.allclose(got, got.T)
    assert np.abs(got - expected).max() < 1e-5 * (1 + np.abs(expected).max())


def test_unactuated_joints_hang_and_stand(model):
    q_a = np.zeros((3, len(model.actuated)))
    unactuated = [i for i, joint in enumerate(model.joints) if joint not in model.actuated]
    hanging, standing = model.rest_position(q_a), model.rest_position(q_a, upright=True)
    for q in (hanging, standing):
        assert q.shape == (3, len(model.joints))
        assert np.abs(model.gravity(q)[:, unactuated]).max() < 1e-9
    at_rest = np.zeros_like(hanging)
    energy = [model.energy(np.concatenate([q, at_rest], axis=1))[0] for q in (hanging, standing)]
    assert energy[0] < energy[1]


def test_wrong_shapes_are_named(model):
    n = len(model.joints)
    with pytest.raises(upswing.InputError, match=rf"`q`: expected an array of shape \(\.\.\., {n}\)"):
        model.mass_matrix(np.zeros(n + 1))
    with pytest.raises(ValueError, match="`u`: expected the leading shape"):
        model.f(np.zeros((2, 2 * n)), np.zeros((3, len(model.actuated))))
    with pytest.raises((TypeError, ValueError)):
        model.gravity("hello")
