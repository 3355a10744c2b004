"""Couplings between the interfaces of placed parts: equations between degrees of freedom, and springs.

Two frames that positions of few digits leave apart by d = x_a - x_b are joined at the first one, u_b + theta_b x d =
u_a, so that the assembly turns without strain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.dynamics.assembly.tolerances import TOL
from morembs.fem import DofMap, Nodes, rigid_motion
from morembs.fem.constraints import Equations

ALL = (0, 1, 2, 3, 4, 5)
MOTIONS = tuple(f"{kind} {axis}" for kind in ("translation", "rotation") for axis in "xyz")


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
            raise InputError(f"couple {couple.between}: both interfaces are one; expected two", kind="conflict")
        for name in couple.between:
            if name not in self.nodes.sets:
                raise InputError(
                    f"couple {couple.between}: there is no {name!r}; {nearest(name, self.nodes.sets)}", kind="unknown"
                )
            sides.append(self.nodes.sets[name])
        xyz = [self.nodes.xyz[rows] for rows in sides]
        what = " and ".join(couple.between)
        if len(sides[0]) != len(sides[1]):
            raise InputError(f"{what} have {len(sides[0])} and {len(sides[1])} nodes; couple interfaces that match")
        distance, match = cKDTree(xyz[1]).query(xyz[0])
        if distance.max() > TOL.coupled_distance * self.extent or len(set(match.tolist())) < len(match):
            raise InputError(
                f"{what} are {distance.max():.3g} m apart; expected at most {TOL.coupled_distance * self.extent:.1g} "
                "m, by their position and rotation"
            )
        if distance.max() > TOL.coincident_distance * self.extent and (self.table[sides[1], 3:6] < 0).any():
            self.warnings.append(
                f"{what} are {distance.max():.1e} m apart and coupled as one, without rotations that would tell the "
                "difference, which strains the assembly as it turns; give positions and rotations with all their digits"
            )
        components = list(couple.components)
        if not components or not all(isinstance(c, int) and c in ALL for c in components):
            raise InputError(
                f"{what}: components = {components} was given; expected some of 0 to 5", keyword="components"
            )
        components = sorted(set(components))
        if couple.stiffness is not None and len(sides[0]) > 1:
            raise InputError(
                f"{what} have {len(sides[0])} nodes each, which one spring cannot join; take rigid or average "
                "interfaces for springs",
                kind="unsupported",
            )
        first, second = self.table[sides[0]][:, components], self.table[sides[1][match]][:, components]
        both = (first >= 0) & (second >= 0)
        if ((first >= 0) != (second >= 0)).any() or not both.any():
            raise InputError(f"{what} do not have the same components {components}; name components that both have")
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

    def _turning(self, first: Ints, second: Ints) -> tuple[Ints, Floats]:
        """Dofs (k, 3) and coefficients (k, 3): how rotations of the nodes of ``second`` (k,) move these dofs where the
        nodes of ``first`` (k,) are, in m. Stiff springs feel the last digit of a place."""
        xyz, node = self.nodes.xyz, self.dofs.node[second]
        offsets = xyz[self.dofs.node[first]] - xyz[node]
        rotations, component = self.table[node, 3:6], self.dofs.component[second]
        moved = rigid_motion(offsets, component)[:, 3:]
        moved[(component > 2) | (rotations < 0).any(axis=1)] = 0.0
        return rotations, moved

    def equations(self) -> list[Equations]:
        """One for each rigid coupling: a dof of one side is that of the other, moved there by rotations."""
        follows: dict[int, tuple[int, dict[int, float]]] = {}

        def leader(dof: int) -> tuple[int, dict[int, float]]:
            """What ``dof`` follows in the end, and the coefficients of rotations beside that."""
            beside: dict[int, float] = {}
            while dof in follows:
                dof, more = follows[dof]
                beside = _plus(beside, more)
            return dof, beside

        equations = []
        for couple, first, second in self.pairs:
            if couple.stiffness is not None:
                continue
            led: dict[int, dict[int, float]] = {}
            for a, b, turns, by in zip(first.tolist(), second.tolist(), *self._turning(first, second), strict=True):
                (one, of_one), (other, of_other) = leader(a), leader(b)
                if one == other:
                    raise InputError(
                        f"{' and '.join(couple.between)} are coupled already, directly or through other parts; "
                        "leave one couple out",
                        kind="conflict",
                    )
                own = {dof: value for dof, value in zip(turns.tolist(), by.tolist(), strict=True) if value}
                beside = _plus(of_one, _plus(own, of_other), -1.0)
                follows[other] = one, beside
                led[other] = {one: 1.0} | beside
            dofs = np.array(list(led), dtype=np.int64)
            terms = np.array([term for row in led.values() for term in row], dtype=np.int64)
            equations.append(
                Equations(
                    name=" - ".join(couple.between),
                    nodes=self.dofs.node[dofs],
                    components=self.dofs.component[dofs],
                    offsets=np.cumsum([0, *(len(row) for row in led.values())]),
                    term_nodes=self.dofs.node[terms],
                    term_components=self.dofs.component[terms],
                    coefficients=np.array([value for row in led.values() for value in row.values()]),
                )
            )
        return equations

    def free_motions(self, part: Ints) -> list[str]:
        """Which relative rigid motions of the parts each coupling and all others leave free, in words; ``part``
        (nodes,) is the number of the part of each node."""
        count, node, length = int(part.max()) + 1, self.dofs.node, self.extent or 1.0
        xyz = (self.nodes.xyz - self.nodes.xyz.mean(axis=0)) / length

        def motion(nodes: Ints, components: Ints) -> Floats:
            rows = np.zeros((len(nodes), count, len(ALL)))
            rows[np.arange(len(nodes)), part[nodes]] = rigid_motion(xyz[nodes], components)
            return rows.reshape(len(nodes), -1)

        rows = [np.zeros((1, count * len(ALL)))]
        for couple, first, second in self.pairs:
            values = np.ones(len(ALL)) if couple.stiffness is None else np.asarray(couple.stiffness)
            holds = values[self.dofs.component[first]] > 0
            one, other = (motion(node[side], self.dofs.component[side])[holds] for side in (first, second))
            rows.append(one - other)
        held = np.vstack(rows)
        values, Z = np.linalg.eigh(held.T @ held)
        Z, words = Z[:, values <= TOL.free_motion**2], []
        for couple, first, second in self.pairs:
            one, other = (motion(np.repeat(node[side[:1]], len(ALL)), np.array(ALL)) for side in (first, second))
            free = np.flatnonzero(np.linalg.norm((one - other) @ Z, axis=1) > TOL.free_motion)
            if len(free):
                names = ", ".join(MOTIONS[k] for k in free)
                words.append(f"{names} of {couple.between[1]} against {couple.between[0]}")
        return words

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
                    "or more, and damping beside stiffness",
                    keyword=which,
                )
            k = np.asarray(values, dtype=float)[self.dofs.component[first]]
            turns, by = self._turning(first, second)
            ones, rows = np.ones((len(first), 1)), np.repeat(np.arange(len(first)), 5)
            data, columns = np.hstack([ones, -ones, -by]), np.column_stack([first, second, turns])
            G = sp.csr_array((data.ravel(), (rows, columns.ravel() % self.size)), shape=(len(first), self.size))
            G.eliminate_zeros()
            total = total + G.T @ sp.diags_array(k) @ G
        return sp.csr_array(total)


def _plus(one: dict[int, float], other: dict[int, float], factor: float = 1.0) -> dict[int, float]:
    """The sum of ``one`` and ``factor`` times ``other``, coefficients of dofs."""
    return {dof: one.get(dof, 0.0) + factor * other.get(dof, 0.0) for dof in {**one, **other}}
