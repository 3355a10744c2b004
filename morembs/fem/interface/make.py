"""An interface from the nodes that a user selects, checked."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from morembs.base.arguments import explain_misfit
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel
from morembs.fem.interface.base import Interface, coupling_kind
from morembs.fem.surface import nodal_areas, outer_faces
from morembs.fem.tolerances import TOL

log = logging.getLogger(__name__)


@explain_misfit
def make_interface(
    model: FEModel,
    *,
    name: str,
    nodes: Ints,
    coupling: str = "rigid",
    point: Sequence[float] | None = None,
    components: Sequence[int] | None = None,
) -> Interface:
    """Interface with checked nodes, area-consistent weights and, if not given, the centroid as point.

    Args:
        nodes: rows of ``model.nodes`` (see ``select_nodes``).
        point: in m.
        coupling: "rigid", "average", "direct", or a kind of your own in ``COUPLINGS``.
        components: exposed degrees of freedom; by default all six, or for "direct" all that every node has.

    Raises:
        InputError: unknown coupling, no nodes, components that a node lacks, or collinear nodes under a rigid or
            average coupling; a text, labels or other numbers in place of rows.

    >>> make_interface(model, name="tip", nodes=select_nodes(model, "set:RIGHT"), coupling="average").point
    array([0.4  , 0.025, 0.025])
    """
    kind = coupling_kind(name, coupling)
    rows = np.unique(_rows(model, name, nodes))
    if not len(rows):
        raise InputError(f"interface {name!r} has no nodes", kind="missing")
    there = kind.available(model, name, rows)
    chosen = there if components is None else tuple(sorted(set(components)))
    if not chosen or not set(chosen) <= set(there):
        known = f"0..{there[-1]}" if there == tuple(range(len(there))) else ", ".join(map(str, there))
        raise InputError(
            f"interface {name!r}: components = {list(components or [])} was given; expected some of {known}",
            keyword="components",
        )
    weights, bare = _area_weights(model, rows)
    xyz = model.nodes.xyz[rows]
    origin = weights @ xyz / weights.sum() if point is None else np.asarray(point, dtype=float)
    extent = float(np.linalg.norm(np.ptp(model.nodes.xyz, axis=0)))
    if not np.linalg.norm(origin - xyz.mean(axis=0)) <= TOL.far_lengths * max(extent, np.finfo(float).tiny):
        raise InputError(
            f"interface {name!r}: its point {origin.tolist()} m lies more than {TOL.far_lengths:g} lengths of the "
            "model away from its nodes; check the point and the units",
            keyword="origin",
        )
    if kind.weighted and bare:
        log.warning(
            "interface %s: %d of %d nodes carry no whole face of the selection and get no weight", name, bare, len(rows)
        )
    interface = Interface(name=name, nodes=rows, coupling=coupling, point=origin, weights=weights, components=chosen)
    kind.check(model, interface)
    return interface


def _rows(model: FEModel, name: str, nodes: Ints) -> Ints:
    """``nodes`` as rows of ``model.nodes``."""
    if isinstance(nodes, str):
        raise InputError(
            f"interface {name!r}: nodes = {nodes!r} was given; expected rows of the nodes, "
            f"select_nodes(model, {nodes!r}) gives them",
            keyword="nodes",
        )
    rows, count = np.asarray(nodes), len(model.nodes)
    if rows.dtype.kind not in "iu" and rows.size:
        raise InputError(
            f"interface {name!r}: nodes holds {rows.dtype}; expected rows of the nodes, see select_nodes",
            keyword="nodes",
        )
    if rows.size and not (rows.min() >= 0 and rows.max() < count):
        bad = rows[(rows < 0) | (rows >= count)][0]
        raise InputError(
            f"interface {name!r}: nodes holds the row {bad}, and the model has {count}; labels are turned into rows "
            f'by select_nodes(model, "ids:{bad}")',
            keyword="nodes",
        )
    return rows.astype(np.int64)


def _area_weights(model: FEModel, rows: Ints) -> tuple[Floats, int]:
    """Areas (ns,) in m2 of the whole faces between the nodes, and how many nodes lie on none of these.

    Ones, and no such nodes, where there are no faces at all.
    """
    if model.mesh is not None:
        faces = outer_faces(model.mesh, within=rows[rows < len(model.mesh.nodes)])
        areas = nodal_areas(model.nodes.xyz, faces)[rows]
        if areas.sum() > 0:
            on_face = np.isin(rows, np.concatenate([nodes.ravel() for nodes in faces.values()]))
            return areas, int((~on_face).sum())
    return np.ones(len(rows)), 0
