"""From matrices to a reduced system in one call, for users who bring K, M and B and no mesh."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import ArgumentError, InputError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.body.diagnostics import list_warnings
from morembs.fem.interface import Interface, matrix_interface
from morembs.importers.matrices.from_matrices import from_matrices
from morembs.problem import Damping, Problem
from morembs.reducers import REDUCERS
from morembs.reducers.base import ReducedModel, Reducer
from morembs.reducers.transfer_function import TransferFunction


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedSystem(TransferFunction):
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

    def frequencies_hz(self) -> Floats:
        """Undamped eigenfrequencies (n,), ascending."""
        return np.asarray(eigenvalue_in_hz(self.model.modes()[0]))


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
        InputError: matrices, a method or options that cannot be used, or matrices that ``list_warnings`` refuses.
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
            "pymor.models.iosys.LTIModel takes E and A",
            kind="unsupported",
            keyword="B",
        )
    _refuse_inputs_as_damping(K, D)
    full = from_matrices(K, M, D, B, C)
    for sentence in list_warnings(full):
        warnings.warn(sentence, stacklevel=2)
    reducer = _reducer(method, options)
    ports = [
        matrix_interface(full, name=name, matrix=name) for name, given in (("B", B), ("C", C)) if given is not None
    ]
    if reducer.needs_interfaces and not ports:
        raise InputError(
            f'method {reducer.method!r} needs inputs; give B = (N, m), or take method = "modal"',
            kind="missing",
            keyword="method",
        )
    return _reduce_problem(reducer, Problem(full, ports, damping=damping), ports)


def _refuse_inputs_as_damping(K: Any, D: Any) -> None:
    """Refuse inputs in the place of D.

    Raises:
        InputError: D is not square and has as many rows as K.
    """
    rows, shape = np.shape(K)[:1], np.shape(D)
    if len(shape) == 2 and shape[:1] == rows != shape[1:]:
        raise InputError(
            f"D = a matrix of {shape[0]} x {shape[1]} was given, the third argument; expected a square one, as K is. "
            "Inputs go by name: reduce(K, M, B=B)"
        )


def _reducer(method: str, options: dict[str, Any]) -> Reducer:
    spelled = method if method in REDUCERS else method.replace("_", "-").lower()
    if spelled not in REDUCERS:
        raise InputError(f"method = {method!r} was given; {REDUCERS.advice(method)}", kind="unknown", keyword="method")
    kind = REDUCERS[spelled]
    known = {each.name for each in fields(kind)}
    wrong = next((name for name in options if name not in known), None)
    if wrong is not None:
        raise ArgumentError(
            f"method {spelled!r} has no option {wrong!r}; {nearest(wrong, known)}", kind="unknown", keyword=wrong
        )
    return kind(**options)


def _reduce_problem(reducer: Reducer, problem: Problem, ports: list[Interface]) -> ReducedSystem:
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
