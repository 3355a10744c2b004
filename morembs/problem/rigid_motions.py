"""The one place where it is decided which rigid motions a coupled model has, from its matrices and never by its graph.

Evidence are the forces K R of geometric rigid motions against their round-off, for the whole model and for each group
of dofs that K does not couple. Coordinates without places have no rigid motions of geometry: the null space of K is
all that they have. Motions without energy beyond these (hinges) show when K is factorised.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel
from morembs.fem.fe_model import Component, has_places
from morembs.fem.interface import Coupling
from morembs.linalg.congruence import abs_products
from morembs.linalg.null_space import groups_of, null_space
from morembs.linalg.rigid import decimal_precision, free_in_groups, has_stiffness, rigid_null_space
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem.tolerances import TOL


def need_factor(model: FEModel, K: sp.csr_array) -> bool:
    """True if the motions of ``K`` show in a factorisation only: many coordinates without places that are coupled."""
    limit = LINALG.dense_rows
    return not has_places(model) and K.shape[0] > limit and int(np.bincount(groups_of(K)[1]).max()) > limit


def rigid_motions(
    model: FEModel, coupling: Coupling, K: sp.csr_array, M: sp.csr_array, solver: LinearSolver
) -> tuple[Floats, Floats]:
    """M-orthonormal bases of the rigid motions (Nc, r) that K leaves free of strain and (Nc, h) that it holds.

    Raises:
        InputError: a support so soft that it is hidden by round-off, parts that move against each other without
            strain, or motions without stiffness and mass.
        SolverError: a large model without places, of which K cannot be factorised.
    """
    Phi, massless = _independent_motions(coupling.R, M)
    current_budget().release_pages()
    # One matrix at a time has its pages in memory.
    size, last = terms_in_rows(model, coupling, model.K, Phi), max(decimal_precision(model.K.data), model.strained)
    current_budget().release_pages()
    rows = nodes_of_rows(model, coupling)
    free, supported = rigid_null_space(K, Phi, size, rows, last)
    if massless.shape[1]:
        loose = rigid_null_space(K, massless, terms_in_rows(model, coupling, model.K, massless), rows, last)[0].shape[1]
        _refuse_massless(loose)
    current_budget().release_pages()
    if has_places(model):
        _refuse_free_parts(model, coupling, K, Phi, free.shape[1], last)
    else:
        Z = null_space(K, solver.with_memory(current_budget().bytes_left()), last)
        if Z.shape[1] > free.shape[1]:
            free, supported = Z, Phi[:, :0]
    return _orthonormal(free, M), _orthonormal(supported, M)


def terms_in_rows(model: FEModel, coupling: Coupling, A: sp.csr_array, Phi: Floats) -> Floats:
    """Sums (Nc, k) of all terms that cancel in A Phi for a matrix ``A`` of the model.

    Frames sum up the forces of their nodes, most of which cancel there: their round-off grows with the root of the
    number of terms, and so do these sums.
    """
    T = sp.csc_array(abs(coupling.T))
    size = T.T @ abs_products(A, T @ np.abs(Phi), model.dofs.component == Component.SCALAR)
    terms = T.astype(bool).T @ np.diff(A.indptr).astype(float)
    growth = np.where(np.diff(T.indptr) > 1, np.sqrt(np.maximum(terms / TOL.row_terms, 1.0)), 1.0)
    return np.asarray(size * growth[:, None])


def nodes_of_rows(model: FEModel, coupling: Coupling) -> Ints:
    """Node (Nc,) that each coupled dof moves, the first of several nodes of a frame."""
    T = sp.csc_array(coupling.T)
    of_entry = np.asarray(model.dofs.node, dtype=np.int64)[T.indices]
    return np.minimum.reduceat(of_entry, T.indptr[:-1])


def acts_on_rigid_motion(
    model: FEModel, coupling: Coupling, own: sp.csr_array | None, given: sp.csr_array | None, rigid: Floats
) -> bool:
    """True if a matrix ``own`` (Nc, Nc) of the coupled dofs, ``given`` (N, N) in the model, acts on the motions
    ``rigid`` (Nc, r), which then couple to the elastic part."""
    if own is None or given is None or not own.nnz or not rigid.shape[1]:
        return False
    # A row that moves by the round-off of these vectors alone has no terms that its force could cancel among.
    moves = np.abs(rigid) > TOL.still_row * np.abs(rigid).max(axis=0)
    rigid = np.where(moves, rigid, 0.0)
    sums, rows = terms_in_rows(model, coupling, given, rigid), nodes_of_rows(model, coupling)
    return has_stiffness(own, rigid, sums, rows, decimal_precision(given.data))


def _independent_motions(R: Floats, M: sp.csr_array) -> tuple[Floats, Floats]:
    """Independent combinations of the rigid motions ``R`` (Nc, 6), of one size: (Nc, k) with mass, (Nc, l) without."""
    moves = R[:, :3].any(axis=1)
    # Rotations per radius, so that all motions move nodes as far.
    radius = float(np.sqrt((R[moves, 3:] ** 2).sum(axis=1).mean())) if moves.any() else 0.0
    inertia = np.abs(np.diag(R.T @ (M @ R)))
    gyration = float(np.sqrt(inertia[3:].sum() / inertia[:3].sum())) if inertia[:3].any() else 0.0
    # Where all nodes follow one frame, its place alone is left of theirs, perhaps the origin.
    radius = radius if radius > TOL.compact_radius * gyration else gyration
    R = R / np.repeat([1.0, radius or 1.0], 3)
    G = R.T @ (M @ R)
    # Eigenvectors of the inertia are independent motions also where some vanish (all nodes on a line).
    scale = np.sqrt(np.abs(np.diag(G)).clip(np.finfo(float).tiny))
    values, U = sl.eigh(G / np.outer(scale, scale))
    good = values > TOL.dependent_motion
    far = np.where(moves, 1.0, radius or 1.0)[:, None]
    Phi = R if good.all() else (R / scale) @ U[:, good]
    others = R @ np.linalg.qr(U[:, ~good] / scale[:, None])[0]
    size = np.linalg.norm(others * far, axis=0)
    moving = size > TOL.still_motion * np.linalg.norm(R * far, axis=0).max(initial=0.0)
    return np.asarray(Phi / np.linalg.norm(Phi * far, axis=0)), np.asarray(others[:, moving] / size[moving])


def _refuse_massless(count: int) -> None:
    if count:
        raise InputError(
            f"{count} rigid-body motions of the model have neither stiffness nor mass (such as turning about the "
            "line of all nodes beside lumped masses); hold them, leave their dofs out, or give them mass",
            kind="model",
            keyword="mass",
        )


def _refuse_free_parts(
    model: FEModel, coupling: Coupling, K: sp.csr_array, Phi: Floats, free: int, last: float
) -> None:
    """Refuse groups of dofs that K does not couple and that have more motions free of strain than the ``free`` of all.

    Raises:
        InputError: in these cases.
    """
    count, group = groups_of(K)
    if count == 1:
        return
    size = np.bincount(group)
    order, ends = np.argsort(group, kind="stable"), np.cumsum(size)
    # The motions of all groups in the same columns: K couples none of them.
    own = np.zeros_like(Phi)
    rank = np.zeros(count, dtype=np.int64)
    for number in np.flatnonzero(size > 1):
        rows = order[ends[number] - size[number] : ends[number]]
        U, s, _ = np.linalg.svd(Phi[rows], full_matrices=False)
        rank[number] = int((s > TOL.still_motion * s.max(initial=0.0)).sum())
        own[rows, : rank[number]] = U[:, : rank[number]]
    terms = terms_in_rows(model, coupling, model.K, own)
    found = free_in_groups(K, own, terms, nodes_of_rows(model, coupling), last, group, rank)
    if int(found.sum()) <= free:
        return
    part = _parts(model, coupling, group)[group]
    counts = np.sort(np.bincount(part))[::-1]
    loose = model.nodes.ids[nodes_of_rows(model, coupling)[order[ends[int(np.argmax(found))] - 1]]]
    expected = "one free body has 6" if free == Phi.shape[1] == 6 else f"the whole model has {free}"
    if len(counts) == 1:
        raise InputError(
            f"the model has a mechanism: {int(found.sum())} rigid-body modes where {expected}: dofs at node {loose} "
            "move against others; look for parts that touch in a node or an edge only, or nodes that should be merged",
            kind="model",
        )
    raise InputError(
        f"the model has {len(counts)} unconnected parts (of {', '.join(map(str, counts[:5].tolist()))} dofs) and "
        f"{int(found.sum())} rigid-body modes where {expected}: nothing holds the part at node {loose} to the others; "
        "join the parts (merge coincident nodes), hold each of them, or reduce them one by one",
        kind="model",
    )


def _parts(model: FEModel, coupling: Coupling, group: Ints) -> Ints:
    """The part (groups,) of each group of coupled dofs; groups that move one node belong together."""
    T, count = sp.coo_array(coupling.T), int(group.max()) + 1
    ends = count + model.dofs.node[T.coords[0]]
    links = sp.csr_array(
        (np.ones(T.nnz, dtype=np.int8), (group[T.coords[1]], ends)), shape=(count + len(model.nodes),) * 2
    )
    return np.unique(connected_components(links, directed=False)[1][:count], return_inverse=True)[1].astype(np.int64)


def _orthonormal(Z: Floats, M: sp.csr_array) -> Floats:
    if not Z.shape[1]:
        return Z
    mass = Z.T @ (M @ Z)
    try:
        return np.asarray(Z @ np.linalg.inv(np.linalg.cholesky(mass)).T)
    except np.linalg.LinAlgError:
        _refuse_massless(
            max(int((np.linalg.eigvalsh(mass) <= TOL.dependent_motion * np.abs(mass).max(initial=0.0)).sum()), 1)
        )
        raise
