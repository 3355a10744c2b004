"""The manifold of static equilibria of a planar component over its end angles, as arrays and tables.

See ``equilibria`` for one of them and ``offline`` for how a grid of them is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.gmp.chebyshev import ChebyshevTable, points
from morembs.dynamics.gmp.equilibria import BeamWork, Equilibrium, Solver
from morembs.dynamics.gmp.offline import Tabulated, tabulate_member
from morembs.dynamics.gmp.plan import Plan
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent

__all__ = ["Equilibrium", "Manifold", "Solver", "manifold"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Manifold:
    """Equilibria at all points of a Chebyshev grid on ``-reach <= t1, t2 <= reach``.

    ``X`` (c, c, N), ``W`` (c, c), ``moments`` (c, c, 2), ``modes`` (c, c, N, 2); tables of X and of W.
    """

    reach: float
    X: Floats
    W: Floats
    moments: Floats
    modes: Floats
    shape: ChebyshevTable
    energy: ChebyshevTable

    @classmethod
    def of(cls, tables: Tabulated) -> Manifold:
        """From the equilibria on a grid."""
        X, W = tables.stack_equilibria("X"), tables.stack_equilibria("W")
        return cls(
            reach=tables.reach,
            X=X,
            W=W,
            moments=tables.stack_equilibria("moments"),
            modes=tables.stack_equilibria("modes"),
            shape=ChebyshevTable.through(tables.reach, X),
            energy=ChebyshevTable.through(tables.reach, W, curved=True),
        )

    def errors(self) -> tuple[float, float]:
        """Largest error, over the grid, of the derivatives of the tables: dX/dt against the constraint modes (per
        largest entry) and dW/dt against the moments of the frames (per largest moment)."""
        grid = points(self.reach, len(self.W))
        mode, moment = 0.0, 0.0
        for i, a in enumerate(grid):
            for j, b in enumerate(grid):
                t = np.array([a, b])
                mode = max(mode, float(np.abs(self.shape.at(t)[1].T - self.modes[i, j]).max()))
                moment = max(moment, float(np.abs(self.energy.at(t)[1] - self.moments[i, j]).max()))
        return mode / float(np.abs(self.modes).max()), moment / float(np.abs(self.moments).max())


def manifold(component: NonlinearComponent, *, reach: float, points_per_angle: int = 9) -> Manifold:
    """All equilibria on a grid, each by continuation from one that is nearer to the middle.

    Args:
        component: the component without load.
        reach: largest angle in rad.
        points_per_angle: grid points along each angle.

    Raises:
        InputError: a range that crosses a bifurcation or has no equilibrium, too few points, wrong frames.
    """
    tables = Manifold.of(tabulate_member(BeamWork(component), Plan(reach=reach, points_per_angle=points_per_angle)))
    refuse_coarse(tables.errors(), tables.reach, points_per_angle)
    return tables


def refuse_coarse(errors: tuple[float, float], reach: float, count: int) -> None:
    """Refuses tables with large errors of their derivatives.

    Raises:
        InputError: there are too few points.
    """
    if max(errors) > TOL.max_derivative_error:
        raise InputError(
            f"tables of {count} points per angle on +-{reach:g} rad miss the reactions or the motion of the "
            f"component by {max(errors):.2g}; expected at most {TOL.max_derivative_error}. Take more points or a "
            "smaller range",
            kind="result",
            keyword="points",
        )
