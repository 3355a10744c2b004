"""Meshes whose nodes move in proportion to parameters: x(t) = x0 + sum_i t_i d_i.

At a point of quadrature J(t) = J0 + sum_i t_i J_i, and in K_e = sum N(t)' C N(t) w / det(t) only 1 / det is no
polynomial. Interpolated at the same Chebyshev points of t everywhere (empirical interpolation of one scalar: Barrault,
Maday, Nguyen and Patera 2004), it makes K a polynomial that keeps rigid motion free of strain at every t, and differs
from the assembled stiffness by at most the part eps in every quadratic form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock, Mesh
from morembs.fem.assembly import chunks
from morembs.fem.elements import TYPES, Rule
from morembs.fem.formulations import formulation_of, jacobian
from morembs.parametric.law import bernstein, chebyshev_points, chebyshev_roots, lagrange
from morembs.parametric.parameter import Parameter
from morembs.parametric.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Morph:
    """How nodes of ``mesh`` (at t = 0) move with the ``parameters`` whose numbers are ``which`` (m,)."""

    mesh: Mesh
    parameters: tuple[Parameter, ...]
    which: tuple[int, ...]

    @classmethod
    def of(cls, mesh: Mesh, parameters: Sequence[Parameter]) -> Morph:
        """The morphs among ``parameters``.

        Raises:
            InputError: too many, displacements of another shape, or elements that do not take them.
        """
        which = tuple(number for number, each in enumerate(parameters) if each.kind == "morph")
        if len(which) > TOL.max_morphs:
            names = ", ".join(parameters[number].name for number in which)
            raise InputError(f"{len(which)} morphs were given ({names}); expected {TOL.max_morphs} at most")
        for number in which:
            given = parameters[number].displacement
            if given is None or given.shape != mesh.nodes.xyz.shape or not np.isfinite(given).all():
                raise InputError(
                    f"parameter {parameters[number].name}: a morph needs displacements of all {len(mesh.nodes)} nodes "
                    f"as finite numbers; those given have the shape {None if given is None else given.shape}",
                    kind="missing",
                )
            for block in mesh.blocks:
                if not formulation_of(block).is_plain:
                    raise InputError(
                        f"parameter {parameters[number].name}: {block.type} elements with the formulation "
                        f"{block.formulation!r} cannot be morphed; take elements with the strain of their field"
                    )
        return cls(mesh=mesh, parameters=tuple(parameters), which=which)

    @property
    def displacements(self) -> list[Floats]:
        """Displacement (n, 3) of each morph per unit."""
        return [np.asarray(self.parameters[number].displacement) for number in self.which]

    def positions(self, p: Floats) -> Floats:
        """Coordinates (n, 3) of the nodes at ``p`` (P,)."""
        moves = (p[number] * d for number, d in zip(self.which, self.displacements, strict=True))
        return np.asarray(sum(moves, start=self.mesh.nodes.xyz))

    def move_mesh(self, p: Floats) -> Mesh:
        """The mesh at ``p`` (P,)."""
        if not self.which:
            return self.mesh
        return replace(self.mesh, nodes=replace(self.mesh.nodes, xyz=self.positions(p)))

    def find_deformed(self) -> list[Ints]:
        """For each block a number (ne,) whose bit k says that morph k changes the shape of an element."""
        codes = [np.zeros(len(block.ids), dtype=np.int64) for block in self.mesh.blocks]
        for bit, d in enumerate(self.displacements):
            for block, code in zip(self.mesh.blocks, codes, strict=True):
                own = d[block.nodes]
                code += (1 << bit) * (own != own[:, :1]).any(axis=(1, 2))
        return codes

    def range(self, number: int) -> tuple[float, float]:
        """Least and largest value of a parameter."""
        return self.parameters[number].low, self.parameters[number].high

    def points(self, bits: int, count: int) -> dict[int, Floats]:
        """Chebyshev points (count,) of the parameters whose bits are set, with the ends of their ranges."""
        return {number: chebyshev_points(*self.range(number), count) for number in self._numbers(bits)}

    def roots(self, bits: int, count: int) -> dict[int, Floats]:
        """Points (count,) where 1 / det J is interpolated."""
        return {number: chebyshev_roots(*self.range(number), count) for number in self._numbers(bits)}

    def _numbers(self, bits: int) -> list[int]:
        return [number for bit, number in enumerate(self.which) if bits >> bit & 1]

    def determinants(self, block: ElementBlock, rows: Ints, rule: Rule, p: Floats) -> Floats:
        """det J (n, nq) of elements of a block at ``p`` (P,)."""
        return np.asarray(np.linalg.det(jacobian(self.positions(p)[block.nodes[rows]], rule)))

    def sample_determinants(self, block: ElementBlock, rows: Ints, rule: Rule, points: dict[int, Floats]) -> Floats:
        """det J (s1, ..., n, nq) at all combinations of ``points`` of the parameters, others nominal."""
        shape = tuple(len(each) for each in points.values())
        values = [self.determinants(block, rows, rule, p) for p in self.grid(points)]
        return np.asarray(values).reshape(*shape, *values[0].shape)

    def grid(self, points: dict[int, Floats]) -> Iterator[Floats]:
        """Values (P,) of all parameters at all combinations of ``points``, others nominal."""
        nominal = np.array([parameter.nominal for parameter in self.parameters])
        for values in product(*points.values()):
            p = nominal.copy()
            p[list(points)] = values
            yield p

    def factors(self, p: Floats, points: dict[int, Floats]) -> Callable[[ElementBlock, Ints], Floats]:
        """Of a block and rows of its elements det J times the interpolant of 1 / det J through ``points``, at ``p``."""

        def weights(block: ElementBlock, rows: Ints) -> Floats:
            rule = formulation_of(block).integration(TYPES[block.type])
            inverse = 1 / self.sample_determinants(block, rows, rule, points)
            return self._interpolate(inverse, p, points) * self.determinants(block, rows, rule, p)

        return weights

    def _interpolate(self, values: Floats, p: Floats, points: dict[int, Floats]) -> Floats:
        """Polynomial through ``values`` (s1, ..., n, nq) at ``points``, at ``p``."""
        for number, at in points.items():
            values = np.tensordot(lagrange(at, p[number])[0], values, axes=(0, 0))
        return values

    def error(self, count: int) -> float:
        """eps: largest difference of ``factors`` from one in the box with ``count`` points for each morph.

        A polynomial of each parameter at each point. One of degree n is nowhere larger than 1 / cos(n pi / 2m) times
        its largest value at the m roots of a Chebyshev polynomial (Ehlich and Zeller 1964), so that eps is proven.
        """
        largest, m = 0.0, TOL.samples_per_point * (count + TOL.det_coefficients)
        between = 1 / np.cos((count - 1 + TOL.det_coefficients - 1) * np.pi / (2 * m))
        for bits, chosen in self.groups():
            points = self.roots(bits, count)
            dense = [chebyshev_roots(*self.range(number), m) for number in points]
            tables = [lagrange(at, z)[0] for at, z in zip(points.values(), dense, strict=True)]
            cubic = self.points(bits, TOL.det_coefficients)
            cubics = [lagrange(at, z)[0] for at, z in zip(cubic.values(), dense, strict=True)]
            for block, rows in chunks(self.mesh, chosen):
                rule = formulation_of(block).integration(TYPES[block.type])
                # Piece by piece, so that the closely sampled values stay near 50 MB.
                size = max(1, 6_000_000 // (len(rule.weights) * int(np.prod([len(z) for z in dense]))))
                for part in np.array_split(rows, max(1, len(rows) // size)):
                    det = on_grid(cubics, self.sample_determinants(block, part, rule, cubic))
                    g = on_grid(tables, 1 / self.sample_determinants(block, part, rule, points))
                    largest = max(largest, between ** len(points) * float(np.abs(det * g - 1).max(initial=0.0)))
        return float(largest)

    def points_for(self, tolerance: float, wanted: float = np.inf) -> tuple[int, float]:
        """Least number of points, and eps with them, that is at most ``tolerance`` and, where that can be, ``wanted``.

        Raises:
            InputError: none is enough.
        """
        if not self.which:
            return 0, 0.0
        error = np.inf
        for count in range(TOL.least_points, TOL.most_points + 1):
            error = self.error(count)
            if error <= min(tolerance, wanted):
                return count, error
        if error <= tolerance:
            return TOL.most_points, error
        names = " and ".join(self.parameters[number].name for number in self.which)
        raise InputError(
            f"the volumes of elements change so much with {names} that {TOL.most_points} points give them to "
            f"{error:.1e} only ({tolerance:.1e} is needed); narrow the range, or raise the tolerance"
        )

    def groups(self) -> Iterator[tuple[int, dict[int, NDArray[np.bool_]]]]:
        """Bits of the morphs, and the elements of each block (by identity) that exactly these deform."""
        codes = self.find_deformed()
        for bits in range(1, 1 << len(self.which)):
            chosen = {id(b): code == bits for b, code in zip(self.mesh.blocks, codes, strict=True)}
            if any(rows.any() for rows in chosen.values()):
                yield bits, chosen

    def check(self, rules: Callable[[ElementBlock], Sequence[Rule]]) -> None:
        """Refuse morphs that turn elements inside out at a point of the ``rules`` of a block, anywhere in the box.

        Raises:
            InputError: in these cases, with their labels.
        """
        for bits, chosen in self.groups():
            points, bad = self.points(bits, TOL.det_coefficients), list[tuple[str, int]]()
            for block, rows in chunks(self.mesh, chosen):
                inverted = np.zeros(len(rows), dtype=bool)
                for rule in rules(block):
                    det = self.sample_determinants(block, rows, rule, points)
                    inverted |= ~self._positive(det, points).all(axis=-1)
                bad += [(block.type, int(label)) for label in block.ids[rows[inverted]]]
            if bad:
                self._refuse_inverted(bits, bad)

    def _positive(self, det: Floats, points: dict[int, Floats]) -> NDArray[np.bool_]:
        """True if cubics (n, nq) with values ``det`` (4, ..., n, nq) at ``points`` are positive on the box."""
        least = TOL.flat_volume * np.abs(det).max(axis=tuple(range(len(points))))
        sure = _bernstein_least(det, points, {number: [self.range(number)] for number in points}) > least
        if not sure.all():
            cells = {number: _cells(*self.range(number), TOL.det_cells) for number in points}
            sure[~sure] = _bernstein_least(det[..., ~sure], points, cells) > least[~sure]
        return np.asarray(sure)

    def _refuse_inverted(self, bits: int, bad: list[tuple[str, int]]) -> None:
        chosen = [self.parameters[number] for number in self._numbers(bits)]
        ends = [f"{each.name} between {each.low:g} and {each.high:g}" for each in chosen]
        labels = ", ".join(str(label) for _, label in bad[:5]) + (", ..." if len(bad) > 5 else "")
        raise InputError(
            f"parameter {' and '.join(ends)}: {len(bad)} {bad[0][0]} elements are inverted or degenerate there: "
            f"{labels}; narrow its range, or smooth the displacement",
            kind="model",
            keyword="displacement",
        )


def on_grid(tables: Sequence[Floats], values: Floats) -> Floats:
    """``values`` (s1, s2, ..., n, nq) as polynomials through points, at closer ones: ``tables`` (z, s) of each axis."""
    for axis, table in enumerate(tables):
        values = np.moveaxis(np.tensordot(table, values, axes=(1, axis)), 0, axis)
    return values


def _cells(low: float, high: float, count: int) -> list[tuple[float, float]]:
    edges = np.linspace(low, high, count + 1).tolist()
    return list(pairwise(edges))


def _bernstein_least(values: Floats, points: dict[int, Floats], cells: dict[int, list[tuple[float, float]]]) -> Floats:
    """The least Bernstein coefficient on any combination of ``cells``, of polynomials with ``values`` at ``points``."""
    lowest = []
    for combination in product(*cells.values()):
        tables = [bernstein(points[number], *cell) for number, cell in zip(points, combination, strict=True)]
        lowest.append(on_grid(tables, values).min(axis=tuple(range(len(points)))))
    return np.asarray(reduce(np.minimum, lowest))
