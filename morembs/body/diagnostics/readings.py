"""Other readings of the same dofs under which K would fit the geometry: their order, the unit of rotations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from morembs.body.diagnostics.findings import Finding
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Nodes
from morembs.fem.rigid_residual import Residual, motion
from morembs.fem.tolerances import TOL as FEM
from morembs.linalg.congruence import magnitudes


def orders(nodes: Nodes, dofs: DofMap) -> Iterator[tuple[str, DofMap]]:
    """The known orders of the same dofs, other than the given one, each once."""
    node, component = dofs.node, dofs.component
    label = nodes.ids[node]
    by_node, by_component = np.lexsort((component, node)), np.lexsort((node, component))
    candidates = {
        "node by node (x, y, z of the first node, then of the next)": by_node,
        "component by component (x of all nodes, then y, then z)": by_component,
        "node by node in ascending order of the node labels": np.lexsort((component, label)),
        "component by component, each in ascending order of the node labels": np.lexsort((label, component)),
        "the reverse of the given one": np.arange(len(dofs))[::-1],
        "node by node from the last node to the first": np.lexsort((component, -node)),
        "component by component from the last dof to the first": by_component[::-1],
        "node by node from the last dof to the first": by_node[::-1],
    }
    known = {np.arange(len(dofs)).tobytes()}
    for words, order in candidates.items():
        key = np.ascontiguousarray(order).tobytes()
        if key not in known:
            known.add(key)
            yield words, DofMap(node=node[order], component=component[order])


def fitting_order(K: sp.csr_array, nodes: Nodes, dofs: DofMap) -> tuple[str, DofMap] | None:
    """The known order in which far fewer dofs carry force under rigid motion than clearly do so in the given one.

    A soft ground gives some force in every order, and a mesh that is its own mirror image fits the reverse of its
    order as well as its order.
    """
    rows = np.sort(np.random.default_rng(8).permutation(K.shape[0])[: TOL.order_rows])
    some = sp.csr_array(K[rows, :])

    def forces(order: DofMap, above: float) -> float:
        R, _, _ = motion(nodes, order)
        ratio = np.abs(some @ R).max(axis=1) / np.maximum(magnitudes(some, R).max(axis=1), np.finfo(float).tiny)
        return float((ratio > above).mean())

    share = forces(dofs, TOL.wrong_order)
    if share <= TOL.many_dofs:
        return None
    tried = [(forces(other, FEM.strained_force), words, other) for words, other in orders(nodes, dofs)]
    best = min(tried, key=lambda trial: trial[0], default=None)
    return best[1:] if best is not None and best[0] < TOL.explained_share * share else None


def rotation_factor(K: sp.csr_array, residuals: Residual, dofs: DofMap) -> float | None:
    """The factor on the rotations of all nodes that makes K fit the geometry; None where none does."""
    if not residuals.bad.any():
        return None
    turning = dofs.turning
    arms, turns = residuals.R[:, 3:].copy(), residuals.R[:, 3:].copy()
    arms[turning], turns[~turning] = 0.0, 0.0
    a, b = K @ arms, K @ turns
    size = magnitudes(K, arms).max(axis=1) + magnitudes(K, turns).max(axis=1)
    weight = np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0)[:, None]
    a, b = a * weight, b * weight
    # The rows of rotations see a single factor, whatever their own units.
    factor = -float((a[turning] * b[turning]).sum() / max(float((b[turning] ** 2).sum()), np.finfo(float).tiny))
    factor = -float((a * b).sum() / max(float((b**2).sum()), np.finfo(float).tiny)) if factor <= 0 else factor
    left = np.abs(a + factor * b).max(axis=1)
    scale = np.abs(a).max(axis=1) + abs(factor) * np.abs(b).max(axis=1)
    bad = left > TOL.unexplained_row * np.maximum(scale, TOL.empty_row * scale.max())
    explains = bad.sum() <= TOL.explained_share * residuals.bad.sum()
    return factor if factor > 0 and abs(factor - 1) > TOL.no_factor and explains else None


def rotation_finding(factor: float) -> Finding:
    """What a factor on the rotations means."""
    cure = f"multiply the rotations by {factor:.4g} (rows and columns of K and M), or give all lengths in one unit"
    words = ""
    if abs(factor * np.pi / 180 - 1) < TOL.known_factor:
        words, cure = ", as if they were in degrees", "give rotations in radians"
    # Millimetres, centimetres and inches beside metres.
    elif any(abs(factor / usual - 1) < TOL.known_factor for usual in (1e-3, 1e3, 1e-2, 1e2, 0.0254, 1 / 0.0254)):
        words = ", as if coordinates and matrices were in two units of length"
        cure = "give coordinates and matrices in the same units"
    sentence = f"the rotations in K fit the geometry only when scaled by {factor:.4g}{words}"
    return Finding(code="rotation-scale", severity="error", sentence=sentence, cure=cure)
