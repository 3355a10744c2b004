"""Integrals over the mass of an elastic body: all that its inertia forces need, whatever its size.

x are undeformed positions from the origin of the body frame, phi_l the elastic shapes, in axes of the body. Names
C4, C6, Gr, Ge, Oe as Wallrapp (1993, 1994); with q, the elastic coordinates, and angular velocity w

    J(q) = J + J1_l q_l - C6_kl q_k q_l,   Cr(q) = Cr + Cr1_k q_k,   Gr(q') = Gr_l q'_l + ...,   Oe(q) = Oe + Oe1_l q_l.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body.floating.tolerances import TOL
from morembs.fem import FEModel, frozen_numbers, rigid_motion, skew
from morembs.linalg.dense import symmetric
from morembs.storage.table import dataset, derived

if TYPE_CHECKING:
    import scipy.sparse as sp


# Levi-Civita symbol.
PERMUTATION = np.array([[[(a - b) * (b - c) * (c - a) / 2 for c in range(3)] for b in range(3)] for a in range(3)])
# Pairs of axes in the order xx, yy, zz, xy, yz, zx.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
_FOLLOWS = "follows from those above"


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ShapeIntegrals:
    """Integrals of a body with n elastic shapes; SI units, shapes without unit where q is a length.

    ``mass``; ``first`` (3,) int x; ``inertia`` (3, 3) about the origin; ``second`` (3, 3) int x x';
    ``Ct`` (n, 3) int phi; ``Cr`` (n, 3) int x cross phi; ``Me`` (n, n) int phi . phi;
    ``x_phi`` (3, 3, n) [a, b, l] int x_a phi_b,l; ``phi_phi`` (3, 3, n, n) [a, b, k, l] int phi_a,k phi_b,l.
    """

    mass: float = dataset("real", "", units="kg", doc="mass", positive=True)
    first: Floats = dataset("real", "3", "int x dm; x from the origin, phi the shapes", "kg m")
    inertia: Floats = dataset("real", "3 3", "about the origin", "kg m2")
    second: Floats = dataset("real", "3 3", "int x x' dm", "kg m2")
    Ct: Floats = dataset("real", "ne 3", "int phi dm")
    Cr: Floats = dataset("real", "ne 3", "int x cross phi dm")
    Me: Floats = dataset("real", "ne ne", "int phi . phi dm")
    x_phi: Floats = dataset("real", "3 3 ne", "[a, b, l]: int x_a phi_b,l dm")
    phi_phi: Floats = dataset("real", "3 3 ne ne", "[a, b, k, l]: int phi_a,k phi_b,l dm")

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name != "mass":
                object.__setattr__(self, entry.name, frozen_numbers(getattr(self, entry.name)))

    @property
    def count(self) -> int:
        """Number n of elastic shapes."""
        return len(self.Me)

    @property
    def center(self) -> Floats:
        """Centre of mass (3,) from the origin."""
        return np.asarray(self.first / self.mass)

    @cached_property
    def rigid(self) -> Floats:
        """Mass matrix (6, 6) of rigid motion about the origin."""
        arm = skew(self.first)
        return np.block([[self.mass * np.eye(3), -arm], [arm, self.inertia]])

    @derived("later", "ne 3 3", "int x~ phi~ dm", when=_FOLLOWS)
    def C4(self) -> Floats:
        """(n, 3, 3): int x~ phi_l~."""
        trace = np.einsum("aal->l", self.x_phi)
        return np.asarray(self.x_phi.transpose(2, 1, 0) - trace[:, None, None] * np.eye(3))

    @derived("later", "ne ne 3 3", "int phi_k~ phi_l~ dm", when=_FOLLOWS)
    def C6(self) -> Floats:
        """(n, n, 3, 3): int phi_k~ phi_l~."""
        trace = np.einsum("aakl->kl", self.phi_phi)
        return np.asarray(self.phi_phi.transpose(2, 3, 1, 0) - trace[:, :, None, None] * np.eye(3))

    @derived("later", "ne ne 3", "[l, k, a]: Cr per coordinate k", when=_FOLLOWS)
    def Cr1(self) -> Floats:
        """(n, n, 3) [l, k, a]: what q_k adds to row l of Cr."""
        return np.asarray(np.einsum("abc,bckl->lka", PERMUTATION, self.phi_phi))

    @derived("later", "ne 3 3", "inertia per coordinate", when=_FOLLOWS)
    def J1(self) -> Floats:
        """(n, 3, 3): what q_l adds to the inertia."""
        return np.asarray(-(self.C4 + self.C4.transpose(0, 2, 1)))

    @derived("later", "ne 3 3", "gyroscopic moments", doc="gyroscopic moments, -2 C4", when=_FOLLOWS)
    def Gr(self) -> Floats:
        """(n, 3, 3): gyroscopic moments Gr_l q'_l w."""
        return np.asarray(-2 * self.C4)

    @derived("later", "ne ne 3", "gyroscopic forces", when=_FOLLOWS)
    def Ge(self) -> Floats:
        """(n, n, 3): gyroscopic forces sum_k q'_k Ge_k w, Ge_k (n, 3)."""
        return np.asarray(2 * self.Cr1.transpose(1, 0, 2))

    @derived("later", "ne 6", "centrifugal forces, w_a w_b in the order xx, yy, zz, xy, yz, zx", when=_FOLLOWS)
    def Oe(self) -> Floats:
        """(n, 6): centrifugal forces on w_a w_b in the order xx, yy, zz, xy, yz, zx."""
        return _by_pairs(self.C4)

    @derived("later", "ne 6 ne", "[i, ab, l]: Oe per coordinate l", when=_FOLLOWS)
    def Oe1(self) -> Floats:
        """(n, 6, n) [i, ab, l]: what q_l adds to row i of Oe."""
        return np.asarray(_by_pairs(self.C6).transpose(0, 2, 1))

    def without_rigid(self, c: Floats) -> Self:
        """Integrals of the shapes phi_l - t_l - theta_l x x with [t; theta] = ``c`` (6, n)."""
        t, W = c[:3], skew(c[3:].T)
        rows = np.hstack([self.Ct, self.Cr])
        moved = rows - c.T @ self.rigid
        # int phi_a,k r_b,l and int r_a,k r_b,l of the rigid parts r.
        mixed = np.einsum("ka,bl->abkl", self.Ct, t) + np.einsum("lbq,qak->abkl", W, self.x_phi)
        Wf = W @ self.first
        both = (
            self.mass * np.einsum("ak,bl->abkl", t, t)
            + np.einsum("ak,lb->abkl", t, Wf)
            + np.einsum("ka,bl->abkl", Wf, t)
            + np.einsum("kap,lbq,pq->abkl", W, W, self.second, optimize=True)
        )
        Me = self.Me - rows @ c - (rows @ c).T + c.T @ self.rigid @ c
        return replace(
            self,
            Ct=moved[:, :3],
            Cr=moved[:, 3:],
            Me=symmetric(Me),
            x_phi=self.x_phi - np.einsum("a,bl->abl", self.first, t) - np.einsum("lbq,aq->abl", W, self.second),
            phi_phi=self.phi_phi - mixed - mixed.transpose(1, 0, 3, 2) + both,
        )

    def about(self, d: Floats) -> Self:
        """The same with the origin moved by ``d`` (3,)."""
        H = np.eye(6, dtype=d.dtype)
        H[:3, 3:] = skew(d)
        across = np.outer(self.first, d)
        return replace(
            self,
            first=self.first - self.mass * d,
            inertia=(H.T @ self.rigid @ H)[3:, 3:],
            second=self.second - across - across.T + self.mass * np.outer(d, d),
            Cr=self.Cr - np.cross(d, self.Ct),
            x_phi=self.x_phi - np.einsum("a,lb->abl", d, self.Ct),
        )


def _by_pairs(C: Floats) -> Floats:
    """(..., 6) of (..., 3, 3): coefficients of w_a w_b."""
    return np.stack([C[..., a, a] if a == b else C[..., a, b] + C[..., b, a] for a, b in PAIRS], axis=-1)


def shape_integrals(model: FEModel, shapes: Floats, origin: Floats) -> tuple[ShapeIntegrals, str]:
    """Integrals of ``shapes`` (N, n) in the dofs of ``model``, and a note where they are not exact.

    Where every node moves with one mass along x, y and z (solids) all follow from the scalar mass matrix. Other
    masses (beams, shells, point inertias) give mass, first moment, inertia, Ct, Cr and Me exactly; terms of higher
    order then come from the mean translational mass. Peak memory: three blocks of columns (N / 3, .) besides
    ``shapes``.
    """
    x, dofs = model.nodes.xyz - origin, model.dofs.of_nodes(np.arange(len(model.nodes)))
    Ms, exact = _scalar_mass(model.M, dofs)
    n = shapes.shape[1]
    at = [np.flatnonzero(dofs[:, a] >= 0) for a in range(3)]
    Ct, x_phi, phi_phi = np.zeros((n, 3)), np.zeros((3, 3, n)), np.zeros((3, 3, n, n))
    weighted = Ms @ np.column_stack([np.ones(len(x)), x])
    budget = current_budget()
    width = budget.columns(len(x), widest=TOL.integral_columns)
    for first in range(0, n, width):
        block = slice(first, min(first + width, n))
        for b in range(3):
            Y = Ms @ _component(shapes, dofs, at, b, block)
            Ct[block, b] = Y.sum(axis=0)
            x_phi[:, b, block] = x.T @ Y
            for other in range(0, n, width):
                rows = slice(other, min(other + width, n))
                for a in range(3):
                    phi_phi[a, b, rows, block] = _component(shapes, dofs, at, a, rows).T @ Y
            budget.release_if_tight()
    second = x.T @ weighted[:, 1:]
    Cr = np.einsum("abc,bcl->la", PERMUTATION, x_phi)
    integrals = ShapeIntegrals(
        mass=float(weighted[:, 0].sum()),
        first=x.T @ weighted[:, 0],
        inertia=np.trace(second) * np.eye(3) - second,
        second=symmetric(second),
        Ct=Ct,
        Cr=Cr,
        Me=np.einsum("aakl->kl", phi_phi),
        x_phi=x_phi,
        phi_phi=phi_phi,
    )
    if exact:
        return integrals, ""
    return _with_consistent_parts(integrals, model, shapes, x), (
        "inertia terms of second order come from the mean translational mass: the mass of this model is not the same "
        "along x, y and z, or it turns"
    )


def _component(shapes: Floats, dofs: NDArray[np.int64], at: list[NDArray[np.int64]], a: int, block: slice) -> Floats:
    """Displacements (n_nodes, .) along axis ``a``."""
    if len(shapes) == dofs.size and len(at[a]) == len(dofs):
        return np.ascontiguousarray(shapes[:, block][dofs[:, a]])
    out = np.zeros((len(dofs), shapes[:, block].shape[1]))
    out[at[a]] = shapes[:, block][dofs[at[a], a]]
    return out


def _scalar_mass(M: sp.csr_array, dofs: NDArray[np.int64]) -> tuple[sp.csr_array, bool]:
    """Mean mass (n, n) of the nodes along x, y and z, and whether M is this mass along each and nothing else."""
    first = _along(M, dofs[:, 0])
    largest = abs(first).max()
    if any(abs(_along(M, dofs[:, a]) - first).max() > TOL.same_mass * largest for a in (1, 2)):
        return (first + _along(M, dofs[:, 1]) + _along(M, dofs[:, 2])) / 3, False
    # Nothing between the axes, and nothing that turns.
    rest = abs(np.abs(M.data).sum() - 3 * np.abs(first.data).sum())
    return first, bool(rest <= TOL.same_mass * len(dofs) * largest)


def _along(M: sp.csr_array, dofs: NDArray[np.int64]) -> sp.csr_array:
    """Mass (n, n) of the nodes along one axis; ``dofs`` (n,) are -1 where a node lacks that displacement."""
    import scipy.sparse as sp

    has = np.flatnonzero(dofs >= 0)
    rows = sp.csr_array((np.ones(len(has)), (has, dofs[has])), shape=(len(dofs), M.shape[0]))
    return sp.csr_array((rows @ M) @ rows.T)


def _with_consistent_parts(integrals: ShapeIntegrals, model: FEModel, shapes: Floats, x: Floats) -> ShapeIntegrals:
    """Rigid and linear terms from the whole mass matrix."""
    R = rigid_motion(x[model.dofs.node], model.dofs.component)
    MR = model.M @ R
    G = R.T @ MR
    rows = shapes.T @ MR
    first = np.array([G[1, 5] - G[2, 4], G[2, 3] - G[0, 5], G[0, 4] - G[1, 3]]) / 2
    Me = shapes.T @ (model.M @ shapes)
    return replace(
        integrals,
        mass=float(np.trace(G[:3, :3]) / 3),
        first=first,
        inertia=0.5 * (G[3:, 3:] + G[3:, 3:].T),
        Ct=rows[:, :3],
        Cr=rows[:, 3:],
        Me=symmetric(Me),
    )
