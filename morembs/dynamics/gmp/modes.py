"""Bending modes of a planar component between two held frames, without load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Count
from morembs.base.types import Floats
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.linalg.columns import fix_signs


@dataclass(frozen=True, kw_only=True, eq=False)
class BendingModes:
    """``Psi`` (N, m), zero at the frames, Psi' M Psi = 1; ``squares`` (m,) their angular frequencies squared;
    ``excluded`` (e,) those of modes of stretching among them."""

    Psi: Floats
    squares: Floats
    excluded: Floats


@checked
def bending_modes(component: NonlinearComponent, count: Count, stretch: Floats | None = None) -> BendingModes:
    """The lowest ``count`` modes of bending; modes of stretching are left out.

    With ``stretch`` A (N,) they are those of K - K A A'K / A'KA, which that shape does not strain.

    Args:
        component: the component at rest.
        count: number of modes.
        stretch: shape (N,) that the modes must not strain.

    Raises:
        InputError: the component has fewer, or is not stable without load.
    """
    held = np.concatenate(tuple(component.frames.values()))
    free = np.setdiff1d(np.arange(component.size), held)
    full_K = component.tangent(component.reference)
    K, M = full_K[free][:, free], component.M[free][:, free]
    g = np.zeros(len(free))
    if stretch is not None:
        g = np.asarray((full_K @ stretch)[free] / np.sqrt(stretch @ (full_K @ stretch)))
    if not all(np.isfinite(values).all() for values in (K.data, M.data, g**2)):
        raise InputError(
            "stiffness or mass of the component overflow; expected lengths and sections in its units", keyword="member"
        )
    tried = count + max(4, count // 2)
    while True:
        if tried + 1 >= len(free) or len(free) <= TOL.dense_modes_dofs:
            omega_squared, shapes = _all_modes(K.toarray() - np.outer(g, g), M.toarray())
        else:
            start = np.random.default_rng(7).standard_normal(len(free))
            omega_squared, shapes = spl.eigsh(K.tocsc(), tried, M.tocsc(), sigma=0.0, v0=start, OPinv=_inverse(K, g))
        if len(omega_squared) and omega_squared[0] <= 0:
            raise InputError("the component is not stable without load; expected a stable reference", kind="model")
        full = np.zeros((component.size, len(omega_squared)))
        full[free] = shapes
        along = np.zeros_like(full)
        along[component.translations[:, 0]] = full[component.translations[:, 0]]
        share = np.einsum("ik,ik->k", along, component.M @ along)
        bending = np.flatnonzero(share < TOL.stretching_share)
        if len(bending) >= count:
            break
        if len(omega_squared) == len(free):
            raise InputError(
                f"{count} modes were given; the component has only {len(bending)} of bending. Take fewer, or a finer "
                "component",
                keyword="modes",
            )
        tried = 2 * tried
    kept = bending[:count]
    Psi = fix_signs(full[:, kept])
    last = omega_squared[kept[-1]] if count else 0.0
    excluded = omega_squared[(share >= TOL.stretching_share) & (omega_squared < last)]
    return BendingModes(Psi=Psi, squares=omega_squared[kept], excluded=excluded)


def _all_modes(K: Floats, M: Floats) -> tuple[Floats, Floats]:
    """Squares of the frequencies (n,), ascending, and shapes (n, n)."""
    try:
        values, shapes = sl.eigh(K, M)
    except np.linalg.LinAlgError:
        raise InputError(
            "the mass matrix of the component is not positive definite; give its section a rotary inertia",
            kind="model",
            keyword="mass",
        ) from None
    return values, shapes


def _inverse(K: sp.spmatrix, g: Floats) -> spl.LinearOperator:
    """(K - g g')^-1 (Sherman and Morrison 1950)."""
    solve = spl.splu(sp.csc_matrix(K)).solve
    y = solve(g)
    y /= np.sqrt(1 - g @ y)
    return spl.LinearOperator(K.shape, matvec=lambda b: solve(b) + y * (y @ b), dtype=float)
