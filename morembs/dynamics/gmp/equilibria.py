"""Static equilibria of a planar component between two turned frames, without axial force.

Its frames ``start`` and ``end`` lie on the chord, at the angles t1 and t2 to it; the end may slide along the chord,
so that its length is the natural one d0(t1, t2). Parameters t = (t1, t2); X(t) are the coordinates in the frame of
the chord (origin at the start). Global modal parameterisation: Bruels, Duysinx, Golinval (2007); Naets, Heirman,
Desmet (2012); the natural chord is ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from morembs.base.errors import InputError, Kind, SolverError
from morembs.base.types import Floats
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.dynamics.nonlinear.member import ends
from morembs.dynamics.nonlinear.statics import Factor, newton


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """One point: coordinates ``X`` (N,), energy ``W`` (J), moments of the frames ``moments`` (2,) N m and
    ``modes`` (N, 2) = dX/dt, the constraint modes (implicit function theorem, no differences)."""

    X: Floats
    W: float
    moments: Floats
    modes: Floats


def first_share(way: Floats) -> float:
    """The part of a way (2,) in rad that the first step takes."""
    return 1.0 / max(1.0, float(np.ceil(np.hypot(*way) / TOL.longest_step)))


class NotFollowedError(InputError):
    """The static equilibria cannot be followed to some end angles, only to those ``reached`` (2,)."""

    kind: Kind = "result"
    keyword: str = "reach"

    def __init__(self, message: str, reached: Floats) -> None:
        super().__init__(message)
        self.reached = reached


class Solver:
    """Equilibria of one component over (t1, t2)."""

    def __init__(self, component: NonlinearComponent) -> None:
        self.component = component
        self.length, _ = ends(component)
        self.first, self.second = component.frames["start"], component.frames["end"]
        self.turns = np.array([self.first[2], self.second[2]])
        held = np.concatenate((self.first, self.second[1:]))
        self.free = np.setdiff1d(np.arange(component.size), held)

    def _solve_near(self, guess: Floats) -> Equilibrium:
        component, free = self.component, self.free
        X, factor = newton(component, guess, free)
        # Newton returns the factors of the last but one point; the modes need those of the last.
        K = component.tangent(X)
        factor = Factor(K[free][:, free])
        if factor.negative:
            raise SolverError(
                f"the equilibrium is not stable ({factor.negative} negative eigenvalue(s) of the tangent stiffness), "
                "a bifurcation was crossed"
            )
        if X[self.second[0]] <= TOL.least_chord * self.length:
            raise SolverError("the ends of the component meet, its chord has no direction")
        modes = np.zeros((component.size, 2))
        modes[self.turns, [0, 1]] = 1
        modes[free] = -factor.solve((K[:, self.turns][free]).toarray())
        force = component.force(X)
        return Equilibrium(X=X, W=component.energy(X), moments=force[self.turns], modes=modes)

    def straight(self) -> Equilibrium:
        """The point t = 0."""
        try:
            return self._solve_near(self.component.reference)
        except SolverError as error:
            raise error.restate(f"the component is in no stable equilibrium without load: {error}") from None

    def toward(self, known: Equilibrium, t: Floats) -> Equilibrium:
        """From a known point to t (2,) by continuation; steps that fail are halved.

        Raises:
            NotFollowedError: the way crosses a bifurcation, or Newton's method fails even in small steps.
        """
        at, now, done = known.X[self.turns], known, 0.0
        step = longest = first_share(t - at)
        while done < 1:
            goal = done + step if done + step < 1 - TOL.negligible_step else 1.0
            change = at + goal * (t - at) - now.X[self.turns]
            guess = now.X + now.modes @ change
            guess[self.turns] = at + goal * (t - at)
            try:
                reached = self._solve_near(guess)
                moved, corrected = (float(np.abs(reached.X - other).max()) for other in (now.X, guess))
                if corrected > TOL.max_correction * max(moved, TOL.least_moved):
                    raise SolverError("Newton's method runs to other equilibria, far from the last one")
                now, done = reached, goal
            except (SolverError, InputError) as error:
                step /= 2
                if step < longest * 0.5**TOL.step_halvings:
                    stuck = now.X[self.turns]
                    raise NotFollowedError(
                        f"the static equilibria cannot be followed to t1 = {t[0]:.4g}, t2 = {t[1]:.4g} rad, only to "
                        f"{stuck[0]:.4g}, {stuck[1]:.4g}: {error}. Take a smaller range, or divide the component "
                        "into more members",
                        stuck,
                    ) from None
        return now


class BeamWork:
    """A planar component at work in the offline stage; ``law`` makes samples of shapes (N,)."""

    def __init__(self, component: NonlinearComponent, law: Callable[[Floats], Any] | None = None) -> None:
        self.component, self.solver, self._law = component, Solver(component), law
        self.turns, self.length = self.solver.turns, self.solver.length

    def straight(self) -> Equilibrium:
        return self.solver.straight()

    def toward(self, X: Floats, modes: Floats, t: Floats) -> Equilibrium:
        return self.solver.toward(Equilibrium(X=X, W=0.0, moments=np.zeros(2), modes=modes), t)

    def sample(self, equilibrium: Equilibrium) -> Any:
        return None if self._law is None else self._law(equilibrium.X)

    def energy(self, x: Floats) -> float:
        return self.component.energy(x)

    def tangent(self, X: Floats) -> Any:
        return self.component.tangent(X)

    def spread(self) -> Floats:
        up = np.zeros(self.component.size)
        up[self.component.translations[:, 1]] = 1.0
        force = np.asarray(self.component.M @ up)
        return force / float(up @ force)
