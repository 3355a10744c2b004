"""Formulations of elements: rigid motion, constant strain, bending, volume, and the strain that others take of them."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from morembs.dynamics.nonlinear.total_lagrangian import SaintVenantKirchhoff
from morembs.fem import FEModel, Mesh, rigid_motion
from morembs.fem.assembly import assemble
from morembs.fem.elements import IRONS, STROUD, TYPES
from morembs.fem.fe_model import Component
from morembs.fem.formulations import FORMULATIONS, MASSES
from morembs.fem.geometric_stiffness import geometric_stiffness
from morembs.fem.material import isotropic, orthotropic
from morembs.fem.stress_operator import stress_operator
from tests.support.meshes import STEEL, box
from tests.support.refusals import refusal

CASES = [(name, kind) for name, rule in FORMULATIONS.items() for kind in rule.orders or () if name != "full"]
NU = 0.3
WOOD = orthotropic(
    set="all", young=(12e9, 0.8e9, 0.5e9), poisson=(0.4, 0.45, 0.3), shear=(0.7e9, 0.6e9, 0.1e9), density=450.0
)


def skewed(x: np.ndarray) -> np.ndarray:
    return x @ np.array([[1.0, 0.1, 0.05], [0.2, 1.1, 0.1], [0.0, -0.1, 0.9]])


def torn(x: np.ndarray) -> np.ndarray:
    return skewed(x) + 0.05 * np.sin(9 * x @ np.array([[1.0, 2.0, 3.0], [0.3, 0.7, 1.9], [2.2, 0.1, 5.0]]))


def of(mesh: Mesh, formulation: str, mass: str = "exact") -> Mesh:
    return replace(mesh, blocks=tuple(replace(block, formulation=formulation, mass=mass) for block in mesh.blocks))


def brick(formulation: str, kind: str = "hex8", n: tuple[int, int, int] = (2, 2, 2), *, warp=None, **change) -> FEModel:
    mesh = of(box(kind, n, (1.0, 1.0, 1.0), warp), formulation, change.pop("mass", "exact"))
    return assemble(mesh, [isotropic(set="all", **{**STEEL, **change})])


@pytest.mark.parametrize("material", ["steel", "wood"])
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_rigid_motion_and_constant_strain(name: str, kind: str, material: str) -> None:
    """Symmetric, no strain of rigid motion, six rigid modes, and the patch test; hex8 of no regular shape, but for the
    modes of CalculiX, which pass it on parallelepipeds."""
    is_torn = kind == "hex8" and not FORMULATIONS[name].has_modes
    mesh = of(box(kind, (2, 2, 2), (1.0, 1.0, 1.0), torn if is_torn else skewed), name)
    used = isotropic(set="all", **STEEL) if material == "steel" else WOOD
    model = assemble(mesh, [used])
    K, x = model.K.toarray(), model.nodes.xyz
    R = rigid_motion(x[model.dofs.node], model.dofs.component)
    assert np.abs(K - K.T).max() == 0 and np.abs(K @ R).max() < 1e-12 * np.abs(K).max()
    values = np.linalg.eigvalsh(K)
    assert values[5] < 1e-11 * values[-1] and values[6] > 1e-7 * values[-1]
    G = np.array([[1.0, 0.3, -0.2], [0.5, -0.4, 0.1], [0.2, 0.6, 0.8]]) * 1e-3
    u = (x @ G.T).ravel()
    unit = box(kind, (2, 2, 2), (1.0, 1.0, 1.0)).nodes.xyz
    inner = ((unit > 1e-9) & (unit < 1 - 1e-9)).all(axis=1)
    force = (K[: len(u), : len(u)] @ u).reshape(-1, 3)
    assert np.abs(K[len(u) :, : len(u)] @ u).max(initial=0.0) < 1e-10 * np.abs(force).max()
    assert inner.any() and np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()
    E = 0.5 * (G + G.T)
    strain = np.array([E[0, 0], E[1, 1], E[2, 2], E[0, 1], E[1, 2], E[2, 0]])
    at_nodes = stress_operator(model, "all", elements=True)
    for operator in (at_nodes, at_nodes.elements.operator):
        assert np.abs(operator.strain(u[:, None]).reshape(-1, 6) - strain).max() < 1e-13


def bent(model: FEModel) -> np.ndarray:
    """Bending of a block about y with unit curvature, at its nodes."""
    x, y, z = (model.nodes.xyz - model.nodes.xyz.mean(axis=0)).T
    return np.stack([x * z, -NU * y * z, -0.5 * (x**2 + NU * (z**2 - y**2))], axis=1).ravel()


def test_incompatible_modes_bend_without_shear() -> None:
    """The energy of one element in bending is that of the beam (Wilson 1973); plain ones are far too stiff."""
    beam = STEEL["young"] / 12 / 2
    energies = {
        name: (u := bent(model := brick(name, n=(1, 1, 1)))) @ (model.K @ u) / 2
        for name in FORMULATIONS
        if "hex8" in (FORMULATIONS[name].orders or TYPES) and not FORMULATIONS[name].has_modes
    }
    assert energies["incompatible"] == pytest.approx(beam, rel=1e-12)
    assert energies["full"] > 1.5 * beam > 1.3 * energies["b-bar"] and energies["mean-strain"] < 0.05 * beam


def test_modes_that_are_dofs_are_those_that_are_condensed() -> None:
    """Of parallelepipeds: K where they carry no load, M of the nodes, and strains of modes at rest."""
    dofs, condensed = (
        brick(name, n=(2, 1, 1), warp=skewed, mass="reduced") for name in ("inner-modes", "incompatible")
    )
    n = condensed.size
    assert dofs.size == n + 2 * 9 and (dofs.dofs.component[n:] == Component.SCALAR).all()
    K, M = dofs.K.toarray(), dofs.M.toarray()
    own = K[:n, :n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], K[n:, :n])
    assert np.abs(own - condensed.K).max() < 1e-12 * np.abs(K).max()
    assert np.abs(M[:n, :n] - condensed.M).max() == 0 and np.linalg.eigvalsh(M)[0] > -1e-12 * np.abs(M).max()
    # At the points of two by two by two each mode is 2 / 3, so that those of an element move one mass.
    mass = STEEL["density"] * np.linalg.det(skewed(np.eye(3))) / 2
    assert M[n:, n:].sum() == pytest.approx(2 * 3 * 9 * 4 / 9 * mass, rel=1e-12)
    u = np.random.default_rng(2).standard_normal((n, 2))
    first, second = (stress_operator(model, "all").strain(u) for model in (dofs, condensed))
    assert np.abs(first - second).max() < 1e-12 * np.abs(first).max()


def test_stress_of_a_bent_element() -> None:
    """Stress of the incompatible element is that of the beam, whose plain neighbours have shear and cross stresses."""
    model = brick("incompatible", n=(1, 1, 1))
    operator = stress_operator(model, "all")
    stress = operator.stress(bent(model)[:, None]).reshape(-1, 6)
    z = model.nodes.xyz[:, 2] - 0.5
    assert stress[:, 0] == pytest.approx(STEEL["young"] * z, rel=1e-11)
    assert np.abs(stress[:, 1:]).max() < 1e-10 * STEEL["young"]
    plain = stress_operator(brick("full", n=(1, 1, 1)), "all").stress(bent(model)[:, None]).reshape(-1, 6)
    assert np.abs(plain[:, 1:]).max() > 0.1 * STEEL["young"]


def test_volume_strain_of_b_bar_is_one_value() -> None:
    """Of one element of any shape, whatever its nodes do; shears are those of the field."""
    strains = {}
    for name in ("full", "b-bar"):
        model = brick(name, n=(1, 1, 1), warp=torn)
        u = np.random.default_rng(3).standard_normal((24, 2))
        strains[name] = stress_operator(model, "all").strain(u).reshape(8, 6, 2)
    volume = strains["b-bar"][:, :3].sum(axis=1)
    assert np.ptp(volume, axis=0).max() < 1e-12 < 1e-3 < np.ptp(strains["full"][:, :3].sum(axis=1), axis=0).min()
    assert np.abs(strains["b-bar"][:, 3:] - strains["full"][:, 3:]).max() < 1e-12


@pytest.mark.parametrize("name", ["b-bar", "mean-strain", "incompatible"])
def test_geometric_stiffness_takes_the_same_stress(name: str) -> None:
    """Equal for a constant stress; else S of B u at the points, K_g = sum dN' S dN dV."""
    steel = isotropic(set="all", **STEEL)
    mesh = box("hex8", (2, 1, 1), (0.2, 0.1, 0.1), skewed)
    u = (mesh.nodes.xyz @ np.diag([1e-3, -2e-4, 3e-4])).ravel()
    kg, plain = (geometric_stiffness(of(mesh, rule), [steel], u).toarray() for rule in (name, "full"))
    if name != "mean-strain":
        assert np.abs(kg - plain).max() < 1e-11 * np.abs(plain).max()
    single = of(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0), torn), name)
    u = 1e-3 * np.random.default_rng(5).standard_normal(24)
    formulation, block = FORMULATIONS[name], single.blocks[0]
    elements = formulation.elements(TYPES["hex8"], single.nodes.xyz[block.nodes], block.ids, steel.stiffness[None])
    rows = (3 * block.nodes[0][:, None] + np.arange(3)).ravel()
    B, want = formulation.operator(elements)[0], np.zeros((8, 8))
    for q, (dN, dV) in enumerate(zip(elements.here.dN[0], elements.here.dV[0], strict=True)):
        s = steel.stiffness @ B[q] @ u[rows]
        S = np.array([[s[0], s[5], s[4]], [s[5], s[1], s[3]], [s[4], s[3], s[2]]])
        want += dN @ S @ dN.T * dV
    of_block = geometric_stiffness(single, [steel], u).toarray()[np.ix_(block.nodes[0], block.nodes[0])]
    assert np.abs(of_block - want).max() < 1e-12 * np.abs(want).max()


@pytest.mark.parametrize(("mass", "kind"), [(mass, kind) for mass, kinds in MASSES.items() for kind in kinds])
def test_every_mass_has_the_whole_mass(mass: str, kind: str) -> None:
    model = brick("full", kind, mass=mass, warp=skewed)
    volume = np.linalg.det(skewed(np.eye(3)))
    assert model.M.sum() / 3 == pytest.approx(STEEL["density"] * volume, rel=1e-12)
    if mass == "row-sum":
        assert model.M.nnz == model.size and model.M.data.min() > 0


def test_the_mass_of_the_mean_strain_is_that_of_the_whole_volume() -> None:
    mean, exact = brick("mean-strain", mass="reduced", warp=torn), brick("full", warp=torn)
    assert mean.M.sum() == pytest.approx(exact.M.sum(), rel=1e-12)


@pytest.mark.parametrize(("kind", "name", "count"), [("hex20", IRONS, 14), ("tet10", STROUD, 15)])
def test_rules_by_name_are_exact_to_degree_five(kind: str, name: str, count: int) -> None:
    rule = TYPES[kind].rule(name)
    assert len(rule.weights) == count
    for powers in itertools.product(range(6), repeat=3):
        if sum(powers) <= 5:
            exact = 1 / np.prod(np.add(powers, 1))
            if kind == "tet10":
                exact = np.prod([math.factorial(p) for p in powers]) / math.factorial(sum(powers) + 3)
            assert rule.weights @ np.prod(rule.points ** np.array(powers), axis=1) == pytest.approx(exact, rel=1e-12)


def test_names_that_do_not_fit_are_refused() -> None:
    with refusal("unknown", "formulation", "bbar", "hex8", "b-bar"):
        brick("bbar")
    with refusal("conflict", "formulation", "b-bar", "tet4", "hex8"):
        brick("b-bar", "tet4")
    with refusal("conflict", "mass", "row-sum", "tet10", "tet4", "hex8"):
        brick("full", "tet10", mass="row-sum")


def test_large_displacements_need_the_strain_of_the_field() -> None:
    with refusal("unsupported", "formulation", "8", "hex8", "b-bar", "full"):
        SaintVenantKirchhoff(brick("b-bar"))
    model = brick("reduced", "hex20", n=(1, 1, 1))
    tangent = SaintVenantKirchhoff(model).tangent(model.nodes.xyz)
    assert abs(tangent - model.K).max() < 1e-12 * abs(model.K).max()
