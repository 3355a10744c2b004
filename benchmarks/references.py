"""Bounds of the error of references, and of round-off, against what they bound.

    python benchmarks/references.py --count 100 --seed 1

The models are those of certificates.py. Bounds of references that end at 1e-1 to 1e-7 of the envelope are
compared with dense solutions of the full equations, modal damping on their exact modes included; bounds of
round-off with modal sums in extended precision, on resonances and as far as three half widths beside them. What counts
is the error over its bound, which must not exceed one, and how large the bound is beside the error.
"""

from __future__ import annotations

import sys
from typing import Any, ClassVar

import numpy as np
from certificates import Drawn, asked, drawn, exact_modes, long_modes

from morembs.base.types import Floats
from morembs.problem import Problem
from morembs.responses import certified
from morembs.responses.certified import certified_reference
from morembs.responses.certified_reference import CertifiedReference
from morembs.responses.residual_bound import Residual

TOLERANCES, FREQUENCIES, SAMPLES = 10.0 ** -np.arange(1, 8), 40, 200
# Smaller errors, as multiples of what round-off may be, are those of the dense solution.
LEAST = 10.0


class Kept(Residual):
    """The residual of the space that was made last."""

    last: ClassVar[list[Residual]] = []

    def bounds(self, band: tuple[float, float], tolerance: float) -> tuple[Floats, Floats]:
        """As in the package."""
        self.last[:] = [self]
        return super().bounds(band, tolerance)


def kind_of(case: Drawn) -> str:
    """What damps a model."""
    return case.words.split(",")[0].split()[-1]


def bounds_of(problem: Problem, high: float, rng: np.random.Generator) -> Floats:
    """(3, n) of the errors, of their bounds at these frequencies, and of those of their cells, over the envelope."""
    ratios = []
    for tolerance in TOLERANCES:
        problem.release()
        reference = certified_reference(problem, [0.0, high], tolerance=tolerance)
        at = np.concatenate([rng.uniform(0.01, 1, FREQUENCIES) * high, np.sqrt(reference.values) / (2 * np.pi)])
        omega = 2 * np.pi * at[at <= high]
        standard = reference.standard()
        size = standard.modes.moduli(omega)[0]
        e = size @ standard.residue_norms[:, 0]
        lost = standard.rounding.at(size).size()[:, 0] / e + standard.floor
        off = np.linalg.norm(reference.H(omega) - true_response(reference, omega), axis=(1, 2)) / e
        # No tolerance: the plain formula at one frequency.
        (residual,) = Kept.last
        there = np.array([Residual.bounds(residual, (w, w * (1 + 1e-9)), 0.0)[1].max() for w in omega])
        cells = standard.uncertainty(omega, omega)
        known = off > LEAST * lost
        ratios.append(np.stack([off, there, cells])[:, known])
    return np.hstack(ratios)


def true_response(reference: CertifiedReference, omega: Floats) -> Any:
    """Scaled response (nf, m, m) of the full equations with the damping of ``reference``."""
    problem, damping = reference.problem, reference.model.damping
    K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
    F = problem.B.toarray()
    F = F - M @ (Z @ (Z.T @ F))
    D = damping.alpha * M + damping.beta * K
    if damping.is_modal:
        theta, phi = exact_modes(K, M, Z.shape[1])
        D = (M @ phi * damping.of_modes(theta)) @ phi.T @ M
    S = np.outer(problem.motion_scale, problem.motion_scale)
    c = 1 + 1j * damping.structural
    return np.array([F.T @ np.linalg.solve(c * K + 1j * w * D - w**2 * M, F.astype(complex)) for w in omega]) * S


def rounding_of(problem: Problem, high: float, rng: np.random.Generator) -> Floats:
    """(2, n) errors at resonances against extended precision, and how far the response is not known there."""
    problem.release()
    reference = certified_reference(problem, [0.0, high])
    theta, phi = long_modes(problem.K.toarray(), problem.M.toarray(), problem.rigid.shape[1])
    damping = reference.model.damping
    b = (problem.B.T.toarray().astype(np.longdouble) @ phi).T * problem.motion_scale
    d, loss = damping.of_modes(theta.astype(float)), damping.structural
    at = np.flatnonzero(np.sqrt(theta) <= 2 * np.pi * high)
    k = rng.choice(at, SAMPLES)
    width = 0.5 * (d + loss * np.sqrt(theta.astype(float)))[k]
    omega = np.sqrt(theta.astype(float))[k] + rng.choice([0.0, 1.0], SAMPLES) * rng.uniform(-3, 3, SAMPLES) * width
    omega = omega[omega <= 2 * np.pi * high]
    w = omega.astype(np.longdouble)[:, None]
    a = theta * (1 + 1j * np.longdouble(loss)) + 1j * w * d - w**2
    H = np.einsum("pi,fp,pj->fij", b, 1 / a, b)
    off = np.abs(reference.H(omega) - H).astype(float)
    return np.stack([np.sqrt((off**2).sum(axis=(1, 2))), reference.uncertainty(omega)])


def main(arguments: list[str]) -> int:
    """Run trials and print what they found; the number of errors above a bound."""
    options = asked(__doc__, arguments)
    vars(certified)["Residual"] = Kept
    bounds: dict[str, list[Floats]] = {}
    rounding: list[Floats] = []
    for number in options.numbers:
        rng = np.random.default_rng([options.seed, number])
        case = drawn(rng, number)
        with case.problem as problem:
            bounds.setdefault(kind_of(case), []).append(bounds_of(problem, case.high, rng))
            rounding.append(rounding_of(problem, case.high, rng))
    above = 0
    for kind, parts in sorted(bounds.items()):
        off, there, cells = np.hstack(parts)
        wrong = int((off > np.minimum(there, cells)).sum())
        above += wrong
        words = f"{len(off)} errors, {wrong} above, bound over error {quantiles(there / off)}"
        sys.stdout.write(f"reference, {kind} damping: {words}\n")
    off, known = np.hstack(rounding)
    wrong = int((off > known).sum())
    sys.stdout.write(f"round-off: {len(off)} errors, {wrong} above, bound over error {quantiles(known / off)}\n")
    return above + wrong


def quantiles(ratio: Floats) -> str:
    """Smallest, median and 95 % in words."""
    if not len(ratio):
        return "not known"
    least, median, most = np.quantile(ratio, (0, 0.5, 0.95))
    return f"{least:.3g} at least, {median:.3g} median, {most:.3g} for 95 %"


if __name__ == "__main__":
    sys.exit(bool(main(sys.argv[1:])))
