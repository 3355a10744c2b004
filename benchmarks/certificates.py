"""Certificates of random bodies against dense solutions: values above a limit, sharpness, time.

    python benchmarks/certificates.py --count 100 --seed 1
    python benchmarks/certificates.py --count 500 --start 500 --seed 1
    python benchmarks/certificates.py --seed 1 --only 17
    python benchmarks/certificates.py --count 100 --seed 2 --above-zero 0.33
    python benchmarks/certificates.py --count 100 --seed 2 --own 1

Trusses of 12 to 40 nodes, free and held, some with twins of nearly equal modes, with 1 to 9 inputs; Rayleigh,
structural and modal damping from 1e-6 to 5e-2, dashpots along the bars (``--own``) and none, reduced by projections and
by methods that are none. The truth is the modal sum of a dense eigenproblem, with dashpots a quadratic one, at 20,000
frequencies of the band, about every pole and where the certificate says that it reaches its limits. Beyond a limit
counts what is above the limit of its cell.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.certificate.certify import certify
from morembs.certificate.limits import body_response
from morembs.certificate.record import Certificate
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import BalancedTruncation, CraigBampton, FreeInterface, Gramian, Krylov, Modal
from morembs.reducers.base import ReducedModel
from morembs.responses.certified import certified_reference
from morembs.responses.clusters import damping_of_clusters
from morembs.responses.layout import BlockIndex
from morembs.responses.measures import MEASURES
from morembs.responses.rational import PoleResidueForm, squares

DENSE, BESIDE = 20_000, 25
# Samples are up to so much lower than the peaks between them, so that all maxima above this part of the highest count.
ALIKE = 0.9
# Frequencies that are looked at together: what fits into a cache.
AT_ONCE = 250
DAMPINGS = ("rayleigh", "structural", "both", "modal", "none")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One certificate: its ``kind``, ``above`` values beyond the limits, upper limits over the largest dense values
    (3,), upper over lower limits (3,), upper limits (3,), whether round-off is small beside them (3,), ``seconds`` it
    took."""

    words: str
    kind: str
    above: int
    effectivity: Floats
    gap: Floats
    upper: Floats
    clear: NDArray[np.bool_]
    seconds: float


def dashpots(rng: np.random.Generator, model: FEModel, omega: Floats) -> FEModel:
    """``model`` with a dashpot along one bar in two, of random ratios about one of the middle of the band."""
    zeta, middle = 10 ** rng.uniform(-6, np.log10(5e-2)), float(np.sqrt(omega[0] * omega[-1]))
    D, xyz = np.zeros(model.K.shape), model.nodes.xyz
    for a, b in zip(*np.nonzero(np.triu(np.abs(model.K.toarray()[::3, ::3]), 1)), strict=True):
        if rng.uniform() < 0.5:
            v = _along(xyz[a], xyz[b], int(a), int(b), len(D))
            D += 1e6 * 2 * zeta / middle * 10 ** rng.uniform(-1, 1) * np.outer(v, v)
    return replace(model, D=sp.csr_array(D))


def truss(rng: np.random.Generator, nodes: int, held: bool, twins: bool) -> FEModel:
    """Bars between near points of a slender cloud; ``twins`` are two equal halves, joined softly."""
    half = nodes // 2 if twins else nodes
    xyz = rng.uniform(0, 1, (half, 3)) * [1.0, 0.4, 0.3]
    xyz = xyz[np.argsort(xyz[:, 0])]
    bars = {(max(0, b - back), b) for b in range(1, half) for back in (1, 2, 3, 4, 5)}
    K, M = _bars(rng, xyz, sorted(bars), held), np.diag(np.repeat(10 ** rng.uniform(-0.5, 0.5, half), 3))
    if twins:
        xyz = np.vstack([xyz, xyz + np.array([0.0, 0.8, 0.0])])
        K, M = sl.block_diag(K, K), sl.block_diag(M, M)
        soft = 10 ** rng.uniform(-5, -2) * 1e6
        for a in range(half):
            # Bars along the line that joins the twins resist no rigid motion of the whole.
            v = _along(xyz[a], xyz[a + half], a, a + half, len(K))
            K += soft * np.outer(v, v)
            for other in {max(a - 1, 0), min(a + 1, half - 1)} - {a}:
                v = _along(xyz[a], xyz[other + half], a, other + half, len(K))
                K += soft * np.outer(v, v)
    node = np.repeat(np.arange(len(xyz)), 3)
    return FEModel(
        K=sp.csr_array(0.5 * (K + K.T)),
        M=sp.csr_array(M),
        nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz),
        dofs=DofMap(node=node, component=np.tile(np.arange(3), len(xyz))),
    )


def _along(a: Floats, b: Floats, i: int, j: int, size: int) -> Floats:
    v = np.zeros(size)
    direction = (b - a) / np.linalg.norm(b - a)
    v[3 * i : 3 * i + 3], v[3 * j : 3 * j + 3] = -direction, direction
    return v


def _bars(rng: np.random.Generator, xyz: Floats, bars: list[tuple[int, int]], held: bool) -> Floats:
    K = np.zeros((3 * len(xyz), 3 * len(xyz)))
    for a, b in bars:
        if a != b:
            v = _along(xyz[a], xyz[b], a, b, len(K))
            K += 1e6 * rng.uniform(0.3, 3) * np.outer(v, v)
    if held:
        K[:9, :9] += 1e6 * np.eye(9)
    return K


def damping_of(rng: np.random.Generator, kind: str, omega: Floats) -> Damping:
    """Damping of about a random ratio of critical damping in the middle of the band."""
    zeta, middle = 10 ** rng.uniform(-6, np.log10(5e-2)), float(np.sqrt(omega[0] * omega[-1]))
    rayleigh = {"alpha": zeta * middle, "beta": zeta / middle}
    return Damping(
        **{
            "rayleigh": rayleigh,
            "structural": {"structural": 2 * zeta},
            "modal": {"modal": zeta},
            "both": {**rayleigh, "structural": zeta},
            "none": {},
        }[kind]
    )


def bodies_of(problem: Problem, high: float, rng: np.random.Generator) -> list[ReducedModel]:
    """Two bodies of different methods, with other damping spoiled in one out of four."""
    count = len(problem.elastic_modes(below=(2 * np.pi * high) ** 2).eigenvalues)
    m, bodies = problem.B.shape[1], []
    band = [0.0, high]
    tried = [
        Modal(modes=count + 2),
        FreeInterface(modes=max(1, count - int(rng.integers(0, 3)))),
        Krylov(shifts_hz=[0.0, 0.8 * high]),
        Gramian(band_hz=band, order=count + m),
        BalancedTruncation(order=count + m, band_hz=band),
        CraigBampton(modes=count),
    ]
    for number in rng.permutation(len(tried)):
        try:
            bodies.append(tried[number].reduce(problem))
        except (InputError, SolverError):
            continue
        if len(bodies) == 2:
            break
    return bodies


def judged(problem: Problem, reduced: ReducedModel, band: tuple[float, float], words: str) -> Verdict:
    """The certificate of ``reduced`` against dense values."""
    start = time.process_time()
    (certificate,) = certify(problem, [reduced], band, points=10)
    seconds = time.process_time() - start
    omega, true = dense_errors(problem, reduced, band, [limit.at_hz for limit in certificate.limits.values()])
    cell = np.clip(np.searchsorted(certificate.cells_hz[:, 0], omega / (2 * np.pi), side="right") - 1, 0, None)
    upper = np.array([certificate.limits[name].upper for name in MEASURES])
    lower = np.array([certificate.limits[name].lower for name in MEASURES])
    return Verdict(
        words=words,
        kind=certificate.kind,
        above=int((true > certificate.cell_limit[cell]).sum()),
        effectivity=upper / true.max(axis=0),
        gap=upper / np.maximum(lower, 1e-300),
        upper=upper,
        clear=lost_beside(certificate, upper),
        seconds=seconds,
    )


def dense_errors(
    problem: Problem, reduced: ReducedModel, band: tuple[float, float], also_hz: Sequence[float] = ()
) -> tuple[Floats, Floats]:
    """Frequencies (nf,) in rad/s, ``also_hz`` among them, and the true errors (nf, 3) of ``reduced`` there."""
    reference = certified_reference(problem, band)
    loss = problem.damping.structural + 2 * reference.floor
    values, phi = exact_modes(problem.K.toarray(), problem.M.toarray(), problem.rigid.shape[1])
    b = (problem.B.T @ phi).T * problem.motion_scale
    layout = BlockIndex(b.shape[1], list(problem.coupling.columns.values()), symmetric=False)
    body, rows = body_response(reference, reduced, layout).terms, layout.rows(b, b)
    D = None if problem.D is None else phi.T @ problem.D.toarray() @ phi
    d = problem.damping.of_modes(values) if D is None else damping_of_clusters(values, D)[0]
    modes = PoleResidueForm.second_order(values * (1 + 1j * loss), d, rows)
    full_terms = modes if D is None else dashpot_terms(values, D, b, layout)
    z = np.concatenate([terms.z.ravel() for terms in (full_terms, body)])
    beside = z.real[:, None] + np.maximum(np.abs(z.imag), 1e-9 * np.abs(z))[:, None] * np.linspace(-5, 5, BESIDE)
    w = [2 * np.pi * np.linspace(*band, DENSE), beside.ravel(), 2 * np.pi * np.array(also_hz)]
    omega = np.unique(np.concatenate(w))
    omega = omega[(omega >= 2 * np.pi * band[0]) & (omega <= 2 * np.pi * band[1])]
    E, H, e = np.zeros(len(omega)), np.zeros(len(omega)), np.zeros(len(omega))
    for at in range(0, len(omega), AT_ONCE):
        some = slice(at, at + AT_ONCE)
        full = full_terms.at(omega[some])
        E[some], H[some] = (np.sqrt(squares(X).sum(axis=1)) for X in (full - body.at(omega[some]), full))
        e[some] = modes.moduli(omega[some])[0] @ (b**2).sum(axis=1)
    peak = max(_peak(full_terms, omega, at) for at in np.flatnonzero(ALIKE * H.max() < H) if _is_top(H, at))
    return omega, np.stack([E / e, E / max(peak, H.max()), E / H], axis=1)


def dashpot_terms(values: Floats, D: Floats, b: Floats, layout: BlockIndex) -> PoleResidueForm:
    """H of modes with the eigenvalues ``values`` (k,), coupled by ``D`` (k, k), and the loads ``b`` (k, m): its 2 k
    complex poles, each vector y with y' (2 mu + D) y = 1 (Lancaster 1966)."""
    k = len(values)
    mu, Y = np.linalg.eig(np.block([[np.zeros((k, k)), np.eye(k)], [-np.diag(values), -D]]))
    Y = Y[:k]
    Y = Y / np.sqrt((Y * (2 * mu * Y + D @ Y)).sum(axis=0))
    c = Y.T @ b
    return PoleResidueForm.first_order(mu, layout.rows(c, c))


def _is_top(H: Floats, at: int) -> bool:
    return bool(H[at] >= H[max(at - 1, 0)] and H[at] >= H[min(at + 1, len(H) - 1)])


def _peak(terms: PoleResidueForm, omega: Floats, top: int) -> float:
    """The largest response between the samples beside ``top``; there are others of near modes."""
    finer = np.linspace(omega[max(top - 1, 0)], omega[min(top + 1, len(omega) - 1)], 2001)
    top = int(np.linalg.norm(terms.at(finer), axis=1).argmax())
    around = finer[max(top - 1, 0)], finer[min(top + 1, len(finer) - 1)]
    return -float(
        minimize_scalar(
            lambda x: -float(np.linalg.norm(terms.at(np.array([x])))),
            bounds=around,
            method="bounded",
            options={"xatol": 1e-12 * around[1]},
        ).fun
    )


def exact_modes(K: Floats, M: Floats, rigid: int) -> tuple[Floats, Floats]:
    """Eigenvalues and vectors but for the ``rigid`` lowest, corrected in extended precision.

    Those of LAPACK are known to eps of the highest eigenvalue, which hides what certificates of soft models tell.
    """
    theta, phi = long_modes(K, M, rigid)
    return theta.astype(float), phi.astype(float)


def long_modes(K: Floats, M: Floats, rigid: int) -> tuple[NDArray[np.longdouble], NDArray[np.longdouble]]:
    """``exact_modes`` in extended precision."""
    phi = sl.eigh(K, M)[1]
    long = [A.astype(np.longdouble) for A in (K, M, phi)]
    for _ in range(2):
        A, G = (long[2].T @ (matrix @ long[2]) for matrix in long[:2])
        theta = np.diag(A) / np.diag(G)
        gap = theta - theta[:, None]
        # Rigid motions, and modes that LAPACK itself tells apart, stay as they are among themselves.
        apart = np.abs(gap) > 1e-9 * np.maximum(theta, theta[rigid])
        C = np.where(apart, (A - G * theta) / np.where(apart, gap, 1), 0)
        long[2] = long[2] @ (np.eye(len(C)) + C + np.diag((1 - np.diag(G)) / 2))
    theta = (long[2] * (long[0] @ long[2])).sum(axis=0) / (long[2] * (long[1] @ long[2])).sum(axis=0)
    return theta[rigid:], long[2][:, rigid:]


def lost_beside(certificate: Certificate, upper: Floats) -> NDArray[np.bool_]:
    """Whether what is not known of the full response is below a tenth of the limits."""
    return np.asarray(certificate.reference_error.max() < 0.1 * upper)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A random ``problem``, to be closed, a band that ends at ``high`` Hz, and what it is like in ``words``."""

    problem: Problem
    high: float
    words: str


def drawn(rng: np.random.Generator, number: int, own: float = 0.0) -> Drawn:
    """The random model ``number``; a part ``own`` of all has dashpots."""
    while True:
        held, twins, kind = bool(rng.integers(2)), rng.uniform() < 0.3, str(rng.choice(DAMPINGS))
        model = truss(rng, int(rng.integers(12, 41)), held, twins)
        at = rng.permutation(len(model.nodes))[: int(rng.integers(1, 4))]
        inputs = [np.sort(rng.permutation(3)[: int(rng.integers(1, 4))]) for _ in at]
        faces = [
            make_interface(model, name=f"i{n}", nodes=np.array([node]), coupling="direct", components=own.tolist())
            for n, (node, own) in enumerate(zip(at, inputs, strict=True))
        ]
        try:
            with Problem(model, faces) as plain:
                omega = np.sqrt(plain.elastic_modes(count=12).eigenvalues)
            break
        except (InputError, SolverError):
            continue
    high = float(omega[int(rng.integers(4, 10))] * rng.uniform(1.01, 1.1) / (2 * np.pi))
    if own and rng.uniform() < own:
        kind, model = "dashpots", dashpots(rng, model, omega)
    words = f"{number}: {'held' if held else 'free'} {'twins ' if twins else ''}{kind}, {sum(map(len, inputs))} inputs"
    if model.D is not None:
        return Drawn(problem=Problem(model, faces), high=high, words=words)
    return Drawn(problem=Problem(model, faces, damping=damping_of(rng, kind, omega)), high=high, words=words)


def low_end(seed: int, number: int, high: float, part: float) -> float:
    """Where a band up to ``high`` Hz begins: at 0 but for a ``part`` of all models. It changes nothing else."""
    rng = np.random.default_rng([seed, number, 1])
    return float(high * rng.uniform(0.05, 0.9)) if rng.uniform() < part else 0.0


def trial(seed: int, number: int, part: float = 0.0, own: float = 0.0) -> list[Verdict]:
    """Certificates of one random model; a ``part`` of all bands begins above 0 Hz, a part ``own`` of models has
    dashpots."""
    rng = np.random.default_rng([seed, number])
    case = drawn(rng, number, own)
    low = low_end(seed, number, case.high, part)
    words = case.words + (f", from {low / case.high:.2f} of the band" if low else "")
    with case.problem as problem:
        return [
            judged(problem, body, (low, case.high), f"{words}, {body.recipe['method']}")
            for body in bodies_of(problem, case.high, rng)
        ]


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The ``seed`` and the ``numbers`` of the trials that a command line asks for, whether it is one of them ``alone``,
    the part of the bands that begins ``above_zero``, and that of the models with a damping matrix of their ``own``."""

    seed: int
    numbers: Sequence[int]
    alone: bool
    above_zero: float
    own: float


def asked(description: str | None, arguments: list[str]) -> Asked:
    """What a command line asks for."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--above-zero", type=float, default=0.0, help="part of the bands that begins above 0 Hz")
    parser.add_argument("--own", type=float, default=0.0, help="part of the models with dashpots")
    options = parser.parse_args(arguments)
    alone = options.only is not None
    numbers = [options.only] if alone else range(options.start, options.start + options.count)
    return Asked(seed=options.seed, numbers=numbers, alone=alone, above_zero=options.above_zero, own=options.own)


def main(arguments: list[str]) -> int:
    """Run trials and print what they found; the number of values above a limit."""
    options = asked(__doc__, arguments)
    verdicts = []
    for number in options.numbers:
        for verdict in trial(options.seed, number, options.above_zero, options.own):
            verdicts.append(verdict)
            if verdict.above or options.alone:
                figures = f"{verdict.effectivity}, {verdict.gap}, {verdict.upper}"
                sys.stdout.write(f"{verdict.words}: {verdict.above} above, {figures}\n")
        if not options.alone and (number + 1) % 50 == 0:
            told(verdicts)
            sys.stdout.flush()
    return told(verdicts)


def told(verdicts: list[Verdict]) -> int:
    """Print what certificates are like so far; the number of values above a limit."""
    for q, name in enumerate(MEASURES):
        clear = [verdict for verdict in verdicts if verdict.clear[q] and np.isfinite(verdict.upper[q])]
        if clear:
            shown = [
                np.quantile([getattr(verdict, what)[q] for verdict in clear], (0.5, 0.95, 1)).round(3).tolist()
                for what in ("effectivity", "gap")
            ]
            sys.stdout.write(f"{name}: upper over dense {shown[0]}, over lower {shown[1]} ({len(clear)} bodies)\n")
    seconds = np.quantile([verdict.seconds for verdict in verdicts], (0.5, 1)).round(2).tolist()
    above = sum(verdict.above for verdict in verdicts)
    exceeded, proven = sum(verdict.above > 0 for verdict in verdicts), sum(v.kind == "proven" for v in verdicts)
    endless = sum(not np.isfinite(verdict.upper).all() for verdict in verdicts)
    sys.stdout.write(
        f"{len(verdicts)} certificates, {above} values above a limit in {exceeded} of them, {endless} with a measure "
        f"that has none, {seconds} s (median, largest), {proven} proven\n"
    )
    return above


if __name__ == "__main__":
    sys.exit(bool(main(sys.argv[1:])))
