"""By how much round-off moves a sum over modes, at most.

The delivered matrices are rounded, products with them are, and computed modes are coupled by what eigensolvers leave.
In modal coordinates this is H = C (diag(a) + dA)^-1 B' with |dA_pq| <= s_p t_q; of a symmetric K rounded by eps of its
entries s_p = t_p = (eps |u_p|'|K||u_p|)^(1/2), as |x|'|K||y| <= (x'w x)^(1/2) (y'w y)^(1/2) with the row sums w of |K|.
By the series of Neumann, for the motions i and the loads j of a block,

    |H_ij - sum_p c_p,i b_p,j' / a_p|
        <= (sum_p |c_p,i| s_p / |a_p|) (sum_p t_p |b_p,j| / |a_p|) / (1 - sum_p s_p t_p / |a_p|).

It is not enough to move every a_p by its own s_p t_p: between resonances couplings of modes count as much.

The rows c_p and b_p are off as well. They are sums of products; and a rounded K does not leave rigid motions z free of
forces: modes turn by z'K u_p / lam_p towards them, which moves the rows of soft modes by that part of the large rows of
rigid motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.responses.layout import BlockIndex
from morembs.responses.rational import PoleResidueForm
from morembs.responses.tolerances import TOL

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, kw_only=True, eq=False)
class RoundoffBound:
    """Of P modes: ``left`` and ``right`` (P, 1 + ni) norms of their rows times s_p and t_p, ``own`` (P,) their product
    s_p t_p, ``rows`` (P, 1 + nb) by how much the norms of c_p b_p' are off."""

    left: Floats
    right: Floats
    own: Floats
    rows: Floats
    layout: BlockIndex

    @classmethod
    def of(
        cls,
        layout: BlockIndex,
        c: NDArray[np.number],
        b: NDArray[np.number],
        s: Floats,
        t: Floats,
        off_c: Floats | float = 0.0,
        off_b: Floats | float = 0.0,
    ) -> RoundoffBound:
        """For rows ``c`` and ``b`` (P, m), known up to ``off_c`` and ``off_b`` (P, m), and s_p and t_p (P,)."""
        long_c, long_b = layout.lengths(c), layout.lengths(b)
        far_c, far_b = (
            long + layout.lengths(np.broadcast_to(off, c.shape)) for long, off in ((long_c, off_c), (long_b, off_b))
        )
        size = layout.products(long_c, long_b)
        return cls(
            left=far_c * s[:, None],
            right=far_b * t[:, None],
            own=s * t,
            rows=layout.products(far_c, far_b) - size + TOL.evaluation_eps * EPS * size,
            layout=layout,
        )

    def at(self, inverse: Floats) -> RoundoffSums:
        """What is lost where 1 / |a_p| are ``inverse`` (..., P)."""
        return RoundoffSums(
            coupled=self.layout.products(inverse @ self.left, inverse @ self.right),
            own=inverse @ self.own,
            rows=inverse @ self.rows,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """A transfer matrix as a sum over its poles, and by how much that may be off."""

    terms: PoleResidueForm
    rounding: RoundoffBound


@dataclass(frozen=True, kw_only=True, eq=False)
class RoundoffSums:
    """The sums of the limit at some frequencies: ``coupled`` and ``rows`` (..., 1 + nb), ``own`` (...)."""

    coupled: Floats
    own: Floats
    rows: Floats

    def size(self, growth: Floats | float = 1.0) -> Floats:
        """(..., 1 + nb) how far H and its blocks may be off, where all 1 / |a_p| grow by ``growth`` (...)."""
        growth = np.asarray(growth)[..., None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            margin = np.maximum(1.0 - growth * self.own[..., None], 0.0)
            through_poles = np.where(margin > 0, growth**2 * self.coupled / margin, np.inf)
        return np.asarray(through_poles + growth * self.rows)

    def part(self, points: slice) -> RoundoffSums:
        """That at ``points`` of the points (nc, n) of cells."""
        return RoundoffSums(coupled=self.coupled[:, points], own=self.own[:, points], rows=self.rows[:, points])


def bound_entry_errors(A: NDArray[np.number], L: NDArray[np.number], X: NDArray[np.number]) -> tuple[Floats, Floats]:
    """s and t (k,) with (n + 4) eps |L_p|'|A||X_q| <= s_p t_q, for vectors ``L`` and ``X`` (n, k) and any ``A`` (n, n).

    The products L'A X are off by that at most: two sums of n terms with eps / 2 each, and four roundings of complex
    numbers (Higham 2002, sections 3.1 and 3.6).
    """
    size = np.abs(A)
    d = np.sqrt(np.diag(size))
    d[d == 0] = 1.0
    eps = (len(d) + 4) * EPS
    rows, columns = (eps * d * (magnitudes @ (1 / d)) for magnitudes in (size, size.T))
    return np.sqrt(rows @ np.abs(L) ** 2), np.sqrt(columns @ np.abs(X) ** 2)


def absorb_couplings(s: Floats, t: Floats, R: NDArray[np.number]) -> tuple[Floats, Floats]:
    """s and t (k,) that also cover couplings ``R`` (k, k) which an eigensolver left.

    With r_p = max_q |R_pq| / t_q and k_q = max_p |R_pq| / s_p, |R_pq| <= (r_p s_p k_q t_q)^(1/2), and by Cauchy
    s_p t_q + |R_pq| <= (s_p^2 + r_p s_p)^(1/2) (t_q^2 + k_q t_q)^(1/2).
    """
    size, tiny = np.abs(R), np.finfo(float).tiny
    s, t = np.maximum(s, tiny), np.maximum(t, tiny)
    rows, columns = (size / t).max(axis=1, initial=0.0), (size / s[:, None]).max(axis=0, initial=0.0)
    return np.sqrt(s**2 + rows * s), np.sqrt(t**2 + columns * t)
