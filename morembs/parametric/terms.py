"""K(p) = sum_q a_q(p) K_q and M(p) = sum_j b_j(p) M_j of a mesh, exact in moduli and densities of sets of elements.

``varied_model`` makes the terms in the dofs of the mesh, ``AffineProblem`` is the coupled problem at nominal values
that has them, and gives problems at others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import UNLIMITED, Budget
from morembs.errors import InputError, nearest
from morembs.interface import Interface
from morembs.linalg.congruence import congruence
from morembs.model import FEModel, Mesh
from morembs.model.assembly import (
    assemble,
    check_mesh,
    integrate,
    mass_matrix,
    mass_warnings,
    material_of_elements,
    stiffness_matrix,
)  # fmt: skip
from morembs.model.fe_model import DofMap
from morembs.model.material import Material, isotropic
from morembs.model.middle_nodes import mesh_in_order
from morembs.parametric.law import LINEAR, ONE, Law
from morembs.parametric.parameter import Box, Parameter
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.progress import SILENT, Progress

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Part by which elastic constants may differ from those of an isotropic material.
ISOTROPIC = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Terms:
    """Data of Q matrices on one pattern, and the ``law`` of their coefficients.

    Of each of the ``parts`` the places (l,) in the data of the pattern and the values (q, l) of q terms there, in the
    order of the law.
    """

    law: Law
    size: int
    parts: tuple[tuple[Ints, Floats], ...]

    def __len__(self) -> int:
        return len(self.law.factors)

    def combined(self, theta: Floats) -> Floats:
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

    ``mesh`` is that of nominal values; its element sets ``regions`` have one material each, and ``young`` and
    ``density`` say which parameter (-1: none) gives that of each region.
    """

    parameters: tuple[Parameter, ...]
    box: Box
    mesh: Mesh
    graph: sp.csr_array
    regions: tuple[Material, ...]
    young: Ints
    density: Ints
    stiffness: Terms
    mass: Terms
    mass_integration: str
    seams: bool
    warnings: tuple[str, ...]

    def materials(self, p: Floats) -> tuple[Material, ...]:
        """The material of each region at ``p`` (P,)."""
        return tuple(
            replace(
                region, stiffness=region.stiffness if E < 0 else region.stiffness * p[E],
                density=region.density if rho < 0 else float(p[rho]),
            )
            for region, E, rho in zip(self.regions, self.young.tolist(), self.density.tolist(), strict=True)
        )  # fmt: skip

    def mesh_at(self, p: Floats) -> Mesh:
        """The mesh at ``p`` (P,), whose element sets are those of the regions too."""
        return self.mesh

    def model(self, p: Floats, budget: Budget = UNLIMITED) -> FEModel:
        """The model at ``p`` (P,) from the terms."""
        K = stiffness_matrix(self.graph, self.stiffness.combined(self.stiffness.law(p)), budget)
        M = mass_matrix(self.graph, self.mass.combined(self.mass.law(p)), budget)
        mesh = self.mesh_at(p)
        return FEModel(
            K=K, M=M, nodes=mesh.nodes, dofs=DofMap.translations(len(mesh.nodes)), mesh=mesh,
            materials=self.materials(p), source=mesh.source, warnings=self.warnings,
        )  # fmt: skip

    def assembled(self, p: Floats, budget: Budget = UNLIMITED) -> FEModel:
        """The model at ``p`` (P,) by direct integration, of which the terms know nothing."""
        return assemble(
            self.mesh_at(p), self.materials(p), mass_integration=self.mass_integration, seams=self.seams, budget=budget
        )


def varied_model(
    mesh: Mesh, materials: Sequence[Material], parameters: Sequence[Parameter], *, mass_integration: str = "element",
    seams: bool = False, budget: Budget = UNLIMITED, progress: Progress = SILENT,
) -> VariedModel:  # fmt: skip
    """Affine terms of ``mesh`` with ``materials``, those of parameters replaced.

    Raises:
        InputError: as ``assemble``; unknown sets, sets of two parameters that overlap, or the modulus of an
            anisotropic material.
    """
    warnings = (*mesh.warnings, *mass_warnings(mesh, mass_integration))
    mesh, box = mesh_in_order(mesh), Box.of(parameters)
    graph = check_mesh(mesh, materials)
    mesh, regions, young, density = _regions(mesh, materials, parameters)
    owner = material_of_elements(mesh, regions)
    count = len(parameters)

    def terms(which: Ints, size: int, key: str) -> Terms:
        factors, parts = [], []
        for j in np.unique(which).tolist():
            chosen = {id(block): (which == j)[owner[id(block)]] for block in mesh.blocks}
            data = np.zeros(size)
            integrate(
                mesh, regions, owner, graph, mass_integration=mass_integration, chosen=chosen, budget=budget,
                progress=progress, stiffness=data if key == "young" else None, mass=data if key == "density" else None,
            )  # fmt: skip
            places = np.flatnonzero(data)
            parts.append((places, data[places][None]))
            row = np.full(count, ONE)
            if j >= 0:
                row[j] = LINEAR
            factors.append(row)
        law = Law(factors=np.array(factors), points=(np.zeros(0),) * count)
        return Terms(law=law, size=size, parts=tuple(parts))

    return VariedModel(
        parameters=tuple(parameters), box=box, mesh=mesh, graph=graph, regions=regions, young=young, density=density,
        stiffness=terms(young, 9 * graph.nnz, "young"), mass=terms(density, graph.nnz, "density"),
        mass_integration=mass_integration, seams=seams, warnings=warnings,
    )  # fmt: skip


def _regions(
    mesh: Mesh, materials: Sequence[Material], parameters: Sequence[Parameter]
) -> tuple[Mesh, tuple[Material, ...], Ints, Ints]:
    """The mesh with a set for each region of one material and parameters, their materials per unit of the latter, and
    the parameters of each."""
    owner = material_of_elements(mesh, materials)
    young, density = (_owners(mesh, parameters, key) for key in ("young", "density"))
    keys = [np.stack([owner[id(b)], E, rho], axis=1) for b, E, rho in zip(mesh.blocks, young, density, strict=True)]
    unique, where = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    split = np.split(where.ravel(), np.cumsum([len(block.ids) for block in mesh.blocks])[:-1])
    sets, regions = dict(mesh.element_sets), []
    for number, (material, E, rho) in enumerate(unique.tolist()):
        given, name = materials[material], f"region {number}"
        sets[name] = tuple(np.flatnonzero(part == number) for part in split)
        regions.append(
            Material(
                set=name, stiffness=given.stiffness if E < 0 else given.stiffness / young_of(given, parameters[E].name),
                density=given.density if rho < 0 else 1.0,
            )
        )  # fmt: skip
    return replace(mesh, element_sets=sets), tuple(regions), unique[:, 1], unique[:, 2]


def _owners(mesh: Mesh, parameters: Sequence[Parameter], key: str) -> list[Ints]:
    """For each block the number of the parameter (-1: none) that gives the property ``key`` of each element."""
    owners = [np.full(len(block.ids), -1, dtype=np.int64) for block in mesh.blocks]
    for number, parameter in enumerate(parameters):
        if parameter.kind != key:
            continue
        for name, (block, taken, rows) in chain.from_iterable(
            ((name, item) for item in zip(mesh.blocks, owners, rows_of_set(mesh, name, parameter.name), strict=True))
            for name in parameter.sets
        ):
            other = taken[rows]
            clash = np.flatnonzero((other >= 0) & (other != number))
            if len(clash):
                raise InputError(
                    f"parameters {parameters[other[clash[0]]].name} and {parameter.name} both give the {key} of "
                    f"element {block.ids[rows[clash[0]]]}, of the set {name!r}; give every element one"
                )
            taken[rows] = number
    return owners


def rows_of_set(mesh: Mesh, name: str, parameter: str) -> tuple[Ints, ...]:
    """For each block the rows of the element set ``name``.

    Raises:
        InputError: no such set, or no elements in it.
    """
    if name == "all":
        return tuple(np.arange(len(block.ids)) for block in mesh.blocks)
    if name not in mesh.element_sets:
        raise InputError(
            f"parameter {parameter} names the element set {name!r}, which the mesh does not have; "
            f"{nearest(name, ['all', *mesh.element_sets])}"
        )
    if not sum(len(rows) for rows in mesh.element_sets[name]):
        raise InputError(f"parameter {parameter} names the element set {name!r}, which has no elements; name another")
    return mesh.element_sets[name]


def young_of(material: Material, parameter: str) -> float:
    """Young's modulus of an isotropic material in Pa.

    Raises:
        InputError: a material that is not isotropic.
    """
    S = np.linalg.inv(material.stiffness)
    E, nu = 1 / S[0, 0], -S[0, 1] / S[0, 0]
    alike = isotropic(set=material.set, young=E, poisson=nu, density=material.density).stiffness
    if np.abs(alike - material.stiffness).max() > ISOTROPIC * np.abs(alike).max():
        raise InputError(
            f"parameter {parameter} is the young of the set {material.set!r}, whose material is not isotropic; the "
            "modulus of an isotropic material can vary"
        )
    return float(E)


class AffineProblem(Problem):
    """The coupled problem at nominal values of parameters, with the terms of which all others of its box are sums.

    ``K_terms``, ``M_terms`` (Nc, Nc) and ``law_K``, ``law_M`` give K(p) and M(p); B and the coupling are one for all.
    ``rigid_terms`` (Nc, 6, 1 + morphs): the geometric rigid motions are R0 + sum_i t_i R_i, about a fixed pole.

    >>> with AffineProblem(varied, interfaces) as problem:
    ...     problem.at(problem.box.point({"E": 2e11})).K.shape
    (48, 48)
    """

    def __init__(
        self, varied: VariedModel, interfaces: Sequence[Interface] = (), *, damping: Damping | None = None,
        budget: Budget | None = None, model: FEModel | None = None, **options: Any,
    ) -> None:  # fmt: skip
        nominal = varied.box.nominal
        model = varied.model(nominal, budget or UNLIMITED) if model is None else model
        self.varied, self.box, self.parameters = varied, varied.box, varied.parameters
        given = _damping(damping or Damping(), self.parameters, nominal)
        super().__init__(model, interfaces, damping=given, budget=budget, **options)

    @property
    def law_K(self) -> Law:
        """Coefficients a_q(p) of the stiffness."""
        return self.varied.stiffness.law

    @property
    def law_M(self) -> Law:
        """Coefficients b_j(p) of the mass."""
        return self.varied.mass.law

    @cached_property
    def K_terms(self) -> tuple[sp.csr_array, ...]:
        """The terms K_q (Nc, Nc), each on the pattern of its own elements."""
        return tuple(self.stiffness_sum(theta) for theta in np.eye(len(self.varied.stiffness)))

    @cached_property
    def M_terms(self) -> tuple[sp.csr_array, ...]:
        """The terms M_j (Nc, Nc)."""
        return tuple(self.mass_sum(theta) for theta in np.eye(len(self.varied.mass)))

    def stiffness_sum(self, theta: Floats) -> sp.csr_array:
        """sum_q theta_q K_q (Nc, Nc) for any coefficients (Q,)."""
        terms = self.varied.stiffness
        return self._coupled(stiffness_matrix(self.varied.graph, terms.combined(theta), self.budget))

    def mass_sum(self, theta: Floats) -> sp.csr_array:
        """sum_j theta_j M_j (Nc, Nc) for any coefficients (J,)."""
        return self._coupled(mass_matrix(self.varied.graph, self.varied.mass.combined(theta), self.budget))

    def _coupled(self, A: sp.csr_array) -> sp.csr_array:
        A.eliminate_zeros()
        T = self.coupling.T
        return A if T.shape[0] == T.shape[1] else congruence(T, A, self.budget)

    @cached_property
    def rigid_terms(self) -> Floats:
        """(Nc, 6, 1 + morphs): R(p) = R0 + sum_i t_i R_i over the morphs i in the order of the parameters."""
        return self.coupling.R[:, :, None]

    def damping_at(self, p: Floats) -> Damping:
        """The damping at ``p`` (P,)."""
        return _damping(self.damping, self.parameters, p)

    def at(self, p: Floats, *, assembled: bool = False) -> Problem:
        """The problem at ``p`` (P,), K and M being sums of the terms, or ``assembled`` by direct integration."""
        model = (self.varied.assembled if assembled else self.varied.model)(p, self.budget)
        return Problem(
            model, self.interfaces_at(p), solver=self.solver, damping=self.damping_at(p), budget=self.budget,
            progress=self.progress,
        )  # fmt: skip

    def interfaces_at(self, p: Floats) -> tuple[Interface, ...]:
        """The interfaces at ``p`` (P,)."""
        return self.interfaces


def _damping(damping: Damping, parameters: Sequence[Parameter], p: Floats) -> Damping:
    given: dict[str, Any] = {
        parameter.kind: float(value)
        for parameter, value in zip(parameters, p, strict=True)
        if parameter.kind in ("alpha", "beta")
    }
    return replace(damping, **given) if given else damping
