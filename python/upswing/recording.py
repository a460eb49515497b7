"""Recordings of every control cycle as arrays, tables and pages."""

from __future__ import annotations

import html
import os
from typing import TYPE_CHECKING, Any, Dict, List, Mapping, Optional, Union

import numpy as np

from upswing._upswing import Run, read_recording, report_html

if TYPE_CHECKING:
    import pandas

_PER_JOINT = ("q", "qd", "q_d", "qd_d")
_PER_ACTUATED = ("u_d", "u", "tau", "tau_measured")
_NUMBERS = ("seq", "t_ns", "mode", "fault", "warnings", "flags", "plan_id", "t_plan")


class Recording:
    """Cycles of one run, from an MCAP file or from a `Run`.

    All fields of the recording are attributes, one row per cycle: `q`, `qd` (measured positions, estimated velocities; rad or m, and per
    second), `q_d`, `qd_d` (reference), `u_d`, `u` (accelerations before and after the feedback), `tau`, `tau_measured` (N m or N),
    `t_plan` (s), `t_ns`, `mode` (index in `modes`), `flags`, ...
    """

    def __init__(self, fields: Mapping[str, Any]):
        self.fields: Dict[str, Any] = dict(fields)
        self.joints: List[str] = list(fields["joints"])
        self.actuated: List[str] = list(fields["actuated"])
        #: Names of the modes; `mode` has their indices.
        self.modes: List[str] = list(fields["modes"])
        #: Keys and values that identify the run.
        self.details: Dict[str, str] = dict(fields.get("details", {}))
        #: Names and texts of the settings.
        self.files: Dict[str, str] = dict(fields.get("files", {}))

    @classmethod
    def read(cls, path: Union[str, "os.PathLike[str]"], start: float = 0.0, end: Optional[float] = None) -> "Recording":
        """Reads the cycles from `start` to `end` (s after the first cycle) of an MCAP file."""
        return cls(read_recording(path, start, end))

    @classmethod
    def of(cls, run: Run) -> "Recording":
        """The cycles of a run."""
        return cls(run.records)

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["fields"][name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def t(self) -> np.ndarray:
        """Time since the first cycle, s, shape (cycles,)."""
        t_ns = self.fields["t_ns"]
        return (t_ns - t_ns[0]) * 1e-9

    def __len__(self) -> int:
        return len(self.fields["seq"])

    def to_pandas(self, every: int = 1) -> "pandas.DataFrame":
        """One row for each `every`-th cycle, indexed by the time in s; values of joints in columns like `q_joint_1`."""
        import pandas

        columns = {name: self.fields[name][::every] for name in _NUMBERS}
        for names, fields in ((self.joints, _PER_JOINT), (self.actuated, _PER_ACTUATED)):
            for field in fields:
                for i, joint in enumerate(names):
                    columns[f"{field}_{joint}"] = self.fields[field][::every, i]
        columns["mode"] = np.asarray(self.modes, dtype=object)[columns["mode"].astype(int)]
        return pandas.DataFrame(columns, index=pandas.Index(self.t[::every], name="t"))


class Report:
    """The page of a run: the robot in motion, curves, modes and summary. A notebook shows it inline."""

    def __init__(self, page: str):
        #: The page as one HTML document, which needs no network.
        self.html = page

    def save(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Writes the page to a file."""
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.html)

    def _repr_html_(self) -> str:
        # A frame keeps styles and scripts of the page and of the notebook apart.
        style = "width: 100%; height: 900px; border: 0"
        return f'<iframe style="{style}" sandbox="allow-scripts" srcdoc="{html.escape(self.html)}"></iframe>'


def report(source: Union[Run, str, "os.PathLike[str]"], start: float = 0.0, end: Optional[float] = None) -> Report:
    """The page of a run or of an MCAP file, as `upswing report` writes it, from `start` to `end` (s, of a file)."""
    return Report(source._repr_html_page() if isinstance(source, Run) else report_html(source, start, end))
