"""What C code needs of a body: its variables, and the tables of its equations."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.recovery_shapes import Recovery
from morembs.body.vtkhdf_series import stored_recovery
from morembs.exporters.base import ExportContext
from morembs.exporters.real_time import RealTime
from morembs.exporters.tolerances import TOL
from morembs.fem.fe_model import Component

AXES = "xyz"
LOADS = (("force", "N"), ("moment", "N.m"))
MOTIONS = (("displacement", "m"), ("rotation", "rad"))
VELOCITIES = (("velocity", "m/s"), ("angular_velocity", "rad/s"))
REACTIONS = (("reaction_force", "N"), ("reaction_moment", "N.m"))
ACCELERATIONS = (("acceleration", "m/s2"), ("angular_acceleration", "rad/s2"))
_TENSOR = ("xx", "yy", "zz", "xy", "yz", "zx")
# Keywords of C, and files beside which those of a body lie.
_KEYWORDS = frozenset(
    (
        "auto",
        "bool",
        "break",
        "case",
        "char",
        "const",
        "continue",
        "default",
        "do",
        "double",
        "else",
        "enum",
        "extern",
        "float",
        "for",
        "goto",
        "if",
        "inline",
        "int",
        "long",
        "register",
        "restrict",
        "return",
        "short",
        "signed",
        "sizeof",
        "static",
        "struct",
        "switch",
        "typedef",
        "union",
        "unsigned",
        "void",
        "volatile",
        "while",
        "fmi2",
        "fmi3",
        "instance",
        "math",
        "model",
        "stdbool",
        "stdint",
        "stdlib",
        "string",
    )
)


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A number that goes in or out: ``unit`` one of ``description.UNITS``; ``start`` where there is one; ``direct``
    of an output that follows inputs at once; ``nominal`` size of a state."""

    name: str
    unit: str
    about: str = ""
    start: float | None = None
    direct: bool = False
    nominal: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """A body of one ``structure`` with n normal or elastic coordinates, ready to be written as C.

    ``tables`` and ``constants`` by the names that the C code has; ``buffers``: length of each array that its equations
    work with. A "member" is a planar one of large deflections. ``real_time``: modes and errors at the time step.
    """

    structure: Literal["linear", "floating", "member"]
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    tables: Mapping[str, Floats]
    constants: Mapping[str, int | float]
    buffers: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    real_time: RealTime | None = None


GRAVITY = tuple(
    Variable(name=f"gravity.{axis}", unit="m/s2", about="acceleration of gravity", start=0.0) for axis in AXES
)


def oscillators(unit: Floats | float, omega: Floats, about: str) -> tuple[Variable, ...]:
    """Coordinates q[1], q[2], ... and then their rates, at rest; nominal values are those of one energy in all modes,
    that of a deflection of ``unit`` times ``nominal_deflection`` in the slowest."""
    speed = TOL.nominal_deflection * np.broadcast_to(unit, omega.shape) * np.min(omega[omega > 0], initial=np.inf)
    speed = np.where(np.isfinite(speed), speed, 1.0)
    size = speed / np.where(omega > 0, omega, np.min(omega[omega > 0], initial=np.inf))
    sizes = (("q", about, np.where(size > 0, size, 1.0)), ("q_rate", f"rate of a {about}", speed))
    return tuple(
        Variable(name=f"{name}[{k + 1}]", unit="1", about=text, start=0.0, nominal=value)
        for name, text, values in sizes
        for k, value in enumerate(values.tolist())
    )


def identifier(name: str) -> str:
    """``name`` as C and Modelica take it: letters, digits and underscores, no digit first, no keyword of C."""
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"n_{text}" if not text or text[0].isdigit() or text in _KEYWORDS else text


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Each name -> an identifier of its own, whatever the case of letters."""
    result: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        text = base = identifier(name)
        count = 1
        while text.upper() in taken:
            count += 1
            text = f"{base}_{count}"
        taken.add(text.upper())
        result[name] = text
    return result


def renamed_note(names: Mapping[str, str]) -> tuple[str, ...]:
    """A note on the names that are others now."""
    changed = ", ".join(f"{old!r} is {new}" for old, new in names.items() if old != new)
    return (f"names that are no identifiers of C: {changed}",) if changed else ()


def labels(context: ExportContext) -> tuple[list[str], dict[str, str]]:
    """Of each column of the input matrix the thing that moves, such as ``big_end``, and identifiers of interfaces."""
    source = context.source
    names, known = list(source.interfaces), identifiers(source.interfaces)
    columns, scalars = [], dict.fromkeys(names, 0)
    for index, component, node in zip(
        source.input_interface.tolist(), source.input_component.tolist(), source.input_node_id.tolist(), strict=True
    ):
        name = names[index]
        if component == Component.SCALAR:
            forces = source.interfaces[name].forces
            columns.append(f"{known[name]}.{identifier(forces[scalars[name]])}")
            scalars[name] += 1
        else:
            columns.append(known[name] if node < 0 else f"{known[name]}.node_{node}")
    return columns, known


def variables(
    columns: Sequence[str], components: Sequence[int], kinds: Sequence[tuple[str, str]], about: str, **values: object
) -> tuple[Variable, ...]:
    """One variable for each column: ``kinds`` has name and unit of what is along the axes and of what is about them."""
    result = []
    for column, component in zip(columns, components, strict=True):
        scalar = component == Component.SCALAR
        kind, unit = kinds[0 if scalar else component // 3]
        name = f"{column}.{kind}" if scalar else f"{column}.{kind}.{AXES[component % 3]}"
        result.append(Variable(name=name, unit="1" if scalar else unit, about=about, **values))  # type: ignore[arg-type]
    return tuple(result)


@dataclass(frozen=True, kw_only=True, eq=False)
class StressRows:
    """Stresses that were asked for: (6 s, nr) per reduced coordinate, (6 s, m) per load of a column, and names."""

    shapes: Floats
    loads: Floats
    outputs: tuple[Variable, ...]

    @property
    def count(self) -> int:
        """Number s of tensors."""
        return len(self.shapes) // 6


def stress_rows(context: ExportContext, nodes: Sequence[int]) -> StressRows:
    """Stresses at the nodes with these labels, where materials meet one of each.

    Raises:
        InputError: the body has no stress shapes, or none at such a node.
    """
    n, m = context.body.input_matrix.shape
    none = StressRows(shapes=np.zeros((0, n)), loads=np.zeros((0, m)), outputs=())
    if not nodes:
        return none
    recovery = None if context.file is None else stored_recovery(context.file, context.body.name)
    if recovery is None:
        raise InputError(
            f"stress = {list(nodes)} was given, and body {context.body.name!r} has no stress shapes; reduce it with "
            "[stress], or leave stress out",
            keyword="stress",
        )
    rows, names = _points(recovery, nodes)
    take = (6 * rows[:, None] + np.arange(6)).ravel()
    loads = np.zeros((len(take), m)) if recovery.correction is None else np.asarray(recovery.correction[take], float)
    parts = [*(f"{name}.{part}" for name in names for part in _TENSOR), *(f"{name}.von_mises" for name in names)]
    outputs = tuple(Variable(name=part, unit="Pa", about="stress", direct=bool(loads.any())) for part in parts)
    shapes = np.asarray(recovery.stress[take], dtype=float) @ recovery.deformation
    return StressRows(shapes=shapes, loads=loads, outputs=outputs)


def _points(recovery: Recovery, nodes: Sequence[int]) -> tuple[NDArray[np.int64], list[str]]:
    rows, names = [], []
    for label in dict.fromkeys(nodes):
        points = np.flatnonzero(recovery.points == label)
        if not len(points):
            known = recovery.points
            nearest = known[np.argsort(np.abs(known - label), kind="stable")[:3]].tolist()
            raise InputError(
                f"stress: node {label} has no stress in the file; the nearest labels are {nearest}", kind="unknown"
            )
        rows += points.tolist()
        several = len(points) > 1
        names += [f"stress.node_{label}" + (f".material_{recovery.material[row]}" if several else "") for row in points]
    return np.array(rows, dtype=np.int64), names
