"""Floating frames at every value of parameters, from integrals over each term of the mass.

Shapes are fixed in the model, and positions are x0 + sum_i t_i d_i, so that all integrals are sums of the terms of the
mass times products of the t_i: what has no position, one, or two in it is stored against x0 and each d_i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morembs.floating.frame import FloatingFrame, InterfaceMarker, frame_about
from morembs.floating.integrals import PERMUTATION, ShapeIntegrals
from morembs.model import skew

if TYPE_CHECKING:
    from morembs.parametric.model import ModelAt
    from morembs.parametric.terms import AffineProblem

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTerms:
    """Integrals of the n columns of a basis for each of J terms of the mass, about ``pole`` (3,).

    ``mass`` (J,); ``first`` (J, 1 + morphs, 3); ``second`` (J, 1 + morphs, 3, 1 + morphs, 3); ``Ct`` (J, n, 3);
    ``x_phi`` (J, 1 + morphs, 3, 3, n) and ``phi_phi`` (J, 3, 3, n, n) as in ``ShapeIntegrals``. ``markers`` are the
    motions (6, n) of the interfaces and ``points`` (1 + morphs, 3) their places, by name.
    """

    pole: Floats
    mass: Floats
    first: Floats
    second: Floats
    Ct: Floats
    x_phi: Floats
    phi_phi: Floats
    markers: Mapping[str, Floats]
    points: Mapping[str, Floats]

    def integrals(self, at: ModelAt, Y: Floats) -> ShapeIntegrals:
        """Those of the shapes ``Y`` (n, k) of the basis at one value, about ``pole``."""
        b, t = at.model.law_M(at.p), at.model.box.affine(np.eye(1 + len(at.model.box.morphs)), at.p)
        second = np.einsum("j,k,l,jkalb->ab", b, t, t, self.second, optimize=True)
        x_phi = np.einsum("j,k,jkabl->abl", b, t, self.x_phi, optimize=True) @ Y
        phi_phi = Y.T @ np.tensordot(b, self.phi_phi, axes=1) @ Y
        return ShapeIntegrals(
            mass=float(b @ self.mass), first=np.einsum("j,k,jka->a", b, t, self.first),
            inertia=np.trace(second) * np.eye(3) - second, second=0.5 * (second + second.T),
            Ct=Y.T @ np.tensordot(b, self.Ct, axes=1), Cr=np.einsum("abc,bcl->la", PERMUTATION, x_phi),
            Me=np.einsum("aakl->kl", phi_phi), x_phi=x_phi, phi_phi=phi_phi,
        )  # fmt: skip

    def point(self, name: str, at: ModelAt) -> Floats:
        """Place (3,) of an interface in the model."""
        return at.model.box.affine(self.points[name].T, at.p)

    def frame(
        self, at: ModelAt, *, kind: str = "mean-axes", interfaces: Sequence[str] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> FloatingFrame:  # fmt: skip
        """The floating frame at one value, as ``floating_frame`` of the model there."""
        Y = at.Y[:, at.rigid.shape[1] :]
        about_pole = self.integrals(at, Y)
        away = about_pole.center
        H = np.eye(6)
        H[:3, 3:] = skew(away)
        markers = {
            name: InterfaceMarker(point=self.point(name, at) - self.pole - away, motion=motion @ Y)
            for name, motion in self.markers.items()
        }
        return frame_about(
            at.K, at.D, Y, at.model.rigid_at(at.p) @ H, about_pole.about(away), markers, self.pole + away,
            kind=kind, interfaces=interfaces, origin=origin,
        )  # fmt: skip


def frame_terms(problem: AffineProblem, V: Floats) -> FrameTerms:
    """Integrals of the columns of ``V`` (Nc, n). Peak memory: three times V in the dofs of the model."""
    import scipy.sparse as sp

    varied, coupling = problem.varied, problem.coupling
    graph, mass, pole, n = varied.graph, varied.mass, coupling.pole, V.shape[1]
    U = np.ascontiguousarray((coupling.T @ V).reshape(-1, 3, n).transpose(1, 0, 2))
    X = np.stack([varied.morph.mesh.nodes.xyz - pole, *varied.morph.displacements])
    J, m = len(mass), len(X)
    terms = {
        "mass": np.zeros(J), "first": np.zeros((J, m, 3)), "second": np.zeros((J, m, 3, m, 3)),
        "Ct": np.zeros((J, n, 3)), "x_phi": np.zeros((J, m, 3, 3, n)), "phi_phi": np.zeros((J, 3, 3, n, n)),
    }  # fmt: skip
    for j, theta in enumerate(np.eye(J)):
        Ms = sp.csr_array((mass.combined(theta), graph.indices, graph.indptr), shape=graph.shape)
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
