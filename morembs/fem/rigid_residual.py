"""Force of a stiffness matrix under rigid motion: none in a free body whose dofs and coordinates belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Bools, Floats
from morembs.fem.fe_model import Component, DofMap, rigid_motion, skew
from morembs.fem.mesh import Nodes
from morembs.fem.tolerances import TOL
from morembs.linalg.congruence import abs_products


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """``R`` (N, 6) rigid motion about ``center``, rotations per ``length``; ``force`` K R; ``ratio`` (N, 6) of the
    force to what cancels in it."""

    center: Floats
    length: float
    R: Floats
    force: Floats
    ratio: Floats

    @property
    def worst(self) -> Floats:
        """(N,) the largest ratio of each dof."""
        return np.asarray(self.ratio.max(axis=1))

    @property
    def bad(self) -> Bools:
        """(N,) whether a dof carries force under rigid motion: clearly, or at least far more than most others do."""
        worst = self.worst
        usual = float(np.quantile(worst, TOL.usual_dofs)) if len(worst) else 0.0
        return np.asarray(worst > min(TOL.strained_force, max(TOL.rounded_force, TOL.outlier * usual)))


def motion(nodes: Nodes, dofs: DofMap) -> tuple[Floats, Floats, float]:
    """Rigid motion (N, 6) about the middle of the nodes, rotations per length; that middle and that length."""
    used = nodes.xyz[np.unique(dofs.node)]
    center = 0.5 * (used.min(axis=0) + used.max(axis=0))
    length = float(np.linalg.norm(np.ptp(used, axis=0))) / 2 or 1.0
    R = rigid_motion(nodes.xyz[dofs.node] - center, dofs.component)
    R[:, 3:] /= length
    return R, center, length


def residual(K: sp.csr_array, nodes: Nodes, dofs: DofMap) -> Residual:
    """K R, each row against the largest of its six sums of magnitudes."""
    R, center, length = motion(nodes, dofs)
    force, size = K @ R, abs_products(K, R, dofs.component == Component.SCALAR).max(axis=1)
    ratio = np.divide(np.abs(force), size[:, None], out=np.zeros_like(force), where=size[:, None] > 0)
    return Residual(center=center, length=length, R=R, force=force, ratio=ratio)


def is_mounted(residuals: Residual, nodes: Nodes, dofs: DofMap) -> bool:
    """True if springs between nodes and the ground explain all force under rigid motion.

    Then turning gives the force that the same springs give under the displacement which turning means at their node.
    In a wrong order of the dofs it does not.
    """
    rows = np.flatnonzero(residuals.bad & (dofs.component < 3))
    arms = -skew(nodes.xyz[dofs.node[rows]] - residuals.center) / residuals.length
    force = residuals.force[rows]
    left = np.abs(force[:, 3:] - np.einsum("nc,ncr->nr", force[:, :3], arms)).max(axis=1, initial=0.0)
    return bool(len(rows) and (left > TOL.unexplained_force * np.abs(force).max(axis=1)).mean() <= TOL.unexplained_dofs)


def share_of_other_geometry(K: sp.csr_array, nodes: Nodes, dofs: DofMap) -> float:
    """Part of the dofs at which rigid motion strains ``K`` far more than a preload does; 0 where supports explain it.

    Supports are few, a bedding is ``mounted``, and a preload gives as much force as it strains the material. Small
    models that are held have as large a share: only motions without energy that are not those of the geometry prove
    coordinates or dofs that are not those of ``K``.
    """
    residuals = residual(K, nodes, dofs)
    share = float((residuals.worst > TOL.preload_strain).mean())
    return share if share > TOL.most_dofs and not is_mounted(residuals, nodes, dofs) else 0.0
