"""What comes out of a file of another program, before it becomes a finite-element model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.model import DofMap, Mesh, Nodes, frozen
from morembs.model.constraints import AverageElement, RigidElement
from morembs.model.material import Material

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class PointMass:
    """``mass`` and ``inertia`` (3, 3) about its centre, which is at ``offset`` (3,) from the node in row ``node``."""

    name: str
    node: int
    mass: float
    inertia: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    offset: Floats = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("inertia", "offset"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Imported:
    """All that a file holds, in the units of the file.

    Matrices ``K``, ``M``, ``D`` (N, N) as they are there (whole, not half; real or complex, symmetric or not) with
    ``dofs``; or a ``mesh`` with ``materials``; or both. ``nodes`` may carry sets. ``surfaces`` name -> rows of nodes.
    ``notes`` say in a sentence each what was found and what the file holds that a model cannot carry; ``warnings``
    what makes the model another one than that of the file, beside what ``mesh`` warns of. ``incomplete`` maps an
    element set to the sentence that tells what its material lacks: such a model is refused until the set has one.
    """

    source: str
    K: sp.csr_array | None = None
    M: sp.csr_array | None = None
    D: sp.csr_array | None = None
    nodes: Nodes | None = None
    dofs: DofMap | None = None
    mesh: Mesh | None = None
    materials: tuple[Material, ...] = ()
    rigid: tuple[RigidElement, ...] = ()
    average: tuple[AverageElement, ...] = ()
    masses: tuple[PointMass, ...] = ()
    surfaces: Mapping[str, Ints] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    incomplete: Mapping[str, str] = field(default_factory=dict)
