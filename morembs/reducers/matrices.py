"""From matrices to a reduced system in one call, for those who bring K, M and B and no mesh."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import ArgumentError, InputError, nearest
from morembs.base.optional import optional
from morembs.base.summary import summarised
from morembs.base.types import Complexes, Floats
from morembs.fem.interface import Interface, matrix_interface
from morembs.importers.matrices.from_matrices import from_matrices
from morembs.problem import Damping, Problem
from morembs.reducers import REDUCERS
from morembs.reducers.base import ReducedModel, Reducer
from morembs.reducers.tolerances import TOL

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedSystem:
    """M q'' + D q' + K q = B u, y = C q of matrices that were reduced; ``V`` q are the coordinates of the full system.

    ``M``, ``D``, ``K`` (n, n), ``B`` (n, m), ``C`` (p, n), ``V`` (N, n). With a loss factor
    the stiffness is (1 + i ``structural``) K. ``model`` is the same with all inputs and outputs as ports.

    >>> K, M, B = model.K, model.M, np.eye(model.size)[:, -1:]
    >>> system = reduce(K, M, B=B, method="krylov", order=8)
    >>> system.frequency_response([100.0, 200.0]).shape
    (2, 1, 1)
    """

    M: Floats
    D: Floats
    K: Floats
    B: Floats
    C: Floats
    V: Floats
    model: ReducedModel
    structural: float = 0.0

    def _facts(self) -> dict[str, object]:
        return {
            "order": self.order,
            "method": self.model.recipe["method"],
            "inputs": self.B.shape[1],
            "outputs": len(self.C),
        }

    @property
    def order(self) -> int:
        """Number of coordinates."""
        return len(self.K)

    def frequency_response(self, frequencies_hz: Any) -> Complexes:
        """Transfer matrices H (nf, p, m) at ``frequencies_hz`` (nf,), rigid motion included."""
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
        K = (1 + 1j * self.structural) * self.K
        H = [self.C @ np.linalg.solve(K + 1j * each * self.D - each**2 * self.M, self.B.astype(complex)) for each in w]
        return np.asarray(H, dtype=np.complex128).reshape(len(w), len(self.C), self.B.shape[1])

    def bode(self, frequencies_hz: Any) -> tuple[Floats, Floats]:
        """Magnitudes (nf, p, m) in dB and unwrapped phases (nf, p, m) in degrees at ``frequencies_hz`` (nf,)."""
        H = self.frequency_response(frequencies_hz)
        with np.errstate(divide="ignore"):
            return 20 * np.log10(np.abs(H)), np.degrees(np.unwrap(np.angle(H), axis=0))

    def frequencies_hz(self) -> Floats:
        """Undamped eigenfrequencies (n,), ascending."""
        return np.sqrt(np.maximum(self.model.modes()[0], 0.0)) / (2 * np.pi)

    def plot(self, frequencies_hz: Any = None) -> Figure:
        """Bode plot of every output over every input, by default from below the first mode to beyond the last."""
        from matplotlib.figure import Figure

        f = self._shown() if frequencies_hz is None else np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
        magnitude, phase = self.bode(f)
        figure = Figure(layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True)
        for i in range(len(self.C)):
            for j in range(self.B.shape[1]):
                upper.semilogx(f, magnitude[:, i, j], label=f"output {i + 1}, input {j + 1}")
                lower.semilogx(f, phase[:, i, j])
        upper.set_ylabel("magnitude in dB")
        lower.set_ylabel("phase in degrees")
        lower.set_xlabel("frequency in Hz")
        if len(self.C) * self.B.shape[1] > 1:
            upper.legend()
        return figure

    def _shown(self) -> Floats:
        own = self.frequencies_hz()
        elastic = own[own > TOL.shown_frequency * own[-1]]
        return np.geomspace(elastic[0] / 10, 2 * elastic[-1], TOL.shown_points)

    def _first_order(self) -> tuple[Floats, Floats, Floats, Floats]:
        if self.structural:
            raise InputError(
                f"the system has a loss factor, structural = {self.structural:g}, which has no place in the time "
                "domain; take Damping(modal=...) or Damping(beta=...)"
            )
        n, zero = self.order, np.zeros((self.order, self.order))
        lower = -np.linalg.solve(self.M, np.hstack([self.K, self.D]))
        return (
            np.vstack([np.hstack([zero, np.eye(n)]), lower]),
            np.vstack([np.zeros_like(self.B), np.linalg.solve(self.M, self.B)]),
            np.hstack([self.C, np.zeros_like(self.C)]),
            np.zeros((len(self.C), self.B.shape[1])),
        )

    def to_scipy(self) -> Any:
        """``scipy.signal.StateSpace`` with the states q, q'.

        Raises:
            InputError: structural damping.
        """
        from scipy.signal import StateSpace

        return StateSpace(*self._first_order())

    def to_control(self) -> Any:
        """``control.StateSpace`` with the states q, q'.

        Raises:
            InputError: structural damping, or python-control is not installed.
        """
        control = optional("control", "to_control()")
        return control.StateSpace(*self._first_order())


def reduce(
    K: Any = None,
    M: Any = None,
    D: Any = None,
    *,
    B: Any = None,
    C: Any = None,
    method: str = "modal",
    damping: Damping | None = None,
    **options: Any,
) -> ReducedSystem:
    """Reduce M u'' + D u' + K u = B q, y = C u.

    Args:
        K, M, D: (N, N) symmetric matrices of SciPy (any format) or NumPy, vectors (N,) of their diagonals, or nested
            lists; D may be left out.
        B: (N, m) inputs; methods other than "modal" need them.
        C: (p, N) outputs, B' without it.
        method: a name of ``REDUCERS``: "modal", "craig-bampton", "krylov", "balanced-truncation", "irka", ...
        damping: in addition to D.
        options: those of the method, such as modes=20, order=20, up_to_hz=500.0, band_hz=[0, 500].

    Raises:
        InputError: matrices, a method or options that cannot be used.
        SolverError: a factorisation or an iteration failed.

    >>> tip = np.eye(model.size)[:, -1:]
    >>> system = reduce(model.K, model.M, B=tip, method="gramian", band_hz=[0, 5000], order=6)
    >>> system
    ReducedSystem: order 12; method gramian; inputs 1; outputs 1
    >>> system.to_scipy().A.shape
    (24, 24)
    """
    check_value("reduce: method", method, str)
    if {"A", "E"} & set(options):
        raise ArgumentError(
            "a first-order system E x' = A x + B u was given; expected K, M, D, B and C of M u'' + D u' + K u = B q; "
            "pymor.models.iosys.LTIModel takes E and A"
        )
    full = from_matrices(K, M, D, B, C)
    reducer = _reducer(method, options)
    ports = [
        matrix_interface(full, name=name, matrix=name) for name, given in (("B", B), ("C", C)) if given is not None
    ]
    if reducer.needs_interfaces and not ports:
        raise InputError(f'method {reducer.method!r} needs inputs; give B = (N, m), or take method = "modal"')
    return _reduced(reducer, Problem(full, ports, damping=damping), ports)


def _reducer(method: str, options: dict[str, Any]) -> Reducer:
    spelled = method if method in REDUCERS else method.replace("_", "-").lower()
    if spelled not in REDUCERS:
        raise InputError(f"method = {method!r} was given; {REDUCERS.advice(method)}")
    kind = REDUCERS[spelled]
    known = {each.name for each in fields(kind)}
    wrong = next((name for name in options if name not in known), None)
    if wrong is not None:
        raise ArgumentError(f"method {spelled!r} has no option {wrong!r}; {nearest(wrong, known)}")
    return kind(**options)


def _reduced(reducer: Reducer, problem: Problem, ports: list[Interface]) -> ReducedSystem:
    with problem:
        model = reducer.reduce(problem)
        T = problem.coupling.T
        inputs = len(ports[0].forces) if ports else 0
        outputs = slice(inputs, None) if len(ports) > 1 else slice(0, inputs)
        return ReducedSystem(
            M=model.M,
            D=model.D,
            K=model.K,
            B=model.B[:, :inputs],
            C=model.C[outputs],
            V=np.asarray(T @ model.V),
            model=model,
            structural=model.structural,
        )
