"""Force of a stiffness matrix under rigid motion: none in a free body whose dofs and coordinates belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Bools, Floats
from morembs.fem.fe_model import SCALAR, DofMap, Nodes, rigid_motion, skew
from morembs.linalg.congruence import abs_products

# Force under rigid motion, against the sum of magnitudes that cancel in it: above the first the motion strains the
# body, between both the numbers are rounded (or the ground is very soft).
STRAINED, ROUNDED = 1e-6, 1e-9
# Residuals up to this all over the model come from numbers that were printed with few digits.
FEW_DIGITS = 1e-3
# A residual so many times that of most dofs is not round-off: a very soft ground.
OUTLIER = 100.0
# Part of the dofs with a residual above which the whole body does not fit, not only what holds it.
MOST = 0.5
# Part of the force that springs at the nodes may leave unexplained, and of the dofs at which they may do so.
LEFT, FEW = 1e-3, 0.05
# Strains of a preload stay below this.
BEYOND_PRELOAD = 0.01


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
        usual = float(np.quantile(worst, 0.8)) if len(worst) else 0.0
        return np.asarray(worst > min(STRAINED, max(ROUNDED, OUTLIER * usual)))


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
    force, size = K @ R, abs_products(K, R, dofs.component == SCALAR).max(axis=1)
    ratio = np.divide(np.abs(force), size[:, None], out=np.zeros_like(force), where=size[:, None] > 0)
    return Residual(center=center, length=length, R=R, force=force, ratio=ratio)


def mounted(residuals: Residual, nodes: Nodes, dofs: DofMap) -> bool:
    """Whether springs between nodes and the ground explain all force under rigid motion.

    Then turning gives the force that the same springs give under the displacement which turning means at their node.
    In a wrong order of the dofs it does not.
    """
    rows = np.flatnonzero(residuals.bad & (dofs.component < 3))
    arms = -skew(nodes.xyz[dofs.node[rows]] - residuals.center) / residuals.length
    force = residuals.force[rows]
    left = np.abs(force[:, 3:] - np.einsum("nc,ncr->nr", force[:, :3], arms)).max(axis=1, initial=0.0)
    return bool(len(rows) and (left > LEFT * np.abs(force).max(axis=1)).mean() <= FEW)


def share_of_other_geometry(K: sp.csr_array, nodes: Nodes, dofs: DofMap) -> float:
    """Part of the dofs at which rigid motion strains ``K`` far more than a preload does; 0 where supports explain it.

    Supports are few, a bedding is ``mounted``, and a preload gives as much force as it strains the material. Small
    models that are held have as large a share: only motions without energy that are not those of the geometry prove
    coordinates or dofs that are not those of ``K``.
    """
    residuals = residual(K, nodes, dofs)
    share = float((residuals.worst > BEYOND_PRELOAD).mean())
    return share if share > MOST and not mounted(residuals, nodes, dofs) else 0.0
