"""What joins nodes of an ANSYS archive or hangs on them: CE, CP, rigid beams (MPC184), springs (COMBIN14), masses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import RigidElement, Term
from morembs.importers.ansys.archive import Archive
from morembs.importers.ansys.elements import Elements, Routine, element_name
from morembs.importers.decks.problems import Problems
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement, Imported, PointMass

Options = Mapping[int, int]


def sums(archive: Archive, of_solids: Ints, rotated: set[int], notes: list[str]) -> list[tuple[str, list[Term]]]:
    """Equations of CE and CP by labels; those of rotations that solids do not have are left out.

    Raises:
        InputError: one on nodes with axes of their own.
    """
    given = [(title, terms) for title, terms in archive.equations if terms]
    for (number, component), nodes in archive.coupled.items():
        first, *others = dict.fromkeys(nodes)
        title = f"{archive.name}: CP {number}"
        given += [(title, [(node, component, 1.0), (first, component, -1.0)]) for node in others]
    bad = [title for title, terms in given if any(node in rotated for node, *_ in terms)]
    if bad:
        raise InputError(f"{bad[0]} is on nodes with rotated axes, which is not supported; --skip CE,CP leaves it out")
    solid = set(of_solids.tolist()) if given else set()
    kept = [(t, terms) for t, terms in given if not all(c > 2 and node in solid for node, c, _ in terms)]
    if len(kept) < len(given):
        notes.append(f"{len(given) - len(kept)} equations between rotations of solids, which have none, were left out")
    return kept


def ends(archive: Archive, kind: int, elements: Elements) -> Ints:
    """Labels (k, 1 or 2) of the nodes of elements that hang on a part."""
    return elements.nodes[:, : 1 if archive.types[kind][0] == Routine.MASS21 else 2]


def ties_of(
    archive: Archive,
    hanging: list[tuple[int, Elements]],
    used: Ints,
    xyz: Floats,
    solid: NDArray[np.bool_],
    rotated: NDArray[np.bool_],
    problems: Problems,
) -> Imported:
    """Rigid elements, springs and masses of (type, elements) on rows of the ascending labels ``used`` (n,).

    ``xyz`` (n, 3), ``solid`` (n,) and ``rotated`` (n,) say where the nodes are, which are of solids, and which have
    axes of their own. What is refused goes to ``problems``.
    """
    rigid, discrete, masses = list[RigidElement](), list[DiscreteElement](), list[PointMass]()
    for kind, elements in hanging:
        (routine, keys), rows = archive.types[kind], np.searchsorted(used, ends(archive, kind, elements))
        with problems.collected(flags=(f"--skip {element_name(routine)}",)):
            if routine == Routine.MASS21:
                points, others = point_masses(elements, keys, archive.reals, rows[:, 0].tolist(), archive.name)
                masses += points
                discrete += others
            elif routine == Routine.MPC184:
                rigid += rigid_beams(elements, keys, rows, solid, archive.name)
            else:
                discrete += springs(elements, keys, archive.reals, rows, xyz, rotated, archive.name)
    return Imported(source=archive.name, rigid=tuple(rigid), masses=tuple(masses), discrete=tuple(discrete))


def rigid_beams(
    elements: Elements, options: Options, rows: Ints, solid: NDArray[np.bool_], name: str
) -> list[RigidElement]:
    """Rigid elements of MPC184: beams (KEYOPT(1) = 1) that hang together are one body.

    Args:
        rows: (k, 2) of the nodes of each.
        solid: (n,) whether each node is one of solids; another one leads where there is one.

    Raises:
        InputError: links and joints.
    """
    if options.get(1, 0) != 1:
        raise InputError(
            f"{name} has {len(rows)} elements MPC184 with KEYOPT(1) = {options.get(1, 0)} (first: {elements.ids[0]}); "
            "expected rigid beams, KEYOPT(1) = 1; --skip MPC184 leaves them out"
        )
    count = len(solid)
    touch = sp.coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=(count, count))
    _, body = connected_components(touch, directed=False)
    degree = np.bincount(rows.ravel(), minlength=count)
    bodies = []
    for number in np.unique(body[rows[:, 0]]).tolist():
        members = np.flatnonzero((body == number) & (degree > 0))
        master = members[np.lexsort((-degree[members], solid[members]))[0]]
        label = elements.ids[body[rows[:, 0]] == number].min()
        bodies.append(RigidElement(name=f"MPC184 {label}", master=int(master), slaves=members[members != master]))
    return bodies


def springs(
    elements: Elements,
    options: Options,
    reals: Mapping[int, list[float]],
    rows: Ints,
    xyz: Floats,
    rotated: NDArray[np.bool_],
    name: str,
) -> list[DiscreteElement]:
    """Springs and dampers COMBIN14 between two nodes in the ``rows`` (k, 2) of ``xyz``.

    Raises:
        InputError: nonlinear or plane ones, real constants that are not there, or nodes at one place and no direction.
    """
    way, turning = options.get(2, 0), options.get(3, 0)
    if options.get(1, 0) or way > 6 or (not way and turning > 1):
        raise InputError(
            f"{name}: COMBIN14 with KEYOPT(1) to KEYOPT(3) = {options.get(1, 0)}, {way}, {turning} is not supported; "
            "expected a linear spring in space"
        )
    discrete = []
    for label, real, (i, j) in zip(elements.ids.tolist(), elements.real.tolist(), rows.tolist(), strict=True):
        if real not in reals:
            raise InputError(f"{name}: COMBIN14 {label} names the real constants {real}, which are not there")
        k, c, nonlinear, *_ = [*reals[real], 0.0, 0.0, 0.0]
        part, along = np.zeros(6), xyz[j] - xyz[i]
        if nonlinear:
            raise InputError(f"{name}: COMBIN14 {label} has nonlinear damping (CV2); expected none")
        if way:
            part[way - 1] = 1.0
            if rotated[[i, j]].any():
                raise InputError(f"{name}: COMBIN14 {label} is on nodes with rotated axes, which is not supported")
        elif not np.linalg.norm(along) > 0:
            raise InputError(f"{name}: COMBIN14 {label} has its nodes at one place and no direction (KEYOPT(2))")
        else:
            part[3 * turning : 3 * turning + 3] = along / np.linalg.norm(along)
        discrete += [
            spring(f"COMBIN14 {label}", matrix, [(i, part), (j, -part)], value)
            for matrix, value in (("K", k), ("D", c))
            if value
        ]
    return discrete


def point_masses(
    elements: Elements, options: Options, reals: Mapping[int, list[float]], rows: Sequence[int], name: str
) -> tuple[list[PointMass], list[DiscreteElement]]:
    """Point masses of MASS21 on the nodes in ``rows``, and those whose mass differs by direction.

    Raises:
        InputError: missing constants, negative masses, or forms for plane models.
    """
    form = options.get(3, 0)
    if form not in (0, 2) or options.get(1, 0):
        raise InputError(
            f"{name}: MASS21 with KEYOPT(1) = {options.get(1, 0)}, KEYOPT(3) = {form} is not supported; expected a "
            "mass in space, KEYOPT(1) = 0 and KEYOPT(3) = 0 or 2"
        )
    masses, others = list[PointMass](), list[DiscreteElement]()
    for label, row, real, system in zip(elements.ids, rows, elements.real, elements.system, strict=True):
        if int(real) not in reals:
            raise InputError(f"{name}: MASS21 {label} names the real constants {real}, which are not there")
        values = [*reals[int(real)], *[0.0] * 6]
        x, y, z, ixx, iyy, izz = (values[0],) * 3 + (0.0,) * 3 if form == 2 else tuple(values[:6])
        if min(x, y, z, ixx, iyy, izz) < 0:
            raise InputError(
                f"{name}: MASS21 {label} has the masses {x:g}, {y:g}, {z:g} and inertias {ixx:g}, {iyy:g}, {izz:g}; "
                "expected none negative"
            )
        if not (x == y == z and ixx == iyy == izz) and (system or options.get(2, 0)):
            raise InputError(f"{name}: the inertia of MASS21 {label} is given in turned axes, which is not supported")
        if x == y == z:
            masses.append(PointMass(name=f"MASS21 {label}", node=row, mass=x, inertia=np.diag([ixx, iyy, izz])))
            continue
        used = np.flatnonzero([x, y, z, ixx, iyy, izz])
        others.append(
            DiscreteElement(
                name=f"MASS21 {label}",
                matrix="M",
                nodes=np.full(len(used), row),
                components=used,
                values=np.diag(np.array([x, y, z, ixx, iyy, izz])[used]),
            )
        )
    return masses, others
