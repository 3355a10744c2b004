"""Modal truncation: V = [rigid modes, lowest modes] of the free body, or of the body held at its interfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.errors import InputError, nearest
from morembs.linalg.orthogonal import beside
from morembs.problem import Problem
from morembs.progress import Progress
from morembs.reducers.base import Basis, Reducer, chosen_modes


@dataclass(frozen=True, kw_only=True)
class Modal(Reducer):
    """Lowest modes; ``interfaces`` "free" (rigid modes are added) or "fixed" (none are left)."""

    method: ClassVar[str] = "modal"
    modes: int | None = None
    up_to_hz: float | None = None
    interfaces: str = "free"

    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        chosen_modes(self.modes, self.up_to_hz, self.method)
        if self.interfaces not in ("free", "fixed"):
            raise InputError(
                f"interfaces = {self.interfaces!r} was given; {nearest(self.interfaces, ('free', 'fixed'))}"
            )
        below = None if self.up_to_hz is None else (2 * np.pi * self.up_to_hz) ** 2
        if self.interfaces == "fixed":
            modes = problem.fixed_modes(count=self.modes, below=below)
            rigid, kind = problem.rigid[:, :0], "fixed-interface"
        else:
            modes = problem.elastic_modes(count=self.modes, below=below)
            rigid, kind = problem.rigid, "elastic"
        r, m = rigid.shape[1], len(modes.eigenvalues)
        return Basis(
            V=beside(rigid, modes.vectors, budget=problem.budget),
            kinds=("rigid",) * r + (kind,) * m,
            K=np.diag(np.concatenate([np.zeros(r), modes.eigenvalues])),
            rigid=np.eye(r + m, r),
            holds_interfaces=self.interfaces == "fixed",
        )
