"""Stress at points of a body, and what its displacements lack, from reduced coordinates; as a file keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints, Reals
from morembs.fem import freeze
from morembs.storage.table import Table, dataset, read_rows, table_of

if TYPE_CHECKING:
    import scipy.sparse as sp

_JUMPS = "only where jumps are wanted"


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """Stress at points of a body from its reduced coordinates.

    ``points`` (np,) labels of the nodes, ascending rows of the model; ``coordinates`` (np, 3) m; ``material`` (np,)
    index of the material (a node where materials meet is one point for each). ``stress`` (6 np, nr) Pa per unit of
    each reduced coordinate, ``correction`` (6 np, m) Pa per unit of each interface load, or None; single or double
    precision. ``deformation`` (nr, nr) takes the rigid motion out of reduced coordinates, so that none of it is left
    to cancel in single precision.

    ``missing`` (Nc, m) are displacements in coupled dofs, per unit of each interface load, that the basis lacks; in a
    body file they are ``displacement`` (3 N, m) m of its nodes. ``markers`` (6, m) are the displacements and small
    rotations of the interfaces with a frame in them.

    ``jump`` (6 ne, nr) and ``jump_correction`` (6 ne, m) are as ``stress`` and ``correction``, of single elements
    less the average: at ``jump_point`` (ne,), places in the points, ascending, in the elements ``jump_element`` (ne,).
    """

    points: Ints = dataset("whole", "np", "labels of the nodes; a node where materials meet comes once for each")
    coordinates: Floats = dataset("later", "np 3", "positions of the points", "m")
    material: Ints = dataset("whole", "np", "index of the material of each point")
    deformation: Floats = dataset(
        "real", "n n", "takes the rigid motion out of reduced coordinates, before stress is applied"
    )
    stress: Reals = dataset(
        "later",
        "6np n",
        "row 6 i + c: component c (xx, yy, zz, xy, yz, zx) of point i per unit of each coordinate",
        "Pa",
        columns=True,
    )
    correction: Reals | None = dataset(
        "later",
        "6np m",
        "mode acceleration: what stress lacks, per unit of each interface load; rows as stress",
        "Pa",
        default=None,
        columns=True,
        when="where there are loads and it is wanted",
    )
    missing: Reals | None = None
    displacement: Reals | None = dataset(
        "later",
        "3N m",
        "mode acceleration: what basis lacks, per unit of each interface load; rows as basis",
        "m",
        default=None,
        columns=True,
        when="with `correction`; files from before it have stresses corrected only",
    )
    jump_point: Ints | None = dataset(
        "whole", "nj", "where among the points a stress of a single element is, ascending", default=None, when=_JUMPS
    )
    jump_element: Ints | None = dataset(
        "whole", "nj", "and the number of that element, through all blocks of the mesh", default=None, when=_JUMPS
    )
    jump: Reals | None = dataset(
        "later",
        "6nj n",
        "as stress, of a single element less the average at the point; row 6 i + c of jump_point[i]",
        "Pa",
        default=None,
        columns=True,
        when=_JUMPS,
    )
    jump_correction: Reals | None = dataset(
        "later",
        "6nj m",
        "what jump lacks, per unit of each interface load; rows as jump",
        "Pa",
        default=None,
        columns=True,
        when=_JUMPS,
    )
    markers: Mapping[str, Floats] = dataset(
        "real",
        "6 m",
        "displacement and small rotation of the interface in displacement",
        name="markers/*",
        default_factory=dict,
    )

    def __post_init__(self) -> None:
        for attribute in fields(self):
            if isinstance(value := getattr(self, attribute.name), np.ndarray):
                object.__setattr__(self, attribute.name, freeze(value))

    @cached_property
    def seams(self) -> bool:
        """True if some node is more than one point."""
        return len(np.unique(self.points)) < len(self.points)

    def at(self, coordinates: Floats, loads: Floats | None = None) -> Floats:
        """Stresses (nt, np, 6) in Pa of reduced coordinates (nt, nr) and interface loads (nt, m) in N and Nm."""
        return self._apply_shapes(self.stress, self.correction, coordinates, loads)

    def jumps_at(self, coordinates: Floats, loads: Floats | None = None) -> Floats | None:
        """How far elements miss the averaged stress around each point (nt, np) in Pa; None where that was not kept.

        The largest von Mises stress of element less average, at any of its points, over the elements at the point
        (Zienkiewicz and Zhu 1987 measure the error of stresses by that difference). An element's other points count as
        elements on both sides of a peak agree in it. Von Mises stress being a norm of deviators, no element's von Mises
        stress is further from that of the average.
        """
        if self.jump is None or self.jump_point is None or self.jump_element is None:
            return None
        # Not at the top: what reads does without.
        from morembs.fem.stress_operator import von_mises

        size = von_mises(self._apply_shapes(self.jump, self.jump_correction, coordinates, loads))
        elements, which = np.unique(self.jump_element, return_inverse=True)
        order = np.argsort(which, kind="stable")
        first = np.searchsorted(which[order], np.arange(len(elements)))
        of_element = np.maximum.reduceat(size[:, order], first, axis=1)
        starts = np.searchsorted(self.jump_point, np.arange(len(self.points)))
        return np.asarray(np.maximum.reduceat(of_element[:, which], starts, axis=1))

    def _apply_shapes(
        self, shapes: Reals, correction: Reals | None, coordinates: Floats, loads: Floats | None
    ) -> Floats:
        """Tensors (nt, rows / 6, 6) of shapes (rows, nr) and their correction (rows, m)."""
        q = np.asarray(coordinates, dtype=np.float64) @ self.deformation.T
        tensors = shapes @ q.T.astype(shapes.dtype)
        if loads is not None and correction is not None:
            tensors += correction @ np.asarray(loads).T.astype(correction.dtype)
        return np.asarray(np.moveaxis(tensors.reshape(len(shapes) // 6, 6, -1), -1, 0), dtype=np.float64)


RECOVERY = table_of(Recovery)
_AT_POINTS = ("points", "coordinates", "material", "stress", "correction")
_AT_JUMPS = ("jump_point", "jump_element", "jump", "jump_correction")


def recovery_parts(recovery: Recovery, at_nodes: sp.csr_array | None = None) -> dict[str, Any]:
    """Values for the rows of ``RECOVERY``.

    ``at_nodes`` (3 N, Nc) gives the displacements of the nodes of the file; without it these are as they are.
    """
    # Not at the top: what reads does without.
    from morembs.storage.writer import Columns

    values, missing = dict(vars(recovery)), recovery.missing
    if at_nodes is not None:
        values["displacement"] = (
            missing
            if missing is None
            else Columns(
                (at_nodes.shape[0], missing.shape[1]),
                missing.dtype,
                (at_nodes @ column[:, None] for column in missing.T),
            )
        )
    return values


def read_recovery(group: Any, *, stress: bool = True) -> Recovery:
    """The recovery in an open HDF5 ``group``, whole in memory; without ``stress`` it has no points.

    Raises:
        InputError: a dataset is missing.
    """
    if stress:
        recovery: Recovery = read_rows(group, RECOVERY, "the stress recovery lacks")
        return recovery
    present = {name: group[name] for name in _AT_POINTS if name in group}
    empty: dict[str, Any] = {name: np.empty((0, *item.shape[1:]), item.dtype) for name, item in present.items()}
    rows = tuple(row for row in RECOVERY if row.name not in (*_AT_POINTS, *_AT_JUMPS))
    return Recovery(**read_rows(group, Table(rows), "the stress recovery lacks"), **empty)
