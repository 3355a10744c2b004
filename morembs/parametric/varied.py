"""A mesh whose materials and shape depend on parameters: K(p) = sum_q a_q(p) K_q and M(p) = sum_j b_j(p) M_j.

Exact in moduli and densities of sets of elements, and in the mass of a morph; the stiffness of a morph differs by at
most the part ``eps`` in every quadratic form (see ``morph``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, Mesh
from morembs.fem.assembly import (
    assemble,
    check_mesh,
    entries_of,
    integrate,
    mass_matrix,
    mass_warnings,
    stiffness_matrix,
)
from morembs.fem.elements import TYPES, Rule
from morembs.fem.fe_model import DofMap
from morembs.fem.formulations import formulation_of, mass_rule
from morembs.fem.inner_modes import refuse_inner_modes
from morembs.fem.material import Material
from morembs.fem.mesh import ElementBlock, material_of_elements
from morembs.fem.middle_nodes import mesh_in_order
from morembs.parametric.law import LAGRANGE, LINEAR, ONE, Law
from morembs.parametric.morph import Morph
from morembs.parametric.parameter import Box, Parameter
from morembs.parametric.regions import regions_of
from morembs.parametric.tolerances import TOL
from morembs.parametric.volumes import VolumeRatios, volume_ratios

Chosen = dict[int, NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineTerms:
    """Data of Q matrices on one pattern, and the ``law`` of their coefficients.

    Of each of the ``parts`` the places (l,) in the data of the pattern and the values (q, l) of q terms there, in the
    order of the law.
    """

    law: Law
    size: int
    parts: tuple[tuple[Ints, Floats], ...]

    def __len__(self) -> int:
        return len(self.law.factors)

    def combine(self, theta: Floats) -> Floats:
        """Data (size,) of the sum of all terms times ``theta`` (Q,)."""
        data, first = np.zeros(self.size), 0
        for places, values in self.parts:
            data[places] += theta[first : first + len(values)] @ values
            first += len(values)
        return data


@dataclass(frozen=True, kw_only=True, eq=False)
class VariedModel:
    """A finite-element model that depends on ``parameters``: ``stiffness`` and ``mass`` terms on the ``graph`` of its
    nodes.

    ``morph`` holds the mesh without morphs; its element sets ``regions`` have one material each, and ``young`` and
    ``density`` say which parameter (-1: none) gives that of each region. ``eps`` limits what the interpolation of
    volumes makes of the stiffness: (1 - eps) x'Kx <= x'K~x <= (1 + eps) x'Kx for the assembled K. ``added`` are
    numbers of parameters with matrices (N, N) that join K by their factor: springs and preloads.
    """

    parameters: tuple[Parameter, ...]
    box: Box
    morph: Morph
    graph: sp.csr_array
    regions: tuple[Material, ...]
    young: Ints
    density: Ints
    stiffness: AffineTerms
    mass: AffineTerms
    eps: float
    points: int
    mass_integration: str
    seams: bool
    warnings: tuple[str, ...]
    added: tuple[tuple[int, sp.csr_array], ...] = ()

    @cached_property
    def law_K(self) -> Law:
        """Coefficients of the terms of the stiffness: those of elements, then the ``added`` ones."""
        law, P = self.stiffness.law, len(self.parameters)
        rows = np.full((len(self.added), P), ONE)
        for row, (number, _) in zip(rows, self.added, strict=True):
            row[number] = LINEAR
        factors, points = np.vstack([law.factors, rows]), law.points
        if "preload" in self.box.kinds:
            # Its stiffness may be negative: what holds on the box is told by the corners of all that K depends on.
            ends = np.array([self.box.low, self.box.high]).T
            linear = (factors == LINEAR).any(axis=0)
            points = tuple(each if not used else end for each, used, end in zip(points, linear, ends, strict=True))
        return Law(factors=factors, points=points)

    def stiffness_sum(self, theta: Floats) -> sp.csr_array:
        """sum_q theta_q K_q (N, N) for any coefficients (Q,)."""
        own = len(self.stiffness)
        K = stiffness_matrix(self.graph, self.stiffness.combine(theta[:own]))
        return self._with_added(K, theta[own:])

    def _with_added(self, K: sp.csr_array, theta: Floats) -> sp.csr_array:
        for factor, (_, A) in zip(theta, self.added, strict=True):
            if factor:
                K = sp.csr_array(K + factor * A)
        return K

    def materials(self, p: Floats) -> tuple[Material, ...]:
        """The material of each region at ``p`` (P,)."""
        return tuple(
            replace(
                region,
                stiffness=region.stiffness if E < 0 else region.stiffness * p[E],
                density=region.density if rho < 0 else float(p[rho]),
            )
            for region, E, rho in zip(self.regions, self.young.tolist(), self.density.tolist(), strict=True)
        )

    def model(self, p: Floats) -> FEModel:
        """The model at ``p`` (P,) from the terms."""
        K = self.stiffness_sum(self.law_K(p))
        M = mass_matrix(self.graph, self.mass.combine(self.mass.law(p)))
        return replace(self.outline(p), K=K, M=M)

    def outline(self, p: Floats) -> FEModel:
        """The model at ``p`` (P,) with empty matrices."""
        mesh = self.morph.move_mesh(p)
        size = 3 * len(mesh.nodes)
        empty = sp.csr_array((size, size))
        return FEModel(
            K=empty,
            M=empty,
            nodes=mesh.nodes,
            dofs=DofMap.translations(len(mesh.nodes)),
            mesh=mesh,
            materials=self.materials(p),
            source=mesh.source,
            warnings=self.warnings,
        )

    def assemble_at(self, p: Floats) -> FEModel:
        """The model at ``p`` (P,) by direct integration, of which the terms know nothing."""
        model = assemble(
            self.morph.move_mesh(p), self.materials(p), mass_integration=self.mass_integration, seams=self.seams
        )
        return replace(model, K=self._with_added(model.K, self.law_K(p)[len(self.stiffness) :]))

    def volume_ratios(self) -> tuple[Ints, VolumeRatios]:
        """Which parameter (-1: none) gives the density of each group of elements, and how far volumes in it change."""
        groups = np.unique(self.density)
        owner = material_of_elements(self.morph.mesh, self.regions)
        chosen = [{key: (self.density == j)[own] for key, own in owner.items()} for j in groups.tolist()]
        return groups, volume_ratios(self.morph, chosen, lambda block: (_mass_rule(block, self.mass_integration),))


def varied_model(
    mesh: Mesh,
    materials: Sequence[Material],
    parameters: Sequence[Parameter],
    *,
    tolerance: float = TOL.default_tolerance,
    mass_integration: str = "element",
    seams: bool = False,
) -> VariedModel:
    """Affine terms of ``mesh`` with ``materials``, those of parameters replaced.

    Args:
        tolerance: error that is allowed of bodies; the interpolation of a morph takes a hundredth of that at most.

    Raises:
        InputError: as ``assemble``; unknown sets, sets of two parameters that overlap, the modulus of an anisotropic
            material, or a morph that turns elements inside out.
    """
    refuse_inner_modes(mesh, "a model with parameters")
    warnings = (*mesh.warnings, *mass_warnings(mesh, mass_integration))
    mesh, box = mesh_in_order(mesh), Box.of(parameters)
    graph = check_mesh(mesh, materials)
    mesh, regions, young, density = regions_of(mesh, materials, parameters)
    morph = Morph.of(mesh, parameters)
    morph.check(lambda block: (_stiffness_rule(block), _mass_rule(block, mass_integration)))
    points, eps = morph.points_for(
        TOL.stiffness_share * tolerance,
        (TOL.wanted_share if len(morph.which) == 1 else TOL.stiffness_share) * tolerance,
    )
    make = _Maker(morph, graph, regions, mass_integration)
    return VariedModel(
        parameters=tuple(parameters),
        box=box,
        morph=morph,
        graph=graph,
        regions=regions,
        young=young,
        density=density,
        stiffness=make.terms(young, points, stiffness=True),
        mass=make.terms(density, points, stiffness=False),
        eps=eps,
        points=points,
        mass_integration=mass_integration,
        seams=seams,
        warnings=warnings,
    )


def _stiffness_rule(block: ElementBlock) -> Rule:
    return formulation_of(block).integration(TYPES[block.type])


def _mass_rule(block: ElementBlock, mass_integration: str) -> Rule:
    return mass_rule(block, block.mass if mass_integration == "element" else mass_integration)


class _Maker:
    """Integrates the terms of groups of elements that the same parameters change."""

    def __init__(self, morph: Morph, graph: sp.csr_array, regions: Sequence[Material], mass_integration: str) -> None:
        self.morph, self.graph, self.regions, self.mass_integration = morph, graph, regions, mass_integration
        self.owner = material_of_elements(morph.mesh, regions)

    def terms(self, of_region: Ints, points: int, *, stiffness: bool) -> AffineTerms:
        """Terms of the stiffness or of the mass; ``of_region`` is the parameter of each region, -1 for none."""
        factors: list[Ints] = []
        parts: list[tuple[Ints, Floats]] = []
        at: dict[int, Floats] = {}
        count = points + TOL.det_coefficients if stiffness else TOL.det_coefficients
        for number, bits, chosen in self._groups(of_region):
            grid = self.morph.points(bits, count)
            at |= grid
            entries, places = entries_of(self.morph.mesh, self.graph, chosen)
            places = places if stiffness else entries
            values = [self._integrate(p, bits, points, chosen, stiffness)[places] for p in self.morph.grid(grid)]
            parts.append((places, np.array(values)))
            factors += _rows(len(self.morph.parameters), number, grid)
        law = Law(
            factors=np.array(factors), points=tuple(at.get(j, np.zeros(0)) for j in range(len(self.morph.parameters)))
        )
        return AffineTerms(law=law, size=(9 if stiffness else 1) * self.graph.nnz, parts=tuple(parts))

    def _groups(self, of_region: Ints) -> Iterator[tuple[int, int, Chosen]]:
        codes = self.morph.find_deformed()
        for number in np.unique(of_region).tolist():
            for bits in range(1 << len(self.morph.which)):
                chosen = {
                    id(block): (of_region == number)[self.owner[id(block)]] & (code == bits)
                    for block, code in zip(self.morph.mesh.blocks, codes, strict=True)
                }
                if any(rows.any() for rows in chosen.values()):
                    yield number, bits, chosen

    def _integrate(self, p: Floats, bits: int, points: int, chosen: Chosen, stiffness: bool) -> Floats:
        """Data of K or of the scalar mass of the ``chosen`` elements at ``p`` (P,)."""
        data = np.zeros((9 if stiffness else 1) * self.graph.nnz)
        weights: Callable[[ElementBlock, Ints], Floats] | None = None
        if stiffness and bits:
            weights = self.morph.factors(p, self.morph.roots(bits, points))
        integrate(
            self.morph.move_mesh(p),
            self.regions,
            self.owner,
            self.graph,
            stiffness=data if stiffness else None,
            mass=None if stiffness else data,
            mass_integration=self.mass_integration,
            chosen=chosen,
            weights=weights,
        )
        return data


def _rows(count: int, number: int, grid: dict[int, Floats]) -> list[Ints]:
    """Factors (count,) of each term of a group, in the order of ``Morph.grid``."""
    rows = []
    for place in np.ndindex(*(len(each) for each in grid.values())):
        row = np.full(count, ONE)
        if number >= 0:
            row[number] = LINEAR
        for j, k in zip(grid, place, strict=True):
            row[j] = LAGRANGE + k
        rows.append(row)
    return rows
