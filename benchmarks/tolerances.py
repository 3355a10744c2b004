"""``auto`` on random bodies: errors between the samples, and orders beside the best of a dense search.

    python benchmarks/tolerances.py --count 100 --seed 1
    python benchmarks/tolerances.py --seed 1 --only 17

The models are those of certificates.py, each with three tolerances in two measures. A body fails where an error of
the dense truth, at 20,000 frequencies, about every pole and at the minima of |H|, is above its tolerance. Its order is
compared with the smallest of 18 bases: leading vectors of the responses, weighted with |H| to six powers, in three
inner products, each cut where its error at 4,000 frequencies, beside every resonance and at the minima of |H| holds the
tolerance. A body fails too where its order is above that by more than one in ten, and by more than one.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from certificates import Drawn, asked, dense_errors, drawn, exact_modes

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Complexes, Floats
from morembs.linalg.quadrature import trapezoid
from morembs.problem import Problem
from morembs.reducers import AutoReducer
from morembs.responses.certified import floor_of
from morembs.responses.loads import load_scale, unit_loads
from morembs.responses.measures import MEASURES

TOLERANCES, ASKED = (1e-2, 1e-4, 1e-6), ("envelope", "pointwise")
POWERS, FREQUENCIES = np.linspace(0.0, -1.3, 6), 4000
# Distances from resonances in half widths, at which the rivals are looked at.
BESIDE = np.linspace(-3, 3, 13)
# Times that the neighbourhood of a minimum is made ten times finer.
FINER = 6
AT_ONCE = 500
NOISE = 1e-13


@dataclass(frozen=True, kw_only=True)
class Delivered:
    """A body of ``auto``: its elastic ``order`` and the ``best`` of the rivals, the certified limit and the largest
    dense error over the tolerance; ``why`` it was refused, "" where it was not."""

    words: str
    measure: str
    tolerance: float
    order: int = 0
    best: int = 0
    limit: float = 0.0
    error: float = 0.0
    seconds: float = 0.0
    why: str = ""

    @property
    def excess(self) -> bool:
        """Whether the order is more than a tenth, and more than one, above the best."""
        return not self.why and self.order > max(self.best + 1, int(1.1 * self.best))


class Rivals:
    """The smallest of 18 bases that hold a tolerance at many frequencies, from all modes of a small model."""

    def __init__(self, problem: Problem, high: float) -> None:
        self.values, phi = exact_modes(problem.K.toarray(), problem.M.toarray(), problem.rigid.shape[1])
        self.damping, self.inputs = problem.damping, problem.B.shape[1]
        self.loss = problem.damping.structural + 2 * floor_of(problem, [0.0, high])
        # As in ``auto``: the frame of a body that is held accelerates it.
        F = phi.T @ unit_loads(problem, problem.rigid.shape[1] < 6)
        self.F = F * load_scale(problem.motion_scale, F, F / self.values[:, None])
        self.counted = sorted({self.inputs, F.shape[1]})
        omega = np.sqrt(self.values)
        width = 0.5 * (self.damping.of_modes(self.values) + self.loss * omega)
        top = 2 * np.pi * high
        w = np.concatenate(
            [
                np.linspace(0, top, FREQUENCIES // 2),
                np.geomspace(1e-3 * top, top, FREQUENCIES // 2),
                (omega[:, None] + width[:, None] * BESIDE).ravel(),
            ]
        )
        self.w = np.unique(w[(w >= 0) & (w <= top)])
        self.full = self._response(self.values, self.F)
        self._add_zeros()
        self.norms = self._norms(self.full)
        each = np.stack([(self.F[:, :m] ** 2).sum(axis=1) for m in self.counted], axis=1)
        self.sizes = {"pointwise": self.norms, "envelope": (1 / np.abs(self._dynamic(self.values))) @ each}
        self.bases = self._leading()

    def _dynamic(self, theta: Floats) -> Complexes:
        w = self.w[:, None]
        return np.asarray(theta * (1 + 1j * self.loss) + 1j * w * self.damping.of_modes(theta) - w**2)

    def _response(self, theta: Floats, F: Floats) -> Complexes:
        rows = (F[:, :, None] * F[:, None, :]).reshape(len(F), -1)
        return np.asarray(((1 / self._dynamic(theta)) @ rows).reshape(len(self.w), *F.shape[1:] * 2))

    def _norms(self, H: Complexes) -> Floats:
        return np.stack([np.linalg.norm(H[:, :m, :m], axis=(1, 2)) for m in self.counted], axis=1)

    def _add_zeros(self) -> None:
        """The minima of |H| join the frequencies."""
        size, grid = self._norms(self.full)[:, 0], self.w
        least = 1 + np.flatnonzero((size[1:-1] < size[:-2]) & (size[1:-1] < size[2:]))
        low, high, grids = grid[least - 1], grid[least + 1], [grid]
        for _ in range(FINER):
            self.w = np.linspace(low, high, 21).ravel()
            size = self._norms(self._response(self.values, self.F))[:, 0].reshape(21, -1)
            grids.append(self.w)
            at, step = size.argmin(axis=0), (high - low) / 20
            low, high = low + (at - 1) * step, low + (at + 1) * step
        self.w = np.unique(np.clip(np.concatenate(grids), grid[0], grid[-1]))
        self.full = self._response(self.values, self.F)

    def _leading(self) -> list[Floats]:
        """Orthonormal columns (k, n), leading ones first, for every power and inner product."""
        bases = []
        states = 1 / self._dynamic(self.values)
        for power in POWERS:
            weight = np.sqrt(trapezoid(self.w)) * self.norms[:, -1] ** power
            triangle = np.zeros((0, len(self.F)))
            for at in range(0, len(self.w), AT_ONCE):
                some = slice(at, at + AT_ONCE)
                X = (weight[some, None] * states[some])[:, None, :] * self.F.T
                X = X.reshape(-1, len(self.F))
                triangle = np.linalg.qr(np.vstack([triangle, X.real, X.imag]), mode="r")
            for inner in (np.ones(len(self.F)), np.sqrt(self.values), np.sqrt(self.values + self.w.mean() ** 2)):
                U, s, _ = sl.svd(inner[:, None] * triangle.T, full_matrices=False)
                bases.append(np.linalg.qr(U[:, s > NOISE * s[0]] / inner[:, None])[0])
        return bases

    def error(self, C: Floats, measure: str) -> float:
        """Largest error at the frequencies of the projection on ``C`` (k, n)."""
        theta, Y = sl.eigh(C.T @ (self.values[:, None] * C))
        off = self._norms(self._response(theta, Y.T @ C.T @ self.F) - self.full)
        return float((off / self.sizes[measure]).max())

    def smallest(self, measure: str, tolerance: float) -> int:
        """The smallest order of all bases that holds ``tolerance``."""
        best = 1 + max(C.shape[1] for C in self.bases)
        for C in self.bases:
            high = min(best - 1, C.shape[1])
            if not high or self.error(C[:, :high], measure) > tolerance:
                continue
            low = 0
            while high - low > 1:
                middle = (low + high) // 2
                held = self.error(C[:, :middle], measure) <= tolerance
                low, high = (low, middle) if held else (middle, high)
            best = high
        return best


def judged(case: Drawn) -> list[Delivered]:
    """Bodies of ``auto`` of one model with all tolerances and measures."""
    problem = case.problem
    deliveries: list[Delivered] = []
    rivals = Rivals(problem, case.high)
    for measure in ASKED:
        for tolerance in TOLERANCES:
            start = time.process_time()
            named = {"words": case.words, "measure": measure, "tolerance": tolerance}
            try:
                body = AutoReducer(band_hz=[0.0, case.high], tolerance=tolerance, measure=measure).reduce(problem)
            except (InputError, SolverError) as fault:
                deliveries.append(Delivered(**named, why=str(fault)))
                continue
            seconds = time.process_time() - start
            _, true = dense_errors(problem, body, (0.0, case.high), rivals.w / (2 * np.pi))
            deliveries.append(
                Delivered(
                    **named,
                    order=body.order - problem.rigid.shape[1],
                    best=rivals.smallest(measure, tolerance),
                    limit=float(str(body.recipe["certified"])) / tolerance,
                    error=float(true[:, MEASURES.index(measure)].max()) / tolerance,
                    seconds=seconds,
                )
            )
    return deliveries


def told(deliveries: list[Delivered]) -> int:
    """Print what bodies are like so far; the number of those that fail."""
    for measure in ASKED:
        for tolerance in TOLERANCES:
            asked = measure, tolerance
            some = [delivered for delivered in deliveries if (delivered.measure, delivered.tolerance) == asked]
            kept = [delivered for delivered in some if not delivered.why]
            if not kept:
                continue
            more = np.array([delivered.order - delivered.best for delivered in kept])
            seconds = np.quantile([delivered.seconds for delivered in kept], (0.5, 1)).round(2).tolist()
            sys.stdout.write(
                f"{measure} {tolerance:g}: {len(kept)} bodies, {len(some) - len(kept)} refused; "
                f"limit at most {max(delivered.limit for delivered in kept):.4f}, error at most "
                f"{max(delivered.error for delivered in kept):.4f} of the tolerance; order beside the best "
                f"{dict(zip(*(part.tolist() for part in np.unique(more, return_counts=True)), strict=True))}, "
                f"{sum(delivered.excess for delivered in kept)} above; "
                f"{seconds} s (median, largest)\n"
            )
    failed = sum(max(delivered.error, delivered.limit) > 1 or delivered.excess for delivered in deliveries)
    sys.stdout.write(f"{len(deliveries)} bodies, {failed} fail\n")
    return failed


def main(arguments: list[str]) -> int:
    """Run trials and print what they found; the number of bodies that fail."""
    options = asked(__doc__, arguments)
    seed, numbers, alone = options.seed, options.numbers, options.alone
    deliveries: list[Delivered] = []
    for number in numbers:
        case = drawn(np.random.default_rng([seed, number]), number)
        with case.problem:
            these = judged(case)
        for delivered in these:
            fails = delivered.why or delivered.excess or max(delivered.error, delivered.limit) > 1
            if fails or alone:
                sys.stdout.write(f"{delivered}\n")
        deliveries += these
        if not alone and (number + 1) % 10 == 0:
            told(deliveries)
        sys.stdout.flush()
    return told(deliveries)


if __name__ == "__main__":
    sys.exit(bool(main(sys.argv[1:])))
