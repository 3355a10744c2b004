"""What joins nodes of an ANSYS archive or hangs on them: CE, CP, rigid beams (MPC184), springs (COMBIN14), masses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import RigidElement, Term
from morembs.importers.ansys.archive import Archive
from morembs.importers.ansys.elements import Rows
from morembs.importers.ansys.names import Routine
from morembs.importers.decks.algebra import along, component
from morembs.importers.decks.labels import Labels
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement, PointMass


@dataclass(frozen=True, kw_only=True, eq=False)
class Hanging:
    """What is on single nodes: ``rows`` of elements of a type with a number, whose key options are ``keys``."""

    routine: int
    keys: Mapping[int, int]
    rows: Rows

    @property
    def ends(self) -> Ints:
        """Labels (k, 1 or 2) of its nodes."""
        return self.rows.nodes[:, : 1 if self.routine == Routine.MASS21 else 2]


def sums(archive: Archive, of_solids: Ints, rotated: Ints, notes: list[str]) -> list[tuple[str, list[Term]]]:
    """Equations of CE and CP by labels; those of rotations that solids do not have are left out.

    Raises:
        InputError: one on nodes with axes of their own.
    """
    given = [(title, terms) for title, terms in archive.equations if terms]
    for (number, direction), nodes in archive.coupled.items():
        first, *others = dict.fromkeys(nodes)
        title = f"{archive.name}: CP {number}"
        given += [(title, [(node, direction, 1.0), (first, direction, -1.0)]) for node in others]
    if not given:
        return []
    own_axes, solid = set(rotated.tolist()), set(of_solids.tolist())
    bad = [title for title, terms in given if any(node in own_axes for node, *_ in terms)]
    if bad:
        raise InputError(
            f"{bad[0]} is on nodes with rotated axes, which is not supported; --skip CE,CP leaves it out",
            kind="unsupported",
        )
    kept = [(t, terms) for t, terms in given if not all(c > 2 and node in solid for node, c, _ in terms)]
    if len(kept) < len(given):
        notes.append(f"{len(given) - len(kept)} equations between rotations of solids, which have none, were left out")
    return kept


def rigid_beams(given: Hanging, of_solids: Ints, name: str) -> Iterator[RigidElement]:
    """Rigid elements of MPC184: beams (KEYOPT(1) = 1) that hang together are one body, led by a node that is none of
    ``of_solids`` where there is one.

    Raises:
        InputError: links and joints.
    """
    if given.keys.get(1, 0) != 1:
        raise InputError(
            f"{name} has {len(given.ends)} elements MPC184 with KEYOPT(1) = {given.keys.get(1, 0)} (first: "
            f"{given.rows.ids[0]}); expected rigid beams, KEYOPT(1) = 1; --skip MPC184 leaves them out"
        )
    labels, rows = np.unique(given.ends, return_inverse=True)
    rows, solid, count = rows.reshape(-1, 2), np.isin(labels, of_solids), len(labels)
    touch = sp.coo_array((np.ones(len(rows)), (rows[:, 0], rows[:, 1])), shape=(count, count))
    _, body = connected_components(touch, directed=False)
    degree = np.bincount(rows.ravel(), minlength=count)
    for number in range(int(body.max()) + 1):
        members = np.flatnonzero(body == number)
        master = members[np.lexsort((-degree[members], solid[members]))[0]]
        label = given.rows.ids[body[rows[:, 0]] == number].min()
        slaves = labels[members[members != master]]
        yield RigidElement(name=f"MPC184 {label}", master=int(labels[master]), slaves=slaves)


def springs(
    given: Hanging, reals: Mapping[int, list[float]], nodes: Labels, xyz: Floats, rotated: Ints, name: str
) -> Iterator[DiscreteElement]:
    """Springs and dampers COMBIN14 between two ``nodes``, which are at ``xyz`` (n, 3).

    Raises:
        InputError: nonlinear or plane ones, real constants that are not there, or nodes at one place and no direction.
    """
    way, turning = given.keys.get(2, 0), given.keys.get(3, 0)
    if given.keys.get(1, 0) or way > 6 or (not way and turning > 1):
        raise InputError(
            f"{name}: COMBIN14 with KEYOPT(1) to KEYOPT(3) = {given.keys.get(1, 0)}, {way}, {turning} is not "
            "supported; expected a linear spring in space",
            kind="unsupported",
        )
    places, turned = xyz[nodes.rows(given.ends, "elements name")], np.isin(given.ends, rotated)
    elements = zip(given.rows.ids.tolist(), given.rows.real.tolist(), given.ends.tolist(), strict=True)
    for i, (label, real, (a, b)) in enumerate(elements):
        k, c, nonlinear, *_ = [*_reals(reals, real, f"{name}: COMBIN14 {label}"), 0.0, 0.0, 0.0]
        if nonlinear:
            raise InputError(f"{name}: COMBIN14 {label} has nonlinear damping (CV2); expected none", kind="unsupported")
        if way and turned[i].any():
            raise InputError(
                f"{name}: COMBIN14 {label} is on nodes with rotated axes, which is not supported", kind="unsupported"
            )
        part = component(way - 1) if way else along(places[i, 1] - places[i, 0], 3 * turning)
        if part is None:
            raise InputError(
                f"{name}: COMBIN14 {label} has its nodes at one place and no direction (KEYOPT(2))", kind="model"
            )
        for matrix, value in (("K", k), ("D", c)):
            if value:
                yield spring(f"COMBIN14 {label}", matrix, [(a, part), (b, -part)], value)


def point_masses(
    given: Hanging, reals: Mapping[int, list[float]], name: str
) -> tuple[Sequence[PointMass], Sequence[DiscreteElement]]:
    """Point masses of MASS21, and those whose mass differs by direction.

    Raises:
        InputError: missing constants, negative masses, or forms for plane models.
    """
    form = given.keys.get(3, 0)
    if form not in (0, 2) or given.keys.get(1, 0):
        raise InputError(
            f"{name}: MASS21 with KEYOPT(1) = {given.keys.get(1, 0)}, KEYOPT(3) = {form} is not supported; expected a "
            "mass in space, KEYOPT(1) = 0 and KEYOPT(3) = 0 or 2",
            kind="unsupported",
        )
    masses, others = list[PointMass](), list[DiscreteElement]()
    rows = given.rows
    for label, node, real, system in zip(
        rows.ids.tolist(), rows.nodes[:, 0].tolist(), rows.real.tolist(), rows.system.tolist(), strict=True
    ):
        values = [*_reals(reals, real, f"{name}: MASS21 {label}"), *[0.0] * 6]
        x, y, z, ixx, iyy, izz = (values[0],) * 3 + (0.0,) * 3 if form == 2 else tuple(values[:6])
        if min(x, y, z, ixx, iyy, izz) < 0:
            raise InputError(
                f"{name}: MASS21 {label} has the masses {x:g}, {y:g}, {z:g} and inertias {ixx:g}, {iyy:g}, {izz:g}; "
                "expected none negative",
                kind="unsupported",
            )
        if not (x == y == z and ixx == iyy == izz) and (system or given.keys.get(2, 0)):
            raise InputError(
                f"{name}: the inertia of MASS21 {label} is given in turned axes, which is not supported",
                kind="unsupported",
            )
        if x == y == z:
            masses.append(PointMass(name=f"MASS21 {label}", node=node, mass=x, inertia=np.diag([ixx, iyy, izz])))
            continue
        used = np.flatnonzero([x, y, z, ixx, iyy, izz])
        others.append(
            DiscreteElement(
                name=f"MASS21 {label}",
                matrix="M",
                nodes=np.full(len(used), node),
                components=used,
                values=np.diag(np.array([x, y, z, ixx, iyy, izz])[used]),
            )
        )
    return masses, others


def _reals(reals: Mapping[int, list[float]], number: int, who: str) -> list[float]:
    if number not in reals:
        raise InputError(f"{who} names the real constants {number}, which are not there", kind="unsupported")
    return reals[number]
