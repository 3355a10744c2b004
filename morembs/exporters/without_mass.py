"""Bodies with motions that have no mass on their way into a file: static compliance with a time step, refused without.

Such a motion gets a mass with which it vibrates far above the limit of a step. The other modes stay as they are
(``MassSplit``), and a time step leaves its static compliance, whatever that mass is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.body import Body
from morembs.exporters.real_time import StepTooShortError
from morembs.exporters.tolerances import TOL
from morembs.linalg.massless import CURE, MassSplit, split_massless


def refuse_massless(body: Body, target: str) -> None:
    """Refuse a ``body`` with motions that have no mass for a ``target`` that divides by it.

    Raises:
        InputError: in these cases.
    """
    split = _split(body)
    if split is not None:
        n, m = split.Z.shape
        raise InputError(
            f"{m} of {n} coordinates of body {body.name!r} have no mass, and {target!r} needs mass on each; {CURE}",
            kind="unsupported",
            keyword="mass",
        )


def with_far_mass(body: Body, step: float) -> tuple[Body, Floats | None, tuple[str, ...]]:
    """The ``body`` with motions without mass far above the limit of a ``step`` in s, combinations (n, m) of its
    elastic coordinates that they are, and a note on them.

    Raises:
        StepTooShortError: damping makes them follow loads so slowly that the step resolves it.
    """
    split = _split(body)
    if split is None:
        return body, None, ()
    n, m = split.Z.shape
    slowest = float(split.time_constants(body.damping_matrix)[-1])
    if slowest * TOL.resolved_angle >= step:
        raise StepTooShortError(
            f"a time step of {step:g} s was given, and damping makes the {m} of {n} coordinates of body {body.name!r} "
            f"without mass follow loads with a time constant of up to {slowest:.3g} s (beta of Rayleigh damping, or "
            "dashpots), which this step resolves; take a longer step than that, modal damping, which such "
            "coordinates have none of, or give their dofs mass",
            keyword="time_step",
        )
    far = TOL.far_from_step * TOL.resolved_angle / step
    frame, Z = body.floating, None
    if frame is not None and (own := split_massless(frame.Ke, frame.integrals.Me)) is not None:
        Me, Z = own.with_mass(frame.Ke, frame.integrals.Me, far), own.Z
        frame = replace(frame, integrals=replace(frame.integrals, Me=Me))
    heavy = replace(
        body,
        model=None,
        mass_matrix=split.with_mass(body.stiffness_matrix, body.mass_matrix, far),
        frequencies_hz=np.where(np.isinf(body.frequencies_hz), in_hz(far), body.frequencies_hz),
        floating=frame,
    )
    lag = f"within {slowest:.2g} s, which the error counts" if slowest > TOL.rigid_damping * step else "at once"
    note = f"{m} of {n} coordinates have no mass: their static compliance is exact at rest and follows loads {lag}"
    return heavy, Z, (note,)


def _split(body: Body) -> MassSplit | None:
    return split_massless(body.stiffness_matrix, body.mass_matrix) if body.reduced.symmetric else None
