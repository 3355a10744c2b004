"""The lemmas that the bound of a parametric body rests on, and what holds on the cells of its box.

docs/background/proofs.md has a section with the proof of each lemma.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from morembs.base.summary import upwards
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz, in_hz
from morembs.storage.lemma import ESTIMATE, PROVEN, Lemma
from morembs.storage.table import dataset

if TYPE_CHECKING:
    from morembs.problem.damping import Damping


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxCells:
    """Parts of a box, ``low`` and ``high`` (c, P), with what holds on each: ``alpha`` (c,), K_SS(p) >= alpha K_SS(p_a)
    at the moduli of p_a, and ``least`` (c,), Lam^ for the softest and heaviest values, in (rad/s)2. ``proven`` (c,) by
    counts of eigenvalues, else estimated."""

    low: Floats = dataset("real", "c P", "least values of the cell")
    high: Floats = dataset("real", "c P", "largest values of the cell")
    alpha: Floats = dataset("any", "c", "lower bound of the stiffness over the stiffness at the anchor")
    least: Floats = dataset("any", "c", "lower bound of the eigenvalues outside the deflated motions", "1/s2")
    proven: NDArray[np.bool_] = dataset("flag", "c", "1 if counts of eigenvalues prove `alpha` and `least`")

    def at(self, p: Floats) -> tuple[float, float, bool]:
        """alpha, Lam^ and whether they are proven at ``p`` (P,): of the best cell that holds it."""
        here = np.flatnonzero(((p >= self.low) & (p <= self.high)).all(axis=1))
        if not len(here):
            return 0.0, 0.0, False
        best = here[np.argmax(self.alpha[here])]
        return float(self.alpha[best]), float(self.least[best]), bool(self.proven[best])


def proof_of(
    cells: BoxCells,
    damping: Damping,
    p: Floats | None,
    *,
    residual: tuple[int, int, int],
    highest: float,
    eps: float,
    rounding: bool,
) -> tuple[Lemma, ...]:
    """The chain behind a bound: at the values ``p`` (P,), or at all of the box where None.

    ``residual`` (Q, q, n) counts terms of K, coordinates of residuals and vectors of the basis; ``highest`` is the
    upper end of the band in rad/s, ``eps`` the relative error of an interpolated geometry. ``rounding``: whether the
    round-off of the terms is known.
    """
    terms, coordinates, vectors = residual
    geometry = (_geometry(eps),) if eps else ()
    return (
        _cells(cells, p),
        _residual(coordinates, vectors, highest),
        *geometry,
        _damping(damping),
        _round_off(terms, rounding),
    )


def _cells(cells: BoxCells, p: Floats | None) -> Lemma:
    count, where = len(cells.low), "cells, which cover the box"
    alpha, least, proven = float(cells.alpha.min()), float(cells.least.min()), int(cells.proven.sum())
    if p is not None:
        alpha, least, counted = cells.at(p)
        count, proven, where = 1, int(counted), "cell, which holds the values"
    hz = float(eigenvalue_in_hz(max(least, 0.0)))
    how = "by counts of negative pivots" if proven == count else f"in {count - proven} by eigenvalues at samples"
    statement = (
        f"on {count} {where}, K_SS(p) >= alpha K_SS(p_a) with alpha {alpha:.3g} at least, and beside the deflated "
        f"motions K >= Lam M with Lam that of {hz:,.6g} Hz at the softest and heaviest values, {how}"
    )
    numbers = {"cells": float(count), "proven": float(proven), "alpha": alpha, "least_hz": hz}
    kind = PROVEN if proven == count else ESTIMATE
    return Lemma(name="cells-of-the-box", statement=statement, numbers=numbers, kind=kind)


def _residual(coordinates: int, vectors: int, highest: float) -> Lemma:
    statement = (
        f"|H - H_r| is at most |r|_2 |r|_F / (b - kappa) for the basis of {vectors} vectors at each value and "
        f"frequency, and unbounded where b <= kappa; residuals have {coordinates} coordinates, and the "
        "norm of the remainder"
    )
    numbers = {"vectors": float(vectors), "coordinates": float(coordinates), "highest_hz": float(in_hz(highest))}
    return Lemma(name="parametric-residual", statement=statement, numbers=numbers)


def _geometry(eps: float) -> Lemma:
    statement = f"the interpolated geometry changes no energy by more than {upwards(eps)} of it"
    return Lemma(name="interpolated-geometry", statement=statement, numbers={"eps": eps})


def _damping(damping: Damping) -> Lemma:
    if damping.is_modal:
        statement = (
            "modal damping acts on the modes of the body, and what that differs from those of the model by is unknown"
        )
        return Lemma(name="damping", statement=statement, numbers={}, kind=ESTIMATE)
    proportional = damping.is_viscous or damping.structural
    statement = "damping is a function of K and M at each value" if proportional else "there is no damping"
    return Lemma(name="damping", statement=statement, numbers={})


def _round_off(terms: int, known: bool) -> Lemma:
    if not known:
        statement = "the round-off of the terms of K and M is not in the file, which an earlier version wrote"
        return Lemma(name="round-off-of-terms", statement=statement, numbers={}, kind=ESTIMATE)
    statement = f"the bound has the round-off of entries, products and projections of all {terms} terms of K, and of M"
    return Lemma(name="round-off-of-terms", statement=statement, numbers={"terms": float(terms)})
