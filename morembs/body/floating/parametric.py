"""Floating frames at every value of parameters, from integrals over each term of the mass.

Shapes are fixed in the model, and positions are x0 + sum_i t_i d_i, so that all integrals are sums of the terms of the
mass times products of the t_i: what has no position, one, or two in it is stored against x0 and each d_i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Values
from morembs.body.floating.frame import FloatingFrame, InterfaceMarker, frame_about
from morembs.body.floating.integrals import PERMUTATION, ShapeIntegrals
from morembs.body.floating.tolerances import TOL
from morembs.fem import skew
from morembs.linalg.dense import symmetric
from morembs.storage.table import dataset

if TYPE_CHECKING:
    from morembs.parametric.model import ModelAt
    from morembs.parametric.terms import AffineProblem


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTerms:
    """Integrals of the n columns of a basis for each of J terms of the mass, about ``pole`` (3,).

    ``mass`` (J,); ``first`` (J, 1 + morphs, 3); ``second`` (J, 1 + morphs, 3, 1 + morphs, 3); ``Ct`` (J, n, 3);
    ``x_phi`` (J, 1 + morphs, 3, 3, n) and ``phi_phi`` (J, 3, 3, n, n) as in ``ShapeIntegrals``. ``markers`` are the
    motions (6, n) of the interfaces and ``points`` (1 + morphs, 3) their places, by name.
    """

    pole: Floats = dataset("real", "3", "reference point of the integrals", "m")
    mass: Floats = dataset("real", "J", "mass of each term")
    first: Floats = dataset("real", "J f 3", "int x dm, x0 and the displacement of each morph")
    second: Floats = dataset("real", "J f 3 f 3", "int x x' dm for each pair of these")
    Ct: Floats = dataset("real", "J n 3", "int phi dm, phi the columns of the basis")
    x_phi: Floats = dataset("later", "J f 3 3 n", "[j, i, a, b, l]: int x_a phi_b,l dm")
    phi_phi: Floats = dataset("later", "J 3 3 n n", "[j, a, b, k, l]: int phi_a,k phi_b,l dm")
    markers: Mapping[str, Floats] = dataset(
        "real", "6 n", "displacement and small rotation of the interface per coordinate", name="markers/*"
    )
    points: Mapping[str, Floats] = dataset(
        "real", "f 3", "place of the interface, and its displacement by each morph", "m", name="points/*"
    )

    def point(self, name: str, at: ModelAt) -> Floats:
        """Place (3,) of an interface in the model."""
        return at.model.box.affine(self.points[name].T, at.p)

    def frame(
        self,
        at: ModelAt,
        *,
        kind: str = "mean-axes",
        interfaces: Sequence[str] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        shapes: Floats | None = None,
    ) -> FloatingFrame:
        """The floating frame at one value, as ``floating_frame`` of the model there.

        Elastic coordinates are those of the ``shapes`` (n, k), the elastic modes at the value unless given.
        """
        b, t, rigid = at.model.law_M(at.p), self._positions(at), at.model.rigid_at(at.p)
        Y = _elastic_modes(at) if shapes is None else shapes
        return self._frame(b, t, at.K, at.D, rigid, Y, kind=kind, interfaces=interfaces, origin=origin)

    def derivatives(
        self,
        at: ModelAt,
        *,
        kind: str = "mean-axes",
        interfaces: Sequence[str] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> dict[str, FloatingFrame]:
        """Derivatives of ``frame`` by each parameter, in the fields of a frame: exact, by a complex step of the
        coefficients (Squire and Trapp 1998). The shapes stay those of the elastic modes at the value, as any others of
        the same basis give the same motions.

        Raises:
            InputError: modal damping, which follows the modes.
        """
        model, Y, result = at.model, _elastic_modes(at), {}
        if at.damping.is_modal:
            raise InputError(
                "derivatives of a floating body need Rayleigh damping, or none: modal damping follows the modes",
                kind="model",
            )
        b, t, rigid = model.law_M(at.p), self._positions(at), model.rigid_at(at.p)
        slopes, (dK, dM) = model.law_M.derivative(at.p), model.derivatives(at.p)
        for j, (name, kind_of) in enumerate(zip(model.box.names, model.box.kinds, strict=True)):
            moving = np.array([0.0] + [float(j == morph) for morph in model.box.morphs])
            changes = (rigid, model.rigid @ moving), (at.M, dM[j]), (at.K, dK[j])
            R, M, K = (x + TOL.complex_step * dx for x, dx in changes)
            alpha, beta = (getattr(at.damping, key) + TOL.complex_step * (kind_of == key) for key in ("alpha", "beta"))
            # D leaves rigid motion out, which the shapes have no momentum with: a change of second order.
            D = alpha * M + beta * K
            frame = self._frame(
                b + TOL.complex_step * slopes[:, j],
                t + TOL.complex_step * moving,
                K,
                D,
                R,
                Y,
                kind=kind,
                interfaces=interfaces,
                origin=origin,
            )
            result[name] = _slope(frame)
        return result

    def _positions(self, at: ModelAt) -> Floats:
        """Factors (1 + morphs,) of x0 and of the displacement of each morph."""
        return at.model.box.affine(np.eye(1 + len(at.model.box.morphs)), at.p)

    def _integrals(self, b: Values, t: Values, Y: Floats) -> ShapeIntegrals:
        """Those of the shapes ``Y`` (n, k) of the basis about ``pole``, for coefficients of the mass and positions."""
        second = np.einsum("j,k,l,jkalb->ab", b, t, t, self.second, optimize=True)
        x_phi = np.einsum("j,k,jkabl->abl", b, t, self.x_phi, optimize=True) @ Y
        phi_phi = Y.T @ np.tensordot(b, self.phi_phi, axes=1) @ Y
        return ShapeIntegrals(
            mass=(b @ self.mass).item(),
            first=np.einsum("j,k,jka->a", b, t, self.first),
            inertia=np.trace(second) * np.eye(3) - second,
            second=symmetric(second),
            Ct=Y.T @ np.tensordot(b, self.Ct, axes=1),
            Cr=np.einsum("abc,bcl->la", PERMUTATION, x_phi),
            Me=np.einsum("aakl->kl", phi_phi),
            x_phi=x_phi,
            phi_phi=phi_phi,
        )

    def _frame(
        self,
        b: Values,
        t: Values,
        K: Values,
        D: Values,
        rigid: Values,
        Y: Floats,
        *,
        kind: str,
        interfaces: Sequence[str],
        origin: Sequence[float],
    ) -> FloatingFrame:
        about_pole = self._integrals(b, t, Y)
        away = about_pole.center
        H = np.eye(6, dtype=away.dtype)
        H[:3, 3:] = skew(away)
        markers = {
            name: InterfaceMarker(point=self.points[name].T @ t - self.pole - away, motion=motion @ Y)
            for name, motion in self.markers.items()
        }
        return frame_about(
            K,
            D,
            Y,
            rigid @ H,
            about_pole.about(away),
            markers,
            self.pole + away,
            kind=kind,
            interfaces=interfaces,
            origin=origin,
        )


def _elastic_modes(at: ModelAt) -> Floats:
    return at.Y[:, at.rigid.shape[1] :]


def _slope(frame: FloatingFrame) -> FloatingFrame:
    """What a complex step has left in the imaginary parts of a frame."""

    def of(value: Any) -> Any:
        return np.imag(value) / TOL.complex_step.imag

    markers = {k: InterfaceMarker(point=of(m.point), motion=of(m.motion)) for k, m in frame.markers.items()}
    parts = {entry.name: of(getattr(frame.integrals, entry.name)) for entry in fields(ShapeIntegrals)}
    matrices = {name: of(getattr(frame, name)) for name in ("origin", "elastic", "rigid", "Ke", "De")}
    return replace(frame, integrals=ShapeIntegrals(**parts), markers=markers, notes=(), **matrices)


def frame_terms(problem: AffineProblem, V: Floats) -> FrameTerms:
    """Integrals of the columns of ``V`` (Nc, n). Peak memory: three times V in the dofs of the model."""
    import scipy.sparse as sp

    varied, coupling = problem.varied, problem.coupling
    graph, mass, pole, n = varied.graph, varied.mass, coupling.pole, V.shape[1]
    U = np.ascontiguousarray((coupling.T @ V).reshape(-1, 3, n).transpose(1, 0, 2))
    X = np.stack([varied.morph.mesh.nodes.xyz - pole, *varied.morph.displacements])
    J, m = len(mass), len(X)
    terms = {
        "mass": np.zeros(J),
        "first": np.zeros((J, m, 3)),
        "second": np.zeros((J, m, 3, m, 3)),
        "Ct": np.zeros((J, n, 3)),
        "x_phi": np.zeros((J, m, 3, 3, n)),
        "phi_phi": np.zeros((J, 3, 3, n, n)),
    }
    for j, theta in enumerate(np.eye(J)):
        Ms = sp.csr_array((mass.combine(theta), graph.indices, graph.indptr), shape=graph.shape)
        share = Ms.sum(axis=0)
        terms["mass"][j], terms["first"][j] = share.sum(), np.einsum("i,kia->ka", share, X)
        terms["second"][j] = np.einsum("kia,lib->kalb", X, np.stack([Ms @ x for x in X]), optimize=True)
        for b in range(3):
            Y = Ms @ U[b]
            terms["Ct"][j, :, b] = Y.sum(axis=0)
            terms["x_phi"][j, :, :, b] = np.einsum("kia,il->kal", X, Y, optimize=True)
            for a in range(3):
                terms["phi_phi"][j, a, b] = U[a].T @ Y
        problem.budget.release_if_tight()
    frames = coupling.frames.T @ V
    points = {}
    for interface in problem.interfaces:
        moves = [d[interface.nodes[0]] for d in varied.morph.displacements]
        start = interface.point - sum(problem.box.nominal[i] * d for i, d in zip(problem.morphs, moves, strict=True))
        points[interface.name] = np.array([start, *moves])
    markers = {name: np.asarray(frames[columns]) for name, columns in coupling.frame_columns.items()}
    return FrameTerms(pole=pole, markers=markers, points=points, **terms)
