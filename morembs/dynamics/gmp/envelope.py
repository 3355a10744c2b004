"""The end angles that moments on a member cause, by continuation in the moments."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, Protocol

import numpy as np

from morembs.base.errors import BudgetError, InputError, SolverError
from morembs.base.types import Floats
from morembs.dynamics.gmp.equilibria import Equilibrium
from morembs.dynamics.gmp.plan import AngleRange
from morembs.dynamics.gmp.symmetry import Symmetry
from morembs.dynamics.gmp.tolerances import TOL
from morembs.linalg.dense import symmetric


class Loaded(Protocol):
    """What is needed of a component at work."""

    def toward(self, X: Floats, modes: Floats, t: Floats) -> Equilibrium: ...

    def tangent(self, X: Floats) -> Any:
        """Sparse stiffness (N, N)."""

    def spread(self) -> Floats:
        """Forces (N,) of a unit load along y that is spread as the mass is."""


def target(
    work: Loaded, start: Equilibrium, turns: Any, envelope: AngleRange, group: tuple[Symmetry, ...]
) -> tuple[float, tuple[str, ...]]:
    """The range in rad for an envelope, and notes of what is not reached.

    Raises:
        InputError: not even a small part of the moments can be borne.
    """
    if envelope.angle is not None:
        return envelope.angle, ()
    if envelope.moment is not None:
        wanted = [envelope.moment * np.array(signs) for signs in product((1.0, -1.0), repeat=2)]
    else:
        wanted = [sign * (envelope.load or 0.0) * (start.modes.T @ work.spread()) for sign in (1.0, -1.0)]
    angle_range, visited = 0.0, set[tuple[float, ...]]()
    notes: tuple[str, ...] = ()
    for moments in wanted:
        # Moments become those of the image as angles do: the matrices are orthogonal.
        images = {tuple(np.round(g.turn @ moments, 12)) for g in group}
        if images & visited:
            continue
        visited.add(tuple(np.round(moments, 12)))
        t, done, why = _follow_moments(lambda now, aim: _balance(work, turns, now, aim), start, turns, moments)
        if done < 1:
            notes = (
                f"end moments of {moments[0]:.4g} and {moments[1]:.4g} N m are not borne, only {done:.3g} of them "
                f"({why}); the range ends there",
            )
        angle_range = max(angle_range, float(np.abs(t).max()))
    if angle_range < TOL.least_range and notes:
        raise InputError(
            f"{notes[0].removesuffix('; the range ends there')}; expected smaller loads, or an angle", keyword="reach"
        )
    if angle_range < TOL.least_range:
        raise InputError(
            f"the envelope turns the ends by no more than {angle_range:.2g} rad; expected larger loads, or an angle"
        )
    return min(TOL.range_margin * angle_range, TOL.max_range), notes


def _follow_moments(
    balanced: Callable[[Equilibrium, Floats], Equilibrium], start: Equilibrium, turns: Any, moments: Floats
) -> tuple[Floats, float, str]:
    """Angles under the moments, or under the part of them that is borne."""
    now, done, share, why = start, 0.0, TOL.first_moment_part, ""
    while done < 1:
        aim = min(1.0, done + share)
        try:
            now, done = balanced(now, aim * moments), aim
        except BudgetError:
            raise
        except (SolverError, InputError) as error:
            share, why = share / 2, str(error)
            if share < TOL.least_moment_part:
                break
    return now.X[turns], done, why


def _balance(work: Loaded, turns: Any, now: Equilibrium, moments: Floats) -> Equilibrium:
    """The equilibrium near ``now`` under end moments (2,).

    Raises:
        SolverError: none, or one that would not last under these moments.
    """
    for _ in range(TOL.moment_iterations):
        S = now.modes.T @ (work.tangent(now.X) @ now.modes)
        if np.linalg.eigvalsh(symmetric(S))[0] <= 0:
            raise SolverError("the member gives way under these moments")
        step = np.linalg.solve(S, moments - now.moments)
        if not np.abs(step).max() < TOL.max_moment_step:
            raise SolverError("the angles grow too fast")
        if np.abs(step).max() < TOL.moment_angle_change:
            return now
        now = work.toward(now.X, now.modes, now.X[turns] + step)
    raise SolverError("no equilibrium was found")
