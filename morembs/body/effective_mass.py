"""Modes of a body with interfaces held, and the mass that each of them moves as the support does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.body.body import Body
from morembs.body.delivered import collect_delivered
from morembs.body.rigid_check import eigh, rigid_coordinates
from morembs.body.tolerances import TOL
from morembs.fem import skew
from morembs.linalg.dense import symmetric
from morembs.linalg.massless import split_massless


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectiveMasses:
    """Modes phi of unit modal mass that leave held coordinates at rest, ascending.

    ``participation`` (k, 6) are the factors phi' M R for unit motions R of the support along x, y, z and about them, in
    sqrt(kg) and sqrt(kg) m; their squares are the effective ``masses`` (k, 6) in kg and kg m2. ``total`` (6,) are mass
    and inertia of the whole body: the sum of the masses of all modes and of the mass that moves with held coordinates.

    Source: Clough and Penzien (1975); Girard and Roy (2008).
    """

    frequencies_hz: Floats
    participation: Floats
    total: Floats

    @property
    def masses(self) -> Floats:
        """(k, 6) in kg and kg m2."""
        return self.participation**2

    @property
    def share(self) -> Floats:
        """(6,) what all modes together have of the whole."""
        share: Floats = self.masses.sum(axis=0) / self.total
        return share


def effective_masses(M: Floats, K: Floats, C: Floats, rigid: Floats) -> EffectiveMasses:
    """Modes of M and K (n, n) with C q (m, n) at rest, and their masses for the ``rigid`` motions (n, 6).

    Rows of C may depend on each other, as those of a rigid interface and of its nodes do.
    """
    s = np.maximum(np.abs(C).max(axis=1, keepdims=True), np.finfo(float).tiny)
    _, sizes, rows = np.linalg.svd(C / s)
    N = rows[np.count_nonzero(sizes > TOL.dependent_motion * sizes.max(initial=0.0)) :].T
    total = np.diag(rigid.T @ M @ rigid)
    split = split_massless(symmetric(N.T @ K @ N), symmetric(N.T @ M @ N))
    # Motions without mass have no effective mass.
    N = N if split is None else N @ split.P
    if not N.shape[1]:
        return EffectiveMasses(frequencies_hz=np.zeros(0), participation=np.zeros((0, 6)), total=total)
    values, phi = eigh(N.T @ K @ N, N.T @ M @ N)
    return EffectiveMasses(frequencies_hz=eigenvalue_in_hz(values), participation=(N @ phi).T @ M @ rigid, total=total)


def held_modes(body: Body, held: Sequence[str], point: Sequence[float]) -> EffectiveMasses:
    """Modes of a free ``body`` with the interfaces ``held`` at rest; rotations of the support are about ``point`` (3,).

    Raises:
        InputError: a body without six rigid motions, that is not symmetric, or whose motions are not known.
    """
    given = collect_delivered(body, None)
    if given.rigid_count < 6 or not given.symmetric:
        raise InputError(
            f"body {body.name!r} is held or not symmetric; effective masses need a free one-sided body",
            kind="unsupported",
        )
    split = split_massless(given.K, given.M)
    if split is not None:
        given = replace(given, M=split.with_mass(given.K, given.M))
    ways = rigid_coordinates(given, eigh(given.K, given.M)[1])
    if not ways:
        raise InputError(f"body {body.name!r} has no motions that are known to be rigid; give it a rigid interface")
    about = np.eye(6)
    about[:3, 3:] = skew(np.asarray(point, dtype=float))
    rows = np.concatenate([np.arange(len(given.C))[body.part.columns[name]] for name in held])
    return effective_masses(given.M, given.K, given.C[rows], next(iter(ways.values())) @ about)
