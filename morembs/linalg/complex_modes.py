"""Lowest complex modes of (s^2 M + s (D + G) + K + N) x = 0, G and N skew and K held, by a block Davidson method.

The space grows by K^-1 r of the residuals r, real and imaginary parts, and projection is by congruence: symmetric
parts stay symmetric and skew ones skew, so that a body without damping has imaginary eigenvalues to the last bit. With
K > 0 and D = 0 the eigenvalues of K - w^2 M + i w G fall wherever they cross zero, so half the negative eigenvalues of
[K - w^2 M, -w G; w G, K - w^2 M] count the frequencies below w (Wittrick and Williams 1973 for gyroscopic bodies).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import InputError, SingularMatrixError, SolverError
from morembs.base.types import Complexes, Floats
from morembs.linalg.columns import m_norms, orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.space import Space
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import Factorization, LinearSolver
from morembs.linalg.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class ComplexModes:
    """``eigenvalues`` s (k,) in 1/s by their size, of each conjugate pair that above the real axis; ``vectors`` (n, k).

    ``residuals`` (k,) are |K^-1 r| / |x| in M. ``verified_below`` rad/s is where a count proved that none is missing,
    0 where there is none; ``no_count`` says why.
    """

    eigenvalues: Complexes
    vectors: Complexes
    residuals: Floats
    verified_below: float
    no_count: str = ""

    @property
    def frequencies(self) -> Floats:
        """Damped frequencies (k,) in rad/s."""
        return np.asarray(self.eigenvalues.imag)

    @property
    def ratios(self) -> Floats:
        """Damping ratios -Re s / |s| (k,)."""
        return np.asarray(-self.eigenvalues.real / np.abs(self.eigenvalues))


def small_complex_modes(K: Floats, M: Floats, C: Floats) -> tuple[Complexes, Complexes]:
    """All eigenvalues s (m,) of s^2 M + s C + K on or above the real axis, by size, and vectors (n, m); dense.

    ``C`` (n, n) is damping and gyroscopic matrix together, ``K`` stiffness and circulatory matrix. Where C is skew and
    K symmetric and positive definite the eigenvalues are imaginary.
    """
    n = len(K)
    skew = np.array_equal(C, -C.T) and np.array_equal(K, K.T)
    nothing = np.zeros((n, n))
    if skew:
        try:
            # diag(K, M) z = w (-i [C, M; -M, 0]) z with z = (x, i w x): both sides Hermitian.
            A, H = np.block([[K, nothing], [nothing, M]]), -1j * np.block([[C, M], [-M, nothing]])
            mu, Z = sl.eigh(H, A)
            mu, Z = mu[n:][::-1], Z[:n, n:][:, ::-1]
            return 1j / mu, Z
        except np.linalg.LinAlgError:
            pass
    L = sl.cho_factor(M)
    A = np.block([[nothing, np.eye(n)], [-sl.cho_solve(L, K), -sl.cho_solve(L, C)]])
    values, Z = sl.eig(A)
    size = np.abs(values)
    values.imag[np.abs(values.imag) <= TOL.real_eigenvalue * size] = 0.0
    if skew:
        values.real[np.abs(values.real) <= TOL.real_eigenvalue * size.max(initial=0.0)] = 0.0
    up = values.imag >= 0
    order = np.argsort(size[up], kind="stable")
    return values[up][order], Z[:n, up][:, order]


def complex_modes(
    K: sp.csr_array,
    M: sp.csr_array,
    *,
    G: sp.csr_array | None = None,
    D: sp.csr_array | None = None,
    N: sp.csr_array | None = None,
    count: int,
    solver: LinearSolver,
    start: Floats | None = None,
) -> ComplexModes:
    """The ``count`` modes of lowest \\|s\\|, with K symmetric and regular.

    Args:
        start: columns (n, j) near the modes, which save steps.

    Peak memory: one factor of K, and about 2 ``TOL.complex_columns_per_mode`` ``count`` columns.

    Raises:
        InputError: more modes than there are.
        SingularMatrixError: K is singular: nothing holds the body.
        SolverError: no convergence, or modes that the count finds missing are not found.
    """
    n = K.shape[0]
    if not 0 < count <= n:
        raise InputError(
            f"{count} complex modes were asked for; expected 1 to {n}, the free degrees of freedom", keyword="count"
        )
    solver = solver if solver.counts else select_solver(scratch=solver.scratch)
    parts = [A for A in (D, G) if A is not None]
    C = sp.csr_array(sum(parts[1:], start=parts[0])) if parts else sp.csr_array((n, n))
    with solver.factorize(K, "symmetric", what="the stiffness of the held body") as factor:
        pencil = _Pencil(K, M, C, N, factor)
        V = _start(pencil, count, start)
        given = {"damping": D, "a circulatory matrix": N}
        why = next((words for words, A in given.items() if A is not None and A.nnz), "")
        why = why or (
            ""
            if factor.negative_pivots() == 0
            else ("the stiffness is indefinite, as it is above the first critical speed")
        )
        for _ in range(TOL.complex_attempts):
            modes, V = _iterate_modes(pencil, V, count)
            cut = "" if why else _cut(modes.frequencies, count)
            if isinstance(cut, str):
                return _first(modes, count, 0.0, why or "the last modes are one cluster")
            count_below = int((modes.frequencies < cut).sum())
            true = frequencies_below(K, M, G, cut, solver)
            if true == count_below:
                return _first(modes, count, cut, "")
            progress.update(f"complex modes: {true} below {cut:.6g} rad/s, {count_below} found")
            V = np.hstack([V, _more(pencil, V, 2 * max(true - count_below, 1))])
    raise SolverError(
        f"a count finds {true} complex modes below {cut:.6g} rad/s, the eigensolver {count_below}; ask for a few "
        "modes more"
    )


def frequencies_below(K: sp.csr_array, M: sp.csr_array, G: sp.csr_array | None, w: float, solver: LinearSolver) -> int:
    """Number of frequencies of s^2 M + s G + K below ``w`` rad/s, K positive definite and G skew."""
    A = sp.csr_array(K - w * w * M)
    if G is None or not G.nnz:
        return solver.negative_eigenvalues(A, "K - w^2 M")
    doubled = sp.kron(A, sp.eye_array(2)) + sp.kron(w * G, sp.csr_array(np.array([[0.0, -1.0], [1.0, 0.0]])))
    return solver.negative_eigenvalues(sp.csr_array(doubled), "K - w^2 M + i w G") // 2


@dataclass(frozen=True, eq=False)
class _Pencil:
    K: sp.csr_array
    M: sp.csr_array
    C: sp.csr_array
    N: sp.csr_array | None
    factor: Factorization

    def corrections(self, s: Complexes, X: Complexes) -> Complexes:
        """K^-1 (s^2 M + s C + K + N) x of each column."""
        R = (self.M @ X) * s**2 + (self.C @ X) * s
        if self.N is not None:
            R += self.N @ X
        both = self.factor.solve(np.hstack([R.real, R.imag]))
        return np.asarray(both[:, : X.shape[1]] + 1j * both[:, X.shape[1] :] + X)


def _start(pencil: _Pencil, count: int, given: Floats | None) -> Floats:
    n = pencil.M.shape[0]
    V = orthonormal(given, pencil.M) if given is not None else np.zeros((n, 0))
    return np.hstack([V, _more(pencil, V, min(count + TOL.complex_modes_beyond, n) - min(V.shape[1], count))])


def _more(pencil: _Pencil, V: Floats, count: int) -> Floats:
    """``count`` columns near the softest motions, M-orthonormal to those of ``V``."""
    X = np.random.default_rng(5).standard_normal((len(V), max(count, 1)))
    for _ in range(2):
        X = pencil.factor.solve(pencil.M @ X)
        X /= m_norms(X, pencil.M @ X)
    return Space(pencil.M).complement(V, X)


def _iterate_modes(pencil: _Pencil, V: Floats, count: int) -> tuple[ComplexModes, Floats]:
    """The lowest ``count`` modes and some beyond, those unconverged, and the space that they are from."""
    wanted, history = min(count + TOL.complex_modes_beyond, len(V)), list[float]()
    for step in range(TOL.complex_steps):
        Kv, Mv, Cv = (_project(V, A) for A in (pencil.K, pencil.M, pencil.C))
        # To the last bit, by which a body without damping is known.
        Kv = symmetric(Kv)
        values, Y = small_complex_modes(Kv if pencil.N is None else Kv + _project(V, pencil.N), Mv, Cv)
        # A pair of s and its conjugate has one mode, two real s have one each.
        s, X = values[:wanted], V @ Y[:, :wanted]
        X /= m_norms(X, pencil.M @ X)
        Z = pencil.corrections(s, X)
        residuals = m_norms(Z, pencil.M @ Z)
        open_ = residuals > TOL.complex_residual
        progress.update(f"complex modes: step {step + 1}, {int((~open_[:count]).sum())} of {count}")
        history.append(float(residuals[:count].max()))
        before = history[: -TOL.stalled_complex_steps]
        stuck = bool(before) and history[-1] > 0.5 * min(before)
        if not open_[:count].any() or V.shape[1] == len(V) or (stuck and history[-1] <= TOL.stalled_complex_residual):
            return ComplexModes(eigenvalues=s, vectors=X, residuals=residuals, verified_below=0.0), V
        if V.shape[1] + 2 * open_.sum() > max(TOL.complex_columns_per_mode * wanted, 2 * wanted + 40):
            V = orthonormal(np.hstack([X.real, X.imag]), pencil.M)
        Z = Z[:, open_]
        added = Space(pencil.M).complement(V, np.hstack([Z.real, Z.imag]))
        if not added.shape[1] or (stuck and len(history) > 5 * TOL.stalled_complex_steps):
            break
        V = np.hstack([V, added])
    raise SolverError(
        f"the complex modes converge to {residuals[:count].max():.1e} only (needed {TOL.complex_residual:.0e}); "
        "ask for fewer"
    )


def _project(V: Floats, A: sp.csr_array) -> Floats:
    """V' A V, its symmetric and its skew part as exact as those of ``A``."""
    P = V.T @ (A @ V)
    Q = V.T @ (A.T @ V)
    S, Z = 0.5 * (P + Q), 0.5 * (P - Q)
    return np.asarray(symmetric(S) + 0.5 * (Z - Z.T))


def _cut(w: Floats, count: int) -> float | str:
    """A frequency in the first gap behind mode ``count``, or in the last before it; "" without any."""
    for k in (*range(count, len(w)), *range(count - 1, 0, -1)):
        if w[k] - w[k - 1] > TOL.frequency_gap * w[k]:
            return float(0.5 * (w[k] + w[k - 1]))
    return ""


def _first(modes: ComplexModes, count: int, below: float, why: str) -> ComplexModes:
    return ComplexModes(
        eigenvalues=modes.eigenvalues[:count],
        vectors=modes.vectors[:, :count],
        residuals=modes.residuals[:count],
        verified_below=min(below, float(modes.frequencies[count])) if len(modes.frequencies) > count else below,
        no_count=why,
    )


__all__ = ["ComplexModes", "SingularMatrixError", "complex_modes", "frequencies_below", "small_complex_modes"]
