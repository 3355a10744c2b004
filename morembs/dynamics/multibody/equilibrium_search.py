"""Newton's method for the static equilibrium of a system.

Joint equations and coordinates have units that differ by many powers of ten, so the linear systems are equilibrated
first; motions without stiffness stay where they are unless a load acts along them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.dynamics.multibody.floating_body import FloatingBody
from morembs.dynamics.multibody.reactions import saddle
from morembs.dynamics.multibody.steady_spin import SteadySpin
from morembs.dynamics.multibody.system import Assembly, State
from morembs.dynamics.multibody.tangents import pulls, stiffness_and_damping
from morembs.dynamics.multibody.tolerances import TOL


class EquilibriumSearch:
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
        for iteration in range(TOL.equilibrium_iterations):
            M, g, Phi, B = (self.spin.equations if self.spin else Assembly.equations)(a, self.time, x, self.still)
            scale = 1 / np.sqrt(np.diag(M))
            if multipliers is None:
                # Reactions of the guess: the tangent needs their geometric stiffness, or it leads to other equilibria.
                multipliers = _least_squares(scale[:, None] * B.T, -scale * g)
            residual = g + multipliers @ B
            forces = self._magnitude(x, scale) + float(np.linalg.norm(scale * (multipliers @ B)))
            left = float(np.linalg.norm(scale * residual))
            may_open = TOL.closed_joint * self.size + TOL.closed_joint_roundoff * self.reach
            closed = float(np.abs(Phi).max(initial=0.0)) <= may_open
            if self.spin is None:
                K, _ = stiffness_and_damping(a, self.time, x, self.still, self.still, multipliers)
            else:
                K, _ = self.spin.tangents(a, self.time, x, multipliers)
            change, free = self._newton(K, M, B, residual, Phi)
            moved = math.sqrt(max(float(change[: a.size] @ M @ change[: a.size]), 0.0) / float(np.diag(M).max()))
            # Where all forces vanish, as in a spring at rest, what Newton's method still moves tells.
            still = moved <= TOL.still_motion * self.size and not free.any()
            if closed and (left <= self.tolerance * forces or still):
                return x, multipliers, iteration
            if closed and np.linalg.norm(free) > (1 - TOL.balanced_part) * left and left > self.tolerance * forces:
                raise InputError(self._explain_unbalanced(free * scale), kind="model", keyword="load")
            step, more = change[: a.size], change[a.size :]
            short = min(1.0, *self._limits(step))
            x, multipliers = a.move(x, short * step), multipliers + short * more
        raise SolverError(
            f"no equilibrium was found in {TOL.equilibrium_iterations} iterations (forces off by "
            f"{left / forces:.1e}, joints open by {np.abs(Phi).max(initial=0.0):.1e}); start nearer to it (guess, "
            "or places of the bodies), or let the loads grow with load_steps = 10"
        )

    def _measure(self, x: Floats) -> None:
        """Size of the system, by its markers and bodies, and how far from the origin it is, m."""
        a = self.assembly
        at = np.array([place.position for place in a.places(x).values()]).reshape(-1, 3)
        lengths = [c.length for c in a.components if isinstance(c, FloatingBody)]
        self.size = max([TOL.least_size, *lengths, *(np.ptp(at, axis=0).tolist() if len(at) else [])])
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
        soft = max(
            TOL.soft_part * float((np.abs(np.diag(K)) / mass).max()),
            TOL.soft_pendulum * acceleration / self.size,
            TOL.soft_square,
        )
        w = 1 / np.sqrt(np.abs(np.diag(K)) + soft * mass)
        rows = np.linalg.norm(B * w, axis=1)
        r = 1 / np.where(rows > 0, rows, 1.0)
        scales = np.concatenate((w, r))
        S = scales[:, None] * saddle(K, B) * scales
        U, s, Vt = np.linalg.svd(S)
        kept = s > TOL.no_stiffness * s[0]
        right = -scales * np.concatenate((residual, Phi))
        change = scales * (Vt[kept].T @ ((U[:, kept].T @ right) / s[kept]))
        lost = U[:, ~kept] @ (U[:, ~kept].T @ right)
        return change, (lost[:k] / w) / np.sqrt(mass)

    def answer(self, state: State) -> Callable[[Floats, Floats], Floats]:
        """How an equilibrium changes (k + m,) with forces (k,) that are left and joints (m,) that are open."""
        M, _, _, B = self.assembly.equations(self.time, state.x, self.still)
        K, _ = stiffness_and_damping(
            self.assembly,
            self.time,
            state.x,
            self.still,
            self.still,
            state.multipliers,
            known=pulls(self.assembly, state),
        )
        return lambda forces, Phi: self._newton(K, M, B, forces, Phi)[0]

    def _limits(self, step: Floats) -> Sequence[float]:
        """The parts of a step that turn and move the floating bodies as far as is allowed at once."""
        limits = [1.0]
        for component, j in zip(self.assembly.components, self.assembly.in_v, strict=True):
            if isinstance(component, FloatingBody):
                turn, move = (float(np.linalg.norm(part)) for part in (step[j][3:6], step[j][:3]))
                limits += [TOL.max_turn / turn if turn > TOL.max_turn else 1.0]
                limits += [TOL.max_move * self.size / move if move > TOL.max_move * self.size else 1.0]
        return limits

    def _explain_unbalanced(self, force: Floats) -> str:
        bodies = [
            c.name
            for c, j in zip(self.assembly.components, self.assembly.in_v, strict=True)
            if np.abs(force[j]).max(initial=0.0) > TOL.named_force * np.abs(force).max()
        ]
        return (
            f"nothing balances the load along a motion of {', '.join(map(repr, bodies))} that the joints allow and no "
            "stiffness resists; add a spring or a joint that holds it, or take the load away"
        )


def _least_squares(A: Floats, b: Floats) -> Floats:
    return np.asarray(sl.lstsq(A, b, cond=TOL.no_stiffness)[0]) if A.shape[1] else np.zeros(0)
