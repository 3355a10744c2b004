"""Couplings between the interfaces of placed parts: equations between degrees of freedom, and springs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from morembs.errors import InputError, nearest
from morembs.model import DofMap, Nodes
from morembs.model.constraints import Equations

Ints = NDArray[np.int64]
# Distance of two interfaces that are coupled, and that which is round-off, as parts of the size of the assembly.
APART, TOGETHER = 1e-6, 1e-13
ALL = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Couple:
    """Two interfaces ``between`` which ("part:INTERFACE") the ``components`` 0 to 5 are one, along the axes of the
    assembly; with ``stiffness`` (6,) in N/m and Nm/rad, and ``damping`` (6,), springs instead.

    >>> Couple(between=("upper:TIP", "lower:ROOT"), components=(0, 1, 2)).stiffness is None
    True
    """

    between: tuple[str, str]
    components: tuple[int, ...] = ALL
    stiffness: Sequence[float] | None = None
    damping: Sequence[float] | None = None


class Joints:
    """Couplings as equations and springs between dofs."""

    def __init__(self, nodes: Nodes, dofs: DofMap, couples: Sequence[Couple]) -> None:
        self.nodes, self.size = nodes, len(dofs)
        self.dofs, self.table = dofs, dofs.table(len(nodes))
        self.extent = float(np.ptp(nodes.xyz, axis=0).max(initial=0.0))
        self.warnings: list[str] = []
        self.pairs = [(couple, *self._ends(couple)) for couple in couples]

    def _ends(self, couple: Couple) -> tuple[Ints, Ints]:
        """Dofs (k,) of both sides in the same order."""
        sides = []
        if couple.between[0] == couple.between[1]:
            raise InputError(f"couple {couple.between}: both interfaces are one; expected two")
        for name in couple.between:
            if name not in self.nodes.sets:
                raise InputError(f"couple {couple.between}: there is no {name!r}; {nearest(name, self.nodes.sets)}")
            sides.append(self.nodes.sets[name])
        xyz = [self.nodes.xyz[rows] for rows in sides]
        what = " and ".join(couple.between)
        if len(sides[0]) != len(sides[1]):
            raise InputError(f"{what} have {len(sides[0])} and {len(sides[1])} nodes; couple interfaces that match")
        distance, match = cKDTree(xyz[1]).query(xyz[0])
        if distance.max() > APART * self.extent or len(set(match.tolist())) < len(match):
            raise InputError(
                f"{what} are {distance.max():.3g} m apart; expected at most {APART * self.extent:.1g} m, by their "
                "position and rotation"
            )
        if distance.max() > TOGETHER * self.extent:
            self.warnings.append(
                f"{what} are {distance.max():.1e} m apart and coupled as one, which strains the assembly as it "
                "turns; give positions and rotations with all their digits"
            )
        components = list(couple.components)
        if not components or not all(isinstance(c, int) and c in ALL for c in components):
            raise InputError(f"{what}: components = {components} was given; expected some of 0 to 5")
        components = sorted(set(components))
        if couple.stiffness is not None and len(sides[0]) > 1:
            raise InputError(
                f"{what} have {len(sides[0])} nodes each, between which one spring has no place; take rigid or average "
                "interfaces for springs"
            )
        first, second = self.table[sides[0]][:, components], self.table[sides[1][match]][:, components]
        both = (first >= 0) & (second >= 0)
        if ((first >= 0) != (second >= 0)).any() or not both.any():
            raise InputError(f"{what} do not have the same components {components}; name those that both have")
        return first[both], second[both]

    def leading(self, rows: Ints) -> Ints:
        """The nodes that ``rows`` follow with all their dofs, themselves where they follow none."""
        leaders: dict[int, int] = {}

        def last(node: int) -> int:
            while node in leaders:
                node = leaders[node]
            return node

        for couple, first, second in self.pairs:
            if couple.stiffness is None and set(couple.components) == set(ALL):
                for a, b in zip(self.dofs.node[first].tolist(), self.dofs.node[second].tolist(), strict=True):
                    if last(a) != last(b):
                        leaders[last(b)] = last(a)
        return np.array([last(row) for row in rows.tolist()], dtype=np.int64)

    def equations(self) -> list[Equations]:
        """One for each rigid coupling: a dof of one side is that of the other."""
        follows: dict[int, int] = {}

        def leader(dof: int) -> int:
            while dof in follows:
                dof = follows[dof]
            return dof

        equations = []
        for couple, first, second in self.pairs:
            if couple.stiffness is not None:
                continue
            begin = len(follows)
            for a, b in zip(first.tolist(), second.tolist(), strict=True):
                a, b = leader(a), leader(b)
                if a == b:
                    raise InputError(f"{' and '.join(couple.between)} are coupled already, perhaps by way of others")
                follows[b] = a
            led = list(follows.items())[begin:]
            own, other = np.array(led, dtype=np.int64).T
            equations.append(
                Equations(
                    name=" - ".join(couple.between), nodes=self.dofs.node[own], components=self.dofs.component[own],
                    offsets=np.arange(len(own) + 1), term_nodes=self.dofs.node[other],
                    term_components=self.dofs.component[other], coefficients=np.ones(len(own)),
                )
            )  # fmt: skip
        return equations

    def springs(self, which: str) -> sp.csr_array:
        """``stiffness`` or ``damping`` (N, N) of the elastic couplings."""
        total = sp.csr_array((self.size, self.size))
        for couple, first, second in self.pairs:
            values = getattr(couple, which)
            if values is None:
                continue
            if len(values) != len(ALL) or not np.isfinite(values).all() or min(values) < 0 or couple.stiffness is None:
                raise InputError(
                    f"{' and '.join(couple.between)}: {which} = {list(values)} was given; expected six numbers, zero "
                    "or more, and damping beside stiffness"
                )
            k = np.asarray(values, dtype=float)[self.dofs.component[first]]
            rows, columns = [first, second, first, second], [first, second, second, first]
            entries = np.concatenate([k, k, -k, -k]), (np.concatenate(rows), np.concatenate(columns))
            total = total + sp.csr_array(entries, shape=total.shape)
        return total
