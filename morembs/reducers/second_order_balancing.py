"""Second-order balanced truncation in small matrices, for symmetric models driven and measured at the same places.

[Zp; Zv] is a factor of the controllability Gramian of the state (x, x'), with E = diag(I, M). That of the
observability Gramian is [M Zv + D Zp; Zp] (see ``linalg.adi``), so four small products of Zp and Zv hold all
singular values (Meyer and Srinivasan 1996; Chahlaoui, Lemonnier, Vandendorpe, Van Dooren 2006; Reis and Stykel
2008). Gramians of a modal model are written down here too: over all frequencies in closed form, over a band by
quadrature of its states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Complexes, Floats
from morembs.linalg.quadrature import modal_poles, resonant
from morembs.reducers.tolerances import TOL

VARIANTS = ("p", "v", "pv", "vp", "fv", "so")
# These project with one basis, which keeps symmetry and with it stability.
ONE_SIDED = ("pv", "fv")


@dataclass(frozen=True, kw_only=True, eq=False)
class Products:
    """``pp`` = Zpo' Zpc, ``vv`` = Zvo' M Zvc, ``pv`` = Zvo' M Zpc, ``vp`` = Zpo' Zvc (k, k), c and o for
    controllability and observability; ``p_norms`` = Zp' M Zp and ``v_norms`` = Zv' M Zv."""

    pp: Floats
    vv: Floats
    pv: Floats
    vp: Floats
    p_norms: Floats
    v_norms: Floats

    @classmethod
    def of(cls, Mpp: Floats, Mpv: Floats, Mvv: Floats, Dpp: Floats, Dpv: Floats) -> Products:
        """From Zp'M Zp, Zp'M Zv, Zv'M Zv, Zp'D Zp and Zp'D Zv."""
        return cls(pp=Mpv.T + Dpp, vv=Mpv, pv=Mpp, vp=Mvv + Dpv, p_norms=Mpp, v_norms=Mvv)


@dataclass(frozen=True, kw_only=True, eq=False)
class Truncation:
    """V = Zp ``right`` or, for ``right_of_velocities``, Zv ``right``; equations are tested with Zp ``left``
    (None: with V) and velocities expanded with Zv ``velocity`` (None: with V); ``values`` the singular values.

    ``cosine`` is that of the largest angle in M between spaces that belong together; 1 for one-sided variants.
    """

    right: Floats
    left: Floats | None
    velocity: Floats | None
    right_of_velocities: bool
    values: Floats
    cosine: float


def singular_values(products: Products, variant: str) -> Floats:
    """Singular values of ``variant``, descending; of "so" the smaller in rank of position and velocity values."""
    return np.asarray(_svd(_leading(products, variant))[1])


def truncate_balanced(products: Products, variant: str, order: int, balancing: str) -> Truncation:
    """The first ``order`` directions of ``variant``; ``balancing`` "sr" scales, "bfsr" orthonormalises in M."""
    Up, sp, Vp = _svd(products.pp)
    Uv, sv, Vv = _svd(products.vv)
    test = Uv[:, :order]
    left: Floats | None = test
    velocity: Floats | None = None
    if variant == "so":
        # T = V1 (W1'V1)^-1 W1'V2 depends on no scaling of V1 and W1.
        velocity = Vv[:, :order]
        right = (Vp[:, :order] / sp[:order]) @ (Up[:, :order].T @ (products.vp @ velocity))
        values, lengths = sv, products.v_norms
    else:
        _, values, right = _svd(_leading(products, variant))
        right = right[:, :order]
        lengths = products.v_norms if variant in ("v", "vp") else products.p_norms
    expanded = right if velocity is None else velocity
    trial_change, test_change = _orthonormalise(expanded, lengths), _orthonormalise(test, products.p_norms)
    # Zp' M Zv of mixed spaces is the product vv.
    mixed = products.p_norms if lengths is products.p_norms else products.vv
    cosine = _cosine(test @ test_change, mixed, expanded @ trial_change)
    if velocity is not None:
        positions = right @ _orthonormalise(right, products.p_norms)
        cosine = min(cosine, _cosine(positions, products.vv, velocity @ trial_change))
    if variant in ONE_SIDED:
        left, cosine = None, 1.0
    if balancing == "sr":
        trial_change = test_change = np.diag(1 / np.sqrt(values[:order]))
    return Truncation(
        right=right @ trial_change,
        left=None if left is None else left @ test_change,
        velocity=None if velocity is None else velocity @ trial_change,
        right_of_velocities=variant in ("v", "vp"),
        values=values,
        cosine=cosine,
    )


def usable_order(products: Products, variant: str) -> int:
    """How many directions are above round-off in all factors that ``variant`` takes."""
    needed = [_leading(products, variant)]
    if variant not in ONE_SIDED:
        needed.append(products.vv)
    if variant == "so":
        needed.append(products.pp)
    return min(int((s > TOL.singular_noise * s[0]).sum()) for s in (_svd(A)[1] for A in needed))


def _leading(products: Products, variant: str) -> Floats:
    """The product whose singular values decide in ``variant``."""
    table = {
        "p": products.pp,
        "fv": products.pp,
        "v": products.vv,
        "so": products.vv,
        "pv": products.pv,
        "vp": products.vp,
    }
    return table[variant]


def _svd(A: Floats) -> tuple[Floats, Floats, Floats]:
    """U, singular values and V of A = U S V'."""
    U, s, Vt = sl.svd(A)
    return U, s, Vt.T


def _orthonormalise(X: Floats, G: Floats) -> Floats:
    """R (j, j) with (X R)' G (X R) = I as far as the columns are independent to working accuracy."""
    gram = X.T @ G @ X
    size = 1 / np.sqrt(np.diag(gram))
    values, Y = sl.eigh(size[:, None] * gram * size)
    return np.asarray((size[:, None] * Y) / np.sqrt(np.maximum(values, TOL.singular_noise * values[-1])))


def _cosine(X: Floats, G: Floats, Y: Floats) -> float:
    """Smallest singular value of X' G Y: zero where a direction of one space is perpendicular to the other."""
    return float(sl.svdvals(X.T @ G @ Y)[-1])


def lyapunov_factor(values: Floats, damping: Floats, F: Floats) -> tuple[Floats, Floats]:
    """Zp and Zv (k, 2k) of x'' + diag(``damping``) x' + diag(``values``) x = F u over all frequencies.

    With X, Y, V the integrals of x x', x v' and v v', the Lyapunov equation for two modes i and j reads
    V - d_j Y - l_j X = 0, V + d_i Y - l_i X = 0 and (d_i + d_j) V + (l_i - l_j) Y = f_i f_j, which gives each
    entry by itself.
    """
    FF = F @ F.T
    di, dj, li, lj = damping[:, None], damping[None], values[:, None], values[None]
    X = FF / (lj * di + li * dj + (li - lj) ** 2 / (di + dj))
    Y = (li - lj) / (di + dj) * X
    V = (lj * di + li * dj) / (di + dj) * X
    # Positions in units of velocities at their own frequency, or rounding would hide the velocities.
    scale = np.concatenate([np.sqrt(values), np.ones(len(values))])
    P = scale[:, None] * np.block([[X, Y], [Y.T, V]]) * scale
    eigenvalues, Q = sl.eigh(P)
    keep = eigenvalues > 0
    Z = (Q[:, keep] * np.sqrt(eigenvalues[keep])) / scale[:, None]
    return Z[: len(values)], Z[len(values) :]


def band_factor(
    states: Callable[[Complexes], Complexes],
    values: Floats,
    damping: Floats,
    band: tuple[float, float],
    delta: float = 0.0,
) -> tuple[Floats, Floats]:
    """Zp and Zv (k, 2k) of the Gramian over ``band`` (rad/s), (1/pi) int Re [U; sU][U; sU]* d omega.

    ``states(s)`` (ns, k, m) gives U on the line s = ``delta`` + i omega; ``values`` and ``damping`` (k,) the poles.
    """
    omega, weight = resonant(*band, modal_poles(values, damping) + 1j * delta)
    k = len(values)
    R: Floats = np.zeros((0, 2 * k))
    for first in range(0, len(omega), TOL.nodes_at_once):
        part = slice(first, first + TOL.nodes_at_once)
        s = np.asarray(delta + 1j * omega[part], dtype=complex)
        U = states(s) * np.sqrt(weight[part] / np.pi)[:, None, None]
        both = np.concatenate([U, s[:, None, None] * U], axis=1)
        rows = both.transpose(0, 2, 1).reshape(-1, 2 * k)
        R = sl.qr(np.vstack([R, rows.real, rows.imag]), mode="r", check_finite=False)[0][: 2 * k]
    return R[:, :k].T, R[:, k:].T
