"""Static equilibrium of a system: where forces, gravity and joints balance, and whether it stays there.

g(x, 0) + B' multipliers = 0 and Phi(x) = 0, by Newton's method in the coordinates of the components. Joint equations
and coordinates have units that differ by many powers of ten, so the linear systems are equilibrated first; motions
without stiffness stay where they are unless a load acts along them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.arguments import checked
from morembs.errors import InputError, SolverError
from morembs.multibody.bodies import FloatingBody
from morembs.multibody.forces import Load, PointLoad
from morembs.multibody.linearise import Linearised, linearised
from morembs.multibody.reactions import saddle
from morembs.multibody.result import Result, Segment
from morembs.multibody.result import sensitivities as of_segment
from morembs.multibody.sensitivity import at_rest
from morembs.multibody.steady_spin import SteadySpin
from morembs.multibody.system import Assembly, State, System
from morembs.multibody.tangents import pulls, stiffness_and_damping
from morembs.multibody.variation import StateSlopes, Variation, variations
from morembs.summary import summarised

Floats = NDArray[np.float64]
# Singular values of the equilibrated matrix below this part of the largest are motions without stiffness, and joint
# equations that depend on each other.
CUT = 1e-11
ITERATIONS = 60
# Largest turn (rad) and displacement (part of the size of the system) in one iteration.
TURN, MOVE = 0.5, 0.5
# Stiffness that stands for none where coordinates are equilibrated: part of the largest (rad/s)2, and of that of a
# pendulum as long as the system under its own acceleration.
SOFT, PENDULUM = 1e-9, 1e-3
# Joint equations (m or rad, per size of the system) that are closed, and their round-off, per distance to the origin.
CLOSED, ROUND_OFF = 1e-10, 1e-14
# Motion of an iteration, per size of the system, that is none.
STILL = 1e-13


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """A system at rest: ``state``, and ``linear``, its small motion about it.

    ``result`` has the places, reactions and loads of a run of one instant: ``equilibrium.result.reaction(joint)[0]``.
    ``slopes`` are its derivatives by the parameters of ``variations``, which ``result.sensitivity`` tells.
    ``stable`` is False where a disturbance grows; ``mobilities`` counts the motions that no stiffness resists.
    """

    state: State
    linear: Linearised
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
        """Whether no small disturbance grows."""
        return self.linear.growth <= 0

    @property
    def mobilities(self) -> int:
        """Motions that the joints allow and no stiffness resists."""
        return int((self.linear.squares == 0).sum())

    def _facts(self) -> dict[str, object]:
        hz = [f for f in self.linear.frequencies_hz if f > 0]
        return {
            "stable": "yes" if self.stable else f"no, a disturbance grows by {self.linear.growth:.4g} /s",
            "lowest frequencies in Hz": ", ".join(f"{f:.4g}" for f in hz[:5]), "mobilities": self.mobilities,
            "iterations": self.iterations,
        }  # fmt: skip


@checked
def equilibrium(
    system: System, *, guess: Equilibrium | State | None = None, tolerance: float = 1e-9, load_steps: int = 1,
    time: float = 0.0, spin: SteadySpin | None = None, sensitivities: Sequence[str] | bool = False,
) -> Equilibrium:  # fmt: skip
    """The static equilibrium nearest to the start of the bodies, or to ``guess``; with ``spin`` that of a system which
    turns steadily as a whole, with its small motion as seen by an observer who turns with it.

    Args:
        guess: where to begin; the start of the components unless given.
        tolerance: of the forces that are left, relative to those that balance, in the norm of the mass matrix.
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

    >>> from morembs.multibody import RevoluteJoint, RigidBody, System, equilibrium, ground
    >>> system = System(gravity=(0, 0, -9.81))
    >>> rod = system.add(RigidBody(2.0, (0.1, 0.1, 0.01), position=(0, 0, -0.5), markers={"end": (0, 0, 0.5)}))
    >>> joint = system.add(RevoluteJoint(ground.marker_at(), rod.marker("end"), axis=(0, 1, 0)))
    >>> still = equilibrium(system)
    >>> still.stable, float(still.result.reaction(joint)[0, 2].round(6))
    (True, 19.62)
    """
    if not (0 < tolerance < 1e-2 and isinstance(load_steps, int) and load_steps >= 1 and math.isfinite(time)):
        raise InputError(
            f"tolerance = {tolerance:g}, load_steps = {load_steps} and time = {time:g} were given; expected a "
            "tolerance between 0 and 0.01, an integer of at least one, and a time in s"
        )
    if spin is not None and sensitivities:
        raise InputError("sensitivities were given beside a spin; they are those of systems at rest, leave one out")
    assembly = Assembly(system)
    begin = guess.state if isinstance(guess, Equilibrium) else guess
    if begin is None:
        x, _ = assembly.start()
        assembly.check_positions(time, x)
    else:
        # Prescribed motions may have gone on since; the search closes the joints.
        x, _ = assembly.fitting(begin)
    if spin is not None:
        spin.check(assembly, time, x)
    multipliers, iterations = None, 0
    for number in range(1, load_steps):
        part = Assembly(_scaled(system, number / load_steps))
        x, multipliers, count = _Search(part, time, tolerance, spin).run(x, multipliers)
        iterations += count
    search = _Search(assembly, time, tolerance, spin)
    x, multipliers, count = search.run(x, multipliers)
    iterations += count
    _warn_of_dependent_joints(assembly, time, x)
    v = rate = np.zeros(assembly.size)
    if spin is not None:
        v, rate = spin.motion(assembly, x, v)
    state = State(assembly=assembly, time=time, x=x, v=v, acceleration=rate, multipliers=multipliers)
    of = variations(assembly, sensitivities) if sensitivities else []
    slopes = at_rest(of, state, search.answer(state)) if of else None
    return Equilibrium(
        state=state, linear=linearised(state, spin), iterations=iterations, variations=of, slopes=slopes
    )


def _scaled(system: System, part: float) -> System:
    """The system with ``part`` of its gravity and of its point loads."""
    scaled = System(gravity=part * system.gravity)
    scaled.components, scaled.joints = system.components, system.joints
    scaled.forces = [_part_of(force, part) if isinstance(force, PointLoad) else force for force in system.forces]
    return scaled


def _part_of(load: PointLoad, part: float) -> PointLoad:
    def scaled(value: Load) -> Load:
        return (lambda t: part * np.asarray(value(t))) if callable(value) else part * np.asarray(value, dtype=float)

    return replace(load, force=scaled(load.force), moment=scaled(load.moment))


class _Search:
    """Newton's method for an assembly under its whole loads."""

    def __init__(self, assembly: Assembly, time: float, tolerance: float, spin: SteadySpin | None) -> None:
        self.assembly, self.time, self.tolerance, self.spin = assembly, time, tolerance, spin
        self.still = np.zeros(assembly.size)

    def run(self, x: Floats, multipliers: Floats | None) -> tuple[Floats, Floats, int]:
        """Configuration, multipliers and iterations.

        Raises:
            InputError: a load along a motion that nothing resists.
            SolverError: no convergence.
        """
        a = self.assembly
        self._measure(x)
        for iteration in range(ITERATIONS):
            M, g, Phi, B = (self.spin.equations if self.spin else Assembly.equations)(a, self.time, x, self.still)
            scale = 1 / np.sqrt(np.diag(M))
            if multipliers is None:
                # Reactions of the guess: the tangent needs their geometric stiffness, or it leads to other equilibria.
                multipliers = _least_squares(scale[:, None] * B.T, -scale * g)
            residual = g + multipliers @ B
            forces = self._magnitude(x, scale) + float(np.linalg.norm(scale * (multipliers @ B)))
            left = float(np.linalg.norm(scale * residual))
            closed = float(np.abs(Phi).max(initial=0.0)) <= CLOSED * self.size + ROUND_OFF * self.reach
            if self.spin is None:
                K, _ = stiffness_and_damping(a, self.time, x, self.still, self.still, multipliers)
            else:
                K, _ = self.spin.tangents(a, self.time, x, multipliers)
            change, free = self._newton(K, M, B, residual, Phi)
            moved = math.sqrt(max(float(change[: a.size] @ M @ change[: a.size]), 0.0) / float(np.diag(M).max()))
            # Where all forces vanish, as in a spring at rest, what Newton's method still moves tells.
            if closed and (left <= self.tolerance * forces or (moved <= STILL * self.size and not free.any())):
                return x, multipliers, iteration
            if closed and np.linalg.norm(free) > (1 - 1e-6) * left and left > self.tolerance * forces:
                raise InputError(self._unbalanced(free * scale))
            step, more = change[: a.size], change[a.size :]
            short = min(1.0, *self._limits(step))
            x, multipliers = a.moved(x, short * step), multipliers + short * more
        raise SolverError(
            f"no equilibrium was found in {ITERATIONS} iterations (forces off by {left / forces:.1e}, joints open by "
            f"{np.abs(Phi).max(initial=0.0):.1e}); start nearer to it (guess, or places of the bodies), or let the "
            "loads grow with load_steps = 10"
        )

    def _measure(self, x: Floats) -> None:
        """Size of the system, by its markers and bodies, and how far from the origin it is, m."""
        a = self.assembly
        at = np.array([place.position for place in a.places(x).values()]).reshape(-1, 3)
        lengths = [c.length for c in a.components if isinstance(c, FloatingBody)]
        self.size = max([1e-3, *lengths, *(np.ptp(at, axis=0).tolist() if len(at) else [])])
        self.reach = max(self.size, float(np.abs(at).max(initial=0.0)))

    def _magnitude(self, x: Floats, scale: Floats) -> float:
        """Size of all forces but those of joints, however much they cancel."""
        a, parts = self.assembly, []
        for component, i, j in zip(a.components, a.in_x, a.in_v, strict=True):
            inner, whole = (component.dynamics(self.time, x[i], self.still[j], k * a.gravity)[1] for k in (0, 1))
            parts += [scale[j] * inner, scale[j] * (whole - inner)]
        for force in a.forces:
            g = np.zeros(a.size)
            a.load(force, self.time, self.still, [a.place(m, x) for m in force.markers], g)
            parts.append(scale * g)
        if self.spin is not None:
            v, rate = self.spin.motion(a, x, self.still)
            parts.append(scale * (a.equations(self.time, x, v)[0] @ rate))
        return float(sum(np.linalg.norm(part) for part in parts))

    def _newton(self, K: Floats, M: Floats, B: Floats, residual: Floats, Phi: Floats) -> tuple[Floats, Floats]:
        """Change of configuration and multipliers (k + m,), and the part (k,) of the residual, by mass, that stays."""
        k = self.assembly.size
        mass = np.diag(M)
        acceleration = float(np.linalg.norm(residual / np.sqrt(mass)) / math.sqrt(float(mass.max())))
        soft = max(SOFT * float((np.abs(np.diag(K)) / mass).max()), PENDULUM * acceleration / self.size, 1e-12)
        w = 1 / np.sqrt(np.abs(np.diag(K)) + soft * mass)
        rows = np.linalg.norm(B * w, axis=1)
        r = 1 / np.where(rows > 0, rows, 1.0)
        scales = np.concatenate((w, r))
        S = scales[:, None] * saddle(K, B) * scales
        U, s, Vt = np.linalg.svd(S)
        kept = s > CUT * s[0]
        right = -scales * np.concatenate((residual, Phi))
        change = scales * (Vt[kept].T @ ((U[:, kept].T @ right) / s[kept]))
        lost = U[:, ~kept] @ (U[:, ~kept].T @ right)
        return change, (lost[:k] / w) / np.sqrt(mass)

    def answer(self, state: State) -> Callable[[Floats, Floats], Floats]:
        """How an equilibrium changes (k + m,) with forces (k,) that are left and joints (m,) that are open."""
        M, _, _, B = self.assembly.equations(self.time, state.x, self.still)
        K, _ = stiffness_and_damping(
            self.assembly, self.time, state.x, self.still, self.still, state.multipliers,
            known=pulls(self.assembly, state),
        )  # fmt: skip
        return lambda forces, Phi: self._newton(K, M, B, forces, Phi)[0]

    def _limits(self, step: Floats) -> Sequence[float]:
        """The parts of a step that turn and move the floating bodies as far as is allowed at once."""
        limits = [1.0]
        for component, j in zip(self.assembly.components, self.assembly.in_v, strict=True):
            if isinstance(component, FloatingBody):
                turn, move = (float(np.linalg.norm(part)) for part in (step[j][3:6], step[j][:3]))
                limits += [TURN / turn if turn > TURN else 1.0]
                limits += [MOVE * self.size / move if move > MOVE * self.size else 1.0]
        return limits

    def _unbalanced(self, force: Floats) -> str:
        bodies = [
            c.name for c, j in zip(self.assembly.components, self.assembly.in_v, strict=True)
            if np.abs(force[j]).max(initial=0.0) > 1e-3 * np.abs(force).max()
        ]  # fmt: skip
        return (
            f"nothing balances the load along a motion of {', '.join(map(repr, bodies))} that the joints allow and no "
            "stiffness resists; add a spring or a joint that holds it, or take the load away"
        )


def _least_squares(A: Floats, b: Floats) -> Floats:
    return np.asarray(sl.lstsq(A, b, cond=CUT)[0]) if A.shape[1] else np.zeros(0)


def _warn_of_dependent_joints(assembly: Assembly, time: float, x: Floats) -> None:
    """Warn of joint equations that depend on each other at the equilibrium: their reactions share by least norm."""
    try:
        assembly.check_positions(time, x)
    except InputError as error:
        warnings.warn(f"at the equilibrium {error}; their reactions are those of least norm", stacklevel=3)

