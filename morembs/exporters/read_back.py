"""What was written is read again before it gets its name, and has to be the body: its transfer matrix tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from morembs.base.errors import OutputError
from morembs.base.types import Complexes, Floats
from morembs.exporters.tolerances import TOL

# Round-off of double precision in sums of n terms, per n.
EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)


class Transfer(Protocol):
    """A transfer matrix from numbers of a file or a body."""

    def at(self, omega: float, unit: float) -> tuple[Complexes, Floats]:
        """H (p, m) at ``omega`` in rad/s, and how far its entries may be off when each number of the matrices is off
        by ``unit`` of itself."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondOrder:
    """H = C (K + i w D - w^2 M)^-1 B of M, K, D (n, n), B (n, m), C (p, n)."""

    M: Floats
    K: Floats
    D: Floats | None
    B: Floats
    C: Floats

    def at(self, omega: float, unit: float) -> tuple[Complexes, Floats]:
        """As ``Transfer.at``; by the first order of a perturbation (Higham 2002, ch. 7)."""
        D = np.zeros_like(self.K) if self.D is None else self.D
        A = self.K + 1j * omega * D - omega**2 * self.M
        X, Y = np.linalg.solve(A, self.B), np.linalg.solve(A.T, self.C.T).T
        size = np.abs(self.K) + omega * np.abs(D) + omega**2 * np.abs(self.M)
        off = np.abs(Y) @ size @ np.abs(X) + np.abs(Y) @ np.abs(self.B) + np.abs(self.C) @ np.abs(X)
        return np.asarray(self.C @ X), np.asarray((unit + len(A) * EPS) * off)


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstOrder:
    """H = C (s - A)^-1 B + D with s = i w, with a step ``dt`` s = exp(i w dt)."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    dt: float = 0.0

    def at(self, omega: float, unit: float) -> tuple[Complexes, Floats]:
        """As ``Transfer.at``."""
        s = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        A = s * np.eye(len(self.A)) - self.A
        X, Y = np.linalg.solve(A, self.B), np.linalg.solve(A.T, self.C.T).T
        size = abs(s) * np.eye(len(A)) + np.abs(self.A)
        off = np.abs(Y) @ size @ np.abs(X) + np.abs(Y) @ np.abs(self.B) + np.abs(self.C) @ np.abs(X) + np.abs(self.D)
        return np.asarray(self.C @ X + self.D), np.asarray((unit + len(A) * EPS) * off)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadBack:
    """What a file has (``found``), what the body has (``expected``), and significant ``digits`` of the numbers of the
    format; ``changed`` where coordinates were changed on the way."""

    found: Transfer
    expected: Transfer
    digits: int
    changed: bool = False

    def refuse_others(self, path: object, frequencies_hz: Floats) -> None:
        """Refuse a file that is not the body.

        Raises:
            OutputError: H differs at some of the frequencies (k,) by more than the digits of the format explain.
        """
        unit = 0.5 * 10.0 ** (1 - self.digits) + (TOL.changed_number if self.changed else 0.0)
        for hz in frequencies_hz.tolist():
            with np.errstate(all="ignore"):
                try:
                    (H, off), (expected, own) = (each.at(2 * np.pi * hz, unit) for each in (self.found, self.expected))
                except (np.linalg.LinAlgError, ValueError) as error:
                    raise _mismatch(path, f"cannot be solved at {hz:.6g} Hz ({error})") from error
                if H.shape != expected.shape:
                    raise _mismatch(path, f"has {H.shape[0]} motions by {H.shape[1]} loads, not {expected.shape}")
                largest = float(np.abs(expected).max(initial=0.0))
                floor = TOL.read_back_floor * (unit + len(off) * EPS) * largest
                good = np.abs(H - expected) <= TOL.read_back_slack * (off + own) + floor
                worst = np.abs(H - expected).max(initial=0.0) / max(largest, TINY)
            if not good.all():
                raise _mismatch(path, f"differs at {hz:.6g} Hz by {worst:.2g} of its largest entry")


def _mismatch(path: object, what: str) -> OutputError:
    return OutputError(
        f"{path} was not written: read back, its transfer matrix {what} from that of the body, more than the digits of "
        "the format explain; the exporter or the disk is at fault, take another target and report it"
    )


def frequencies_between(frequencies_hz: Floats, rigid: int) -> Floats:
    """Below the elastic frequencies (n,), between two of them, and above (k,), all away from resonances."""
    elastic = np.unique(frequencies_hz[rigid:])
    elastic = elastic[np.isfinite(elastic) & (elastic > 0)]
    if not len(elastic):
        return np.array([1.0])
    ratio = elastic[1:] / elastic[:-1]
    middle = [] if not len(ratio) else [float(np.sqrt(elastic[k] * elastic[k + 1])) for k in [int(np.argmax(ratio))]]
    return np.array([0.5 * elastic[0], *middle, TOL.beyond_last_mode * elastic[-1]])
