"""Does the stiffness fit the geometry? K times rigid motion is zero for a free body whose dofs are mapped rightly."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats, Ints
from morembs.body.diagnostics.findings import Finding, Names, list_labels
from morembs.body.diagnostics.matrices import pieces
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Nodes
from morembs.fem.rigid_residual import Residual, is_mounted
from morembs.fem.tolerances import TOL as FEM
from morembs.linalg.congruence import magnitudes


def doubled_diagonal(K: sp.csr_array, residuals: Residual) -> bool:
    """True if half the diagonal would fit the geometry: a triangle was added to its mirror image."""
    force = residuals.force - 0.5 * K.diagonal()[:, None] * residuals.R
    size = magnitudes(K, residuals.R).max(axis=1)
    good = np.abs(force).max(axis=1) <= FEM.strained_force * size
    return bool(residuals.bad.mean() > FEM.most_dofs and good.mean() > TOL.halved_share)


def rigid_findings(K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap, names: Names) -> list[Finding]:
    """Why K carries force under rigid motion, in an order of dofs that is right."""
    bad, share = residuals.bad, float(residuals.bad.mean())
    worst = float(residuals.worst.max(initial=0.0))
    if worst <= FEM.rounded_force:
        return []
    if not bad.any():
        sentence = f"the stiffness under rigid motion is {worst:.1e} of its terms, which should cancel: rounded numbers"
        cure = "export with 15 digits if low frequencies matter"
        return [Finding(code="few-digits", severity="note", sentence=sentence, cure=cure)]
    if doubled_diagonal(K, residuals):
        cure = "subtract the diagonal once where a triangle is added to its mirror image"
        sentence = "the diagonal of the stiffness matrix K counts twice"
        return [Finding(code="doubled-diagonal", severity="error", sentence=sentence, cure=cure)]
    held = is_mounted(residuals, nodes, dofs)
    if share > FEM.most_dofs and worst < FEM.few_digits and not held:
        sentence = (
            f"the stiffness under rigid motion is {worst:.1e} of its terms, which should cancel, all over the model"
        )
        cure = "export it with more digits (15); or a preload is in it, which is no mistake"
        return [Finding(code="few-digits", severity="warning", sentence=sentence, cure=cure)]
    shifted = float(residuals.ratio[:, :3].max())
    if shifted < TOL.no_displacement_force * worst or shifted <= FEM.strained_force < worst:
        return [_report_misplaced(K, residuals, nodes, dofs, names)]
    return [_ground_finding(K, residuals, nodes, dofs, names, held)]


def _ground_finding(
    K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap, names: Names, held: bool
) -> Finding:
    rows = np.flatnonzero(residuals.bad)
    labels, words = names.places(rows[np.argsort(-residuals.worst[rows], kind="stable")])
    turned = local_systems(K, residuals, nodes, dofs)
    if len(turned):
        labels = names.node_labels(turned)
        sentence = f"displacements of {list_labels(labels, len(labels), 'node')} are not along the axes of the model"
        cure = "export without local coordinate systems, or turn these dofs"
        return Finding(code="local-axes", severity="error", sentence=sentence, cure=cure, where=labels)
    share = float(residuals.bad.mean())
    hold = residuals.R[:, :3].T @ residuals.force[:, :3]
    if share > FEM.most_dofs and not held:
        sentence = (
            f"rigid motion gives force at {share:.0%} of the dofs: a small body that is held, or coordinates that do "
            "not fit the stiffness matrix K"
        )
        cure = (
            "check that coordinates and dof map belong to these matrices, and that displacements are along the axes of "
            "the model (no local systems)"
        )
        return Finding(code="not-this-geometry", severity="warning", sentence=sentence, cure=cure, where=labels)
    stiff = ", ".join(f"{value:.3g}" for value in np.diag(hold))
    free = free_motions(residuals, held)
    sentence = (
        f"the body is held to the ground: rigid motion gives force at {words}, {stiff} N/m against translations along "
        f"x, y, z; {free} of 6 rigid-body motions are free"
    )
    missing = np.setdiff1d(np.arange(len(nodes)), dofs.node)
    bare = ""
    if len(missing):
        count = f"{len(missing)} nodes have" if len(missing) > 1 else "1 node has"
        bare = f" ({count} no dofs, such as {names.node_labels(missing)[0]})"
    cure = f"export without boundary conditions and springs to the ground{bare}; check local systems at these nodes"
    return Finding(code="grounded", severity="warning", sentence=sentence, cure=cure, where=labels)


def free_motions(residuals: Residual, held: bool) -> int:
    """How many of the six rigid motions give no force, round-off and few digits aside; ``held`` as ``mounted``."""
    worst, bad = float(residuals.worst.max(initial=0.0)), residuals.bad
    if not bad.any() or (bad.mean() > FEM.most_dofs and worst < FEM.few_digits and not held):
        return 6
    force, ratio = residuals.force, residuals.ratio
    with np.errstate(over="ignore"):
        size = np.divide(ratio, np.abs(force), out=np.zeros_like(ratio), where=force != 0)
    s = np.linalg.svd(force * size.max(axis=1)[:, None], compute_uv=False)
    return int((s < (FEM.strained_force if worst > FEM.strained_force else FEM.rounded_force)).sum())


def _report_misplaced(K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap, names: Names) -> Finding:
    """Translations fit and rotations do not: some nodes are not where their coordinates say."""
    culprits, places = misplaced_nodes(K, residuals, nodes, dofs)
    if not len(culprits):
        labels, words = names.places(np.flatnonzero(residuals.bad))
        sentence = f"translations fit the stiffness matrix K but rotations do not: force at {words}"
        cure = (
            "check that the coordinates belong to these matrices; a preload would do the same, and flow through a "
            "straight tube with free ends: hold an end in the model"
        )
        # A body whose rotations alone are held looks the same.
        return Finding(code="node-mapping", severity="warning", sentence=sentence, cure=cure, where=labels)
    given, span = nodes.xyz[culprits], np.linalg.norm(places - nodes.xyz[culprits], axis=1)
    distance = np.linalg.norm(places[:, None] - given[None], axis=2)
    labels = names.node_labels(culprits)
    some = ", ".join(labels[:5])
    if len(culprits) > 1 and (distance.min(axis=1) < TOL.swapped_place * span).all():
        sentence = f"the dofs of {len(culprits)} nodes are swapped: nodes {some} stand in each other's places"
        cure = "mend the map of their dofs (or their labels)"
    else:
        sentence = f"coordinates of {len(culprits)} nodes do not fit the stiffness matrix K: node {some}"
        cure = f"by K node {labels[0]} is at ({', '.join(f'{x:.6g}' for x in places[0])}); mend coordinates or dof map"
    return Finding(code="node-mapping", severity="error", sentence=sentence, cure=cure, where=labels)


def misplaced_nodes(K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap) -> tuple[Ints, Floats]:
    """Rows of nodes whose coordinates do not fit K, and where K has them (k, 3); empty where that is not clear.

    Only nodes whose neighbours all carry force can be wrong; their motion under rotation says where they are.
    """
    columns, change = _motion_from_stiffness(K, residuals, nodes, dofs)
    moved = np.full((len(nodes), 3), np.nan)
    at, component = dofs.node[columns], dofs.component[columns]
    shift = change[:, 3:] * residuals.length
    # Rotation about z moves y by x, about x moves z by y, about y moves x by z.
    for axis, (moving, about) in enumerate(((1, 2), (2, 0), (0, 1))):
        pick = component == moving
        moved[at[pick], axis] = shift[pick, about]
    moved = np.nan_to_num(moved)
    culprits = np.flatnonzero(np.linalg.norm(moved, axis=1) > TOL.wrong_place * residuals.length)
    return culprits, nodes.xyz[culprits] + moved[culprits]


def local_systems(K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap) -> Ints:
    """Rows of nodes whose displacements K has along axes of their own; empty where that is not clear."""
    columns, change = _motion_from_stiffness(K, residuals, nodes, dofs)
    table = np.full((len(nodes), 3, 3), np.nan)
    table[dofs.node[columns], dofs.component[columns]] = (residuals.R[columns] + change)[:, :3]
    rows = np.flatnonzero(np.isfinite(table).all(axis=(1, 2)))
    Q = table[rows]
    if not len(rows) or np.abs(Q @ Q.transpose(0, 2, 1) - np.eye(3)).max() > TOL.axes_error:
        return np.empty(0, dtype=np.int64)
    return np.asarray(rows[np.abs(Q - np.eye(3)).max(axis=(1, 2)) > TOL.own_axes])


def _motion_from_stiffness(K: sp.csr_array, residuals: Residual, nodes: Nodes, dofs: DofMap) -> tuple[Ints, Floats]:
    """Displacement dofs of suspects and the change (k, 6) of their rigid motion that makes K R vanish.

    Suspects are nodes whose neighbours all carry force. Empty where there are none, too many, or no such change.
    """
    none = np.empty(0, dtype=np.int64), np.empty((0, 6))
    touched = np.zeros(len(nodes), dtype=bool)
    touched[dofs.node[residuals.bad]] = True
    # By symmetry of the mesh some dofs of a node may stay free of force: nodes count.
    bad, clear = touched[dofs.node], np.zeros(len(dofs), dtype=bool)
    for _, _, row, column, value in pieces(K):
        clear[column[~bad[row] & (value != 0)]] = True
    suspects = np.setdiff1d(np.arange(len(nodes)), dofs.node[clear | (dofs.component > 2)])
    columns = np.flatnonzero(np.isin(dofs.node, suspects))
    rows = np.flatnonzero(bad)
    if not len(columns) or len(rows) * len(columns) > TOL.dense_numbers:
        return none
    part = K[rows, :][:, columns].toarray()
    change, *_ = np.linalg.lstsq(part, -residuals.force[rows], rcond=TOL.least_squares_cutoff)
    left = np.abs(residuals.force[rows] + part @ change)
    if (left > TOL.unexplained_force * np.abs(residuals.force).max()).any():
        return none
    return columns, change
