"""Rigid-body dynamics of the robot for CasADi, read from the URDF; shares no code with upswing.

Symbols are the paper's (Vu, Hartl-Nesic, Kugi, ICRA 2021). SI units throughout.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np

GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, in the world frame of the URDF."""


@dataclass
class Joint:
    """A revolute joint and the body behind it, with what is fixed to that body."""

    name: str
    """In the URDF."""
    rotation: np.ndarray
    """Axes of the joint's frame at angle 0 in the parent's frame."""
    translation: np.ndarray
    """Origin of the joint's frame in the parent's frame, m."""
    axis: np.ndarray
    """In the joint's frame."""
    mass: float = 0.0
    first_moment: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Mass times centre of mass, in the joint's frame, kg m."""
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """About the joint's origin, in the joint's frame, kg m^2."""


@dataclass
class Chain:
    """The revolute joints from the root to the tip, the actuated ones first."""

    joints: list[Joint]
    n_a: int
    """n_A, number of actuated joints."""

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def nx(self) -> int:
        """Dimension of the state x = [q, qd]."""
        return 2 * self.n

    @property
    def nz(self) -> int:
        """Dimension of a knot [x, u]."""
        return self.nx + self.n_a


def skew(v):
    """[v]x as a NumPy array."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def turn(axis, angle):
    """Rotation matrix about a unit vector."""
    k = skew(axis)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def numbers(text: str) -> list[float]:
    return [float(v) for v in text.split()]


def origin(element):
    """(rotation, translation) of an <origin>; URDF's rpy is Rz(yaw) Ry(pitch) Rx(roll)."""
    tag = element.find("origin")
    attributes = {} if tag is None else tag.attrib
    r, p, y = numbers(attributes.get("rpy", "0 0 0"))
    return (
        turn([0, 0, 1], y) @ turn([0, 1, 0], p) @ turn([1, 0, 0], r),
        np.array(numbers(attributes.get("xyz", "0 0 0"))),
    )


def read_chain(path: Path) -> Chain:
    """The chain of a URDF; fixed joints merge their link into the body before, joints with effort 0 are not actuated."""
    robot = ElementTree.parse(path).getroot()
    links = {link.get("name"): link for link in robot.findall("link")}
    children = {}
    for joint in robot.findall("joint"):
        if children.setdefault(joint.find("parent").get("link"), joint) is not joint:
            raise ValueError(f"{path.name}: expected a chain, but {joint.find('parent').get('link')} has two children")
    (link,) = set(children) - {joint.find("child").get("link") for joint in children.values()}
    chain, actuated = [], []
    # Pose of the current link in the frame of the last revolute joint (or of the world).
    rotation, translation = np.eye(3), np.zeros(3)
    while link in children:
        joint = children[link]
        r, p = origin(joint)
        rotation, translation = rotation @ r, translation + rotation @ p
        if joint.get("type") == "revolute":
            axis = np.array(numbers(joint.find("axis").get("xyz")))
            chain.append(Joint(joint.get("name"), rotation, translation, axis))
            actuated.append(float(joint.find("limit").get("effort")) > 0)
            rotation, translation = np.eye(3), np.zeros(3)
        elif joint.get("type") != "fixed":
            raise ValueError(f"{path.name}: joint {joint.get('name')}: expected revolute or fixed")
        link = joint.find("child").get("link")
        if chain:
            add_body(chain[-1], links[link].find("inertial"), rotation, translation)
    n_a = sum(actuated)
    if not 0 < n_a < len(chain) or not all(actuated[:n_a]):
        raise ValueError(f"{path.name}: expected actuated joints, then unactuated ones; by joint: {actuated}")
    return Chain(chain, n_a)


def add_body(joint: Joint, inertial, rotation, translation):
    """Adds an <inertial> whose link has the given pose in the joint's frame."""
    if inertial is None:
        return
    mass = float(inertial.find("mass").get("value"))
    inertia = inertial.find("inertia")
    about_centre = np.array([[float(inertia.get("i" + min(a, b) + max(a, b))) for a in "xyz"] for b in "xyz"])
    r, p = origin(inertial)
    centre, axes = translation + rotation @ p, rotation @ r
    joint.mass += mass
    joint.first_moment += mass * centre
    joint.inertia += axes @ about_centre @ axes.T - mass * skew(centre) @ skew(centre)


def inverse_dynamics(chain: Chain, q, qd, qdd):
    """Torques of all joints, M qdd + C qd + g: recursive Newton-Euler in body frames."""
    omega, alpha = ca.SX.zeros(3), ca.SX.zeros(3)
    # Gravity as an acceleration of the base.
    acceleration = -ca.SX(ca.DM(GRAVITY))
    to_parent, forces, moments = [], [], []
    for i, joint in enumerate(chain.joints):
        k = ca.DM(skew(joint.axis))
        r = ca.DM(joint.rotation) @ (ca.DM.eye(3) + ca.sin(q[i]) * k + (1 - ca.cos(q[i])) * (k @ k))
        p, axis = ca.DM(joint.translation), ca.DM(joint.axis)
        acceleration = r.T @ (acceleration + ca.cross(alpha, p) + ca.cross(omega, ca.cross(omega, p)))
        omega_parent = r.T @ omega
        alpha = r.T @ alpha + axis * qdd[i] + ca.cross(omega_parent, axis * qd[i])
        omega = omega_parent + axis * qd[i]
        c, inertia = ca.DM(joint.first_moment), ca.DM(joint.inertia)
        forces.append(joint.mass * acceleration + ca.cross(alpha, c) + ca.cross(omega, ca.cross(omega, c)))
        moments.append(inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(c, acceleration))
        to_parent.append((r, p))
    tau = [None] * chain.n
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in reversed(range(chain.n)):
        force, moment = forces[i] + force, moments[i] + moment
        tau[i] = ca.dot(ca.DM(chain.joints[i].axis), moment)
        r, p = to_parent[i]
        force = r @ force
        moment = r @ moment + ca.cross(p, force)
    return ca.vertcat(*tau)


def pendulum_acceleration(chain: Chain, q, qd, u):
    """qdd_U of (3a): the accelerations for which the unactuated joints need no torque."""
    n_u = chain.n - chain.n_a
    qdd_u = ca.SX.sym("qdd_u", n_u)
    residual = inverse_dynamics(chain, q, qd, ca.vertcat(u, qdd_u))[chain.n_a :]
    m, rest = ca.jacobian(residual, qdd_u), ca.substitute(residual, qdd_u, ca.SX.zeros(n_u))
    return -(ca.adj(m) @ rest) / ca.det(m)


def motor_torque(chain: Chain, q, qd, u):
    """tau_A of (3b), (9)."""
    qdd_u = pendulum_acceleration(chain, q, qd, u)
    return inverse_dynamics(chain, q, qd, ca.vertcat(u, qdd_u))[: chain.n_a]


def motor_torque_without_coriolis(chain: Chain, q, u):
    """M~ u + g~ of (11): the torque at standstill."""
    return motor_torque(chain, q, ca.SX.zeros(chain.n), u)
