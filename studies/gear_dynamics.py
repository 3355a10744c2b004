"""Two gears in mesh over time: switched static modes of the flanks against all of them in the coordinates.

Gears turn at constant speed and vibrate about that: turn of the hub, modes of the teeth, contact without pulling forces
in every step. Switched: the static modes of touched elements alone, without mass (Tamarozzi, EUROMECH 524). All active:
static modes of all flank nodes with their mass, the same steps. Draws gear_dynamics.png.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

import numpy as np
import scipy.linalg as sl
from common import OURS, THEIRS, Curve, Floats, Panel, draw, parse

from data.make_spur_gear import CELLS, STEEL, WIDTH, pair
from morembs.dynamics.multibody.contact.lemke import lemke
from morembs.dynamics.multibody.integrate import Scheme
from studies.gear_teeth import FORCE, QUICK_CELLS, Reduced, Touch, base_pitch, reduce, solve, touch

PITCH_TIME, STEPS, QUICK_STEPS, RHO = 2e-3, 400, 100, 0.8  # s for one pitch
RANK = 1e-10  # of the stiffness of static modes, below which a direction counts as none


class Rotor:
    """A gear of coordinates q: turn of its hub, modes, with ``whole`` all static modes of its flanks."""

    def __init__(self, gear: Reduced, whole: bool) -> None:
        self.tables, self.whole, self.base = gear.tables, whole, gear.sector.gear.base
        own, every = np.concatenate(([5], gear.elastic)), np.arange(gear.tables.count)
        M, K, self.rows = gear.reduced.M[np.ix_(own, own)], gear.reduced.K[np.ix_(own, own)], gear.tables.modes[:, own]
        # The rest of a solid disc turns with the hub; only round-off holds that.
        M[0, 0], K[0], K[:, 0] = 0.5 * STEEL["density"] * WIDTH * math.pi * gear.sector.gear.pitch**4, 0.0, 0.0
        if whole:
            R = self.tables.R(every)
            values, S = np.linalg.eigh(R)
            S = S[:, values > RANK * values[-1]] / np.sqrt(values[values > RANK * values[-1]])
            coupling = self.tables.coupling[own] @ S
            M = np.block([[M, coupling], [coupling.T, S.T @ self.tables.Q(every) @ S]])
            K, self.rows = sl.block_diag(K, np.eye(S.shape[1])), np.hstack([self.rows, R @ S])
        self.M, self.K = M, K
        self.q, self.v, self.rate, self.auxiliary = np.zeros((4, len(M)))

    def pushed(self, some: np.ndarray, W: Floats) -> tuple[Floats, Floats]:
        """Motion (n, p) of points by the coordinates, and their compliance (p, p) beside these."""
        if not self.whole:
            return (W @ self.rows[some]).T, W @ self.tables.R(some) @ W.T
        weights = np.zeros((len(W), self.tables.count))
        weights[:, some] = W
        return (weights @ self.rows).T, np.zeros((len(W), len(W)))


def turn(gears: Sequence[Reduced], touches: Sequence[Touch], whole: bool) -> tuple[Floats, Floats, int, float]:
    """Transmission error (s,) m, force (s,) N of all teeth, coordinates, ms per step without the search for contact.

    From the equilibrium at the first place, by generalised-alpha with the forces of each step.
    """
    rotors, a, h = [Rotor(gear, whole) for gear in gears], Scheme(rho=RHO), PITCH_TIME / (len(touches) - 1)
    share = (1 - a.alpha_f) / (1 - a.alpha_m)
    c = h * h * a.beta * share
    factors = [sl.cho_factor(rotor.M + c * rotor.K) for rotor in rotors]

    def ways(at: Touch) -> list[tuple[Floats, Floats]]:
        return [r.pushed(some, W) for r, some, W in zip(rotors, at.active, at.weights, strict=True)]

    at = touches[0]
    near, f = solve(at, [gear.compliance(some) for gear, some in zip(gears, at.active, strict=True)])
    for rotor, (G, _) in zip(rotors, ways(at), strict=True):
        rotor.q[1:] = -np.linalg.solve(rotor.K[1:, 1:], (G @ f)[1:])
    rotors[0].q[0] = near / rotors[0].base
    errors, forces, begin = [], [], time.process_time()
    for at in touches[1:]:
        A, gap, free = np.zeros((len(at.gap),) * 2), at.gap.copy(), []
        for r, factor, (G, R) in zip(rotors, factors, ways(at), strict=True):
            kept = a.alpha_f * r.rate - a.alpha_m * r.auxiliary
            x = r.q + h * r.v + h * h * ((0.5 - a.beta) * r.auxiliary + a.beta * kept / (1 - a.alpha_m))
            load = -r.K @ x
            load[0] += FORCE * r.base
            X = sl.cho_solve(factor, np.column_stack((load, G)), check_finite=False)
            A, gap = A + c * G.T @ X[:, 1:] + R, gap - G.T @ (x + c * X[:, 0])
            free.append((r, x, X, kept))
        unit = np.abs(A).max()
        f = lemke(A / unit, gap / (unit * FORCE)).z * FORCE
        for r, x, X, kept in free:
            r.rate = X[:, 0] - X[:, 1:] @ f
            auxiliary = share * r.rate + kept / (1 - a.alpha_m)
            r.v = r.v + h * ((1 - a.gamma) * r.auxiliary + a.gamma * auxiliary)
            r.q, r.auxiliary = x + c * r.rate, auxiliary
        errors.append(sum(r.base * r.q[0] for r in rotors))
        forces.append(f.sum())
    cost = 1e3 * (time.process_time() - begin) / (len(touches) - 1)
    return np.array(errors), np.array(forces), sum(len(r.M) for r in rotors), cost


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    driver, driven = gears = tuple(reduce(gear, cells=QUICK_CELLS if options.quick else CELLS) for gear in pair())
    places = base_pitch() * np.linspace(-0.5, 0.5, 1 + (QUICK_STEPS if options.quick else STEPS))
    touches = [touch((driver, driven), float(place)) for place in places]
    switched, whole = (turn(gears, touches, every) for every in (False, True))
    for words, (error, _, coordinates, cost) in (("switched", switched), ("all active", whole)):
        print(
            f"{words:10}  {coordinates:4d} coordinates, transmission error {1e6 * error.min():.3f} to "
            f"{1e6 * error.max():.3f} micrometres, {cost:.3f} ms per step"
        )
    error, force = (np.abs(ours - theirs) for ours, theirs in zip(switched[:2], whole[:2], strict=True))
    print(
        f"switched differ by {error.max() / np.abs(whole[0]).max():.1e} of the transmission error and "
        f"{force.max() / FORCE:.1e} of the force, all active take {whole[3] / switched[3]:.2f} times as long"
    )
    x, looks, panels = places[1:] / base_pitch(), (("all active", THEIRS, "-"), ("switched", OURS, "--")), []
    for k, factor, title, unit in ((0, 1e6, "Transmission error", "micrometres"), (1, 1.0, "Force of all teeth", "N")):
        curves = [Curve(x, factor * run[k], *look) for run, look in zip((whole, switched), looks, strict=True)]
        panels.append(Panel(title, "rotation, pitches", unit, curves))
    draw(options.folder / "gear_dynamics.png", "Two gears in mesh over time", panels)
    return 0


if __name__ == "__main__":
    sys.exit(main())
