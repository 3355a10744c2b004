"""Examination with factorisations: motions without energy, mechanisms and where they are, the lowest frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import MorembsError
from morembs.base.types import Bools, Floats, Ints
from morembs.body.diagnostics.findings import Finding, Names, list_labels
from morembs.body.diagnostics.matrices import WORDS
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Nodes, rigid_motion
from morembs.fem.rigid_residual import motion
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.space import Space
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver


def mode_findings(
    K: sp.csr_array,
    M: sp.csr_array,
    *,
    nodes: Nodes | None,
    dofs: DofMap | None,
    solver: LinearSolver | None,
    up_to_hz: float | None,
    time: float,
    expected: int | None,
    parts: int,
    rounding: float = 0.0,
) -> tuple[list[Finding], dict[str, Any]]:
    """Zero-energy motions beyond the ``expected`` rigid ones, and how many modes to expect.

    ``time``: seconds in the unit of time of the matrices; ``rounding`` of the entries of K, relative.

    Costs a factorisation of K + sigma M, about 50 solves and two inertia counts. Peak memory: the factor, three
    copies of K and 60 columns.
    """
    solver = solver if solver is not None else select_solver()
    heavy = M.diagonal() > 0
    sigma = max(TOL.shift, 10 * rounding) * float((K.diagonal()[heavy] / M.diagonal()[heavy]).max())
    try:
        values, Z = _lowest(K, M, sigma, solver)
        zeros = int((values < TOL.zero_eigenvalue * sigma).sum())
        elastic = values[zeros:]
        # Half way on a logarithmic scale no eigenvalue is near the shift; Lanczos may not have room for all zeros.
        between = float(np.sqrt(sigma * max(elastic[0] if len(elastic) else 0.0, 4 * sigma)))
        zeros = max(zeros, _below(K, M, between, solver))
        hz = np.sqrt(np.maximum(elastic, 0.0)) / (2 * np.pi * time)
        counted = None if up_to_hz is None else _below(K, M, (2 * np.pi * up_to_hz * time) ** 2, solver) - zeros
    except MorembsError as error:
        sentence = f"{WORDS['K']} cannot be factorised: {error}"
        return [Finding(code="singular", severity="error", sentence=sentence, cure="look for a mechanism")], {}
    facts: dict[str, Any] = {"zero_modes": zeros, "frequencies_hz": hz}
    findings = []
    usual = 6 * parts if expected is None or parts > 1 else expected
    if zeros > usual and 10 * rounding > TOL.shift:
        sentence = f"K has too few digits to tell elastic from rigid motion: {zeros} motions have next to no energy"
        cure = "export it with 15 digits"
        findings.append(Finding(code="unclear-modes", severity="note", sentence=sentence, cure=cure))
    elif zeros > usual:
        findings.append(_mechanism(K, M, Z, zeros, usual, nodes, dofs))
    if counted is not None and up_to_hz is not None:
        facts["modes_below"] = counted
        words = f"expect {zeros} rigid-body and {counted} elastic modes below {up_to_hz:.6g} Hz"
        findings.append(Finding(code="modes", severity="note", sentence=words))
    elif len(hz):
        words = (
            f"expect {zeros} rigid-body modes, the first elastic one at about {hz[0]:.4g} Hz, and about {len(hz)} of "
            f"these up to {hz[-1]:.4g} Hz"
        )
        findings.append(Finding(code="modes", severity="note", sentence=words))
    return findings, facts


def _below(K: sp.csr_array, M: sp.csr_array, sigma: float, solver: LinearSolver) -> int:
    return solver.negative_eigenvalues(sp.csr_array(K - sigma * M), "K - sigma M")


def _lowest(K: sp.csr_array, M: sp.csr_array, sigma: float, solver: LinearSolver) -> tuple[Floats, Floats]:
    """Estimates of the lowest eigenvalues (k,), up to the first poor one, and the vectors (N, z) without energy."""
    block = min(TOL.block_columns, max(1, K.shape[0] // 3))
    with solver.factorize(sp.csr_array(K + sigma * M), "spd", what="K + sigma M") as factor:
        rng = np.random.default_rng(12)
        start = factor.solve(M @ rng.standard_normal((K.shape[0], block)))
        lanczos = BlockLanczos(
            factor.solve, Space(M), start, capacity=min(block * TOL.krylov_blocks, K.shape[0]), seed=12
        )
        while not lanczos.full() and lanczos.pending.shape[1] and lanczos.size + block <= K.shape[0]:
            lanczos.expand()
    theta, Y, residual = lanczos.ritz()
    sound = theta > 0
    good = sound & (residual <= TOL.good_residual * np.abs(theta))
    # What follows the first poor estimate has gaps.
    count = int(np.argmin(good)) if not good.all() else len(good)
    values = 1 / theta[:count] - sigma
    zeros = int((values < TOL.zero_eigenvalue * sigma).sum())
    return values, lanczos.vectors(Y[:, :zeros])


def _mechanism(
    K: sp.csr_array, M: sp.csr_array, Z: Floats, zeros: int, usual: int, nodes: Nodes | None, dofs: DofMap | None
) -> Finding:
    names = Names(nodes=nodes, dofs=dofs)
    sentence = f"the model has a mechanism: {zeros} motions need no energy where {usual} are expected"
    cure = "join the parts there by a face, or merge nodes that belong together"
    if nodes is not None and dofs is not None:
        moving, hinges = _pieces(K, Z, nodes, dofs)
        if len(moving):
            labels = names.node_labels(hinges if len(hinges) else moving)
            words = list_labels(names.node_labels(moving), len(moving), "node")
            sentence += f"; {words} {'moves' if len(moving) == 1 else 'move'} against the other nodes"
            if len(hinges):
                sentence += f", about {list_labels(labels, len(hinges), 'node')}"
            return Finding(code="mechanism", severity="error", sentence=sentence, cure=cure, where=labels)
        rows = _loose_dofs(M, Z, nodes, dofs)
        labels = names.dof_labels(rows)
        sentence += f"; most of it at {list_labels(labels, len(rows))}"
        return Finding(code="mechanism", severity="error", sentence=sentence, cure=cure, where=labels)
    return Finding(code="mechanism", severity="error", sentence=sentence, cure=cure)


def _pieces(K: sp.csr_array, Z: Floats, nodes: Nodes, dofs: DofMap) -> tuple[Ints, Ints]:
    """Nodes that do not move with the largest rigid piece, and those shared by pieces that are coupled to both.

    Patches of a node and its neighbours give candidates for the rigid motions of a piece.
    """
    used = np.unique(dofs.node)
    table = dofs.of_nodes(used)
    whole = (table >= 0).all(axis=1)
    used, table = used[whole], table[whole]
    if not len(used):
        return used, used
    U = Z[table]
    U = U / max(float(np.abs(U).max(initial=0.0)), np.finfo(float).tiny)
    xyz = nodes.xyz[used] - nodes.xyz[used].mean(axis=0)
    xyz = xyz / (float(np.abs(xyz).max()) or 1.0)
    place = np.full(len(nodes), -1, dtype=np.int64)
    place[used] = np.arange(len(used))
    rng = np.random.default_rng(13)
    left = np.ones(len(used), dtype=bool)
    pieces: list[Bools] = []
    while left.sum() > 2 and len(pieces) < TOL.most_pieces:
        best = np.zeros(len(used), dtype=bool)
        for seed in rng.permutation(np.flatnonzero(left))[: TOL.piece_tries]:
            near = place[_neighbours(K, table[seed], dofs)]
            near = near[near >= 0]
            alike = _moves_with_patch(U, xyz, near)
            if len(near) > 1 and alike[near].all() and (alike & left).sum() > (best & left).sum():
                best = alike
        if not best.any():
            break
        pieces.append(best)
        left &= ~best
    if not pieces or left.all():
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    pieces.sort(key=lambda piece: -int(piece.sum()))
    moving = np.flatnonzero(~pieces[0])
    shared = np.flatnonzero(np.sum(pieces, axis=0) > 1) if len(pieces) > 1 else np.flatnonzero(pieces[0])
    alone = np.full(len(used), -1)
    for number, piece in enumerate(pieces):
        alone[piece & (np.sum(pieces, axis=0) == 1)] = number
    hinges = []
    for node in shared[: 20 * TOL.piece_tries]:
        near = place[_neighbours(K, table[node], dofs)]
        if len(np.unique(alone[near[near >= 0]][alone[near[near >= 0]] >= (0 if len(pieces) > 1 else -1)])) > 1:
            hinges.append(node)
    return used[moving], used[np.array(hinges, dtype=np.int64)]


def _neighbours(K: sp.csr_array, rows: Ints, dofs: DofMap) -> Ints:
    """Nodes that are coupled to the node with these dofs, itself among them."""
    neighbours = [
        K.indices[K.indptr[row] : K.indptr[row + 1]][K.data[K.indptr[row] : K.indptr[row + 1]] != 0] for row in rows
    ]
    return np.unique(dofs.node[np.concatenate(neighbours)])


def _moves_with_patch(U: Floats, xyz: Floats, patch: Ints) -> Bools:
    """Nodes (n,) that move with the rigid motions fitted to a ``patch``; U (n, 3, z) motions, xyz (n, 3)."""
    if not len(patch):
        return np.zeros(len(xyz), dtype=bool)
    component = np.tile(np.arange(3), len(patch))
    R = rigid_motion(np.repeat(xyz[patch], 3, axis=0), component)
    motions, *_ = np.linalg.lstsq(R, U[patch].reshape(3 * len(patch), -1), rcond=TOL.dependent_motion)
    moved = motions[:3] + np.cross(motions[3:].T[None], xyz[:, None, :]).transpose(0, 2, 1)
    return np.asarray(np.abs(U - moved).max(axis=(1, 2)) < TOL.same_motion)


def _loose_dofs(M: sp.csr_array, Z: Floats, nodes: Nodes, dofs: DofMap) -> Ints:
    """Dofs that move most in what is left of the motions without energy beside the rigid ones."""
    R, _, _ = motion(nodes, dofs)
    c, *_ = np.linalg.lstsq(R, Z, rcond=TOL.dependent_motion)
    rest = np.abs(Z - R @ c) * np.sqrt(np.maximum(M.diagonal(), 0.0))[:, None]
    size = rest.max(axis=1)
    rows = np.flatnonzero(size > TOL.named_motion * size.max())
    return np.asarray(rows[np.argsort(-size[rows], kind="stable")])
