"""A model of matrices that a program already holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.base.units import Units, parse_units
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.fe_model import Component
from morembs.fem.named_columns import columns_of_input, columns_of_output
from morembs.importers.imported import Imported
from morembs.importers.matrices.named import square_csr
from morembs.importers.to_model import model_of


@checked
def from_matrices(
    K: Any,
    M: Any,
    D: Any = None,
    B: Any = None,
    C: Any = None,
    *,
    names: Mapping[str, Sequence[str]] | None = None,
    nodes: Nodes | Any = None,
    node: Any = None,
    component: Any = None,
    name: str = "matrices",
    G: Any = None,
    N: Any = None,
    units: Units | str | None = None,
) -> FEModel:
    """Model M u'' + (D + G) u' + (K + N) u = B q, y = C u of matrices of SciPy (any format), NumPy or nested lists.

    Args:
        K, M, D: (N, N) stiffness, mass and damping, symmetric for reductions; D may be left out.
        B, C: (N, m) input and (p, N) output matrix: columns of B and rows of C are generalised forces and motions that
            ``matrix_interface`` makes interfaces of. Entries of displacements have no unit, of rotations lengths.
        G, N: (N, N) gyroscopic and circulatory matrix, as ``FEModel`` has them.
        names: of the columns of B and the rows of C: {"B": [...], "C": [...]}; "1", "2", ... without.
        nodes: places (n, 3), or ``Nodes`` with labels and sets. Without any, each dof is a node of its own, whose mass
            properties and rigid motion mean nothing.
        node, component: (N,) row of ``nodes`` of each dof and its component: 0..2 displacements along x, y, z, 3..5
            rotations, 6 a coordinate without place and direction. x, y, z of each node in turn without them.
        name: what messages call the model.
        units: of all numbers, as ``parse_units`` takes them ("mm-t-s"); SI unless given.

    ``morembs.list_warnings(model)`` says whether places, dofs and units fit the matrices; this function does not.

    Peak memory: copies of the matrices in CSR form.

    Raises:
        InputError: matrices that are not square, of different sizes, or not finite, or B, C, names or
            dofs that do not fit them.

    >>> from_matrices([[2.0, -1.0], [-1.0, 2.0]], [[1.0, 0.0], [0.0, 1.0]], name="two masses").size
    2
    >>> from_matrices([[2.0, -1.0], [-1.0, 2.0]], [[1.0, 0.0], [0.0, 1.0]], B=[1.0, 0.0], name="driven").inputs.names
    ('1',)
    >>> from_matrices(model.K, model.M, nodes=nodes, name="bar again")
    FEModel: dofs 60; nodes 20; matrices K, M; source bar again
    """
    given = {"K": K, "M": M, "D": D, "G": G, "N": N}
    for role, value in given.items():
        if isinstance(value, str | Path):
            raise InputError(
                f"{role} = {str(value)!r} was given; expected a matrix. Files are read by "
                "morembs.import_model(stiffness=..., mass=..., damping=...)",
                keyword=role,
            )
    missing = [role for role in ("K", "M") if given[role] is None]
    if missing:
        raise InputError(
            f"{name}: {' and '.join(missing)} is missing; expected a stiffness matrix K and a mass matrix M",
            kind="missing",
            keyword=missing[0],
        )
    if (node is None) != (component is None) or (node is not None and nodes is None):
        raise InputError(
            f"{name}: nodes, node and component belong together; expected all three, or nodes alone",
            kind="conflict",
            keyword="nodes",
        )
    ready = {role: square_csr(name, role, value) for role, value in given.items() if value is not None}
    size, titles = ready["K"].shape[0], dict(names or {})
    for role in titles:
        if role not in ("B", "C") or {"B": B, "C": C}[role] is None:
            raise InputError(
                f"{name}: names has {role!r}, and there is no such matrix; expected names of B or C",
                kind="unknown",
                keyword="names",
            )
    inputs = None if B is None else columns_of_input(name, B, size, titles.get("B"))
    outputs = None if C is None else columns_of_output(name, C, size, titles.get("C"))
    placed = nodes if nodes is None or isinstance(nodes, Nodes) else _nodes_at(nodes, name)
    dofs = None
    if node is not None:
        dofs = DofMap(node=_whole(node, "node", name), component=_whole(component, "component", name))
        if len(dofs) and dofs.component.max() > Component.SCALAR:
            raise InputError(
                f"{name}: component runs to {dofs.component.max()}; expected 0 to {Component.SCALAR}",
                keyword="component",
            )
    system = parse_units(units) if isinstance(units, str) else units
    return model_of(Imported(source=name, nodes=placed, dofs=dofs, inputs=inputs, outputs=outputs, **ready), system)


def _nodes_at(xyz: Any, name: str) -> Nodes:
    try:
        places = np.asarray(xyz, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: nodes are no numbers ({error}); expected places (n, 3)") from error
    if places.ndim != 2 or places.shape[1] != 3:
        raise InputError(f"{name}: nodes have the shape {places.shape}; expected places (n, 3)", keyword="nodes")
    return Nodes(ids=np.arange(1, len(places) + 1), xyz=places)


def _whole(values: Any, what: str, name: str) -> Ints:
    numbers = np.asarray(values)
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise InputError(
            f"{name}: {what} is {numbers.dtype} of shape {numbers.shape}; expected integers (N,)", keyword=what
        )
    return numbers.astype(np.int64)
