"""Published second-order models, reduced here and by pyMOR, and the errors of both by one independent way.

Inputs and outputs are at the same places, C = B', so that both programs see the same system. ``published.py`` says
where data come from. The H2 error is that of a dense Lyapunov equation of the difference, the H-infinity error the
largest singular value of the difference on a fine grid, refined about its peaks; neither uses code of a reducer.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

import morembs

Floats = NDArray[np.float64]
# Frequencies of the grid, and those about each resonance in half-widths of its peak.
POINTS, ABOUT_PEAK = 2000, np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])
# Seconds beside which those count little that libraries take to load in a first run.
LOADING = 20.0
# Steps of pyMOR's SOR-IRKA and of its inner IRKA.
STEPS = 10
# Shear modulus of the viscoelastic layer at rest (NLEVP 4.1), and damping that its real model has here: 1 % at 50 Hz.
RUBBER, BETA = 350.4e3, 0.02 / (2 * np.pi * 50)


class System(NamedTuple):
    """M u'' + D u' + K u = B q, y = C u."""

    M: Any
    D: Any
    K: Any
    B: Floats
    C: Floats


def _system(M: Any, D: Any, K: Any, B: Floats) -> System:
    return System(*(sp.csc_array(A) for A in (M, D, K)), B, B.T)


def triple_chain(length: int) -> System:
    """Three chains of masses that meet in one, held by a spring at their ends (Truhar and Veselic 2009, example 2).

    Rayleigh damping of 0.002 and three dampers of 5, as M-M.E.S.S. has it, with one input on all masses.
    """
    masses, springs = (1.0, 2.0, 3.0), (10.0, 20.0, 1.0)
    n = 3 * length
    chain = sp.diags_array([np.full(length, 2.0), -np.ones(length - 1), -np.ones(length - 1)], offsets=[0, 1, -1])
    K = sp.block_diag([*(k * chain for k in springs), [[sum(springs) + 50.0]]], format="lil")
    for number, k in enumerate(springs):
        last = (number + 1) * length - 1
        K[last, n] = K[n, last] = -k
    M = sp.diags_array(np.r_[np.repeat(masses, length), 10.0])
    dampers = np.zeros(n + 1)
    dampers[[0, length - 1, 2 * length]] = 5.0
    return _system(M, 0.002 * (M + K) + sp.diags_array(dampers), K, np.ones((n + 1, 1)))


def mass_spring_damper(count: int) -> System:
    """A chain of equal masses, held at its end, each with a damper to the ground and a force on the first, free one
    (Gugercin, Polyuga, Beattie and van der Schaft 2012)."""
    diagonal = np.full(count, 8.0)
    diagonal[0] = 4.0
    K = sp.diags_array([diagonal, np.full(count - 1, -4.0), np.full(count - 1, -4.0)], offsets=[0, 1, -1])
    return _system(4.0 * sp.eye_array(count), sp.eye_array(count), K, np.eye(count)[:, :1])


def sandwich_beam(folder: Path) -> System:
    """A clamped beam with a viscoelastic layer (Van Beeumen and others 2013), its modulus at rest and damping that is
    proportional to K; the force is on the last dof."""
    held = scipy.io.loadmat(str(folder / "sandwich_beam_168.mat"), spmatrix=False)
    M, Ke, Kv = (sp.csc_array(held[name]) for name in ("M", "Ke", "Kv"))
    K = sp.csc_array(Ke + RUBBER * Kv)
    return _system(M, BETA * K, K, np.eye(M.shape[0])[:, -1:])


# Name -> the system, from the folder of data.
MODELS: dict[str, Callable[[Path], System]] = {
    "triple chain": lambda folder: triple_chain(100),
    "mass-spring-damper chain": lambda folder: mass_spring_damper(100),
    "sandwich beam": sandwich_beam,
}


def ours(system: System, method: str, order: int, points: Floats) -> System:
    """The reduced system of morembs."""
    options: dict[str, object] = {"order": order}
    name = method
    if method == "krylov":
        options = {"shifts_hz": (points / (2 * np.pi)).tolist(), "moments": 1}
    elif method == "irka":
        options["band_hz"] = [0.0, float(1.2 * points[-1] / (2 * np.pi))]
    elif method in ("fv", "pv"):
        name, options["variant"] = "balanced-truncation", method
    done = morembs.reduce(system.K, system.M, system.D, B=system.B, method=name, **options)
    return System(done.M, done.D, done.K, done.B, done.C)


def pymor(system: System, method: str, order: int, points: Floats) -> System:
    """The same by pyMOR: bitangential interpolation, SOR-IRKA and balancing of the same variant.

    Raises:
        ImportError: pyMOR is not installed.
    """
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors.interpolation import SOBHIReductor
    from pymor.reductors.sobt import SOBTfvReductor, SOBTpvReductor
    from pymor.reductors.sor_irka import SORIRKAReductor

    set_log_levels({"pymor": "CRITICAL"})
    M, D, K, B, C = system
    full = SecondOrderModel.from_matrices(M, D, K, B, C)
    if method == "krylov":
        width = B.shape[1]
        sigma = np.repeat([s for w in points for s in (1j * w, -1j * w)], width)
        directions = np.tile(np.eye(width, dtype=complex), (2 * len(points), 1))
        reduced = SOBHIReductor(full).reduce(sigma, directions, directions)
    elif method == "irka":
        np.random.seed(0)  # noqa: NPY002
        # Its defaults, 100 steps with 100 inner ones, take minutes where the shifts do not come to rest.
        reduced = SORIRKAReductor(full).reduce(order, maxit=STEPS, irka_options={"maxit": STEPS})
    else:
        reduced = {"fv": SOBTfvReductor, "pv": SOBTpvReductor}[method](full).reduce(order)
    return System(*(np.asarray(A) for A in reduced.to_matrices()[:5]))


def measure(spec: dict[str, Any]) -> dict[str, Any]:
    """One reduction by one program: seconds, order and relative errors; a first run, which loads libraries, is
    not counted."""
    folder, order = Path(spec["data"]), spec["order"]
    try:
        system = MODELS[spec["model"]](folder)
    except FileNotFoundError as error:
        return {"error": f"no {Path(error.filename).name}: see published.py"}
    resonances = np.sqrt(sl.eigh(system.K.toarray(), system.M.toarray(), eigvals_only=True))
    points = np.geomspace(resonances[0], resonances[min(2 * order, len(resonances) - 1)], order // 2)
    way = ours if spec["who"] == "morembs" else pymor
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for _ in range(2):
                start = time.perf_counter()
                reduced = way(system, spec["method"], order, points)
                seconds = time.perf_counter() - start
                if seconds > LOADING:
                    break
        except ImportError:
            return {"error": "not installed: pip install pymor"}
    h2, hinf = errors(system, reduced)
    return {"dofs": len(resonances), "order": len(reduced.M), "seconds": seconds, "h2_error": h2, "hinf_error": hinf}


def errors(full: System, reduced: System) -> tuple[float, float] | tuple[None, None]:
    """H2 and H-infinity norm of the difference over those of ``full``; none where ``reduced`` is unstable."""
    first, second = _states_of_energy(full), _states(reduced)
    if np.linalg.eigvals(second[0]).real.max() >= 0:
        return None, None
    A, B = sl.block_diag(first[0], second[0]), np.vstack([first[1], second[1]])
    C = np.hstack([first[2], -second[2]])
    h2 = [_h2(*system) for system in ((A, B, C), first)]
    omega = _frequencies(np.linalg.eigvals(A))
    H = [_response(system, omega) for system in (full, reduced)]
    difference = np.linalg.norm(H[0] - H[1], 2, axis=(1, 2))
    peaks = difference, np.linalg.norm(H[0], 2, axis=(1, 2))
    functions = (lambda w: _response(full, w) - _response(reduced, w)), (lambda w: _response(full, w))
    hinf = [_refined(omega, size, of) for size, of in zip(peaks, functions, strict=True)]
    return h2[0] / h2[1], hinf[0] / hinf[1]


def _states_of_energy(system: System) -> tuple[Floats, Floats, Floats]:
    """A, B, C of the states (R' x, L' x') with K = R R' and M = L L': both halves have one unit."""
    M, D, K = (A.toarray() for A in system[:3])
    L, R = np.linalg.cholesky(M), np.linalg.cholesky(K)
    half = sl.solve_triangular(L, R, lower=True)
    damping = sl.solve_triangular(L, sl.solve_triangular(L, D, lower=True).T, lower=True)
    F, zero = sl.solve_triangular(L, system.B, lower=True), np.zeros_like(half)
    A = np.block([[zero, half.T], [-half, -damping]])
    outputs = sl.solve_triangular(R, system.C.T, lower=True).T
    return A, np.vstack([0 * F, F]), np.hstack([outputs, 0 * outputs])


def _states(system: System) -> tuple[Floats, Floats, Floats]:
    """A, B, C of the states (x, x') of a reduced system, symmetric or not."""
    M, D, K, B, C = system
    zero = np.zeros_like(M)
    A = np.block([[zero, np.eye(len(M))], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, np.vstack([0 * B, np.linalg.solve(M, B)]), np.hstack([C, 0 * C])


def _h2(A: Floats, B: Floats, C: Floats) -> float:
    P = sl.solve_continuous_lyapunov(A, -B @ B.T)
    return float(np.sqrt(max(np.trace(C @ P @ C.T), 0.0)))


def _frequencies(poles: NDArray[np.complex128]) -> Floats:
    """A grid in rad/s over all ``poles``, dense about each."""
    size = np.abs(poles)
    every = (np.abs(poles.imag)[:, None] - poles.real[:, None] * ABOUT_PEAK).ravel()
    grid = np.geomspace(1e-2 * size.min(), 10 * size.max(), POINTS)
    return np.unique(np.concatenate([[0.0], grid, every[every > 0]]))


def _response(system: System, omega: Floats) -> NDArray[np.complex128]:
    """H (n, m, m) by solves with A(i omega): sparse where the matrices are."""
    M, D, K, B, C = system
    out = np.empty((len(omega), len(C), B.shape[1]), dtype=complex)
    for row, w in enumerate(omega.tolist()):
        A = K + 1j * w * D - w**2 * M
        out[row] = C @ (_solved(A, B) if sp.issparse(A) else np.linalg.solve(A, B))
    return out


def _solved(A: Any, B: Floats) -> NDArray[np.complex128]:
    """A^-1 B of a sparse complex matrix."""
    from scipy.sparse.linalg import splu

    return np.asarray(splu(sp.csc_array(A)).solve(B.astype(complex)))


def _refined(omega: Floats, size: Floats, of: Callable[[Floats], NDArray[np.complex128]]) -> float:
    """The largest value of a curve, from its largest sample and the interval about it."""
    from scipy.optimize import minimize_scalar

    at = int(np.argmax(size))
    low, high = omega[max(at - 1, 0)], omega[min(at + 1, len(omega) - 1)]
    found = minimize_scalar(
        lambda w: -float(np.linalg.norm(of(np.array([w]))[0], 2)), bounds=(low, high), method="bounded"
    )
    return max(float(size[at]), -float(found.fun))
