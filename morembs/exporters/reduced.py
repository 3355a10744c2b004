"""The reduced matrices of a body: by the letters of the papers, and with interface dofs among the coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.body import Body
from morembs.body.stored import StoredBodies
from morembs.exporters.base import ExportContext
from morembs.exporters.read_back import SecondOrder
from morembs.exporters.tolerances import TOL
from morembs.fem.fe_model import Component
from morembs.linalg.dense import symmetric

_ADVICE = 'reduce with method "craig-bampton" or keep more modes, or export to "op4" or "matrix-market"'


def reduced_matrices(body: Body) -> dict[str, Floats]:
    """M, K, D (n, n) and B (n, m); C (m, n) too where it is not B'. Without D or B where there are none."""
    matrices = {"M": body.mass_matrix, "K": body.stiffness_matrix}
    if body.damping_matrix.any():
        matrices["D"] = body.damping_matrix
    if body.input_matrix.size:
        matrices["B"] = body.input_matrix
        if not np.array_equal(body.output_matrix, body.input_matrix.T):
            matrices["C"] = body.output_matrix
    return matrices


def body_transfer(body: Body, rows: Ints | slice = slice(None)) -> SecondOrder:
    """The transfer matrix of a body, of some ``rows`` of C and the same columns of B."""
    return second_order(reduced_matrices(body) | {"B": body.input_matrix[:, rows], "C": body.output_matrix[rows]})


def second_order(matrices: Mapping[str, Any]) -> SecondOrder:
    """Of M, K, D, B, C by their letters, as ``reduced_matrices`` gives them."""
    dense = {key: A.toarray() if sp.issparse(A) else np.asarray(A) for key, A in matrices.items()}
    B = dense.get("B", np.eye(len(dense["M"])))
    return SecondOrder(M=dense["M"], K=dense["K"], D=dense.get("D"), B=B, C=dense.get("C", B.T))


def interface_transfer(matrices: Mapping[str, Any], count: int) -> SecondOrder:
    """Of matrices whose first ``count`` coordinates are interface degrees of freedom."""
    return second_order({**matrices, "B": np.eye(matrices["M"].shape[0], count)})


@dataclass(frozen=True, kw_only=True, eq=False)
class InterfaceBody:
    """Reduced ``matrices`` M, K, D (n, n) in coordinates of which the first m are the interface degrees of freedom.

    ``node`` label and ``dof`` (n,) of each; dofs 1 to 6 of the ``grids`` (label, interface, point (3,) in m), then
    one of each point of ``rest``.
    """

    matrices: dict[str, Floats]
    node: Ints
    dof: Ints
    grids: tuple[tuple[int, str, Floats], ...]
    rest: tuple[int, ...]
    notes: tuple[str, ...]

    def transfer(self, labelled: Mapping[str, tuple[Any, Ints, Ints]]) -> SecondOrder:
        """Of matrices M, K, D of a file, each with the labels of the points of its rows and their dofs.

        Raises:
            InputError: rows that are not of this body.
        """
        place = {pair: row for row, pair in enumerate(zip(self.node.tolist(), self.dof.tolist(), strict=True))}
        matrices = {}
        for key, (matrix, node, dof) in labelled.items():
            pairs = list(zip(node.tolist(), dof.tolist(), strict=True))
            if not set(pairs) <= set(place):
                raise InputError(f"matrix {key} has rows of other points")
            rows = [place[pair] for pair in pairs]
            matrices[key] = np.zeros((len(place), len(place)))
            matrices[key][np.ix_(rows, rows)] = matrix.toarray()
        return interface_transfer(matrices, len(place) - len(self.rest))


def on_interfaces(
    context: ExportContext, first_label: int | None, *, component_of_rest: int, largest_label: int
) -> InterfaceBody:
    """The body with interface dofs as coordinates, all others beside them; labels up to ``largest_label``.

    Raises:
        InputError: the body is not symmetric or has no stiffness, its interface degrees of freedom depend on each
            other or are generalised forces, or there are no labels for its points.
    """
    body, source = context.body, context.source
    for name in ("mass_matrix", "stiffness_matrix"):
        if not getattr(body, name).any():
            raise InputError(
                f"the {name} of body {body.name!r} has no entries (it holds rigid-body motion only), and this target "
                'has no matrix for that; keep at least one elastic mode, or export to "op4" or "matrix-market"',
                kind="unsupported",
                keyword="modes",
            )
    refuse_two_sided(body)
    if (source.input_component == Component.SCALAR).any():
        name = list(source.interfaces)[
            source.input_interface[np.flatnonzero(source.input_component == Component.SCALAR)[0]]
        ]
        raise InputError(
            f"interface {name!r} has generalised forces (columns of B or C), which belong to no node of this target; "
            'export to "op4" or "matrix-market"',
            kind="unsupported",
            keyword="interface",
        )
    T, notes = to_interfaces(body, body.output_matrix)
    wanted = {"M": body.mass_matrix, "K": body.stiffness_matrix, "D": body.damping_matrix}
    matrices = {key: symmetric(T.T @ A @ T) for key, A in wanted.items() if key != "D" or A.any()}
    others = len(T) - len(source.input_interface)
    label, note = _first_label(source, first_label, others, largest_label)
    grids, node, free = _grids(source, label)
    rest = tuple(range(free, free + others))
    return InterfaceBody(
        matrices=matrices,
        grids=grids,
        rest=rest,
        notes=(*notes, *note),
        node=np.concatenate([node, np.array(rest, dtype=np.int64)]),
        dof=np.concatenate([source.input_component + 1, np.full(len(rest), component_of_rest, dtype=np.int64)]),
    )


def refuse_two_sided(body: Body) -> None:
    """Refuse a body whose matrices are not symmetric.

    Raises:
        InputError: it is one.
    """
    if not np.array_equal(body.output_matrix, body.input_matrix.T):
        raise InputError(
            f"body {body.name!r} comes from a two-sided reduction; forces and motions of its interfaces are not of one "
            'coordinate. Reduce it with a one-sided method, or export to "op4" or "matrix-market"',
            kind="unsupported",
            keyword="method",
        )
    if not body.symmetric:
        raise InputError(
            f"body {body.name!r} has gyroscopic or circulatory terms, so that its matrices are not symmetric, and this "
            'format takes symmetric ones; export to "op4", "matrix-market", "statespace" or "modelica"',
            kind="model",
        )


def to_interfaces(body: Body, C: Floats) -> tuple[Floats, tuple[str, ...]]:
    """T (n, n): reduced coordinates = T @ [interface degrees of freedom C q; others], and what was done.

    Raises:
        InputError: these degrees of freedom depend on each other.
    """
    m, n = C.shape
    if not m:
        return np.eye(n), ()
    boundary, N, unchanged = held_and_free(C, body.name)
    if unchanged:
        return np.hstack([boundary, N]), ()
    if m == n:
        return boundary, ("coordinates were changed to the interface degrees of freedom",)
    eigenvalues, Y = sl.eigh(symmetric(N.T @ body.stiffness_matrix @ N), symmetric(N.T @ body.mass_matrix @ N))
    N = N @ Y
    if eigenvalues[0] > TOL.rigid_stiffness * eigenvalues[-1]:
        # With the interfaces held nothing moves freely, so unit motions can be static: K couples nothing then.
        boundary = boundary - N @ ((N.T @ body.stiffness_matrix @ boundary) / eigenvalues[:, None])
    note = "coordinates were changed: interface degrees of freedom, then modes of the body with interfaces held"
    return np.hstack([boundary, N]), (f"{note}; none was dropped",)


def held_and_free(C: Floats, name: str) -> tuple[Floats, Floats, bool]:
    """X (n, m) with C X = 1 and N (n, n - m) with C N = 0 for the motions C (m, n) of a body, and whether these are
    coordinates of the body, each one of them.

    Raises:
        InputError: the motions depend on each other.
    """
    m, n = C.shape
    entry = np.argmax(np.abs(C), axis=1)
    unit = np.zeros_like(C)
    unit[np.arange(m), entry] = 1.0
    if np.array_equal(C, unit) and len(set(entry.tolist())) == m:
        order = np.concatenate([entry, np.setdiff1d(np.arange(n), entry)])
        return np.eye(n)[:, order[:m]], np.eye(n)[:, order[m:]], True
    size = np.linalg.norm(C, axis=1)
    scaled = C / np.where(size > 0, size, 1.0)[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    if m > n or values[-1] <= TOL.dependent_interface * values[0]:
        raise InputError(
            f"the {m} interface degrees of freedom of body {name!r} are not independent in its {n} coordinates, "
            f"so they cannot be coordinates themselves; {_ADVICE}",
            kind="model",
            keyword="modes",
        )
    return np.linalg.pinv(scaled) / size, sl.null_space(scaled, rcond=TOL.dependent_interface), False


def _first_label(source: StoredBodies, given: int | None, others: int, largest: int) -> tuple[int, tuple[str, ...]]:
    """Label of the first frame, then come the other frames and ``others``; and a note where it needs care."""
    known = [source.node_ids, *(interface.node_ids for interface in source.interfaces.values())]
    highest = max((int(ids.max()) for ids in known if len(ids)), default=0)
    label = highest + 1 if given is None else given
    framed = source.input_node_id < 0
    # Nodes of direct interfaces come under their own labels.
    direct = source.input_node_id[~framed].tolist()
    if direct and min(direct) < 1:
        raise InputError(f"a direct interface has a node with the label {min(direct)}; expected 1 or more, renumber it")
    count = others + len(np.unique(source.input_interface[framed]))
    least, last = max([0, *direct]) + 1, largest - count + 1
    if not least <= label <= last:
        what = f"labels from {label} on are needed" if given is None else f"first_label = {label} was given"
        why = "above those of the nodes of direct interfaces, " if direct else ""
        raise InputError(f"{what}; expected {least} to {last}, {why}so that {count} points have room")
    if label > highest:
        return label, ()
    return label, (f"labels count from {label}, though the model had labels up to {highest}; leave its nodes out",)


def _grids(source: StoredBodies, label: int) -> tuple[tuple[tuple[int, str, Floats], ...], Ints, int]:
    """Label, interface and point of each grid, the label for each interface dof, and the next free label."""
    names = list(source.interfaces)
    xyz = dict(zip(source.node_ids.tolist(), source.coordinates, strict=True))
    frames: dict[int, int] = {}
    grids: dict[int, tuple[str, Floats]] = {}
    node = []
    for index, own in zip(source.input_interface.tolist(), source.input_node_id.tolist(), strict=True):
        if own < 0:
            own = frames.setdefault(index, label + len(frames))
            grids[own] = names[index], source.interfaces[names[index]].point
        elif own in xyz:
            grids[own] = names[index], xyz[own]
        else:
            raise InputError(
                f"the file lacks node {own} of the interface {names[index]!r}; write it again", kind="file"
            )
        node.append(own)
    return tuple((key, *grids[key]) for key in sorted(grids)), np.array(node, dtype=np.int64), label + len(frames)
