"""Random small supported, partly supported and free models over twelve decades of stiffness, against a dense solution.

    python benchmarks/attack/structured.py --count 500 --seed 1
    python benchmarks/attack/structured.py --seed 1 --only 17

Every model is made in extended precision (64-bit mantissa), rounded to the double matrices that the program gets, and
solved in extended precision too: eigenvalues by inverse iteration, transfer functions by elimination. The program must
deliver the same frequencies and transfer functions, or refuse with a message. What rounding the entries of K to double
may do to a mode, eps |phi|' |K| |phi|, is no fault of it.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import sys
import time
import traceback
from collections import Counter
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import MorembsError
from morembs.base.types import Floats
from morembs.certificate.certify import certify
from morembs.fem import DofMap, FEModel, Nodes, rigid_motion
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import AutoReducer, CraigBampton, Modal
from morembs.reducers.base import ReducedModel
from morembs.responses.tolerances import TOL as RESPONSES

Long = NDArray[np.longdouble]
EPS = float(np.finfo(float).eps)
DECADES = 12
SUPPORTS = ("free", "one direction", "point", "hinge", "all", "everywhere")
FAMILIES = ("springs", "beams", "solid")
# Relative error that no double solution needs to beat, and how many times the rounding of K a mode may be off.
FINE, ROUNDING = 1e-5, 4.0
# No more than this, whatever the rounding: the program has to refuse then.
WRONG = 1e-2
MODES = 8
# Tolerance of method "auto", and how many times the rounding of K at a resonance of the damping that it assumes.
TOLERANCE, ABOVE = 1e-4, 10.0


@dataclass(frozen=True, kw_only=True)
class Case:
    """``K`` (N, N) in extended precision, ``M`` and coordinates in double; ``decade`` of its ratio of stiffnesses."""

    K: Long
    M: Floats
    xyz: Floats
    dofs: DofMap
    decade: int
    free: int
    words: str

    def model(self) -> FEModel:
        """What the program gets."""
        return FEModel(
            K=sp.csr_array(self.K.astype(float)),
            M=sp.csr_array(self.M),
            dofs=self.dofs,
            nodes=Nodes(ids=np.arange(1, len(self.xyz) + 1), xyz=self.xyz),
        )


def random_case(rng: np.random.Generator, largest: int = 200) -> Case:
    """A connected structure of up to ``largest`` dofs, links far stiffer, a ground far softer, in random units."""
    family, support = str(rng.choice(FAMILIES)), str(rng.choice(SUPPORTS))
    make = {"springs": _springs, "beams": _beams, "solid": _solid}[family]
    while True:
        xyz, component, node, K, M = make(rng)
        if len(K) > largest:
            continue
        dofs = DofMap(node=node, component=component)
        base = float(np.median(np.diag(K)[component < 3]))
        spread = float(rng.uniform(0, DECADES))
        above = spread * float(rng.choice([0.0, 0.5, 1.0]))
        G = _ground(rng, support, xyz, dofs)
        R = rigid_motion(xyz[node] - xyz.mean(axis=0), component)
        R[:, 3:] /= np.linalg.norm(np.ptp(xyz, axis=0))
        s = np.linalg.svd(np.vstack([G.astype(float) @ R, np.zeros((6, 6))]), compute_uv=False)
        held = int((s > 1e-6 * max(s.max(), 1e-300)).sum())
        # Supports that are all but dependent are a matter of their own.
        if not held or s[held - 1] > 1e-2 * s[0]:
            break
    soft = np.longdouble(base * 10 ** (above - spread))
    K = K + soft * G.T @ (np.diag(rng.uniform(0.5, 2.0, len(G))) @ G) if len(G) else K
    if above:
        for _ in range(int(rng.integers(1, 3))):
            v = _link(rng, xyz, dofs)
            K = K + np.longdouble(base * 10**above) * np.outer(v, v)
    # Units: lengths, forces and masses, each by a random power of ten; rotations stay.
    length, force, mass = 10.0 ** rng.uniform(-3, 3, 3)
    units = np.where(component < 3, 1.0, length)
    K = K * np.outer(units, units).astype(np.longdouble) * np.longdouble(force)
    M = M * np.outer(units, units) * mass
    words = f"{family} of {len(K)} dofs, support: {support}, stiffness ratio 1e{spread:.1f}"
    return Case(K=K, M=M, xyz=xyz * length, dofs=dofs, decade=int(spread), free=6 - held, words=words)


def _springs(rng: np.random.Generator) -> tuple[Floats, NDArray, NDArray, Long, Floats]:  # type: ignore[type-arg]
    """Point masses, each joined to all that came before by bars."""
    n = int(rng.integers(5, 14))
    xyz = rng.uniform(-1, 1, (n, 3))
    K = np.zeros((3 * n, 3 * n), dtype=np.longdouble)
    for b in range(1, n):
        for a in rng.permutation(b)[:6]:
            v = _bar(xyz, int(a), b, 3 * n, 3)
            K += np.longdouble(1e5 * rng.uniform(0.3, 3)) * np.outer(v, v)
    M = np.diag(np.repeat(10 ** rng.uniform(-0.7, 0.7, n), 3))
    return xyz, np.tile(np.arange(3), n), np.repeat(np.arange(n), 3), K, M


def _beams(rng: np.random.Generator) -> tuple[Floats, NDArray, NDArray, Long, Floats]:  # type: ignore[type-arg]
    """A polygon of Euler-Bernoulli beams with lumped masses."""
    n = int(rng.integers(3, 9))
    xyz = np.cumsum(rng.uniform(0.2, 1.0, (n, 3)) * rng.choice([-1, 1, 1], (n, 3)), axis=0)
    K, M = np.zeros((6 * n, 6 * n), dtype=np.longdouble), np.zeros((6 * n, 6 * n))
    for a in range(n - 1):
        at = np.arange(6 * a, 6 * a + 12)
        K[np.ix_(at, at)] += _beam(xyz[a], xyz[a + 1], 1e6, 1e4 * rng.uniform(0.3, 3), 2e4 * rng.uniform(0.3, 3), 1e4)
    for a in range(n):
        mass = 10 ** rng.uniform(-0.5, 0.5)
        M[6 * a : 6 * a + 6, 6 * a : 6 * a + 6] = np.diag(mass * np.array([1, 1, 1, 0.02, 0.03, 0.04]))
    return xyz, np.tile(np.arange(6), n), np.repeat(np.arange(n), 6), K, M


def _beam(a: Floats, b: Floats, EA: float, EIy: float, EIz: float, GJ: float) -> Long:
    """(12, 12) from its flexibility at ``b`` with ``a`` clamped, and the rigid motion that carries b to a."""
    length = np.linalg.norm((b - a).astype(np.longdouble))
    x = (b - a).astype(np.longdouble) / length
    y = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))].astype(np.longdouble))
    y /= np.sqrt((y * y).sum())
    z = np.cross(x, y)
    S = np.zeros((6, 6), dtype=np.longdouble)
    S[0, 0], S[3, 3] = EA / length, GJ / length
    for u, t, EI, sign in ((1, 5, EIz, -1), (2, 4, EIy, 1)):
        S[u, u], S[t, t] = 12 * EI / length**3, 4 * EI / length
        S[u, t] = S[t, u] = sign * 6 * EI / length**2
    axes = np.zeros((6, 6), dtype=np.longdouble)
    axes[:3, :3] = axes[3:, 3:] = np.array([x, y, z])
    carry = np.eye(6, dtype=np.longdouble)
    d = (b - a).astype(np.longdouble)
    carry[:3, 3:] = -np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]])
    # What b moves beyond the rigid motion of a.
    J = axes @ np.hstack([-carry, np.eye(6, dtype=np.longdouble)])
    return np.asarray(J.T @ S @ J)


def _solid(rng: np.random.Generator) -> tuple[Floats, NDArray, NDArray, Long, Floats]:  # type: ignore[type-arg]
    """A warped block of linear tetrahedra, six to a cell."""
    cells = rng.integers(1, 3, 3)
    grid = np.stack(np.meshgrid(*(np.arange(k + 1) for k in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    number = {tuple(p): i for i, p in enumerate(grid.tolist())}
    xyz = (grid + rng.uniform(-0.15, 0.15, grid.shape)) * rng.uniform(0.05, 1.0, 3)
    n = len(grid)
    K, M = np.zeros((3 * n, 3 * n), dtype=np.longdouble), np.zeros((n, n))
    C = np.diag([0.8, 0.8, 0.8, 0.4, 0.4, 0.4])
    C[:3, :3] += 0.6
    for cell in np.ndindex(*cells):
        for steps in itertools.permutations(np.eye(3, dtype=int)):
            corners = np.array(cell) + np.vstack([np.zeros((1, 3), dtype=int), np.cumsum(steps, axis=0)])
            nodes = [number[tuple(c)] for c in corners.tolist()]
            x = xyz[nodes].astype(np.longdouble)
            J = x[1:] - x[0]
            dx, volume = np.zeros((4, 3), dtype=np.longdouble), abs((J[0] * np.cross(J[1], J[2])).sum()) / 6
            dx[1:] = _inverse(J).T
            dx[0] = -dx[1:].sum(axis=0)
            strain = np.zeros((6, 12), dtype=np.longdouble)
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                strain[i, i::3] = dx[:, i]
                strain[3 + i, j::3], strain[3 + i, k::3] = dx[:, k], dx[:, j]
            at = (3 * np.array(nodes)[:, None] + np.arange(3)).ravel()
            K[np.ix_(at, at)] += 1e9 * volume * strain.T @ C @ strain
            M[np.ix_(nodes, nodes)] += 1e3 * float(volume) / 20 * (1 + np.eye(4))
    return xyz, np.tile(np.arange(3), n), np.repeat(np.arange(n), 3), K, np.kron(M, np.eye(3))


def _inverse(J: Long) -> Long:
    """(3, 3) inverse by cofactors."""
    columns = [np.cross(J[(i + 1) % 3], J[(i + 2) % 3]) for i in range(3)]
    return np.asarray(np.array(columns).T / (J[0] * columns[0]).sum())


def _bar(xyz: Floats, a: int, b: int, size: int, step: int) -> Long:
    v = np.zeros(size, dtype=np.longdouble)
    d = (xyz[b] - xyz[a]).astype(np.longdouble)
    d /= np.sqrt((d * d).sum())
    v[step * a : step * a + 3], v[step * b : step * b + 3] = -d, d
    return v


def _link(rng: np.random.Generator, xyz: Floats, dofs: DofMap) -> Long:
    """A bar between two random nodes."""
    a, b = rng.choice(len(xyz), 2, replace=False)
    return _bar(xyz, int(a), int(b), len(dofs), len(dofs) // len(xyz))


def _ground(rng: np.random.Generator, support: str, xyz: Floats, dofs: DofMap) -> Long:
    """Directions (g, N) of springs to the ground."""
    n, step = len(xyz), len(dofs) // len(xyz)
    some = rng.permutation(n)
    unit = np.eye(len(dofs), dtype=np.longdouble)
    if support == "free":
        return unit[:0]
    if support == "one direction":
        return unit[step * some[: int(rng.integers(1, n + 1))] + int(rng.integers(3))]
    if support in ("point", "hinge"):
        nodes = some[: 1 if support == "point" else 2]
        return unit[(step * nodes[:, None] + np.arange(3)).ravel()]
    if support == "everywhere":
        return unit[(step * np.arange(n)[:, None] + np.arange(3)).ravel()]
    rows = []
    for a in rng.integers(0, n, 8):
        direction = rng.standard_normal(3).astype(np.longdouble)
        rows.append(direction @ unit[step * a : step * a + 3])
    return np.array(rows)


class Eliminated:
    """A^-1 in extended precision: equilibrated, partial pivoting."""

    def __init__(self, A: Long) -> None:
        self.scale = 1 / np.sqrt(np.maximum(np.abs(A).max(axis=1), np.finfo(float).tiny))
        A = A * np.outer(self.scale, self.scale)
        self.order = np.arange(len(A))
        for k in range(len(A)):
            p = k + int(np.argmax(np.abs(A[k:, k])))
            A[[k, p]], self.order[[k, p]] = A[[p, k]], self.order[[p, k]]
            A[k + 1 :, k] /= A[k, k]
            A[k + 1 :, k + 1 :] -= np.outer(A[k + 1 :, k], A[k, k + 1 :])
        self.LU = A

    def solve(self, B: Long) -> Long:
        """A^-1 B."""
        X = (B * self.scale[:, None])[self.order]
        for k in range(len(X)):
            X[k] -= self.LU[k, :k] @ X[:k]
        for k in range(len(X) - 1, -1, -1):
            X[k] = (X[k] - self.LU[k, k + 1 :] @ X[k + 1 :]) / self.LU[k, k]
        return np.asarray(X * self.scale[:, None])


def exact_modes(case: Case) -> tuple[Floats, Floats]:
    """The lowest eigenvalues and vectors (N, m), rigid motions first, by inverse iteration in extended precision."""
    K, M = case.K, case.M.astype(np.longdouble)
    values, V = sl.eigh(K.astype(float), case.M)
    highest, p = float(values[-1]), min(case.free + MODES + 10, len(K))
    V = V[:, :p].astype(np.longdouble)
    for shift in (1e-13 * highest, None):
        # Rigid motions have no stiffness; the last shift stays far below what is wanted.
        sigma = np.longdouble(shift or 0.03 * values[case.free])
        inverse = Eliminated(K + sigma * M)
        for _ in range(4):
            V = inverse.solve(M @ V)
            for k in [*range(p), *range(p)]:
                V[:, k] -= V[:, :k] @ (V[:, :k].T @ (M @ V[:, k]))
                V[:, k] /= np.sqrt(V[:, k] @ (M @ V[:, k]))
            V = V @ _jacobi(np.asarray(V.T @ (M @ inverse.solve(M @ V))))
            values = np.array([float(v @ (K @ v) / (v @ (M @ v))) for v in V.T])
    values[: case.free] = 0.0
    return values[: case.free + MODES], np.asarray(V[:, : case.free + MODES], dtype=float)


def _jacobi(T: Long) -> Long:
    """Eigenvectors of a small symmetric matrix, the largest value first; graded ones keep their digits."""
    T, Y = 0.5 * (T + T.T), np.eye(len(T), dtype=np.longdouble)
    for _ in range(12):
        off = np.abs(T) / np.sqrt(np.abs(np.outer(np.diag(T), np.diag(T))))
        pairs = [(i, j) for i, j in itertools.combinations(range(len(T)), 2) if off[i, j] > 1e-18]
        for i, j in pairs:
            t = (T[j, j] - T[i, i]) / (2 * T[i, j]) if T[i, j] else np.longdouble(np.inf)
            t = (1 if t >= 0 else -1) / (abs(t) + np.sqrt(1 + t * t))
            c = 1 / np.sqrt(1 + t * t)
            turn = np.array([[c, t * c], [-t * c, c]])
            T[:, [i, j]] = T[:, [i, j]] @ turn
            T[[i, j]] = turn.T @ T[[i, j]]
            Y[:, [i, j]] = Y[:, [i, j]] @ turn
    return np.asarray(Y[:, np.argsort(-np.diag(T))])


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """ "right", "refused" or "wrong", and why; ``error`` is the largest relative one, ``allowed`` its limit."""

    kind: str
    words: str
    error: float = 0.0


def check(case: Case, rng: np.random.Generator, *, automatic: bool) -> Verdict:
    """What the program makes of ``case``."""
    every, vectors = exact_modes(case)
    rounding = EPS * np.einsum("ij,ij->j", np.abs(vectors), np.abs(case.K).astype(float) @ np.abs(vectors))
    values = every[case.free :]
    # Half a mode away from the next, and far below the first.
    omega = np.sqrt(values[0]) * np.array([0.03, 0.5]), np.sqrt(values[0]) + 0.4 * np.diff(np.sqrt(values[:2]))
    omega = np.concatenate(omega)
    at = np.sort(rng.choice(len(case.xyz), 3, replace=False))
    model = case.model()
    interfaces = [make_interface(model, name=str(a), nodes=np.array([a]), coupling="direct") for a in at]
    near = np.abs(every[:, None] - omega**2)
    slack = FINE + ROUNDING * (rounding[:, None] / near).max(axis=0)
    # No program can promise a response to less than the rounding of K makes of it.
    lost = rounding[case.free :] / (2 * RESPONSES.damping_floor * values)
    tolerance = min(max(TOLERANCE, ABOVE * float(lost[np.sqrt(values) < 1.1 * omega[-1]].max())), WRONG)
    worst = 0.0
    try:
        with Problem(model, interfaces) as problem:
            if problem.rigid.shape[1] != case.free:
                return Verdict(kind="wrong", words=f"{problem.rigid.shape[1]} rigid motions, {case.free} expected")
            B, S = problem.B.toarray(), np.outer(problem.motion_scale, problem.motion_scale)
            bodies = [Modal(modes=MODES if len(B) - case.free > MODES else 2).reduce(problem)]
            bodies.append(_whole(problem))
            if automatic:
                bodies.append(_automatic(problem, omega, tolerance))
    except MorembsError as error:
        return Verdict(kind="refused", words=str(error))
    H = _responses(case.K, case.M, B, B.T, omega)
    for body in bodies:
        if body.recipe["method"] != "auto":
            frequencies = _frequencies(body, 0.03 * values[0])[case.free :][: len(values)]
            off = np.abs(frequencies / values[: len(frequencies)] - 1) / 2
            limit = np.minimum(FINE + ROUNDING * rounding[case.free :] / values, WRONG)[: len(frequencies)]
            worst = max(worst, float(off.max()))
            if not (off <= limit).all():
                k = int(np.argmax(off / limit))
                return Verdict(
                    kind="wrong", error=worst, words=f"{body.name}: mode {k} off by {off[k]:.1e}, limit {limit[k]:.1e}"
                )
        if body.recipe["method"] == "modal":
            continue
        reduced = _responses(body.K, body.M, body.B, body.C, omega)
        off = np.linalg.norm((reduced - H) * S, axis=(1, 2)) / np.linalg.norm(H * S, axis=(1, 2))
        limit = np.minimum(slack + (tolerance if body.recipe["method"] == "auto" else 0.0), WRONG)
        worst = max(worst, float(off.max()))
        if not (off <= limit).all():
            k = int(np.argmax(off / limit))
            return Verdict(
                kind="wrong", error=worst, words=f"{body.name}: H off by {off[k]:.1e} at {k}, limit {limit[k]:.1e}"
            )
    return Verdict(kind="right", words="", error=worst)


def _frequencies(body: ReducedModel, shift: float) -> Floats:
    """Eigenvalues of the delivered matrices: vectors of the inverse pencil, which has the lowest ones to most digits,
    and their Rayleigh quotients in extended precision, which have the others too."""
    V = sl.eigh(body.M, body.K + shift * body.M)[1][:, ::-1].astype(np.longdouble)
    energies = ((V * (A.astype(np.longdouble) @ V)).sum(axis=0) for A in (body.K, body.M))
    return np.asarray(next(energies) / next(energies), dtype=float)


def _whole(problem: Problem) -> ReducedModel:
    """All coordinates of the model in Craig and Bampton's form: nothing is cut."""
    return CraigBampton(modes=problem.K.shape[0] - problem.B.shape[1]).reduce(problem)


def _automatic(problem: Problem, omega: Floats, tolerance: float) -> ReducedModel:
    """A body chosen by itself to ``tolerance``, with a certificate that must not contradict itself."""
    band = [float(omega[0]) / 7, float(omega[-1]) / 6]
    body = AutoReducer(band_hz=band, tolerance=tolerance, measure="pointwise").reduce(problem)
    (certificate,) = certify(problem, [body], band, points=9)
    limit = certificate.limits["pointwise"].upper
    if not certificate.error.max() <= limit:
        raise ArithmeticError(f"limit {limit:.3e} below the measured error {certificate.error.max():.3e}")
    return body


def _responses(K: Floats | Long, M: Floats, B: Floats, C: Floats, omega: Floats) -> Floats:
    """H (nf, m, p) at ``omega`` (nf,), eliminated in extended precision; its double value."""
    K, M = K.astype(np.longdouble), M.astype(np.longdouble)
    responses = [C @ Eliminated(K - np.longdouble(w) ** 2 * M).solve(B.astype(np.longdouble)) for w in omega]
    return np.array(responses).astype(float)


def main(
    count: int, seed: int, *, only: int | None = None, automatic: int = 10, largest: int = 200
) -> list[tuple[Case, Verdict]]:
    """The verdicts on ``count`` models of ``seed`` of up to ``largest`` dofs.

    ``automatic``: every how many go through method "auto" too.
    """
    verdicts = []
    for number in range(count) if only is None else [only]:
        rng = np.random.default_rng([seed, number])
        case = random_case(rng, largest)
        try:
            verdict = check(case, rng, automatic=number % automatic == 0)
        except Exception as error:
            # Any other error than the program's own is a fault of it too.
            verdict = Verdict(kind="wrong", words=f"{type(error).__name__}: {error}")
            if only is not None:
                traceback.print_exc()
        verdicts.append((case, verdict))
        if verdict.kind != "right" or only is not None:
            _say(f"{verdict.kind}: --seed {seed} --only {number}: {case.words}: {verdict.words} ({verdict.error:.1e})")
    return verdicts


def table(verdicts: list[tuple[Case, Verdict]]) -> str:
    """Right, refused and wrong models and the largest error of the right ones, for each decade of stiffness ratio."""
    lines = ["decade  right  refused  wrong  largest error"]
    for decade in range(DECADES):
        some = [verdict for case, verdict in verdicts if case.decade == decade]
        kinds = Counter(verdict.kind for verdict in some)
        worst = max((v.error for v in some if v.kind == "right"), default=0.0)
        lines.append(f"1e{decade:<5d} {kinds['right']:5d} {kinds['refused']:8d} {kinds['wrong']:6d}  {worst:.1e}")
    return "\n".join(lines)


def _say(words: str) -> None:
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, default=None, help="one model of the seed")
    given = parser.parse_args()
    logging.disable(logging.WARNING)
    began = time.perf_counter()
    results = main(given.count, given.seed, only=given.only)
    _say(f"seed {given.seed}, {len(results)} models, {time.perf_counter() - began:.0f} s\n{table(results)}")
    for words, number in Counter(v.words[:110] for _, v in results if v.kind == "refused").most_common(6):
        _say(f"{number} refused: {words} ...")
    sys.exit(any(v.kind == "wrong" for _, v in results))
