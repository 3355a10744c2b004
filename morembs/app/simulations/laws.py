"""Laws over time in a system file: factors of loads, and prescribed motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from morembs.base.errors import InputError
from morembs.base.key_tables import Table, declare_key
from morembs.base.limits import Finite, Positive, text
from morembs.base.types import Floats
from morembs.storage.csv_table import read_table

if TYPE_CHECKING:
    from morembs.dynamics.multibody import Motion

Scalar = Callable[[float], float]
CsvPath = Annotated[str, text('the path of a table such as "load.csv"', r"\.csv$")]
# Columns of a load: its force and its moment.
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")


def _refuse_keys(kind: str, table: Table, needed: Mapping[str, tuple[str, ...]], common: set[str]) -> None:
    """Refuse keys that the ``kind`` of a law lacks, or that belong to another."""
    for key in needed[kind]:
        if getattr(table, key) is None:
            raise InputError(f'kind = "{kind}" was given without {key}; add it', kind="conflict", keyword="kind")
    for key in sorted(table.given - set(needed[kind]) - common):
        raise InputError(
            f'{key} was given beside kind = "{kind}", which does not have it; leave it out',
            kind="conflict",
            keyword=key,
        )


@dataclass(frozen=True, kw_only=True)
class LawTable(Table):
    """A factor of time: ``offset + sin(2 pi frequency_hz t + phase)``, a column of a table, or a rise from 0 to 1."""

    kind: Literal["sine", "table", "rise"]
    frequency_hz: Positive | None = declare_key("of the kind sine", None)
    phase_degrees: Finite = declare_key("of the kind sine", 0.0)
    offset: Finite = declare_key("of the kind sine", 0.0)
    file: CsvPath | None = declare_key(
        "a .csv file with the columns t and factor, or t and some of fx, fy, fz, mx, my, mz, of the kind table", None
    )
    begin: Finite = declare_key("when it rises, s, of the kind rise", 0.0)
    duration: Positive | None = declare_key("of the rise, a polynomial of degree five, s", None)

    def refuse_conflicts(self) -> None:
        more = {"sine": {"phase_degrees", "offset"}, "table": set[str](), "rise": {"begin"}}
        needed = {"sine": ("frequency_hz",), "table": ("file",), "rise": ("duration",)}
        _refuse_keys(self.kind, self, needed, {"kind", *more[self.kind]})

    def factor(self) -> Scalar:
        """The factor of a law that is no table."""
        if self.kind == "rise":
            # Not at the top: files are checked without it.
            from morembs.dynamics.multibody import Motion

            return Motion.smooth(1.0, self.duration or 1.0, self.begin).value
        w, phase, offset = 2 * math.pi * (self.frequency_hz or 0.0), math.radians(self.phase_degrees), self.offset
        return lambda t: offset + math.sin(w * t + phase)

    def columns(self, resolve: Callable[[str], Path], begin: float, end: float) -> tuple[Floats, Floats]:
        """Times (k,) of the table, and its values: the factor (k, 1), or the six components (k, 6).

        Raises:
            InputError: a file that cannot be read, other columns, times that do not ascend or do not cover the run.
        """
        path = resolve(self.file or "")
        columns = read_table(path, ("t",), ("factor", *COMPONENTS), what="the table of a law")
        t = columns.pop("t")
        if not columns or ("factor" in columns and len(columns) > 1):
            raise InputError(
                f"{path} has the columns t,{','.join(columns)}; expected t,factor or t,fx,fy,fz,mx,my,mz",
                kind="file",
                keyword="columns",
            )
        refuse_outside(path, t, begin, end)
        if "factor" in columns:
            return t, columns["factor"][:, None]
        none = np.zeros(len(t))
        return t, np.stack([columns.get(name, none) for name in COMPONENTS], axis=1)


@dataclass(frozen=True, kw_only=True)
class MotionTable(Table):
    """A prescribed motion: a steady rate, a smooth change, a sine, or the cubic spline through a table."""

    kind: Literal["steady", "smooth", "sine", "table"]
    start: Finite = declare_key("rad or m at time zero; of a sine about which it swings", 0.0)
    rate: Finite | None = declare_key("rad/s or m/s, of the kind steady", None)
    change: Finite | None = declare_key("rad or m, of the kind smooth", None)
    duration: Positive | None = declare_key("s, of the kind smooth", None)
    begin: Finite = declare_key("s, of the kind smooth", 0.0)
    amplitude: Finite | None = declare_key("rad or m, of the kind sine", None)
    frequency_hz: Positive | None = declare_key("of the kind sine", None)
    phase_degrees: Finite = declare_key("of the kind sine", 0.0)
    file: CsvPath | None = declare_key("a .csv file with the columns t and value, of the kind table", None)

    def refuse_conflicts(self) -> None:
        needed = {
            "steady": ("rate",),
            "smooth": ("change", "duration"),
            "sine": ("amplitude", "frequency_hz"),
            "table": ("file",),
        }
        more = {
            "steady": {"start"},
            "smooth": {"start", "begin"},
            "sine": {"start", "phase_degrees"},
            "table": set[str](),
        }
        _refuse_keys(self.kind, self, needed, {"kind", *more[self.kind]})

    def motion(self, resolve: Callable[[str], Path], begin: float, end: float) -> Motion:
        """The motion from ``begin`` to ``end`` (s).

        Raises:
            InputError: a table that cannot be read, or ends before the run does.
        """
        # Not at the top: files are checked without it.
        from morembs.dynamics.multibody import Motion

        if self.kind == "steady":
            return Motion.steady(self.rate or 0.0, self.start)
        if self.kind == "smooth":
            return Motion.smooth(self.change or 0.0, self.duration or 1.0, self.begin, self.start)
        if self.kind == "sine":
            return _sine_motion(self.amplitude or 0.0, self.frequency_hz or 0.0, self.phase_degrees, self.start)
        path = resolve(self.file or "")
        columns = read_table(path, ("t", "value"), what="the table of a motion")
        return _spline(path, columns["t"], columns["value"], begin, end)


def _sine_motion(amplitude: float, hz: float, phase_degrees: float, start: float) -> Motion:
    from morembs.dynamics.multibody import Motion

    w, phase = 2 * math.pi * hz, math.radians(phase_degrees)
    return Motion(
        lambda t: start + amplitude * math.sin(w * t + phase),
        lambda t: amplitude * w * math.cos(w * t + phase),
        lambda t: -amplitude * w * w * math.sin(w * t + phase),
    )


def _spline(path: Path, t: Floats, values: Floats, begin: float, end: float) -> Motion:
    # Not at the top: few systems have such a table.
    from scipy.interpolate import CubicSpline

    from morembs.dynamics.multibody import Motion

    if len(t) < 4:
        raise InputError(
            f"{path} has {len(t)} rows; expected four or more, through which a cubic spline goes",
            kind="file",
            keyword="rows",
        )
    refuse_outside(path, t, begin, end)
    spline = CubicSpline(t, values)
    value, rate, acceleration = (spline.derivative(order) if order else spline for order in (0, 1, 2))
    return Motion(lambda s: float(value(s)), lambda s: float(rate(s)), lambda s: float(acceleration(s)))


def refuse_outside(path: Path, t: Floats, begin: float, end: float) -> None:
    """Refuse times of a table that do not ascend, or do not cover the run.

    Raises:
        InputError: in these cases.
    """
    ascends = np.diff(t) > 0
    if not ascends.all():
        k = int(np.argmin(ascends))
        raise InputError(f"{path}: t = {t[k]:g} is followed by {t[k + 1]:g}; expected times that ascend", keyword="t")
    if t[0] > begin or t[-1] < end:
        raise InputError(
            f"{path} goes from t = {t[0]:g} to {t[-1]:g} s, and the run from {begin:g} to {end:g} s; add rows, or "
            "change begin and end",
            kind="file",
            keyword="t",
        )
