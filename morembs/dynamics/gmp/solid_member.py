"""A reduced planar member made of a solid: tables over its end angles as ``shapes`` makes them for beams.

Formulation "tangent", with two differences. A, the uniform stretch of the bent shape, moves the cross-sections along
the stretched axis and gives them the lateral contraction of the straight solid in their turned frames (scaling all
positions would stretch the sections, too). The amplitudes of the motion are those of functions over the nodes, x and
y with the same ones, z, which does not turn in the plane, with its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.polynomial.chebyshev import chebvander

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Count
from morembs.base.types import Floats
from morembs.dynamics.gmp.chebyshev import ChebyshevTable, points
from morembs.dynamics.gmp.data import Parameterised
from morembs.dynamics.gmp.equilibria import Equilibrium
from morembs.dynamics.gmp.fields import Fields, orthogonal_functions
from morembs.dynamics.gmp.manifold import refuse_coarse
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.offline import Tabulated, tabulate_member
from morembs.dynamics.gmp.plan import AngleRange, Plan
from morembs.dynamics.gmp.solid_manifold import (
    PlaneModes,
    SolidEquilibria,
    SolidEquilibrium,
    plane_bending_modes,
    stretch,
)
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.linalg.dense import symmetric
from morembs.linalg.sparse.solver import LinearSolver


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sample:
    """At one t: positions ``X`` and stretch ``A`` (n, 3) of all nodes, their constraint modes ``slopes`` (2, n, 3),
    chord ``d0``, ``W``, ``moments`` (2,), ``k``, ``c`` (m + e,), ``H`` (m, m)."""

    X: Floats
    A: Floats
    slopes: Floats
    d0: float
    W: float
    moments: Floats
    k: float
    c: Floats
    H: Floats


@checked
def solid_member(
    solid: NonlinearSolid,
    *,
    modes: Count,
    reach: float | AngleRange = TOL.default_reach,
    points_per_angle: int | None = None,
    tolerance: float = TOL.table_error,
    workers: int = 1,
    checkpoint: str | Path | None = None,
    symmetric: bool = True,
    solver: LinearSolver | None = None,
) -> ReducedMember:
    """A member of 6 + ``modes`` coordinates that moves in the plane of x and y.

    Args:
        solid: with rigid interfaces ``start`` at the origin and ``end`` on the x axis; symmetric to the plane z = 0,
            or near enough for its motion to stay in the plane.
        modes: number of bending modes, zero or more.
        reach: largest angle (rad) of an end to the chord, the range of the tables; or an ``AngleRange``.
        points_per_angle, tolerance, workers, checkpoint, symmetric: see ``Plan``.

    Memory: per worker the tangent and its factor; in all, 18 numbers per node and equilibrium.

    Raises:
        InputError: other interfaces, too many modes, a range that crosses a bifurcation or has no equilibrium, a
            tolerance that is not met.
        OutputError: the checkpoint cannot be written.
    """
    plan = Plan(
        reach=reach,
        points_per_angle=points_per_angle,
        tolerance=tolerance,
        workers=workers,
        checkpoint=checkpoint,
        symmetric=symmetric,
    )
    kept = plane_bending_modes(solid, modes + TOL.spare_modes, solver)
    with SolidEquilibria(solid, solver) as equilibria:
        law = _Law(solid, equilibria, kept, modes, stretch(solid, equilibria.length, solver))
        tables = tabulate_member(SolidWork(equilibria, law), plan)
        H0 = law.straight_diagonal()
        length = equilibria.length
    data = _parameterise(solid, tables, kept, length=length, count=modes, H0=H0)
    if points_per_angle is not None:
        refuse_coarse((float(data.errors[0]), float(data.errors[1])), tables.reach, tables.count)
    return ReducedMember.of(data, tables.report)


class SolidWork:
    """A solid at work in the offline stage."""

    def __init__(self, equilibria: SolidEquilibria, law: _Law) -> None:
        self.component, self.length, self.turns = equilibria.solid, equilibria.length, equilibria.turns
        self._equilibria, self._law = equilibria, law

    def straight(self) -> Equilibrium:
        return _plain(self._equilibria.straight())

    def toward(self, X: Floats, modes: Floats, t: Floats) -> Equilibrium:
        return _plain(self._equilibria.toward(X, modes, t))

    def sample(self, equilibrium: Equilibrium) -> _Sample:
        return self._law.sample(equilibrium)

    def energy(self, x: Floats) -> float:
        return self.component.energy(x)

    def tangent(self, X: Floats) -> sp.csr_array:
        return self.component.tangent(X)

    def spread(self) -> Floats:
        solid = self.component
        forces = np.zeros((len(solid.model.nodes), 3))
        forces[:, 1] = np.asarray(sp.csr_array(solid.model.M)[1::3][:, 1::3].sum(axis=1)).ravel()
        return solid.load(solid.reference, forces / forces[:, 1].sum())


def _plain(equilibrium: SolidEquilibrium) -> Equilibrium:
    return Equilibrium(X=equilibrium.X, W=equilibrium.W, moments=equilibrium.moments, modes=equilibrium.modes)


class _Law:
    """Samples of one solid."""

    def __init__(
        self, solid: NonlinearSolid, equilibria: SolidEquilibria, modes: PlaneModes, count: int, linear: Floats
    ) -> None:
        self.solid, self.equilibria, self.Psi, self.count = solid, equilibria, modes.Psi, count
        X = solid.model.nodes.xyz
        self._linear = linear
        self._start = solid.interfaces["start"].nodes
        self._end = solid.interfaces["end"].nodes
        # What a stretch of one does beside moving the sections along the axis: mostly lateral contraction.
        self._aside = solid.step_of_nodes(solid.reference, linear) - X[:, :1] * np.eye(3)[0]
        # The axis and two directions of the sections as polynomials along the member, fitted to all nodes.
        stations = len(np.unique(np.round(X[:, 0] / equilibria.length, 6)))
        self._T = chebvander(2 * X[:, 0] / equilibria.length - 1, min(TOL.section_degree, stations - 1))
        along = np.hstack((self._T, X[:, 1:2] * self._T, X[:, 2:] * self._T))
        self._fit = np.linalg.pinv(along, rcond=TOL.fit_singular_value)

    def stretch(self, x: Floats, d0: float) -> Floats:
        """A (n, 3) of the shape x (n, 3) with the chord d0."""
        axis, second, third = (self._T @ part for part in np.split(self._fit @ x, 3))
        share = self.solid.model.nodes.xyz[:, :1] / self.equilibria.length
        left, right = axis[self._start].mean(axis=0), axis[self._end].mean(axis=0) - d0 * np.eye(3)[0]
        axis = axis - left * (1 - share) - right * share
        frames = np.stack((np.cross(second, third), second, third), axis=2)
        U, _, Vt = np.linalg.svd(frames)
        A = axis + np.einsum("nij,nj->ni", U @ Vt, self._aside)
        A[self._start], A[self._end] = 0.0, d0 * np.eye(3)[0]
        return np.asarray(A)

    def _coordinates(self, A: Floats, d0: float) -> Floats:
        """A (N,) as a change of the coordinates of the solid."""
        result = np.zeros(self.solid.size)
        kept = self.solid.kept
        result[: 3 * len(kept)] = A[kept].ravel()
        result[self.equilibria.second[0]] = d0
        return result

    def _slope(self, X: Floats, A: Floats, Psi: Floats) -> Floats:
        """Derivative of K Psi along A; the central difference of a tangent that is quadratic in x is exact."""
        h = TOL.tangent_step
        return np.asarray((self.solid.tangent(X + h * A) @ Psi - self.solid.tangent(X - h * A) @ Psi) / (2 * h))

    def sample(self, equilibrium: Equilibrium) -> _Sample:
        """All at one equilibrium."""
        solid, d0 = self.solid, float(equilibrium.X[self.equilibria.second[0]])
        nodes = solid.positions(equilibrium.X)
        stretched = self.stretch(nodes, d0)
        A = self._coordinates(stretched, d0)
        force = solid.tangent(equilibrium.X) @ A
        k, Psi = float(A @ force), self.Psi[:, : self.count]
        H = Psi.T @ self._slope(equilibrium.X, A, Psi) / k
        slopes = np.stack([solid.step_of_nodes(equilibrium.X, mode) for mode in equilibrium.modes.T])
        return _Sample(
            X=nodes,
            A=stretched,
            slopes=slopes,
            d0=d0,
            W=equilibrium.W,
            moments=equilibrium.moments,
            k=k,
            c=self.Psi.T @ force / k,
            H=symmetric(H),
        )

    def straight_diagonal(self) -> Floats:
        """Diagonal (m + e,) of H at the straight shape, of all modes."""
        X, A = self.solid.reference, self._linear
        k = float(A @ (self.solid.tangent(X) @ A))
        return np.asarray(np.einsum("nk,nk->k", self.Psi, self._slope(X, A, self.Psi)) / k)


def _parameterise(
    solid: NonlinearSolid, tables: Tabulated, kept: PlaneModes, *, length: float, count: int, H0: Floats
) -> Parameterised:
    grid, reach, ordered = tables.count, tables.reach, tables.samples
    Psi = np.stack([solid.step_of_nodes(solid.reference, column) for column in kept.Psi.T])
    of = _fields(solid, np.concatenate([np.stack([s.X for s in ordered] + [s.A for s in ordered]), Psi]))
    flat = np.array(
        [
            np.concatenate((of.condense(s.X.ravel()), of.condense(s.A.ravel()), [s.d0, s.k], s.c, s.H.ravel()))
            for s in ordered
        ]
    ).reshape(grid, grid, -1)
    table = ChebyshevTable.through(reach, flat)
    W = np.array([s.W for s in ordered]).reshape(grid, grid)
    energy = ChebyshevTable.through(reach, W, curved=True)
    return Parameterised(
        formulation="tangent",
        reach=reach,
        length=length,
        count=count,
        table=table,
        energy=energy,
        fields=of,
        Psi=of.condense(Psi.reshape(len(Psi), -1).T),
        squares=kept.squares,
        H0=H0,
        excluded=np.zeros(0),
        peaks=np.abs(Psi).max(axis=(1, 2)),
        errors=_errors(ordered, table, energy, of, grid),
    )


def _errors(samples: Sequence[_Sample], table: ChebyshevTable, energy: ChebyshevTable, of: Fields, grid: int) -> Floats:
    """Largest errors (2,) of the derivatives of the tables, of shapes against constraint modes and of the energy
    against moments, each per largest."""
    values = points(table.reach, grid)
    shape = moment = top_shape = top_moment = 0.0
    for number, sample in enumerate(samples):
        t = values[[number // grid, number % grid]]
        slope = table.at(t)[1][:, : of.size]
        for approximate, exact in zip(slope, sample.slopes, strict=True):
            shape = max(shape, float(np.abs(of.expand(approximate) - exact.ravel()).max()))
            top_shape = max(top_shape, float(np.abs(exact).max()))
        moment = max(moment, float(np.abs(energy.at(t)[1] - sample.moments).max()))
        top_moment = max(top_moment, float(np.abs(sample.moments).max()))
    return np.array([shape / top_shape, moment / top_moment])


def _fields(solid: NonlinearSolid, shapes: Floats) -> Fields:
    """Functions over the nodes that span ``shapes`` (k, n, 3).

    Raises:
        InputError: a mass matrix that differs along x, y and z.
    """
    M = sp.csr_array(solid.model.M)
    Mx, My, Mz = (M[axis::3][:, axis::3] for axis in range(3))
    if max(abs(Mx - My).max(), abs(Mx - Mz).max()) > TOL.mass_mismatch * abs(Mx).max():
        raise InputError("the mass matrix differs along x, y and z; expected that of solid elements")
    n = shapes.shape[1]
    U = orthogonal_functions(np.hstack((shapes[:, :, 0].T, shapes[:, :, 1].T)), TOL.kept_solid_singular_value)
    Uz = orthogonal_functions(shapes[:, :, 2].T, TOL.kept_solid_singular_value)
    r, rz = U.shape[1], Uz.shape[1]
    small = np.zeros((2 * r + rz,) * 2)
    small[:r, :r] = small[r : 2 * r, r : 2 * r] = U.T @ (Mx @ U)
    small[2 * r :, 2 * r :] = Uz.T @ (Mx @ Uz)
    numbers = np.arange(3 * n).reshape(-1, 3)
    return Fields(
        U=U, Ur=Uz, translations=numbers[:, :2], turning=numbers[:, 2], one=np.eye(r)[0], turn=np.zeros(rz), M=small
    )
