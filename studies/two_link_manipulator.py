"""A flexible two-link manipulator: one or two modes along its nominal motion against all degrees of freedom.

Draws two_link_manipulator.png: deflection of the tip, errors, frequencies along the motion. The links and masses are
those of Schiehlen and Leister (1991); the joints turn by a quintic within 0.5 s, since their motion is not published
with them. Reduction along the nominal motion of rigid links (Aarts and Jonker 2002): linear equations about that
motion, with the stiffness of its axial forces, in the lowest modes of each instant; static answers stand in for all
others. Motion in a horizontal plane, no damping.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from common import OURS, THEIRS, THIRD, Curve, Floats, Panel, draw, parse
from scipy.optimize import curve_fit

from morembs.multibody.integrate import Scheme
from morembs.nonlinear import FullMember, Mechanism, PlanarBeam, Section, simulate

LENGTHS, AREAS, MOMENTS = (0.545, 0.675), (9.0e-4, 4.0e-4), (1.69e-8, 3.33e-9)
E, DENSITY, ELBOW, TIP = 7.3e10, 2700.0, 1.0, 3.0
MOVE, END, STEP, COARSE, ELEMENTS = 0.5, 2.0, 1e-3, 4e-3, 10
QUICK_END, QUICK_ELEMENTS, QUICK_STEPS = 1.2, 3, (8e-3, 1.6e-2)
# Shoulder and elbow (rad): start, and turn within MOVE. The arm is straight at the end.
SHOULDER, ELBOW_START, ELBOW_TURN = np.pi / 3, np.pi / 2, -np.pi / 2
RHO = 0.9


def quintic(t: float) -> float:
    """From 0 to 1 within MOVE, at rest and without acceleration at both ends."""
    s = min(max(t / MOVE, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)


def directions(t: float) -> tuple[float, float]:
    """Both links of the rigid arm, rad."""
    return SHOULDER * quintic(t), SHOULDER * quintic(t) + ELBOW_START + ELBOW_TURN * quintic(t)


def links(elements: int) -> list[PlanarBeam]:
    """Both links along x."""
    return [
        PlanarBeam.straight(length, elements, Section.of(E=E, A=A, I=moment, density=DENSITY))
        for length, A, moment in zip(LENGTHS, AREAS, MOMENTS, strict=True)
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Times (T,), deflection (T,) m of the tip across the second link of the rigid arm, ms per step, offline s."""

    time: Floats
    deflection: Floats
    step: float
    offline: float = 0.0

    def error(self, reference: Run) -> float:
        """Largest difference per largest deflection of the reference, which may have smaller steps."""
        exact = np.interp(self.time, reference.time, reference.deflection)
        return float(np.abs(self.deflection - exact).max() / np.abs(reference.deflection).max())


def across(times: Floats, tip: Floats) -> Floats:
    """Distance (T,) of the tip (T, 2) from that of the rigid arm, across its second link."""
    a, b = np.array([directions(t) for t in times]).T
    rigid = np.column_stack([sum(n * f(x) for n, x in zip(LENGTHS, (a, b), strict=True)) for f in (np.cos, np.sin)])
    return np.asarray(np.sum((tip - rigid) * np.column_stack((-np.sin(b), np.cos(b))), axis=1))


def full(*, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Run:
    """All degrees of freedom, large rotations and deflections."""
    mechanism, (first, second) = Mechanism(), links(elements)
    a, b = directions(0.0)
    elbow = LENGTHS[0] * np.array([np.cos(a), np.sin(a)])
    points = [mechanism.point((0, 0), fixed="xy"), mechanism.point(elbow)]
    points.append(mechanism.point(elbow + LENGTHS[1] * np.array([np.cos(b), np.sin(b)])))
    shoulder = mechanism.driven(a, lambda t: SHOULDER * quintic(t))
    outer = mechanism.angle(a)
    joint = mechanism.driven(b, lambda t: ELBOW_TURN * quintic(t), seen_from=outer)
    mechanism.add(FullMember(first), points[0], points[1], start=shoulder, end=outer)
    mechanism.add(FullMember(second), points[1], points[2], start=joint)
    mechanism.mass(points[1], ELBOW)
    mechanism.mass(points[2], TIP)
    begin = time.process_time()
    motion = simulate(mechanism, end=end, step=step, rho=RHO)
    seconds = time.process_time() - begin
    tip = motion.q[:, points[2].numbers]
    return Run(time=motion.times, deflection=across(motion.times, tip), step=seconds / (len(motion.times) - 1))


class Nominal:
    """Linear equations about the rigid motion, in the coordinates y (n,) of all nodes that can move."""

    def __init__(self, elements: int) -> None:
        self.links, size = links(elements), 3 * (elements + 1)
        self.size = size
        # The first node of link 1 is driven; that of link 2 has the motion of the last of link 1.
        last = np.arange(size - 6, size - 3)
        columns = np.r_[np.full(3, -1), np.arange(size - 3), last, np.arange(size - 3, 2 * size - 6)]
        self.S = np.zeros((2 * size, 2 * size - 6))
        self.S[np.flatnonzero(columns >= 0), columns[columns >= 0]] = 1
        M = sl.block_diag(*(link.M.toarray() for link in self.links))
        M[range(size - 3, size - 1), range(size - 3, size - 1)] += ELBOW
        M[range(2 * size - 3, 2 * size - 1), range(2 * size - 3, 2 * size - 1)] += TIP
        self.full_M = M
        self.M = self.S.T @ M @ self.S

    def rigid(self, t: float) -> Floats:
        """Coordinates (2 size,) of the rigid arm."""
        pieces, origin = [], np.zeros(2)
        for link, angle in zip(self.links, directions(t), strict=True):
            axis = np.array([np.cos(angle), np.sin(angle)])
            along = link.reference.reshape(-1, 3)[:, 0]
            pieces.append(np.column_stack((origin + along[:, None] * axis, np.full(len(along), angle))).ravel())
            origin = origin + along[-1] * axis
        return np.concatenate(pieces)

    def _tangent(self, x: Floats) -> Floats:
        blocks = [link.tangent(part).toarray() for link, part in zip(self.links, np.split(x, 2), strict=True)]
        return np.asarray(self.S.T @ sl.block_diag(*blocks) @ self.S)

    def at(self, t: float, small: float = 1e-4) -> tuple[Floats, Floats, Floats]:
        """x of the rigid arm, K (n, n) with the stiffness of its axial forces, force (n,) of its inertia."""
        x = self.rigid(t)
        acceleration = (self.rigid(t + small) - 2 * x + self.rigid(t - small)) / small**2
        force = -self.S.T @ (self.full_M @ acceleration)
        moved = self.S @ np.linalg.solve(self._tangent(x), force)
        stretched = x.copy()
        for k, angle in enumerate(directions(t)):
            part, axis = slice(k * self.size, (k + 1) * self.size), np.array([np.cos(angle), np.sin(angle)])
            motion = moved[part].reshape(-1, 3)[:, :2] @ axis
            nodes = stretched[part].reshape(-1, 3)
            nodes[:, :2] += (motion - motion[0])[:, None] * axis
        return x, self._tangent(stretched), force

    def tip(self, x: Floats, y: Floats) -> Floats:
        """Tip (2,): directions of the elements from the nodes' rotations, lengths as they are."""
        total = np.zeros(2)
        for link, part in zip(self.links, np.split(x + self.S @ y, 2), strict=True):
            turn = part.reshape(-1, 3)[:, 2]
            middle = (turn[1:] + turn[:-1]) / 2
            total += [np.sum(link.lengths * np.cos(middle)), np.sum(link.lengths * np.sin(middle))]
        return total


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """Modes of all instants: ``Phi`` (T, n, m), ``squares`` (T, m), forces and static answers beside the modes."""

    nominal: Nominal
    times: Floats
    x: Floats
    Phi: Floats
    squares: Floats
    force: Floats
    rest: Floats
    seconds: float


def prepare(modes: int, *, end: float = END, step: float = STEP, elements: int = ELEMENTS) -> Path:
    """The offline stage; after the motion nothing changes any more."""
    begin, nominal, times = time.process_time(), Nominal(elements), step * np.arange(round(end / step) + 1)
    xs, Phis, squares, forces, rests = [], [], [], [], []
    for t in times:
        if t <= MOVE + 2 * step:
            x, K, force = nominal.at(t)
            values, Phi = sl.eigh(K, nominal.M, subset_by_index=[0, modes - 1])
            if Phis:
                Phi = Phi * np.sign(np.einsum("nk,nk->k", Phi, nominal.M @ Phis[-1]))
            rest = np.linalg.solve(K, force) - Phi @ (Phi.T @ force / values)
        for table, value in zip((xs, Phis, squares, forces, rests), (x, Phi, values, force, rest), strict=True):
            table.append(value)
    return Path(
        nominal=nominal, times=times, x=np.array(xs), Phi=np.array(Phis), squares=np.array(squares),
        force=np.array(forces), rest=np.array(rests), seconds=time.process_time() - begin,
    )  # fmt: skip


def reduced(path: Path, *, static: bool = True) -> Run:
    """Generalised-alpha on y = Phi(t) eta; ``static`` adds the static answers of all other modes to the result."""
    a, h = Scheme(rho=RHO), float(path.times[1] - path.times[0])
    c = (1 - a.alpha_m) / ((1 - a.alpha_f) * a.beta * h * h)
    begin, count = time.process_time(), len(path.times)
    Psi = np.matmul(path.nominal.M, path.Phi)
    loads = np.einsum("tnm,tn->tm", path.Phi, path.force)
    y, v, rate, auxiliary = (np.zeros(path.Phi.shape[1]) for _ in range(4))
    answers = np.zeros((count, len(y)))
    for k in range(1, count):
        # The part of the acceleration that the new amplitudes do not change.
        known = ((-y / h - v) / (a.beta * h) - (0.5 - a.beta) / a.beta * auxiliary) * (1 - a.alpha_m)
        known = (known + a.alpha_m * auxiliary - a.alpha_f * rate) / (1 - a.alpha_f)
        eta = (loads[k] - Psi[k].T @ known) / (c + path.squares[k])
        new = path.Phi[k] @ eta
        later = ((new - y) / h - v) / (a.beta * h) - (0.5 - a.beta) / a.beta * auxiliary
        rate = ((1 - a.alpha_m) * later + a.alpha_m * auxiliary - a.alpha_f * rate) / (1 - a.alpha_f)
        v = v + h * ((1 - a.gamma) * auxiliary + a.gamma * later)
        y, auxiliary, answers[k] = new, later, new
    seconds = (time.process_time() - begin) / (count - 1)
    if static:
        answers = answers + path.rest
    tip = np.array([path.nominal.tip(x, answer) for x, answer in zip(path.x, answers, strict=True)])
    return Run(time=path.times, deflection=across(path.times, tip), step=seconds, offline=path.seconds)


def residual_frequency(run: Run) -> float:
    """Hz, of the slowest oscillation after the motion: two sines fitted to the deflection."""
    after = run.time >= MOVE
    t, w = run.time[after] - MOVE, run.deflection[after]

    def waves(t: Floats, f: float, g: float, *amplitudes: float) -> Floats:
        parts = [function(2 * np.pi * frequency * t) for frequency in (f, g) for function in (np.cos, np.sin)]
        return np.asarray(amplitudes @ np.array(parts))

    return float(curve_fit(waves, t, w, p0=(3.0, 23.0, 1e-2, 1e-2, 0, 0))[0][0])


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the comparison and draws the picture. Returns the exit code."""
    options = parse(arguments, "A flexible two-link manipulator and its modes along the nominal motion.", __file__)
    end, elements = (QUICK_END, QUICK_ELEMENTS) if options.quick else (END, ELEMENTS)
    fine, coarse_step = QUICK_STEPS if options.quick else (STEP, COARSE)
    reference = full(end=end, step=fine, elements=elements)
    locked = np.sqrt(prepare(2, end=MOVE, elements=elements).squares[-1]) / (2 * np.pi)
    print(f"arm locked at the end of the motion: {locked[0]:.4f} and {locked[1]:.3f} Hz")
    print(f"all coordinates: {residual_frequency(reference):.4f} Hz after the motion, largest deflection "
          f"{np.abs(reference.deflection).max():.5f} m, {1e3 * reference.step:.3f} ms per step of "
          f"{reference.time[1]:g} s")  # fmt: skip
    print("modes  static answers  step, s   largest error / deflection   Hz after   ms per step   offline, s")
    runs: dict[str, Run] = {}
    cases = [(modes, static, fine) for modes in (1, 2) for static in (False, True)] + [(2, True, coarse_step)]
    for modes, static, step in cases:
        run = reduced(prepare(modes, end=end, step=step, elements=elements), static=static)
        runs.setdefault(f"{modes} mode{'s' * (modes > 1)}{', static answers' * static}", run)
        print(f"{modes:5d}  {'yes' if static else 'no':14}  {step:7g}   {run.error(reference):26.4f}   "
              f"{residual_frequency(run):8.4f}   {1e3 * run.step:11.4f}   {run.offline:10.2f}")  # fmt: skip
    coarse = full(end=end, step=coarse_step, elements=elements)
    gap = coarse.error(reference)
    print(f"all coordinates, steps of {coarse_step:g} s: error {gap:.4f}, {1e3 * coarse.step:.3f} ms each")
    looks = {"1 mode": "#9aa5b1", "2 modes": THIRD, "2 modes, static answers": OURS}
    shown = [Curve(x=reference.time, y=1e3 * reference.deflection, label="all coordinates", color=THEIRS, width=3.5)]
    errors = []
    for name, color in looks.items():
        run = runs[name]
        shown.append(Curve(x=run.time, y=1e3 * run.deflection, label=name, color=color, width=1.2))
        gap = np.abs(run.deflection - np.interp(run.time, reference.time, reference.deflection))
        part = np.maximum(gap / np.abs(reference.deflection).max(), 1e-6)
        errors.append(Curve(x=run.time, y=part, label=name, color=color, width=1.2))
    draw(options.folder / "two_link_manipulator.png", "Two-link manipulator", [
        Panel(title="Deflection of the tip", x="time, s", y="mm", curves=shown),
        Panel(title="Error", x="time, s", y="part of the largest", curves=errors, logarithmic=True),
    ])  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
