"""Node selections such as ``set:BIGEND`` or ``cylinder:x,y,z,dx,dy,dz,r``."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.fe_model import FEModel
from morembs.fem.surface import outer_faces
from morembs.fem.tolerances import TOL

NUMBERS = {"box": 6, "sphere": 4, "cylinder": 7}


def select_nodes(model: FEModel, text: str, *, length: float = 1.0) -> Ints:
    """Rows of ``model.nodes`` that ``text`` selects, sorted.

    Args:
        text: ``set:NAME`` (node set, or all nodes of an element set), ``skin:NAME`` (surface nodes of an
            element set), ``ids:1,2,3`` (labels), ``box:x0,y0,z0,x1,y1,z1``, ``sphere:x,y,z,r`` or
            ``cylinder:x,y,z,dx,dy,dz,r`` (from x, y, z along the vector d to its end; radius r).
        length: m per unit of the numbers in ``text``.

    Raises:
        InputError: unknown form, set or label, wrong count of numbers, or nothing selected.

    >>> select_nodes(model, "set:RIGHT")
    array([16, 17, 18, 19])
    >>> len(select_nodes(model, "box:0,0,0,0.1,1,1"))
    8
    """
    kind, colon, rest = text.partition(":")
    known = ("set", "skin", "ids", *NUMBERS)
    if not colon and text in _names(model):
        raise InputError(f'nodes = {text!r} was given; did you mean "set:{text}"?', kind="unknown", keyword="nodes")
    if not colon or kind not in known:
        raise InputError(
            f"nodes = {text!r} was given; expected set:NAME, skin:NAME, ids:1,2,3, box:x0,y0,z0,x1,y1,z1, "
            f"sphere:x,y,z,r or cylinder:x,y,z,dx,dy,dz,r",
            keyword="nodes",
        )
    if kind in ("set", "skin"):
        rows = _of_set(model, rest) if kind == "set" else _of_skin(model, rest)
    elif kind == "ids":
        rows = _of_labels(model, rest)
    else:
        rows = nodes_in_region(model.nodes.xyz, kind, rest, length=length)
    if not len(rows):
        raise InputError(f"nodes = {text!r} selects no node; {_extent(model, length)}", keyword="nodes")
    return rows


def _names(model: FEModel) -> set[str]:
    """Names of all sets of the model."""
    return {*model.nodes.sets, *(model.mesh.element_sets if model.mesh is not None else ())}


def _of_set(model: FEModel, name: str) -> Ints:
    sets = model.nodes.sets
    if name in sets:
        return sets[name]
    if model.mesh is not None and name in model.mesh.element_sets:
        picked = model.mesh.element_sets[name]
        pairs = zip(model.mesh.blocks, picked, strict=True)
        return np.unique(np.concatenate([block.nodes[rows].ravel() for block, rows in pairs]))
    raise InputError(
        f"the node set {name!r} does not exist or is empty; sets of this model: "
        f"{', '.join(sorted(_names(model))) or 'none'}{_alike(name, model)}",
        kind="unknown",
    )


def _alike(name: str, model: FEModel) -> str:
    """The set of the same name in other capitals."""
    alike = [known for known in _names(model) if known.lower() == name.lower()]
    return f"; did you mean {alike[0]!r}?" if alike else ""


def _of_skin(model: FEModel, name: str) -> Ints:
    if model.mesh is None:
        raise InputError(
            f"nodes = 'skin:{name}' needs elements; this model has matrices only", kind="unsupported", keyword="nodes"
        )
    sets = model.mesh.element_sets
    if name != "all" and name not in sets:
        raise InputError(
            f"the element set {name!r} does not exist; element sets: {', '.join(sets) or 'none'}, all", kind="unknown"
        )
    faces = outer_faces(model.mesh, elements=None if name == "all" else sets[name])
    return np.unique(np.concatenate([nodes.ravel() for nodes in faces.values()]))


def _of_labels(model: FEModel, text: str) -> Ints:
    try:
        labels = np.unique(np.array([int(part) for part in text.split(",")], dtype=np.int64))
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"nodes = 'ids:{text}' was given; expected single node labels such as ids:1,2,3 (no ranges)",
            keyword="nodes",
        ) from error
    order = np.argsort(model.nodes.ids, kind="stable")
    at = np.minimum(np.searchsorted(model.nodes.ids[order], labels), len(order) - 1)
    rows = order[at]
    missing = labels[model.nodes.ids[rows] != labels]
    if len(missing):
        low, high = model.nodes.ids.min(), model.nodes.ids.max()
        raise InputError(f"node {missing[0]} does not exist; labels run from {low} to {high}", kind="unknown")
    return np.sort(rows)


def nodes_in_region(xyz: Floats, kind: str, text: str, *, length: float = 1.0) -> Ints:
    """Rows of ``xyz`` (n, 3) in the box, sphere or cylinder (``kind``) of the numbers ``text``, sorted.

    Args:
        length: units of ``xyz`` per unit of the numbers.

    Raises:
        InputError: wrong numbers.
    """
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(
            f"nodes = '{kind}:{text}' was given; expected {NUMBERS[kind]} numbers", keyword="nodes"
        ) from error
    if len(numbers) != NUMBERS[kind] or not np.isfinite(numbers).all():
        raise InputError(
            f"nodes = '{kind}:{text}' has {len(numbers)} numbers; {NUMBERS[kind]} finite ones are needed",
            keyword="nodes",
        )
    numbers = numbers * length
    if kind == "box":
        low, high = np.minimum(numbers[:3], numbers[3:]), np.maximum(numbers[:3], numbers[3:])
        slack = TOL.region_slack * max(float((high - low).max()), np.finfo(float).tiny)
        inside = ((xyz >= low - slack) & (xyz <= high + slack)).all(axis=1)
    elif kind == "sphere":
        inside = np.linalg.norm(xyz - numbers[:3], axis=1) <= numbers[3] * (1 + TOL.region_slack)
    else:
        height = float(np.linalg.norm(numbers[3:6]))
        if height == 0:
            raise InputError(
                f"nodes = 'cylinder:{text}' has no direction; dx,dy,dz must not all be zero", keyword="nodes"
            )
        along = (xyz - numbers[:3]) @ (numbers[3:6] / height)
        away = np.linalg.norm(xyz - numbers[:3] - along[:, None] * (numbers[3:6] / height), axis=1)
        slack = TOL.region_slack * max(height, float(numbers[6]))
        inside = (along >= -slack) & (along <= height + slack) & (away <= numbers[6] + slack)
    return np.flatnonzero(inside)


def _extent(model: FEModel, length: float) -> str:
    low, high = model.nodes.xyz.min(axis=0) / length, model.nodes.xyz.max(axis=0) / length
    return "the model spans " + " to ".join("(" + ", ".join(f"{v:.6g}" for v in p) + ")" for p in (low, high))
