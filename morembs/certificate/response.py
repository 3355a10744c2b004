"""Transfer functions between interface degrees of freedom, of the reduced and of the full model.

Both are the elastic part of H(i omega) = B' (K + i omega D - omega^2 M)^-1 B: rigid-body motion, which
both models carry exactly, would hide every difference at low frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.optional import optional
from morembs.base.types import Complexes, Floats
from morembs.certificate.tolerances import TOL
from morembs.fem.interface import Interface
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.direct import direct_response
from morembs.responses.massless import massless_motions
from morembs.responses.reference import reference_model

MOTIONS = ("x", "y", "z", "rotation x", "rotation y", "rotation z")


def reduced_response(reduced: ReducedModel, omega: Floats) -> Complexes:
    """Elastic part of H (nf, m, m) of a reduced model at ``omega`` (nf,) in rad/s.

    Args:
        reduced: the reduced model.
        omega: (nf,) in rad/s.

    >>> omega = 2 * np.pi * np.array([100.0, 1000.0])
    >>> error = reduced_response(reduced, omega) - full_response(problem, omega)
    >>> error.shape
    (2, 12, 12)
    """
    r = reduced.rigid_count
    if reduced.congruent:
        E = reduced.modes()[1][:, r:]
        M, D, K = (E.T @ A @ E for A in (reduced.M, reduced.D, reduced.K))
        B, C = E.T @ reduced.B, reduced.C @ E
    else:
        M, D, K = (A[r:, r:] for A in (reduced.M, reduced.D, reduced.K))
        B, C = reduced.B[r:], reduced.C[:, r:]
    # As in the full model: the limit of falling frequencies at zero, where the loss factor stays.
    c = 1 + 1j * reduced.structural
    H = [C @ np.linalg.solve(c * K + 1j * w * D - w**2 * M, B.astype(complex)) for w in omega]
    return np.array(H, dtype=complex).reshape(len(omega), *C.shape[:1], *B.shape[1:])


def full_response(problem: Problem, omega: Floats, *, tolerance: float = TOL.full_response_error) -> Complexes:
    """Elastic part of H (nf, m, m) of the full coupled model at ``omega`` (nf,) in rad/s.

    Forces and moments are scaled to equal static energy; the estimated error of every entry is below
    ``tolerance`` times the largest scaled entry at that frequency. Peak memory: as ``reference_model``. Models with a
    gyroscopic or circulatory matrix, and those whose loads deform dofs without mass alone, are solved for at each
    frequency, to round-off.

    Args:
        problem: the full model with its interfaces.
        omega: (nf,) in rad/s.
        tolerance: largest error, as a part of the largest scaled entry.

    Raises:
        InputError: no interfaces, or modal damping beside a damping matrix of the model.
        SolverError: the error does not fall below ``tolerance``.

    >>> omega = 2 * np.pi * np.array([100.0, 1000.0])
    >>> H = full_response(problem, omega)
    >>> np.allclose(H, H.transpose(0, 2, 1))                         # Maxwell-Betti
    True
    """
    if not problem.symmetric or massless_motions(problem):
        # Modes have no part in what loads deform without moving mass.
        return direct_response(problem, omega)
    return reference_model(problem, omega, tolerance=tolerance).response(omega)


def to_xarray(H: Complexes, frequencies_hz: Floats, interfaces: Sequence[Interface]) -> Any:
    """A response H (nf, m, m) as an ``xarray.DataArray`` with the dimensions ``frequency_hz``, ``motion`` and ``load``.

    Motions and loads are named as ``big_end x``, ``big_end rotation z``, or ``bore 1207 x`` (1207 is a row of the
    nodes) where an interface exposes its nodes, ``drive B:a`` where it takes a column; m or rad per N or Nm.

    Args:
        frequencies_hz: (nf,) of the response, which is computed at 2 pi times these.
        interfaces: those of the problem or part, in their order.

    Raises:
        InputError: xarray is not installed, or shapes that do not fit each other.

    >>> hz = np.array([100.0, 1000.0])
    >>> H = to_xarray(reduced_response(reduced, 2 * np.pi * hz), hz, interfaces)
    >>> complex(H.sel(frequency_hz=100.0, motion="RIGHT x", load="LEFT x").item()).real < 0
    True
    """
    xarray = optional("xarray", "to_xarray")
    names = []
    for interface in interfaces:
        names += [f"{interface.name} {force}" for force in interface.forces]
        for component, node in () if interface.forces else zip(*interface.kind.columns(interface), strict=True):
            names.append(" ".join([interface.name, *([str(node)] if node >= 0 else []), MOTIONS[component]]))
    expected = (len(frequencies_hz), len(names), len(names))
    if np.shape(H) != expected:
        raise InputError(
            f"H has the shape {np.shape(H)}; expected {expected} of these frequencies and interfaces", keyword="H"
        )
    return xarray.DataArray(
        H,
        dims=("frequency_hz", "motion", "load"),
        name="H",
        coords={"frequency_hz": np.asarray(frequencies_hz), "motion": names, "load": names},
    )
