"""A reduced model for every value of its parameters: matrices, frequencies, responses, and their derivatives.

All values share one basis V, so K(p) = sum_q a_q(p) V'K_q V and M(p) are sums of small matrices, and derivatives are
those of the coefficients. NumPy and SciPy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Complexes, Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.parametric.bound import ParametricBound
from morembs.parametric.law import Law
from morembs.parametric.parameter import DAMPING, Box
from morembs.parametric.tolerances import TOL
from morembs.storage.lemma import Lemma, proof_json
from morembs.storage.table import dataset, derived, table_of

if TYPE_CHECKING:
    from morembs.parametric.terms import AffineProblem
    from morembs.problem.damping import Damping

# Fields of the damping of a body that a file keeps.
_KEPT_DAMPING = ("alpha", "beta", "modal", "modal_table", "structural")


@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricModel:
    """``K`` (Q, n, n) and ``M`` (J, n, n) with their laws, ``B`` (n, m), and rigid motions ``rigid`` (n, r, 1 + morphs)
    of unit translations and rotations, affine in the morphs.

    ``damping`` is that of nominal values, ``scale`` (m,) turns rotations into lengths; ``bound`` says how wrong the
    responses are, None where that is not known; ``box_bound`` is the largest relative bound of all sampled values, for
    a damping ratio of ``floor`` beside the damping.
    """

    box: Box = dataset(table_of(Box), inline=True)
    law_K: Law = dataset(
        "whole",
        "Q P",
        "factors of the coefficient of each term of K: 0: 1; 1: p; 2: p^2; 3 + k: Lagrange polynomial of point k of p",
        name="law/K",
        write=lambda model: model.law_K.factors,
    )
    law_M: Law = dataset(
        "whole",
        "J P",
        "factors of the coefficient of each term of M, as for K",
        name="law/M",
        write=lambda model: model.law_M.factors,
    )
    K: Floats = dataset("later", "Q n n", "terms of the stiffness")
    M: Floats = dataset("later", "J n n", "terms of the mass")
    B: Floats
    rigid: Floats = dataset("real", "n any f", "unit translations and rotations, constant and per morph")
    damping: Damping = dataset(
        "json",
        "",
        "damping at nominal values, as JSON",
        doc="damping at nominal values as JSON: `alpha`, `beta`, `modal`, `modal_table`, `structural`",
        write=lambda model: {key: asdict(model.damping)[key] for key in _KEPT_DAMPING},
    )
    scale: Floats = dataset("real", "m", "turns rotations into lengths", "m")
    bound: Any = dataset(
        table_of(ParametricBound, build=dict),
        default=None,
        doc="data for the bound of the error",
        when="where there is one",
    )
    box_bound: float = dataset(
        "any",
        "",
        "largest relative bound over the band at all sampled values",
        default=np.inf,
        doc="largest bound over the band at all sampled values, relative to the envelope of the response: a maximum "
        "over samples",
    )
    floor: float = dataset("real", "", "damping ratio that box_bound gives to models without damping", default=0.0)

    @property
    def order(self) -> int:
        """Number n of reduced coordinates."""
        return int(self.K.shape[1])

    @property
    def highest_hz(self) -> float:
        """Upper end of the band that the basis was made for, infinite where that is not known."""
        return np.inf if self.bound is None else float(in_hz(self.bound.highest))

    @derived("real", "any", "points of a parameter with Lagrange polynomials in K", name="law/points_K/*", read=True)
    def points_K(self) -> dict[str, Floats]:
        """Points of ``law_K`` by the names of parameters that have some."""
        return self._points(self.law_K)

    @derived("real", "any", "the same in M", name="law/points_M/*", read=True)
    def points_M(self) -> dict[str, Floats]:
        """Points of ``law_M``."""
        return self._points(self.law_M)

    def _points(self, law: Law) -> dict[str, Floats]:
        return {name: at for name, at in zip(self.box.names, law.points, strict=True) if len(at)}

    @derived(
        "json",
        "",
        "lemmas that the bound rests on at all values",
        since="0.2",
        when="where there is a bound",
        write=lambda model: proof_json(model.proof),
    )
    def proof(self) -> tuple[Lemma, ...]:
        """The lemmas that the bounds rest on at all of the box, with its nominal damping; none where it has none."""
        return () if self.bound is None else self.bound.proof(self.damping)

    def matrices(self, p: Floats) -> tuple[Floats, Floats]:
        """K and M (..., n, n) at ``p`` (..., P)."""
        return np.tensordot(self.law_K(p), self.K, axes=1), np.tensordot(self.law_M(p), self.M, axes=1)

    def rigid_at(self, p: Floats) -> Floats:
        """Coordinates (n, r) of the rigid motions at ``p`` (P,)."""
        return self.box.affine(self.rigid, p)

    def at(self, p: Floats) -> ModelAt:
        """The reduced model at ``p`` (P,).

        Raises:
            InputError: a value outside the box.
        """
        # Not at the top: files are shown without what evaluates them.
        import scipy.linalg as sl

        from morembs.linalg.columns import without_rigid_motion
        from morembs.linalg.dense import symmetric
        from morembs.linalg.eigen import accurate_eigh

        p = self.box.checked(p)
        K, M = self.matrices(p)
        rigid = self.rigid_at(p)
        K = without_rigid_motion(K, M, rigid)
        damping = self.box.damping(self.damping, p)
        G = rigid.T @ M @ rigid
        Z = sl.solve_triangular(sl.cholesky(symmetric(G), lower=True), rigid.T, lower=True).T
        values, Y = accurate_eigh(K, M)
        values[: rigid.shape[1]] = 0.0
        return ModelAt(
            model=self, p=p, K=K, M=M, D=damping.matrix(M, K, Z), rigid=Z, damping=damping, eigenvalues=values, Y=Y
        )

    def frequencies_hz(self, table: Floats, count: int) -> Floats:
        """The first elastic eigenfrequencies (k, ``count``) at each row of ``table`` (k, P).

        Raises:
            InputError: a value outside the box, or more frequencies than there are.
        """
        table, r = np.atleast_2d(self.box.checked(table)), self.rigid.shape[1]
        if not 0 < count <= self.order - r:
            raise InputError(f"{count} frequencies were asked for; expected 1 to {self.order - r}")
        result = np.empty((len(table), count))
        for first in range(0, len(table), TOL.table_rows):
            p = table[first : first + TOL.table_rows]
            K, M = self.matrices(p)
            L = np.linalg.cholesky(M)
            A = np.linalg.solve(L, np.linalg.solve(L, K).transpose(0, 2, 1))
            values = np.linalg.eigvalsh(0.5 * (A + A.transpose(0, 2, 1)))[:, r : r + count]
            result[first : first + TOL.table_rows] = eigenvalue_in_hz(values)
        return result

    def derivatives(self, p: Floats) -> tuple[Floats, Floats]:
        """dK/dp and dM/dp (P, n, n) at ``p`` (P,)."""
        dK, dM = self.law_K.derivative(p), self.law_M.derivative(p)
        return np.tensordot(dK.T, self.K, axes=1), np.tensordot(dM.T, self.M, axes=1)


def _stored_model(
    box: Box,
    law_K: Any,
    law_M: Any,
    points_K: Mapping[str, Floats],
    points_M: Mapping[str, Floats],
    damping: dict[str, Any],
    bound: dict[str, Any] | None = None,
    **own: Any,
) -> ParametricModel:
    """A model of its datasets in a file; its loads are those of the body."""
    from morembs.problem.damping import Damping

    first, second = (
        Law(factors=factors, points=tuple(points.get(name, np.zeros(0)) for name in box.names))
        for factors, points in ((law_K, points_K), (law_M, points_M))
    )
    return ParametricModel(
        box=box,
        law_K=first,
        law_M=second,
        damping=Damping(**damping),
        bound=None if bound is None else ParametricBound(law_K=first, law_M=second, **bound),
        B=np.zeros((0, 0)),
        **own,
    )


MODEL = table_of(ParametricModel, build=_stored_model)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelAt:
    """The reduced model at one ``p`` (P,): ``K``, ``M``, ``D`` (n, n), M-orthonormal ``rigid`` motions (n, r), and the
    ``eigenvalues`` (n,) in (rad/s)2, rigid ones zero, with vectors ``Y`` (n, n)."""

    model: ParametricModel
    p: Floats
    K: Floats
    M: Floats
    D: Floats
    rigid: Floats
    damping: Damping
    eigenvalues: Floats
    Y: Floats

    @property
    def B(self) -> Floats:
        """Loads (n, m), the same at all values."""
        return self.model.B

    @property
    def frequencies_hz(self) -> Floats:
        """Elastic eigenfrequencies (n - r,)."""
        return np.asarray(eigenvalue_in_hz(self.eigenvalues[self.rigid.shape[1] :]))

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Elastic part of H (nf, m, m) at frequencies in Hz, as ``full_response`` has that of the full model."""
        return np.asarray(self.model.B.T @ self.states(frequencies_hz))

    def states(self, frequencies_hz: Floats) -> Complexes:
        """Elastic part of A^-1 B (nf, n, m)."""
        Y, a = self._elastic(frequencies_hz)
        return np.asarray(Y @ ((Y.T @ self.model.B) / a[:, :, None]))

    def _elastic(self, frequencies_hz: Floats) -> tuple[Floats, Complexes]:
        """Elastic vectors (n, e) and a_k (nf, e)."""
        r = self.rigid.shape[1]
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=float))[:, None]
        values = self.eigenvalues[r:]
        a = (1 + 1j * self.damping.structural) * values + s * self.damping.of_modes(values) + s * s
        return self.Y[:, r:], a

    @cached_property
    def bound_at(self) -> Any:
        """The bound of the model at this value and with its own damping, None where it has none."""
        model = self.model
        if model.bound is None:
            return None
        return model.bound.at(
            self.p, K=self.K, M=self.M, B=model.B * model.scale, rigid=model.rigid_at(self.p), damping=self.damping
        )

    @property
    def proof(self) -> tuple[Lemma, ...]:
        """The lemmas that ``bound`` rests on at this value, none where it has no bound."""
        return () if self.bound_at is None else tuple(self.bound_at.proof)

    @property
    def bound_kind(self) -> str:
        """ "bound" where it is proven in exact arithmetic, "estimate" or "none"."""
        return "none" if self.bound_at is None else str(self.bound_at.kind)

    def bound(self, frequencies_hz: Floats) -> Floats:
        """Bounds (nf,) of |H - H_r|_F in m/N, rotations times a length, infinite where there is none."""
        omega = 2 * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
        return np.full(len(omega), np.inf) if self.bound_at is None else np.asarray(self.bound_at.error(omega))

    def sensitivity(self, count: int | None = None) -> Sensitivity:
        """Derivatives with respect to each parameter, exact for the reduced model; of the first ``count`` frequencies,
        of all without it."""
        box = self.model.box
        dK, dM = self.model.derivatives(self.p)
        clusters = _clusters(self.eigenvalues[self.rigid.shape[1] :])
        if count is not None:
            clusters = [cluster for cluster in clusters if cluster[0] < count]
        frequencies = {name: self._slopes(dK[j], dM[j], clusters) for j, name in enumerate(box.names)}
        clustered = np.concatenate([np.full(len(c), len(c) > 1) for c in clusters])
        return Sensitivity(
            at=self,
            K=dict(zip(box.names, dK, strict=True)),
            M=dict(zip(box.names, dM, strict=True)),
            frequencies_hz=frequencies,
            clustered=clustered,
            in_band=self.frequencies_hz[: len(clustered)] <= self.model.highest_hz,
        )

    def _slopes(self, dK: Floats, dM: Floats, clusters: list[NDArray[np.int64]]) -> Floats:
        """d f / dp (e,) of the elastic frequencies; of a cluster those of its branches, ascending."""
        r, result = self.rigid.shape[1], np.empty(clusters[-1][-1] + 1)
        for cluster in clusters:
            y = self.Y[:, r + cluster]
            value = self.eigenvalues[r + cluster].mean()
            # f = sqrt(lam) / 2 pi.
            slope = np.linalg.eigvalsh(y.T @ (dK - value * dM) @ y)
            result[cluster] = slope / (4 * np.pi * np.sqrt(value))
        return result


def _clusters(values: Floats) -> list[NDArray[np.int64]]:
    """Places of eigenvalues that lie together, ascending."""
    gaps = np.flatnonzero(np.diff(values) > 2 * TOL.mode_cluster_gap * values[1:])
    return np.split(np.arange(len(values)), gaps + 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Derivatives at one value, by the names of the parameters: ``K``, ``M`` (n, n) and elastic ``frequencies_hz``
    (e,). ``clustered`` (e,) marks frequencies that lie together, whose derivatives are those of the branches,
    ``in_band`` (e,) the ones that the reduction had to keep: others and their derivatives may differ by percents from
    the full model's."""

    at: ModelAt
    K: Mapping[str, Floats]
    M: Mapping[str, Floats]
    frequencies_hz: Mapping[str, Floats]
    clustered: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    in_band: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def response(self, frequencies_hz: Floats) -> dict[str, Complexes]:
        """dH/dp (nf, m, m) of the elastic part of H by each parameter, dH = -y' dA y.

        Raises:
            InputError: modal damping, which follows the modes.
        """
        at, damping = self.at, self.at.damping
        if damping.is_modal:
            raise InputError(
                "derivatives of responses are not known with modal damping; take Rayleigh or structural damping",
                kind="unsupported",
            )
        model, p = at.model, at.p
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=float))[:, None, None]
        y, R = at.states(frequencies_hz), model.rigid_at(p)
        w = np.linalg.solve(R.T @ at.M @ R, R.T @ model.B)
        c, g = damping.proportional(s)
        result = {}
        for j, (name, kind) in enumerate(zip(model.box.names, model.box.kinds, strict=True)):
            dA = c * self.K[name] + g * self.M[name]
            if kind in DAMPING:
                dA = dA + s * (at.M if kind == "alpha" else at.K)
            # A^-1 B is y and R w / g; with K R = 0 at all values what that adds comes down to the change of the
            # momentum M R, to which y is orthogonal.
            momentum = self.M[name] @ R
            if j in model.box.morphs:
                momentum = momentum + at.M @ model.rigid[:, :, 1 + model.box.morphs.index(j)]
            across = y.transpose(0, 2, 1) @ (momentum @ w)
            result[name] = -(y.transpose(0, 2, 1) @ dA @ y) - across - across.transpose(0, 2, 1)
        return result


def parametric_model(problem: AffineProblem, V: Floats, bound: Any = None, **more: Any) -> ParametricModel:
    """The reduced model of all values on the basis ``V`` (Nc, n), which spans the rigid motions of each; ``more``
    are fields of ``ParametricModel``.

    Raises:
        SolverError: it does not span them.
    """
    space = problem.space
    K, M = (
        np.array([space.project(V, make(theta)) for theta in np.eye(len(law.factors))])
        for make, law in ((problem.stiffness_sum, problem.law_K), (problem.mass_sum, problem.law_M))
    )
    return ParametricModel(
        box=problem.box,
        law_K=problem.law_K,
        law_M=problem.law_M,
        K=K,
        M=M,
        B=np.asarray((problem.B.T @ V).T),
        rigid=_rigid(problem, V),
        damping=problem.damping,
        scale=problem.motion_scale,
        bound=bound,
        **more,
    )


def _rigid(problem: AffineProblem, V: Floats) -> Floats:
    """Coordinates (n, r, 1 + morphs) in ``V`` of the rigid motions."""
    import scipy.linalg as sl

    if not problem.rigid.shape[1]:
        return np.zeros((V.shape[1], 0, 1 + len(problem.morphs)))
    R = problem.rigid_terms.reshape(len(V), -1)
    # Columns of unit size: translations are larger than rotations by a length.
    size = np.linalg.norm(R, axis=0)
    size[size == 0] = 1.0
    Q, T = np.linalg.qr(V)
    coordinates = sl.solve_triangular(T, Q.T @ (R / size))
    missed = float(np.linalg.norm(R / size - V @ coordinates, axis=0).max(initial=0.0))
    if not missed <= TOL.missed_rigid:
        raise SolverError(f"the basis misses {missed:.1e} of a rigid motion of some value; it has to span all of them")
    return np.asarray((coordinates * size).reshape(V.shape[1], 6, -1))
