"""Stress at nodes against exact fields, and its recovery from reduced models against full solutions."""

import dataclasses
from types import SimpleNamespace
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.base.budget import Budget
from morembs.base.units import parse_units
from morembs.body.recovery_shapes import RECOVERY, read_recovery, recovery_parts
from morembs.body.stress_shapes import stress_recovery, stress_shapes
from morembs.fem import Mesh
from morembs.fem.assembly import assemble
from morembs.fem.elements import TYPES
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic, orthotropic
from morembs.fem.stress_operator import principal, stress_operator, von_mises
from morembs.importers import read_mesh
from morembs.problem import Problem
from morembs.reducers import CraigBampton, FreeInterface, Guyan, Krylov, Modal
from morembs.responses.loads import static_response
from morembs.storage.writer import Writer
from tests.support.meshes import STEEL, box, heavy, steel, where
from tests.support.refusals import refusal

TENSOR = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
H = np.array([[1.0, 0.4, -0.3], [0.2, -0.7, 0.5], [0.6, -0.1, 0.9]]) * 1e-3
TURNED = np.linalg.qr(np.array([[1.0, 2.0, 0.0], [0.5, -1.0, 1.0], [0.0, 1.0, 3.0]]))[0]
WOOD = orthotropic(
    set="all", young=(1.2e10, 8e8, 5e8), poisson=(0.4, 0.3, 0.5), shear=(7e8, 6e8, 1e8), density=500.0, axes=TURNED
)


def hooke(young, poisson, H):
    """Six stresses of an isotropic body of displacement gradients H (..., 3, 3)."""
    strain = 0.5 * (H + np.swapaxes(H, -1, -2))
    lam, mu = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    stress = lam * np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) + 2 * mu * strain
    return np.stack([stress[..., i, j] for i, j in TENSOR], axis=-1)


def uneven(xyz):
    """A box without right angles."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    return np.stack([x + 0.2 * y + 0.1 * x * z, y - 0.1 * z + 0.15 * x * y, z + 0.1 * x + 0.05 * y * z], axis=-1)


@pytest.mark.parametrize("kind", sorted(TYPES))
@pytest.mark.parametrize("material", ["steel", "wood"])
def test_patch_test_constant_stress_in_every_element(kind, material):
    mesh = box(kind, (2, 3, 2), (1.0, 1.2, 0.8), uneven)
    model = steel(mesh) if material == "steel" else assemble(mesh, [WOOD])
    operator = stress_operator(model, "all")
    u = (mesh.nodes.xyz @ H.T + np.array([3.0, -2.0, 1.0]) * 1e-3).reshape(-1, 1)
    strain = operator.strain(u).reshape(-1, 6)
    exact = np.array([0.5 * (H + H.T)[i, j] for i, j in TENSOR])
    assert np.abs(strain - exact).max() < 1e-10 * np.abs(exact).max()
    if material == "steel":
        stress = hooke(STEEL["young"], STEEL["poisson"], H)
    else:
        C = WOOD.stiffness @ np.array([*exact[:3], 2 * exact[4], 2 * exact[5], 2 * exact[3]])
        stress = C[[0, 1, 2, 5, 3, 4]]
    assert np.abs(operator.stress(u).reshape(-1, 6) - stress).max() < 1e-10 * np.abs(stress).max()


@pytest.mark.parametrize("kind", ["tet10", "hex20", "hex27", "wedge15"])
def test_linear_stress_is_exact_in_quadratic_elements(kind):
    mesh = box(kind, (2, 2, 2), (1.0, 1.2, 0.8))
    model = steel(mesh)
    x, y, z = mesh.nodes.xyz.T
    u = np.stack([x * x - 0.5 * y * z, x * y + 0.3 * z * z, 0.7 * x * z - y * y], axis=1) * 1e-3
    zero = np.zeros_like(x)
    grad = np.array([[2 * x, -0.5 * z, -0.5 * y], [y, x, 0.6 * z], [0.7 * z, -2 * y, 0.7 * x]]) * 1e-3 + zero
    exact = hooke(STEEL["young"], STEEL["poisson"], np.moveaxis(grad, -1, 0))
    stress = stress_operator(model, "all").stress(u.reshape(-1, 1)).reshape(-1, 6)
    assert np.abs(stress - exact).max() < 1e-10 * np.abs(exact).max()


def test_pieces_of_many_elements_are_those_of_two_blocks():
    whole, parts = (stress_operator(steel(mesh), "skin") for mesh in heavy())
    u = np.sin(np.arange(3.0 * whole.gradient.shape[1]))[:, None]
    assert np.abs(whole.strain(u) - parts.strain(u)).max() < 1e-12 * np.abs(whole.strain(u)).max()


def test_average_weighs_elements_by_volume():
    """Linear tetrahedra have one strain each; that of a node is their mean by volume."""
    mesh = box("tet4", (3, 2, 2), (1.0, 1.0, 1.0), uneven)
    model = steel(mesh)
    u = np.sin(np.arange(3.0 * len(mesh.nodes)))[:, None]
    whole = stress_operator(model, "all").strain(u)
    nodes, xyz = mesh.blocks[0].nodes, mesh.nodes.xyz
    edges = xyz[nodes[:, 1:]] - xyz[nodes[:, :1]]
    volume = np.linalg.det(edges) / 6
    moved = u.reshape(-1, 3)[nodes]
    grad = np.swapaxes(np.linalg.solve(edges, moved[:, 1:] - moved[:, :1]), 1, 2)
    strain = np.array([[0.5 * (g[i, j] + g[j, i]) for i, j in TENSOR] for g in grad])
    for node in (0, 7, 20, len(xyz) - 1):
        at = (nodes == node).any(axis=1)
        mean = volume[at] @ strain[at] / volume[at].sum()
        assert whole.reshape(-1, 6)[node] == pytest.approx(mean, rel=1e-11, abs=1e-12)
    # Entries are summed up whenever they are many.
    assert np.abs(stress_operator(model, "all", collected=1).strain(u) - whole).max() < 1e-12 * np.abs(whole).max()
    some = stress_operator(model, np.array([20, 7, 7]))
    assert some.nodes.tolist() == [7, 20]
    assert some.strain(u).reshape(-1, 6) == pytest.approx(whole.reshape(-1, 6)[[7, 20]], rel=1e-12)
    skin = stress_operator(model, "skin").nodes
    inside = np.setdiff1d(np.arange(len(xyz)), skin)
    assert len(inside) == 2 * 1 * 1


def test_a_node_between_two_materials_has_both_stresses():
    """Tension through two materials: the strain along it jumps, the stress of each is its own."""
    mesh = box("hex20", (4, 1, 1), (4.0, 1.0, 1.0))
    halves = {"soft": (np.array([0, 1]),), "hard": (np.array([2, 3]),)}
    mesh = Mesh(nodes=mesh.nodes, blocks=mesh.blocks, element_sets=halves)
    E = {"soft": 1e9, "hard": 3e9}
    model = assemble(mesh, [isotropic(set=s, young=E[s], poisson=0.0, density=1.0) for s in ("soft", "hard")])
    x = mesh.nodes.xyz[:, 0]
    u = np.zeros((len(x), 3))
    u[:, 0] = np.minimum(x, 2) / E["soft"] + np.maximum(x - 2, 0) / E["hard"]
    operator = stress_operator(model)
    middle = where(model, 0, 2.0)
    assert len(operator.nodes) == len(x) + len(middle)
    assert np.array_equal(operator.nodes[np.flatnonzero(np.diff(operator.nodes) == 0)], middle)
    stress, strain = (f(u.reshape(-1, 1)).reshape(-1, 6) for f in (operator.stress, operator.strain))
    assert np.abs(stress - [1, 0, 0, 0, 0, 0]).max() < 1e-10
    assert np.abs(strain[:, 0] - np.where(operator.material == 0, 1e-9, 1 / 3e9)).max() < 1e-19
    # Two names for one material are one material.
    twice = assemble(mesh, [isotropic(set=s, **STEEL) for s in ("soft", "hard")])
    assert len(stress_operator(twice).nodes) == len(x)


def test_jumps_between_elements_stay_within_a_material():
    """Stress that jumps where materials meet, but not within them, has no jumps; that of a bent bar of tet4 has."""
    mesh = box("hex20", (4, 1, 1), (4.0, 1.0, 1.0))
    mesh = dataclasses.replace(mesh, element_sets={"soft": (np.array([0, 1]),), "hard": (np.array([2, 3]),)})
    young = {"soft": 1e9, "hard": 3e9}
    model = assemble(mesh, [isotropic(set=s, young=E, poisson=0.3, density=1.0) for s, E in young.items()])
    face = make_interface(model, name="all", nodes=np.arange(len(mesh.nodes)), coupling="direct")
    with Problem(model, [face]) as problem:
        recovery = stress_recovery(problem, Guyan().reduce(problem), single=False, correction=False)
    q = (mesh.nodes.xyz @ H.T).reshape(1, -1)  # one strain everywhere, two stresses at the border
    stress = von_mises(recovery.at(q)[0])
    assert stress[recovery.material == 1] == pytest.approx(3 * stress[0])
    assert len(recovery.points) > len(np.unique(recovery.points))
    assert recovery.jumps_at(q)[0].max() < 1e-9 * stress.max()
    # Strain that turns round at the border: each half has its own gradient, and no jump but what its elements miss.
    bent = (mesh.nodes.xyz[:, :1] ** 2 * [1e-4, 0, 0]).reshape(1, -1)
    assert recovery.jumps_at(bent)[0].max() < 1e-9 * von_mises(recovery.at(bent)[0]).max()


def plate_with_hole(kind, count):
    """Stress and jump (Pa) at the edge of a hole in a plate under 100 MPa, where it is 300 MPa (Kirsch 1898).

    A sector of 90 degrees; its other edges have the exact displacements.
    """
    E, nu, a, S = STEEL["young"], STEEL["poisson"], 0.01, 1e8

    def sector(p):
        s, t, z = np.moveaxis(p, -1, 0)
        r, phi = a * 4**s, np.pi * (0.25 + 0.5 * t)
        return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)

    model = steel(box(kind, (count, 2 * count, 1), (1, 1, 0.002), sector))
    x, y, z = model.nodes.xyz.T
    r, phi, k, c = np.hypot(x, y), np.arctan2(y, x), (3 - nu) / (1 + nu), S * a * (1 + nu) / (4 * E)
    cos, sin, far, near = np.cos, np.sin, r / a, a / r
    u = np.stack(
        [
            c
            * (far * (k + 1) * cos(phi) + 2 * near * ((1 + k) * cos(phi) + cos(3 * phi)) - 2 * near**3 * cos(3 * phi)),
            c
            * (far * (k - 3) * sin(phi) + 2 * near * ((1 - k) * sin(phi) + sin(3 * phi)) - 2 * near**3 * sin(3 * phi)),
            -nu / E * S * (1 - 2 * near**2 * cos(2 * phi)) * z,
        ],
        axis=1,
    )
    edge = np.flatnonzero((r > 4 * a * (1 - 1e-9)) | (np.abs(np.abs(x) - y) < 1e-9))
    with Problem(model, [make_interface(model, name="edge", nodes=edge, coupling="direct")]) as problem:
        recovery = stress_recovery(problem, Guyan().reduce(problem), correction=False)
    q = u[edge].reshape(1, -1)
    at = np.hypot(recovery.coordinates[:, 0], recovery.coordinates[:, 1] - a) < 1e-6
    return von_mises(recovery.at(q)[0])[at].max(), recovery.jumps_at(q)[0][at].max()


@pytest.mark.parametrize("kind", ["hex8", "hex20", "tet10"])
def test_jumps_at_a_hole_fall_as_its_stress_converges(kind):
    """Half to three times the error of the peak stress, though elements on both sides of the peak agree in it."""
    (coarse, coarse_jump), (fine, fine_jump) = (plate_with_hole(kind, count) for count in (2, 4))
    errors = 1 - coarse / 3e8, 1 - fine / 3e8
    assert 0.1 < errors[0] < 0.2 and errors[1] < 0.6 * errors[0]
    for stress, jump, error in ((coarse, coarse_jump, errors[0]), (fine, fine_jump, errors[1])):
        assert 0.5 * error < jump / stress < 3 * error
    assert fine_jump < 0.8 * coarse_jump


def test_von_mises_and_principal_values():
    rng = np.random.default_rng(5)
    T = rng.standard_normal((7, 2, 3, 3))
    T = T + np.swapaxes(T, -1, -2)
    six = np.stack([T[..., i, j] for i, j in TENSOR], axis=-1)
    values = np.linalg.eigvalsh(T)
    assert principal(six) == pytest.approx(values[..., ::-1], abs=1e-12)
    a, b, c = np.moveaxis(values, -1, 0)
    assert von_mises(six) == pytest.approx(np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 2), rel=1e-12)
    assert von_mises(np.array([0, 0, 0, 2.0, 0, 0])) == pytest.approx(2 * np.sqrt(3))
    assert von_mises(np.array([5.0, 0, 0, 0, 0, 0], dtype=np.float32)) == pytest.approx(5.0)


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_bending_beam(kind):
    """Cantilever under a tip force: sigma = F (L - x) (z - h/2) / I at the skin, away from the ends."""
    L, b, h, F = 0.5, 0.03, 0.05, 1000.0
    model = steel(box(kind, (10, 1, 2), (L, b, h)), poisson=0.0)
    interfaces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling="average")
        for n, x in (("root", 0.0), ("tip", L))
    ]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=0).reduce(problem)
        recovery = stress_recovery(problem, reduced, single=False)
    root, tip = reduced.B[:, :6], reduced.B[:, 6:]
    K = np.block([[reduced.K, root], [root.T, np.zeros((6, 6))]])
    q = np.linalg.solve(K, np.concatenate([F * tip[:, 2], np.zeros(6)]))[: reduced.order]
    stress = recovery.at(q[None])[0]
    x, _, z = recovery.coordinates.T
    far = (x > 0.1 * L) & (x < 0.9 * L)
    exact = -F * (L - x) * (z - h / 2) / (b * h**3 / 12)
    assert np.abs(stress[far, 0] - exact[far]).max() < 2e-2 * np.abs(exact).max()
    surface = far & ((z == 0) | (np.abs(z - h) < 1e-9))
    assert np.abs(von_mises(stress[surface]) - np.abs(exact[surface])).max() < 2e-2 * np.abs(exact).max()


def bar(**change):
    """Bar with one interface of each coupling, rigid at the left, direct at few nodes in the middle."""
    model = steel(box("hex20", (6, 2, 2), (0.5, 0.06, 0.04)), **change)
    middle = np.flatnonzero(np.linalg.norm(model.nodes.xyz - [0.25, 0.03, 0.04], axis=1) < 1e-6)
    chosen = (
        (("left"), where(model, 0, 0.0), "rigid"),
        ("right", where(model, 0, 0.5), "average"),
        ("middle", middle, "direct"),
    )
    return model, [make_interface(model, name=n, nodes=rows, coupling=c) for n, rows, c in chosen]


@pytest.fixture(scope="module")
def problem():
    model, interfaces = bar()
    with Problem(model, interfaces) as problem:
        yield problem


def full_static(problem, operator, loads):
    """Stress of K u = B f - M R a of the free body by dense least squares, R a balancing the loads."""
    K, M, B, R = problem.K.toarray(), problem.M.toarray(), problem.B.toarray(), problem.coupling.R
    f = B @ loads
    f = f - M @ R @ np.linalg.solve(R.T @ M @ R, R.T @ f)
    d = 1 / np.sqrt(np.diag(K))
    u = d * np.linalg.lstsq(d[:, None] * K * d, d * f, rcond=1e-11)[0]
    return operator.stress((problem.coupling.T @ u)[:, None]).reshape(-1, 6)


@pytest.mark.parametrize(
    "reducer",
    [Modal(modes=6), FreeInterface(modes=3), CraigBampton(modes=4), Modal(modes=3, interfaces="fixed")],
    ids=repr,
)
def test_correction_makes_static_stress_exact(problem, reducer):
    operator = stress_operator(problem.model)
    reduced = reducer.reduce(problem)
    recovery = stress_recovery(problem, reduced, single=False, operator=operator)
    loads = np.sin(1.0 + np.arange(problem.B.shape[1])) * 100
    exact = full_static(problem, operator, loads)
    values, Y = reduced.modes()
    elastic = Y[:, reduced.rigid_count :]
    q = elastic @ ((elastic.T @ (reduced.B @ loads)) / values[reduced.rigid_count :])
    q = q + 1e-3 * Y[:, : reduced.rigid_count].sum(axis=1)
    size = np.abs(exact).max()
    assert np.abs(recovery.at(q[None], loads[None])[0] - exact).max() < 1e-7 * size
    error = np.abs(recovery.at(q[None])[0] - exact).max() / size
    # Attachment modes are complete; craig-bampton lacks only what inertia relief does inside the body.
    least = {FreeInterface: 0.0, CraigBampton: 1e-5, Modal: 0.1}[type(reducer)]
    assert error > least and (error < 1e-7 or type(reducer) is not FreeInterface)


@pytest.mark.parametrize(
    "reducer",
    [
        Krylov(shifts_hz=[9000.0], order=7),
        Krylov(shifts_hz=[3000.0], two_sided=True, inputs=["left"], outputs=["left", "middle"]),
    ],
    ids=["one-sided", "two-sided"],
)
def test_correction_of_bases_that_are_no_modes(problem, reducer):
    """What the reduced model gives and what is added make the static response, also where V is not the test space."""
    operator = stress_operator(problem.model, where(problem.model, 2, 0.0))
    reduced = reducer.reduce(problem)
    recovery = stress_recovery(problem, reduced, nodes=where(problem.model, 2, 0.0), single=False)
    static = stress_shapes(problem, static_response(problem), operator)
    r = reduced.rigid_count
    own = recovery.stress[:, r:] @ np.linalg.solve(reduced.K[r:, r:], reduced.B[r:])
    assert np.abs(own - static).max() > 0.01 * np.abs(static).max()
    np.testing.assert_allclose(recovery.correction + own, static, rtol=0, atol=1e-8 * np.abs(static).max())


def test_rigid_motion_gives_no_stress_even_in_single_precision(problem):
    """A craig-bampton body has no rigid coordinates; moved by 100 m and turned by 1 rad it stays free of stress."""
    for reducer in (CraigBampton(modes=4), Modal(modes=4)):
        reduced = reducer.reduce(problem)
        recovery = stress_recovery(problem, reduced)
        assert recovery.stress.dtype == recovery.correction.dtype == np.float32
        assert not recovery.stress[:, np.array(reduced.mode_kind) == "rigid"].any()
        Z = np.linalg.lstsq(reduced.V, problem.coupling.R, rcond=None)[0]
        q = Z @ np.array([100.0, -50.0, 20.0, 1.0, 0.5, -0.3])
        # 1e-9 of the strain that such displacements make when they are not rigid.
        assert np.abs(recovery.at(q[None])).max() < 1e-9 * STEEL["young"] * 100 / 0.5
        double = stress_recovery(problem, reduced, single=False)
        q = q + np.linspace(-1, 1, reduced.order) * 1e-6
        assert np.abs(recovery.at(q[None]) - double.at(q[None])).max() < 1e-6 * np.abs(double.at(q[None])).max()


def test_recovery_survives_the_file_and_missing_parts_are_named(problem, tmp_path):
    reduced = CraigBampton(modes=2).reduce(problem)
    for single, correction in ((True, True), (False, False)):
        recovery, check = stress_recovery(problem, reduced, single=single, correction=correction), Mock()
        with h5py.File(tmp_path / "r.h5", "w") as file:
            Writer(file, check).rows("r/", RECOVERY, recovery_parts(recovery))
            assert check.check.call_count >= reduced.order
            back = read_recovery(file["r"])
            del file["r/stress"]
            with refusal("file", "stress"):
                read_recovery(file["r"])
        np.testing.assert_equal(dict(back.markers), dict(recovery.markers))
        # Displacements in coupled dofs are written where there are nodes to write them for.
        for name in {field.name for field in dataclasses.fields(recovery)} - {"missing", "markers"}:
            written, read = getattr(recovery, name), getattr(back, name)
            assert (written is None) == (read is None)
            if written is not None:
                assert written.dtype == read.dtype
                np.testing.assert_array_equal(written, read)


def test_what_stress_refuses(problem):
    model = problem.model
    with refusal("value", "nodes"):
        stress_operator(model, "surface")
    with refusal("value", "row -1", "-1"):
        stress_operator(model, np.array([-1, 3]))
    with refusal("value", "no node"):
        stress_operator(model, np.array([], dtype=int))
    for change in ({"mesh": None}, {"materials": ()}):
        with refusal("unsupported", "mesh"):
            stress_operator(dataclasses.replace(model, **change))


@pytest.fixture(scope="module")
def rod(small_meshes):
    """The coarse connecting rod between its pins, with few modes."""
    units = parse_units("mm-t-s")
    mesh = read_mesh(small_meshes / "conrod.msh", units)
    model = assemble(mesh, [isotropic(set="all", **STEEL)])
    interfaces = [make_interface(model, name=n, nodes=mesh.nodes.sets[n]) for n in ("BIGEND", "SMALLEND")]
    with Problem(model, interfaces) as problem:
        reduced, operator = Modal(modes=20).reduce(problem), stress_operator(model)
        recovery = stress_recovery(problem, reduced, operator=operator)
        yield SimpleNamespace(problem=problem, reduced=reduced, operator=operator, recovery=recovery)


def test_connecting_rod_at_its_ten_most_loaded_points(rod):
    """Static loads between the pins, twenty modes: 1e-6 with the correction in single precision, not so without."""
    problem, recovery = rod.problem, rod.recovery
    pull, bend, push = (np.zeros(12) for _ in range(3))
    pull[[0, 6]] = 1000.0, -1000.0
    bend[[5, 11]] = 30.0, -30.0
    push[7] = 500.0  # in balance with the inertia of the rod
    for loads, without in ((pull, 0.06), (bend, 0.06), (push, 0.005)):
        full = problem.free_free.flexibility(problem.B @ loads[:, None])
        exact = stress_shapes(problem, full, rod.operator).reshape(-1, 6)
        top = np.argsort(von_mises(exact))[-10:]
        q = np.linalg.pinv(rod.reduced.K, rcond=1e-9) @ (rod.reduced.B @ loads)
        worst = [
            np.abs(von_mises(s[0, top]) / von_mises(exact[top]) - 1).max()
            for s in (recovery.at(q[None], loads[None]), recovery.at(q[None]))
        ]
        assert worst[0] < 1e-6 and worst[1] > without


def test_correction_in_slow_motion(rod):
    """Harmonic loads at a tenth of the first frequency left out: the error falls by far."""
    problem, reduced = rod.problem, Modal(modes=6).reduce(rod.problem)
    recovery = stress_recovery(problem, reduced, operator=rod.operator)
    left_out = 2 * np.pi * problem.elastic_modes(count=7).frequencies_hz[6]
    loads = np.array([1.0, 2.0, 0.5, 0, 0, 0, -1.5, 1.0, 1.0, 0, 0, 0]) * 500
    omega = 0.1 * left_out
    A = sp.csc_array(problem.K - omega**2 * problem.M)
    exact = rod.operator.stress(problem.coupling.T @ spl.spsolve(A, problem.B @ loads)[:, None]).reshape(-1, 6)
    q = np.linalg.solve(reduced.K - omega**2 * reduced.M, reduced.B @ loads)
    corrected, plain = (
        np.abs(s[0] - exact).max() / np.abs(exact).max()
        for s in (recovery.at(q[None], loads[None]), recovery.at(q[None]))
    )
    assert plain > 0.02 and corrected < 0.05 * plain


def test_a_small_memory_budget_changes_nothing(rod):
    """Scratch files and few columns give what memory gives."""
    model, interfaces = rod.problem.model, rod.problem.interfaces
    with Budget(10**12, in_memory=0, widest=4), Problem(model, interfaces) as problem:
        again = stress_recovery(problem, rod.reduced)
        for name in ("stress", "correction"):
            a, b = getattr(again, name), getattr(rod.recovery, name)
            assert np.abs(a - b).max() < 1e-6 * np.abs(b).max()
