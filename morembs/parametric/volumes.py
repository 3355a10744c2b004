"""How far a morph changes volumes: limits of the ratios of mass to that of nominal values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.fem import ElementBlock
from morembs.fem.assembly import chunks
from morembs.fem.elements import Rule
from morembs.parametric.law import lagrange
from morembs.parametric.morph import Morph, on_grid
from morembs.parametric.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeRatios:
    """Limits of det J(p) / det J(nominal) over the points of quadrature of the mass, per density term.

    At samples of the morphs ``points`` (each (s,)) the extremes ``low`` and ``high`` (groups, s, ...) lie, and between
    them no ratio leaves the straight lines through these by more than ``margin`` (groups,), half of the largest second
    derivative times a quarter of the squared step: the limits are proven.
    """

    which: tuple[int, ...]
    points: tuple[Floats, ...]
    low: Floats
    high: Floats
    margin: Floats

    def at(self, p: Floats) -> tuple[Floats, Floats]:
        """Least and largest ratio (groups,) at ``p`` (P,)."""
        low, high = self.low, self.high
        for number, points in zip(self.which, self.points, strict=True):
            k = int(np.clip(np.searchsorted(points, p[number], side="right") - 1, 0, len(points) - 2))
            share = (p[number] - points[k]) / (points[k + 1] - points[k])
            low, high = ((1 - share) * each[:, k] + share * each[:, k + 1] for each in (low, high))
        return low - self.margin, high + self.margin


def volume_ratios(
    morph: Morph, chosen: Sequence[dict[int, NDArray[np.bool_]]], rules: Callable[[ElementBlock], Sequence[Rule]]
) -> VolumeRatios:
    """Extremes of det J(p) / det J(nominal) at the points of the ``rules`` of a block, for each group of elements."""
    both = (1 << len(morph.which)) - 1
    cubic = morph.points(both, TOL.det_coefficients)
    count = TOL.volume_samples if len(morph.which) < 2 else round(TOL.volume_samples**0.5)
    fine = tuple(np.linspace(*morph.range(number), count) for number in morph.which)
    tables = [lagrange(at, z)[0] for at, z in zip(cubic.values(), fine, strict=True)]
    # The second derivative of a cubic is largest at an end.
    bends = [np.einsum("zk,kl->zl", lagrange(at, at[[0, -1]])[1], lagrange(at, at)[1]) for at in cubic.values()]
    nominal = np.array([parameter.nominal for parameter in morph.parameters])
    shape, axes = tuple(len(z) for z in fine), tuple(range(len(fine)))
    low, high, margin = (
        np.ones((len(chosen), *shape)),
        np.ones((len(chosen), *shape)),
        np.full(len(chosen), TOL.ratio_error),
    )
    for group, rows_of in enumerate(chosen):
        lows, highs = [], []
        for block, rows in chunks(morph.mesh, rows_of):
            for rule in rules(block):
                values = morph.sample_determinants(block, rows, rule, cubic) / morph.determinants(
                    block, rows, rule, nominal
                )
                values = values.reshape(*values.shape[: len(axes)], -1)
                for piece in np.array_split(values, max(1, values.shape[-1] // TOL.volumes_at_once), axis=-1):
                    sampled = on_grid(tables, piece)
                    lows.append(sampled.min(axis=-1))
                    highs.append(sampled.max(axis=-1))
                    for axis, (bend, z) in enumerate(zip(bends, fine, strict=True)):
                        curved = list(tables)
                        curved[axis] = bend
                        largest = float(np.abs(on_grid(curved, piece)).max(initial=0.0))
                        margin[group] = max(
                            margin[group], TOL.ratio_error + len(axes) * largest * (z[1] - z[0]) ** 2 / 8
                        )
        if lows:
            low[group], high[group] = np.min(lows, axis=0), np.max(highs, axis=0)
    return VolumeRatios(which=morph.which, points=fine, low=low, high=high, margin=margin)
