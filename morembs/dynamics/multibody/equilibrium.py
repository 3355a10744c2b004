"""Static equilibrium of a system: where forces, gravity and joints balance, and whether it stays there.

g(x, 0) + B' multipliers = 0 and Phi(x) = 0, by Newton's method in the coordinates of the components.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Finite, PositiveCount
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.dynamics.multibody.equilibrium_search import EquilibriumSearch
from morembs.dynamics.multibody.forces import Load, PointLoad
from morembs.dynamics.multibody.linearise import Linearization, linearize
from morembs.dynamics.multibody.result import Result
from morembs.dynamics.multibody.result import sensitivities as of_segment
from morembs.dynamics.multibody.segment import Segment
from morembs.dynamics.multibody.sensitivity import at_rest
from morembs.dynamics.multibody.steady_spin import SteadySpin
from morembs.dynamics.multibody.system import Assembly, State, System
from morembs.dynamics.multibody.tolerances import TOL, NewtonTolerance
from morembs.dynamics.multibody.variation import StateSlopes, Variation, variations


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """A system at rest: ``state``, and ``linear``, its small motion about it.

    ``result`` has the places, reactions and loads of a run of one instant: ``equilibrium.result.reaction(joint)[0]``.
    ``slopes`` are its derivatives by the parameters of ``variations``, which ``result.sensitivity`` tells.
    ``stable`` is False where a disturbance grows; ``mobilities`` counts the motions that no stiffness resists.
    """

    state: State
    linear: Linearization
    iterations: int
    variations: Sequence[Variation] = ()
    slopes: StateSlopes | None = None

    @cached_property
    def result(self) -> Result:
        """Places, elastic coordinates and forces, as of a run (1, ...)."""
        segment, slopes = Segment.of([self.state]), self.slopes
        known = {} if slopes is None else of_segment(segment, self.variations, [slopes])
        return Result(segments=(segment,), sensitivities=known)

    def slopes_of(self, names: Sequence[str]) -> Floats:
        """(k, P): derivatives of the configuration by parameters, as steps from it.

        Raises:
            InputError: one that was not asked for.
        """
        return np.stack([self.result.sensitivity(name).configuration_step[0] for name in names], axis=1)

    @property
    def stable(self) -> bool:
        """True if no small disturbance grows."""
        return self.linear.growth <= 0

    @property
    def mobilities(self) -> int:
        """Motions that the joints allow and no stiffness resists."""
        return int((self.linear.squares == 0).sum())

    def _facts(self) -> dict[str, object]:
        hz = [f for f in self.linear.frequencies_hz if f > 0]
        return {
            "stable": "yes" if self.stable else f"no, a disturbance grows by {self.linear.growth:.4g} /s",
            "lowest frequencies in Hz": ", ".join(f"{f:.4g}" for f in hz[:5]),
            "mobilities": self.mobilities,
            "iterations": self.iterations,
        }


@checked
def equilibrium(
    system: System,
    *,
    guess: Equilibrium | State | None = None,
    tolerance: NewtonTolerance = TOL.left_force,
    load_steps: PositiveCount = 1,
    time: Finite = 0.0,
    spin: SteadySpin | None = None,
    sensitivities: Sequence[str] | bool = False,
) -> Equilibrium:
    """The static equilibrium nearest to the start of the bodies, or to ``guess``; with ``spin`` that of a system which
    turns steadily as a whole, with its small motion as seen by an observer who turns with it.

    Args:
        guess: where to begin; the start of the components unless given.
        tolerance: of the residual forces, relative to the balancing ones, in the norm of the mass matrix.
        load_steps: gravity and point loads grow in so many steps, where Newton's method does not converge at once.
        time: of prescribed motions and loads that are functions of time, s.
        spin: steady rotation of the whole system, floating bodies only.
        sensitivities: to these parameters of elastic bodies, as "body.parameter", or to all (True):
            ``equilibrium(...).result.sensitivity("rod.E")``. What nothing resists stays where it is.

    An equilibrium that is not stable is a result too: ``stable`` says so. Forces of elastic bodies under redundant
    joints are determined by their elasticity; redundant joints between rigid bodies are refused.

    Raises:
        InputError: joints that are open or redundant, a load along a motion that nothing resists, wrong options.
        SolverError: no convergence.

    >>> from morembs.dynamics.multibody import RevoluteJoint, RigidBody, System, equilibrium, ground
    >>> system = System(gravity=(0, 0, -9.81))
    >>> rod = system.add(RigidBody(2.0, (0.1, 0.1, 0.01), position=(0, 0, -0.5), markers={"end": (0, 0, 0.5)}))
    >>> joint = system.add(RevoluteJoint(ground.marker_at(), rod.marker("end"), axis=(0, 1, 0)))
    >>> still = equilibrium(system)
    >>> still.stable, float(still.result.reaction(joint)[0, 2].round(6))
    (True, 19.62)
    """
    if spin is not None and sensitivities:
        raise InputError(
            "sensitivities were given with a spin; they are known for systems at rest: leave one out", kind="conflict"
        )
    assembly = Assembly(system)
    x = _begin(assembly, guess, time)
    if spin is not None:
        spin.check(assembly, time, x)
    multipliers, iterations = None, 0
    for number in range(1, load_steps):
        part = Assembly(_scale_loads(system, number / load_steps))
        x, multipliers, count = EquilibriumSearch(part, time, tolerance, spin).run(x, multipliers)
        iterations += count
    search = EquilibriumSearch(assembly, time, tolerance, spin)
    x, multipliers, count = search.run(x, multipliers)
    _warn_of_dependent_joints(assembly, time, x)
    v = rate = np.zeros(assembly.size)
    if spin is not None:
        v, rate = spin.motion(assembly, x, v)
    state = State(assembly=assembly, time=time, x=x, v=v, acceleration=rate, multipliers=multipliers)
    of = variations(assembly, sensitivities) if sensitivities else []
    slopes = at_rest(of, state, search.answer(state)) if of else None
    return Equilibrium(
        state=state, linear=linearize(state, spin), iterations=iterations + count, variations=of, slopes=slopes
    )


def _begin(assembly: Assembly, guess: Equilibrium | State | None, time: float) -> Floats:
    """Configuration to begin with.

    Raises:
        InputError: joints that are open at the start of the components, a guess of another system.
    """
    if guess is None:
        x, _ = assembly.start()
        assembly.check_positions(time, x)
        return x
    # Prescribed motions may have gone on since; the search closes the joints.
    return assembly.unpack_state(guess.state if isinstance(guess, Equilibrium) else guess)[0]


def _scale_loads(system: System, part: float) -> System:
    """The system with ``part`` of its gravity and of its point loads."""
    scaled = System(gravity=part * system.gravity)
    scaled.components, scaled.joints = system.components, system.joints
    scaled.forces = [_part_of(force, part) if isinstance(force, PointLoad) else force for force in system.forces]
    return scaled


def _part_of(load: PointLoad, part: float) -> PointLoad:
    def scale(value: Load) -> Load:
        return (lambda t: part * np.asarray(value(t))) if callable(value) else part * np.asarray(value, dtype=float)

    return replace(load, force=scale(load.force), moment=scale(load.moment))


def _warn_of_dependent_joints(assembly: Assembly, time: float, x: Floats) -> None:
    """Warn of joint equations that depend on each other at the equilibrium: their reactions share by least norm."""
    try:
        assembly.check_positions(time, x)
    except InputError as error:
        warnings.warn(f"at the equilibrium {error}; their reactions are those of least norm", stacklevel=3)
