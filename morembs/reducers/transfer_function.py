"""The transfer function of M q'' + D q' + K q = B u, y = C q, and what other packages take of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.optional import optional
from morembs.base.types import Complexes, Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.reducers.tolerances import TOL

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class TransferFunction:
    """Responses of a second-order system with ``M``, ``D``, ``K`` (n, n), ``B`` (n, m) and ``C`` (p, n)."""

    M: Floats
    D: Floats
    K: Floats
    B: Floats
    C: Floats
    structural: float

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

    def plot(self, frequencies_hz: Any = None) -> Figure:
        """Bode plot of every output over every input, by default from below the first mode to beyond the last."""
        from matplotlib.figure import Figure

        f = (
            self._choose_frequencies()
            if frequencies_hz is None
            else np.atleast_1d(np.asarray(frequencies_hz, dtype=float))
        )
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

    def _choose_frequencies(self) -> Floats:
        import scipy.linalg as sl

        own = eigenvalue_in_hz(np.sort(np.abs(sl.eigvals(self.K, self.M))))
        elastic = own[own > TOL.shown_frequency * own[-1]]
        return np.geomspace(elastic[0] / 10, 2 * elastic[-1], TOL.shown_points)

    def _first_order(self) -> tuple[Floats, Floats, Floats, Floats]:
        if self.structural:
            raise InputError(
                f"the system has a loss factor, structural = {self.structural:g}, which has no place in the time "
                "domain; take Damping(modal=...) or Damping(beta=...)",
                kind="unsupported",
                keyword="structural",
            )
        n = len(self.K)
        zero = np.zeros((n, n))
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
