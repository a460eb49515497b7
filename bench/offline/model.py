"""Rigid-body dynamics of a chain of joints for CasADi, read from the URDF; shares no code with upswing.

Symbols are the paper's (Vu, Hartl-Nesic, Kugi, ICRA 2021). SI units throughout: rad, or m for a prismatic joint. Vectors of all joints
have the order of the chain.
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
    """A joint with one degree of freedom and the body behind it, with what is fixed to that body."""

    name: str
    """In the URDF."""
    prismatic: bool
    rotation: np.ndarray
    """Axes of the joint's frame at position 0 in the parent's frame."""
    translation: np.ndarray
    """Origin of the joint's frame at position 0 in the parent's frame, m."""
    axis: np.ndarray
    """In the joint's frame, a unit vector."""
    mass: float = 0.0
    first_moment: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Mass times centre of mass, in the joint's frame, kg m."""
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """About the joint's origin, in the joint's frame, kg m^2."""
    viscous: float = 0.0
    """Friction that plans contain, N m s/rad or N s/m."""


@dataclass
class Chain:
    """The joints from the root to the tip, and the index sets A and U of the actuated and unactuated ones."""

    joints: list[Joint]
    actuated: list[int]
    unactuated: list[int]

    @property
    def names(self) -> list[str]:
        return [joint.name for joint in self.joints]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def n_a(self) -> int:
        """n_A, number of actuated joints."""
        return len(self.actuated)

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
    """The chain of a URDF; fixed joints merge their link into the body before, joints without effort are not actuated."""
    robot = ElementTree.parse(path).getroot()
    links = {link.get("name"): link for link in robot.findall("link")}
    children = {}
    for joint in robot.findall("joint"):
        if children.setdefault(joint.find("parent").get("link"), joint) is not joint:
            raise ValueError(f"{path.name}: expected a chain, but {joint.find('parent').get('link')} has two children")
    (link,) = set(children) - {joint.find("child").get("link") for joint in children.values()}
    chain = Chain([], [], [])
    # Pose of the current link in the frame of the last movable joint (or of the world).
    rotation, translation = np.eye(3), np.zeros(3)
    while link in children:
        joint = children[link]
        r, p = origin(joint)
        rotation, translation = rotation @ r, translation + rotation @ p
        kind = joint.get("type")
        if kind in ("revolute", "continuous", "prismatic"):
            tag = joint.find("axis")
            axis = np.array([1.0, 0.0, 0.0] if tag is None else numbers(tag.get("xyz")))
            limit = joint.find("limit")
            effort = 0.0 if limit is None else float(limit.get("effort", 0))
            (chain.actuated if effort > 0 else chain.unactuated).append(chain.n)
            axis /= np.linalg.norm(axis)
            chain.joints.append(Joint(joint.get("name"), kind == "prismatic", rotation, translation, axis))
            rotation, translation = np.eye(3), np.zeros(3)
        elif kind != "fixed":
            raise ValueError(
                f"{path.name}: joint {joint.get('name')}: expected revolute, continuous, prismatic or fixed, got {kind}"
            )
        link = joint.find("child").get("link")
        if chain.joints:
            add_body(chain.joints[-1], links[link].find("inertial"), rotation, translation)
    if not chain.actuated or not chain.unactuated:
        raise ValueError(f"{path.name}: expected actuated and unactuated joints")
    return chain


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
    """Torques (forces) of all joints, M qdd + C qd + g and viscous friction: recursive Newton-Euler in body frames."""
    omega, alpha = ca.SX.zeros(3), ca.SX.zeros(3)
    # Gravity as an acceleration of the base.
    acceleration = -ca.SX(ca.DM(GRAVITY))
    to_parent, forces, moments = [], [], []
    for i, joint in enumerate(chain.joints):
        axis = ca.DM(joint.axis)
        r, p = ca.DM(joint.rotation), ca.DM(joint.translation)
        if joint.prismatic:
            slide = r @ axis
            p = p + slide * q[i]
        else:
            k = ca.DM(skew(joint.axis))
            r = r @ (ca.DM.eye(3) + ca.sin(q[i]) * k + (1 - ca.cos(q[i])) * (k @ k))
        acceleration = acceleration + ca.cross(alpha, p) + ca.cross(omega, ca.cross(omega, p))
        if joint.prismatic:
            acceleration = acceleration + slide * qdd[i] + 2 * ca.cross(omega, slide * qd[i])
        acceleration, omega, alpha = r.T @ acceleration, r.T @ omega, r.T @ alpha
        if not joint.prismatic:
            alpha = alpha + axis * qdd[i] + ca.cross(omega, axis * qd[i])
            omega = omega + axis * qd[i]
        c, inertia = ca.DM(joint.first_moment), ca.DM(joint.inertia)
        forces.append(joint.mass * acceleration + ca.cross(alpha, c) + ca.cross(omega, ca.cross(omega, c)))
        moments.append(inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(c, acceleration))
        to_parent.append((r, p))
    tau = [None] * chain.n
    force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in reversed(range(chain.n)):
        joint = chain.joints[i]
        force, moment = forces[i] + force, moments[i] + moment
        tau[i] = ca.dot(ca.DM(joint.axis), force if joint.prismatic else moment) + joint.viscous * qd[i]
        r, p = to_parent[i]
        force = r @ force
        moment = r @ moment + ca.cross(p, force)
    return ca.vertcat(*tau)


def accelerations(chain: Chain, u, qdd_u):
    """qdd of all joints from those of the actuated and of the unactuated ones."""
    qdd = [None] * chain.n
    for indices, values in ((chain.actuated, u), (chain.unactuated, qdd_u)):
        for k, i in enumerate(indices):
            qdd[i] = values[k]
    return ca.vertcat(*qdd)


def free_acceleration(chain: Chain, q, qd, u):
    """qdd_U of (3a): the accelerations for which the unactuated joints need no torque."""
    n_u = chain.n - chain.n_a
    qdd_u = ca.SX.sym("qdd_u", n_u)
    residual = inverse_dynamics(chain, q, qd, accelerations(chain, u, qdd_u))[chain.unactuated]
    m, rest = ca.jacobian(residual, qdd_u), ca.substitute(residual, qdd_u, ca.SX.zeros(n_u))
    return -(ca.adj(m) @ rest) / ca.det(m)


def acceleration(chain: Chain, q, qd, u):
    """qdd of all joints."""
    return accelerations(chain, u, free_acceleration(chain, q, qd, u))


def motor_torque(chain: Chain, q, qd, u):
    """tau_A of (3b), (9)."""
    return inverse_dynamics(chain, q, qd, acceleration(chain, q, qd, u))[chain.actuated]


def motor_torque_without_coriolis(chain: Chain, q, u):
    """M~ u + g~ of (11): the torque at standstill."""
    return motor_torque(chain, q, ca.SX.zeros(chain.n), u)
