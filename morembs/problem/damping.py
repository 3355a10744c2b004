"""Damping in addition to a damping matrix of the model: Rayleigh, modal by value or by table, structural.

In the eigenmodes phi_k of (K, M), with omega_k^2 = lam_k, the elastic motion has

    a_k(s) = (1 + i eta + s beta) lam_k + s alpha + s 2 zeta_k omega_k + s^2 = c(s) lam_k + g(s) + s 2 zeta_k omega_k ,

alpha and beta of Rayleigh damping, zeta_k = zeta(omega_k) the modal ratio and eta the structural (hysteretic) loss
factor. As c and g do not depend on the mode, Rayleigh and structural damping need no modes: A = c K + g M. Structural
damping is defined for harmonic motion, s = i omega with omega > 0, and has no counterpart in the time domain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.linalg as sl

from morembs.base.arguments import checked, words
from morembs.base.errors import InputError, nearest
from morembs.base.limits import DampingRatio, NotNegative
from morembs.base.types import Floats
from morembs.fem.fe_model import STRUCTURAL
from morembs.linalg.eigen import modes_with_mass

Steps = tuple[tuple[float, float], ...]
NAMED: Mapping[str, Steps] = {
    # The default of Adams: 1 % below 100 Hz, 10 % from there to 1 kHz, critical above.
    "adams": ((0.0, 0.01), (100.0, 0.1), (1000.0, 1.0))
}


@checked
@dataclass(frozen=True, kw_only=True)
class Damping:
    """Rayleigh damping ``alpha`` (1/s) M + ``beta`` (s) K, or modal damping; a ``structural`` loss factor with either.

    ``modal`` is one ratio of critical damping for all modes. ``modal_table`` gives the ratio by the undamped frequency
    of the mode: points (frequency in Hz, ratio from 0 to 1), each ratio holding from its frequency, inclusive, up to
    the next one; or the name of a table, "adams". ``structural`` makes the stiffness (1 + i structural) K, in the
    frequency domain only. All act on the elastic motion only: rigid motion of a free body is not damped.

    Raises:
        InputError: negative or infinite numbers, ratios above 1, a wrong table, or Rayleigh and modal damping.

    >>> Damping(modal=0.02).is_modal, Damping(alpha=1.0, beta=1e-6).is_rayleigh
    (True, True)
    """

    alpha: NotNegative = 0.0
    beta: NotNegative = 0.0
    modal: DampingRatio = 0.0
    modal_table: str | Sequence[Sequence[float]] = ()
    structural: NotNegative = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "modal_table", modal_steps(self.modal_table) if len(self.modal_table) else ())
        if self.modal and self.modal_table:
            raise InputError(
                "damping: give either one modal ratio or a modal table, not both", kind="conflict", keyword="modal"
            )
        if self.is_modal and (self.alpha or self.beta):
            raise InputError("damping: give either rayleigh or modal, not both", kind="conflict", keyword="rayleigh")

    @property
    def steps(self) -> Steps:
        """(frequency in Hz, ratio) of modal damping, the first at zero."""
        return modal_steps(self.modal_table) if self.modal_table else ((0.0, self.modal),)

    @property
    def is_modal(self) -> bool:
        """True if there is modal damping, which is known mode by mode only."""
        return any(ratio for _, ratio in self.steps)

    @property
    def is_rayleigh(self) -> bool:
        """True if there is Rayleigh damping."""
        return bool(self.alpha or self.beta)

    @property
    def is_viscous(self) -> bool:
        """True if there is damping that a matrix D can hold."""
        return self.is_modal or self.is_rayleigh

    @property
    def jumps(self) -> Floats:
        """Frequencies (j,) in rad/s where the modal ratio jumps, ascending."""
        steps = self.steps
        return np.array([2 * np.pi * b[0] for a, b in pairwise(steps) if a[1] != b[1]])

    def ratio(self, omega: Floats) -> Floats:
        """Modal damping ratios of modes with undamped frequencies ``omega`` in rad/s, of any shape."""
        omega = np.asarray(omega, dtype=float)
        edges, ratios = np.array(self.steps).T
        return np.asarray(ratios[np.searchsorted(2 * np.pi * edges[1:], omega, side="right")])

    def of_modes(self, values: Floats) -> Floats:
        """Viscous modal damping d_k in 1/s of elastic modes with eigenvalues ``values`` in (rad/s)2."""
        omega = np.sqrt(np.maximum(values, 0.0))
        return np.asarray(2 * self.ratio(omega) * omega + self.alpha + self.beta * values)

    def at_resonance(self, values: Floats) -> Floats:
        """``of_modes`` and the viscous equivalent of structural damping, structural omega_k: twice the decay."""
        return np.asarray(self.of_modes(values) + self.structural * np.sqrt(np.maximum(values, 0.0)))

    def proportional(self, s: Any) -> tuple[Any, Any]:
        """c and g of A(s) = c K + g M at ``s`` in 1/s, a number or an array: all but modal damping."""
        c = 1 + s * self.beta
        # Real where it may be: so are factors and solutions then.
        return c + 1j * self.structural if self.structural else c, s * s + s * self.alpha

    def matrix(self, M: Floats, K: Floats, rigid: Floats, symmetric: bool = True) -> Floats:
        """Viscous D (n, n) of a reduced pencil whose M-orthonormal rigid motions are ``rigid`` (n, r)."""
        Mr = M @ rigid
        if self.is_modal and not symmetric:
            eigenvalues, X = sl.eig(K, M)
            return np.asarray((M @ (X * self.of_modes(eigenvalues.real)) @ np.linalg.inv(X)).real)
        if self.is_modal:
            # Motions without mass have none of it.
            values, Y = modes_with_mass(K, M)
            values[: rigid.shape[1]] = 0.0
            MY = M @ Y
            return np.asarray((MY * self.of_modes(values)) @ MY.T)
        return self.alpha * (M - Mr @ Mr.T) + self.beta * K


def modal_steps(given: str | Sequence[Sequence[float]]) -> Steps:
    """Points (frequency in Hz, ratio) of a table of modal damping, or of the one named ``given``.

    Raises:
        InputError: an unknown name; points that are no pairs; a first frequency other than 0, or frequencies that do
            not ascend; a ratio outside [0, 1].
    """
    if isinstance(given, str):
        if given not in NAMED:
            raise InputError(
                f"modal = {given!r} was given; expected a number, a table or a name; {nearest(given, NAMED)}",
                kind="unknown",
                keyword="modal",
            )
        return NAMED[given]
    if not len(given) or any(isinstance(point, str) or len(point) != 2 for point in given):
        raise InputError(f"the modal table {_short(given)} was given; expected points [frequency in Hz, ratio]")
    points = tuple((float(f), float(ratio)) for f, ratio in given)
    if points[0][0] != 0:
        raise InputError(
            f"the modal table begins at {points[0][0]:g} Hz; begin it with [0, ratio], so that every mode has a ratio"
        )
    for (before, _), (f, _) in pairwise(points):
        if not before < f < math.inf:
            raise InputError(
                f"the modal table has {f:g} Hz after {before:g} Hz; expected finite frequencies in ascending order"
            )
    for f, ratio in points:
        if not 0 <= ratio <= 1:
            raise InputError(f"the modal table gives the ratio {ratio:g} at {f:g} Hz; expected {words(DampingRatio)}")
    return points


def frequency_domain_only(recipe: Mapping[str, object]) -> str:
    """Why a body with this ``recipe`` is not the same in the time domain; "" where it is."""
    if not recipe.get(STRUCTURAL):
        return ""
    return (
        f"structural damping of {recipe[STRUCTURAL]} holds in the frequency domain only, and no time-domain model can "
        "carry it: the damping matrix has none of it; add rayleigh or modal damping in its place (modal = "
        "structural / 2 has the same peaks at resonance)"
    )


def _short(given: object) -> str:
    text = str(given)
    return text if len(text) <= 60 else text[:57] + "..."
