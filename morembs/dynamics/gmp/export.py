"""Planar members for other programs: Functional Mock-up Units and C sources of ``ReducedMember``."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.dynamics.gmp.configuration import FRAME_COORDINATES, FRAMES
from morembs.dynamics.gmp.data import Parameterised
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.stored import read_members
from morembs.exporters import default_path, make_exporter
from morembs.exporters.base import Destination, Exported
from morembs.exporters.fmu.system import (
    ACCELERATIONS,
    GRAVITY,
    LOADS,
    REACTIONS,
    VELOCITIES,
    System,
    Variable,
    oscillators,
    variables,
)
from morembs.exporters.fmu.targets import Equations
from morembs.exporters.tolerances import TOL
from morembs.storage.contents import keeping_ledger

_POSITIONS = (("position", "m"), ("angle", "rad"))


@keeping_ledger()
def export_member(
    source: str | Path,
    to: str,
    *,
    path: str | Path | None = None,
    member: str | None = None,
    options: Mapping[str, object] | None = None,
    taken: Collection[Path] = (),
) -> Exported:
    """Write one member of a file of members as a Functional Mock-up Unit or as C source.

    Frames move as what comes in says, and what holds them comes out, as far as the option ``held`` names them:
    ["start", "end"] by default, single coordinates as "start.x", "start.y", "start.angle". Loads come in at all others,
    and their motion comes out. Equations are those of ``ParameterisedBody``.

    Args:
        to: "fmu" or "c".
        path: the output; by default beside the source, named after it (and the member, if there are several).
        member: its name; may be left out where the file holds one.
        options: fields of the exporter. ``damping_ratio`` is that of the first bending mode between held frames;
            damping is proportional to the stiffness of strains.
        taken: files that must stay as they are.

    Raises:
        InputError: another target, an unknown option or member, or an output that is taken.
        OutputError: the file cannot be written.
    """
    exporter, place = make_exporter(to, options), Path(source)
    if not isinstance(exporter, Equations):
        raise InputError(
            f"{place} holds planar members, which have no export to {to!r}; take 'fmu' or 'c'",
            kind="unsupported",
            keyword="to",
        )
    members = read_members(place)
    if member is None and len(members) > 1:
        raise InputError(
            f"{place} holds the members {', '.join(members)}; name one of them (--body on the command line)",
            kind="missing",
        )
    name = next(iter(members)) if member is None else member
    if name not in members:
        raise InputError(f"{place} has no member {name!r}; {nearest(name, members)}", kind="unknown")
    if exporter.structure != "auto" or exporter.stress:
        raise InputError(
            f"structure or stress was given for the planar member {name!r}, which has neither; leave it out",
            kind="unsupported",
            keyword="structure",
        )
    if exporter.time_step is not None:
        raise InputError(
            f"a time step was given for the planar member {name!r}, whose modes all stay; leave it out",
            kind="unsupported",
            keyword="time_step",
        )
    if getattr(exporter, "precision", "double") != "double":
        raise InputError(
            'precision = "single" was given for a planar member; expected "double"',
            kind="unsupported",
            keyword="precision",
        )
    held = [*FRAMES] if exporter.held is None else exporter.held
    system = member_system(members[name], held=held, damping_ratio=exporter.damping_ratio)
    target = default_path(place, exporter, name, several=len(members) > 1) if path is None else Path(path)
    if target.resolve() in {other.resolve() for other in taken}:
        raise InputError(
            f"{target} was just written, from another file or the same; give each file once, or --out", kind="output"
        )
    destination = Destination(path=target, file=place)
    destination.refuse_source(target)
    return exporter.write_equations(system, destination, name, system.notes)


def member_system(data: Parameterised, *, held: Sequence[str], damping_ratio: float = 0.0) -> System:
    """The equations of a member, ready to be written as C; ``held`` as in ``export_member``.

    Raises:
        InputError: an unknown coordinate, or nothing that is free to move.
    """
    fixed = _held_coordinates(held)
    free = np.setdiff1d(np.arange(6), fixed)
    moving, m, p = len(free) + data.count, data.count, data.fields.size
    if not moving:
        raise InputError("a member without bending modes between held frames has nothing to move; hold less")
    at, member = np.zeros(6), ReducedMember.of(data)
    at[3] = data.length
    mass = float(member.rigid[:, 0] @ (member.M @ member.rigid[:, 0]))
    # Of stretch by modes only those in use.
    table = np.delete(data.table.coefficients, np.arange(2 * p + 2 + m, 2 * p + 2 + len(data.squares)), axis=2)
    energy = data.energy.coefficients[:, :, None]
    return System(
        structure="member",
        parameters=_parameters(data, damping_ratio),
        inputs=(
            *GRAVITY[:2],
            *_of(free, LOADS, "on the frame", np.zeros(6)),
            *_of(fixed, _POSITIONS, "of the held frame", at),
            *_of(fixed, VELOCITIES, "of the held frame", np.zeros(6)),
            *_of(fixed, ACCELERATIONS, "of the held frame", np.zeros(6)),
        ),
        states=_states(data, free, at, mass),
        outputs=(
            *_of(fixed, REACTIONS, "of what holds the frame, on the member", direct=True),
            *_of(free, _POSITIONS, "of the frame"),
            *_of(free, VELOCITIES, "of the frame"),
            *_of(free, ACCELERATIONS, "of the frame", direct=True),
        ),
        tables=_tables(member, np.concatenate((free, np.arange(6, 6 + m), fixed)), at, moving, table, energy),
        constants={
            "MODES": moving,
            "LOADED": len(free),
            "HELD": len(fixed),
            "BENDING": m,
            "AMPLITUDES": p,
            "FUNCTIONS": len(data.fields.one),
            "NUMBERS": table.shape[2],
            "POINTS": len(table),
            "ENERGY_POINTS": len(energy),
            "MOST_POINTS": max(len(table), len(energy)),
            "REACH": data.reach,
            "LENGTH": data.length,
            "MASS": mass,
            "DAMPING": 0,
            "TOLERANCE": 1,
        },
        buffers=_buffers(m, p, table.shape[2], moving),
        notes=(
            f"planar member: large deflections by its tables, with end angles up to {data.reach:.4g} rad to its chord; "
            "beyond them its outputs are no numbers and steps fail",
        ),
    )


def _tables(
    member: ReducedMember, places: Ints, at: Floats, moving: int, table: Floats, energy: Floats
) -> dict[str, Floats]:
    """By the names of the C code; ``places`` of the ``moving`` coordinates first, then of the held ones."""
    data, slopes = member.data, member.at(member.start(at)).J
    free = np.zeros((data.fields.size, moving)) if slopes is None else slopes[:, places[:moving]]
    return {
        "PLACE": places.astype(float),
        "TABLE": _by_columns(table),
        "ENERGY": _by_columns(energy),
        "PSI": data.Psi[:, : data.count],
        "SQUARES": data.squares[: data.count],
        "ONE": data.fields.one,
        "TURN": data.fields.turn,
        "FIELD_MASS": data.fields.M,
        "ME": free.T @ (member.M @ free),
    }


def _buffers(m: int, p: int, numbers: int, moving: int) -> dict[str, int]:
    """Lengths of arrays, for m modes, p amplitudes of fields and so many numbers of the table."""
    inner, size = 3 + m, 6 + m
    return {
        **dict.fromkeys(("all_q", "all_v", "force"), size),
        **dict.fromkeys(("shape", "side", "bend"), p),
        **dict.fromkeys(("along", "twice"), numbers),
        **dict.fromkeys(("J", "MJ"), p * size),
        **dict.fromkeys(("S", "S_strains"), inner**2),
        **dict.fromkeys(("K", "K_strains", "free_inertia"), moving**2),
        "number": 6 * numbers,
        "P": inner * size,
        "G": p * inner,
        "inertia": size**2,
    }


def _held_coordinates(held: Sequence[str]) -> Ints:
    """Numbers among the six coordinates of both frames.

    Raises:
        InputError: neither a frame nor a coordinate of one.
    """
    names = FRAME_COORDINATES
    numbers = set[int]()
    for name in held:
        found = [k for k, known in enumerate(names) if name in (known, known.partition(".")[0])]
        if not found:
            raise InputError(
                f"held: a planar member has no frame or coordinate {name!r}; {nearest(name, [*FRAMES, *names])}",
                kind="unknown",
            )
        numbers |= {*found}
    return np.array(sorted(numbers), dtype=np.int64)


def _of(
    coordinates: Ints,
    kinds: Sequence[tuple[str, str]],
    about: str,
    start: Floats | None = None,
    *,
    direct: bool = False,
) -> tuple[Variable, ...]:
    """One variable for each coordinate of a frame."""
    return tuple(
        variables(
            [FRAMES[k // 3]],
            # Along x, along y, about z.
            [(0, 1, 5)[k % 3]],
            kinds,
            about,
            start=None if start is None else float(start[k]),
            direct=direct,
        )[0]
        for k in coordinates.tolist()
    )


def _states(data: Parameterised, free: Ints, at: Floats, mass: float) -> tuple[Variable, ...]:
    """Coordinates, then their rates; eta as ``q[1]``, ..."""
    eta = oscillators(data.length * np.sqrt(mass), np.sqrt(data.squares[: data.count]), "amplitude of a bending mode")
    size = np.where(np.isin(free % 3, 2), 1.0, data.length)
    slowest = float(np.sqrt(data.squares[0])) if len(data.squares) else 1.0
    kinds = ((_POSITIONS, at, 1.0), (VELOCITIES, np.zeros(6), TOL.nominal_deflection * slowest))
    frames, rates = (
        tuple(
            replace(variable, name=f"state.{variable.name}", nominal=nominal * scale)
            for variable, nominal in zip(_of(free, kind, "of the frame", start), size.tolist(), strict=True)
        )
        for kind, start, scale in kinds
    )
    return (*frames, *eta[: data.count], *rates, *eta[data.count :])


def _parameters(data: Parameterised, ratio: float) -> tuple[Variable, ...]:
    if ratio and not len(data.squares):
        raise InputError(
            "damping_ratio was given for a member without a bending mode; leave it out", keyword="damping_ratio"
        )
    factor = 2 * ratio / float(np.sqrt(data.squares[0])) if ratio else 0.0
    about = "damping proportional to the stiffness of strains: small vibrations of f Hz have the ratio pi f times it"
    return (
        Variable(name="damping", unit="s", start=factor, about=about),
        Variable(
            name="tolerance",
            unit="1",
            start=TOL.step_error,
            about="co-simulation: error of a step per length of the member",
        ),
    )


def _by_columns(coefficients: Floats) -> Floats:
    """(s, c c): the numbers s of each pair of polynomials, the first one's degree fastest."""
    c, _, s = coefficients.shape
    return np.asarray(coefficients.transpose(2, 1, 0).reshape(s, c * c))
