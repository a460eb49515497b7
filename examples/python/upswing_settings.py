"""The settings of a system, as `upswing config export` writes them: in full, with the defaults of what its folder leaves out."""

import math
import subprocess
import tempfile
import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Joint:
    """A movable joint of the URDF."""

    name: str
    prismatic: bool
    actuated: bool
    """Whether it has a motor: an effort that is not 0."""

    @property
    def unit(self):
        """Of positions that people read."""
        return "m" if self.prismatic else "deg"

    def shown(self, q):
        """q, rad or m, in that unit."""
        return q if self.prismatic else np.degrees(q)

    def position(self, value):
        """The reverse of `shown`."""
        return value if self.prismatic else math.radians(value)

    def text(self, q):
        """Name and position, q in rad or m."""
        return f"{self.name} {self.shown(q):.{4 if self.prismatic else 2}f} {self.unit}"


class Settings:
    """Files and joints of a system: the name of a shipped one, or a folder."""

    def __init__(self, system, program="upswing"):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder) / "system"
            export = [program, "config", "export", str(folder), "--system", str(system)]
            run = subprocess.run(export, capture_output=True, text=True)
            if run.returncode != 0:
                raise ValueError(run.stderr.strip())
            read = lambda name: tomllib.loads((folder / name).read_text(encoding="utf-8"))
            self.robot, self.daemon, self.plant = read("robot.toml"), read("daemon.toml"), read("plant.toml")
            self.manoeuvres = read("manoeuvres.toml")["manoeuvre"]
            # The bodies of the simulated robot; usually robot.urdf.
            self.urdf = (folder / self.plant["model"]["urdf"]).read_text(encoding="utf-8")
        self.joints = joints_of(self.urdf)
        self.period_ns = self.daemon["cycle"]["period_us"] * 1000

    def per_joint(self, value):
        """A list over the joints: of one value for all, or of a table of names; NaN where it says nothing."""
        if not isinstance(value, dict):
            return [value] * len(self.joints)
        return [value.get(joint.name, value.get("default", math.nan)) for joint in self.joints]

    def numbers(self, value):
        """The same as an array of numbers."""
        return np.array(self.per_joint(value), dtype=float)

    def positions(self, table, key):
        """An array over the joints, rad or m, from the entries KEY_deg and KEY_m of a table; a range has two columns."""
        values, slides = self.by_kind(table, f"{key}_deg", f"{key}_m"), [joint.prismatic for joint in self.joints]
        return np.where(slides, values.T, np.radians(values.T)).T

    def by_kind(self, table, revolute, prismatic):
        """An array over the joints from the entries of a table for revolute and for prismatic joints."""
        both = zip(self.joints, *(self.per_joint(table.get(key, {})) for key in (revolute, prismatic)))
        return np.array([slide if joint.prismatic else turn for joint, turn, slide in both], dtype=float)

    def given(self, name):
        """The joints whose ends a request for this manoeuvre gives, in its order, with the last position in its database, rad or m."""
        found = next((m for m in self.manoeuvres if m["name"] == name), None)
        if found is None:
            raise ValueError(f"unknown manoeuvre `{name}`: this system has {', '.join(m['name'] for m in self.manoeuvres)}")
        rows = [row for row in found.get("target", []) if row.get("given")]
        joints = {joint.name: joint for joint in self.joints}
        value = lambda row, unit: row.get(f"to_{unit}", row.get(f"value_{unit}"))
        return {row["joint"]: joint.position(value(row, joint.unit)) for row in rows if (joint := joints[row["joint"]])}


def add_system_options(parser):
    """The options that name a system."""
    parser.add_argument("--system", default="iiwa-pendulum", metavar="NAME|DIR", help="a shipped one, or a folder [%(default)s]")
    parser.add_argument("--program", default="upswing", help="the program that knows it [%(default)s]")


def joints_of(urdf):
    """The movable joints of a chain, from base to tip."""
    elements = ElementTree.fromstring(urdf).findall("joint")
    children = {joint.find("child").get("link") for joint in elements}
    order, links = [], [link for joint in elements if (link := joint.find("parent").get("link")) not in children][:1]
    while links:
        link = links.pop()
        for joint in elements:
            if joint.find("parent").get("link") == link:
                links.append(joint.find("child").get("link"))
                if joint.get("type") != "fixed":
                    limit = joint.find("limit")
                    effort = 0.0 if limit is None else float(limit.get("effort", 0))
                    order.append(Joint(joint.get("name"), joint.get("type") == "prismatic", effort > 0))
    return order
