"""Reduction methods against dense solutions and exact properties."""

import json

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import SingularMatrixError
from morembs.body import elastic_body, make_part
from morembs.certificate.response import full_response, reduced_response
from morembs.fem import DofMap, ElementBlock, FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.interface import Interface, make_interface
from morembs.fem.material import isotropic
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, FreeInterface, Guyan, Modal
from tests.support.meshes import STEEL, box, ends, steel, where
from tests.support.refusals import refusal

COUPLINGS = ("rigid", "average", "direct")


def bar(kind="hex20", n=(5, 1, 1)):
    return steel(box(kind, n, (0.5, 0.05, 0.03)))


def dense(problem):
    return problem.K.toarray(), problem.M.toarray()


def frequencies(reduced):
    values = sl.eigh(reduced.K, reduced.M, eigvals_only=True)
    return np.sqrt(np.maximum(values[reduced.rigid_count :], 0)) / (2 * np.pi)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_craig_bampton_with_all_modes_is_the_full_model(coupling):
    model = bar(n=(3, 1, 1))
    with Problem(model, ends(model, coupling)) as problem:
        inside = problem.K.shape[0] - problem.B.shape[1]
        reduced = CraigBampton(modes=inside).reduce(problem)
        K, M = dense(problem)
    full = sl.eigh(K, M, eigvals_only=True)[6:]
    values = sl.eigh(reduced.K, reduced.M, eigvals_only=True)[6:]
    assert values == pytest.approx(full, rel=1e-9)


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize(
    "reducer",
    [CraigBampton(modes=5), CraigBampton(up_to_hz=9e3, inertia_modes=True), Guyan(), FreeInterface(modes=5)],
    ids=repr,
)
def test_statics_at_the_interfaces_are_exact(coupling, reducer):
    """Left end held, unit loads at the right end: displacement of the loads' own motions."""
    model = bar()
    with Problem(model, ends(model, coupling)) as problem:
        reduced = reducer.reduce(problem)
        K, _ = dense(problem)
        B = problem.B.toarray()
        half = B.shape[1] // 2
    full = held_flexibility(K, B[:, :half], B[:, half:])
    flexibility = held_flexibility(reduced.K, reduced.B[:, :half], reduced.B[:, half:])
    assert np.abs(flexibility - full).max() < 1e-9 * np.abs(full).max()


def held_flexibility(K, hold, load):
    """load' u under the loads ``load`` with hold' u = 0, on an orthonormal basis of that subspace."""
    N = sl.null_space(hold.T)
    A = N.T @ K @ N
    d = 1 / np.sqrt(np.diag(A))
    u = N @ (d[:, None] * sl.solve(d[:, None] * A * d, d[:, None] * (N.T @ load), assume_a="pos"))
    return load.T @ u


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_reduced_stiffness_has_six_zeros_and_carries_rigid_motion(coupling):
    model = bar()
    with Problem(model, ends(model, coupling)) as problem:
        for reducer in (
            CraigBampton(modes=4),
            CraigBampton(up_to_hz=9e3, inertia_modes=True),
            Guyan(),
            FreeInterface(modes=4),
            Modal(modes=4),
        ):
            reduced = reducer.reduce(problem)
            values = np.abs(sl.eigvalsh(reduced.K))
            # A rank-sized gap: six zeros and no seventh.
            assert (values < 1e-9 * values[-1]).sum() == 6 == reduced.rigid_count, reducer.method
            rigid = problem.coupling.T @ problem.rigid
            V = problem.coupling.T @ reduced.V
            left = rigid - V @ np.linalg.lstsq(V, rigid, rcond=None)[0]
            assert np.abs(left).max() < 1e-10 * np.abs(rigid).max()


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_reduced_matrices_are_the_projections(coupling):
    """The stiffness that each method knows exactly is that of its basis."""
    model = bar()
    with Problem(model, ends(model, coupling)) as problem:
        for reducer in (
            CraigBampton(modes=4),
            CraigBampton(up_to_hz=9e3, inertia_modes=True),
            Guyan(),
            FreeInterface(modes=4),
            Modal(modes=4),
            Modal(modes=4, interfaces="fixed"),
        ):
            reduced = reducer.reduce(problem)
            K = reduced.V.T @ (problem.K @ reduced.V)
            assert np.abs(K - reduced.K).max() < 1e-11 * np.abs(K).max(), reducer.method
            # Nearly dependent attachment modes amplify round-off of the solves.
            assert np.abs((problem.B.T @ reduced.V).T - reduced.B).max() < 1e-9


def test_ritz_frequencies_are_upper_bounds_and_free_interface_beats_modal_in_statics():
    model = bar(n=(8, 1, 1))
    with Problem(model, ends(model, "average")) as problem:
        full = problem.elastic_modes(count=12).frequencies_hz
        for reducer in (CraigBampton(modes=12), FreeInterface(modes=8), Modal(modes=12)):
            hz = frequencies(reducer.reduce(problem))[:8]
            assert (hz > full[:8] * (1 - 1e-9)).all()
            assert hz[:3] == pytest.approx(full[:3], rel=3e-3)
        omega = 2 * np.pi * np.linspace(50.0, 2600.0, 60)
        H = full_response(problem, omega)

        def error(reducer):
            h = reduced_response(reducer.reduce(problem), omega)
            return (np.linalg.norm(h - H, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))).max()

        assert error(FreeInterface(modes=12)) < 0.01 * error(Modal(modes=24))


def test_inertia_modes_pay_at_equal_order():
    """Twelve of thirty internal modes spent on inertia deformation: the error falls tenfold or more."""
    model = bar(n=(10, 2, 1))
    with Problem(model, ends(model, "rigid")) as problem:
        full = problem.elastic_modes(count=10).frequencies_hz
        plain = CraigBampton(modes=30).reduce(problem)
        better = CraigBampton(modes=30, inertia_modes=True).reduce(problem)
        with refusal("unsupported", "", "12"):
            CraigBampton(modes=11, inertia_modes=True).reduce(problem)
    assert plain.order == better.order == 42
    error, lower = (np.abs(frequencies(r)[:10] / full - 1).max() for r in (plain, better))
    assert lower < 0.1 * error and lower < 1e-3
    assert better.mode_kind.count("attachment") == 12


def test_modes_up_to_a_limit_are_all_modes_up_to_it():
    model = bar(n=(8, 1, 1))
    with Problem(model, ends(model, "rigid")) as problem:
        K, M = dense(problem)
        values = sl.eigh(K, M, eigvals_only=True)[6:]
        exact = np.sqrt(values) / (2 * np.pi)
        limit = 0.5 * (exact[9] + exact[10])
        reduced = Modal(up_to_hz=limit).reduce(problem)
        assert frequencies(reduced) == pytest.approx(exact[:10], rel=1e-10)


def test_four_mass_chain_of_the_literature(shared_data):
    case = json.loads((shared_data / "craig_bampton_4dof" / "case.json").read_text())
    model = FEModel(
        K=sp.csr_array(np.array(case["K"], dtype=float)),
        M=sp.csr_array(np.diag(np.array(case["M_diag"], dtype=float))),
        nodes=Nodes(ids=np.arange(1, 5), xyz=np.zeros((4, 3))),
        dofs=DofMap(node=np.arange(4), component=np.zeros(4, dtype=int)),
    )
    # One dof, which has no three displacements: the input is given as a matrix.
    with Problem(model) as problem:
        problem.B = sp.csc_array(np.eye(4)[:, [3]])
        reduced = CraigBampton(modes=3).reduce(problem)
    # Written to six digits in the source, so the exact values are computed here to hold 1e-12.
    K, M = np.array(case["K"], dtype=float), np.diag(np.array(case["M_diag"], dtype=float))
    psi = -np.linalg.solve(K[:3, :3], K[:3, 3:])
    values, phi = sl.eigh(K[:3, :3], M[:3, :3])
    V = np.block([[psi, phi], [np.eye(1), np.zeros((1, 3))]])
    assert np.diag(reduced.K) == pytest.approx([0.25, *values], rel=1e-12)
    assert np.abs(np.abs(reduced.M) - np.abs(V.T @ M @ V)).max() < 1e-12
    assert np.diag(reduced.K) == pytest.approx(case["n3"]["Kred_diag"], abs=2e-6)
    assert np.abs(np.abs(reduced.M) - np.abs(case["n3"]["Mred"])).max() < 1e-6


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_results_do_not_depend_on_numbering_rotation_or_units(coupling):
    mesh = box("tet10", (4, 1, 1), (0.5, 0.05, 0.03))
    left, right = (np.flatnonzero(mesh.nodes.xyz[:, 0] == x) for x in (0.0, 0.5))
    rng = np.random.default_rng(5)

    def result(mesh, left, right, factor=1.0, Q=None):
        material = isotropic(set="all", **STEEL)
        model = assemble(mesh, [material])
        interfaces = [
            make_interface(model, name=n, nodes=rows, coupling=coupling) for n, rows in (("l", left), ("r", right))
        ]
        with Problem(model, interfaces) as problem:
            body = elastic_body(problem, CraigBampton(modes=8).reduce(problem), make_part(problem))
            free = problem.elastic_modes(count=8).frequencies_hz
        return free, body.frequencies_hz[6:], body.part.mass, np.linalg.eigvalsh(body.part.inertia)

    reference = result(mesh, left, right)
    order = rng.permutation(len(mesh.nodes))
    inverse = np.argsort(order)
    shuffled = Mesh(
        nodes=Nodes(ids=np.arange(len(order)), xyz=mesh.nodes.xyz[order]),
        blocks=(ElementBlock(type="tet10", nodes=inverse[mesh.blocks[0].nodes[::-1]], ids=mesh.blocks[0].ids),),
    )
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Q *= np.linalg.det(Q)
    turned = Mesh(nodes=Nodes(ids=mesh.nodes.ids, xyz=mesh.nodes.xyz @ Q.T + [1.0, -2.0, 0.5]), blocks=mesh.blocks)
    for other in (result(shuffled, inverse[left], inverse[right]), result(turned, left, right)):
        for actual, expected in zip(other, reference, strict=True):
            assert actual == pytest.approx(expected, rel=1e-9)


def test_a_body_far_from_the_origin_keeps_its_digits():
    """A part modelled in the coordinates of a whole plant, a kilometre away."""
    mesh = box("hex20", (5, 1, 1), (0.5, 0.05, 0.03))
    away = np.array([1000.0, -2000.0, 500.0])
    far = Mesh(nodes=Nodes(ids=mesh.nodes.ids, xyz=mesh.nodes.xyz + away), blocks=mesh.blocks)
    figures = []
    for nodes in (mesh, far):
        model = steel(nodes)
        left = model.nodes.xyz[:, 0] < model.nodes.xyz[:, 0].min() + 1e-6
        interfaces = [
            make_interface(model, name="l", nodes=np.flatnonzero(left)),
            make_interface(model, name="r", nodes=np.flatnonzero(~left)[-8:], coupling="average"),
        ]
        with Problem(model, interfaces) as problem:
            body = elastic_body(problem, CraigBampton(modes=8).reduce(problem), make_part(problem))
        figures.append((body.frequencies_hz[6:], np.linalg.eigvalsh(body.part.inertia)))
        assert body.reduced.rigid_count == 6
    # Coordinates of 2000 m hold the 0.03 m part to 1e-11 only.
    for near, other in zip(*figures, strict=True):
        assert other == pytest.approx(near, rel=1e-7)


@pytest.mark.parametrize("size", [1e-7, 1e-5, 1e4])
def test_size_does_not_matter(size):
    """Frequencies go with the inverse of the size, from a tenth of a micrometre to ten kilometres."""
    results = []
    for length in (1.0, size):
        model = steel(box("hex20", (5, 1, 1), (0.5 * length, 0.05 * length, 0.03 * length)))
        interfaces = [
            make_interface(model, name=n, nodes=where(model, 0, x), coupling="rigid")
            for n, x in (("l", 0.0), ("r", 0.5 * length))
        ]
        with Problem(model, interfaces) as problem:
            reduced = CraigBampton(modes=14, inertia_modes=True).reduce(problem)
        assert reduced.rigid_count == 6
        results.append(frequencies(reduced) * length)
    assert results[1] == pytest.approx(results[0], rel=1e-7)


def test_a_far_interface_point_is_refused():
    model = bar()
    with refusal("value", "origin"):
        make_interface(model, name="far", nodes=where(model, 0, 0.0), point=(1e5, 0.0, 0.0))


def hexes(*corners):
    """hex8 unit cubes at integer corners, coincident nodes merged."""
    from tests.support.meshes import merged, points_and_cells

    return merged("hex8", points_and_cells("hex8", corners))


def test_a_hinge_is_reported_with_its_number_of_rigid_modes():
    model = steel(hexes((0, 0, 0), (1, 1, 0)))  # joined along one edge
    with Problem(model) as problem, refusal("model", "", "7", "6", by=SingularMatrixError):
        problem.elastic_modes(count=3)


@pytest.mark.parametrize("free", [1, 2], ids=["hinged along an edge", "that slides too"])
@pytest.mark.parametrize("reducer", [Modal(modes=4), FreeInterface(modes=4), CraigBampton(modes=4)])
def test_bodies_that_are_partly_held_keep_their_rigid_motions(free, reducer):
    """Lengths and angles mix in what is left of the six motions."""
    whole = steel(box("hex8", (8, 2, 2), (0.8, 0.1, 0.1)))
    xyz = whole.nodes.xyz
    if free == 1:
        held = np.isin(whole.dofs.node, np.flatnonzero((xyz[:, 0] == 0) & (xyz[:, 2] == 0)))
    else:
        # The edge may slide along itself.
        edge = np.flatnonzero((xyz[:, 0] == 0) & (xyz[:, 2] == 0))
        held = np.isin(whole.dofs.node, edge) & (whole.dofs.component != 1)
    keep = np.flatnonzero(~held)
    dofs = DofMap(node=whole.dofs.node[keep], component=whole.dofs.component[keep])
    K, M = (sp.csr_array(A[keep][:, keep]) for A in (whole.K, whole.M))
    model = FEModel(K=K, M=M, nodes=whole.nodes, dofs=dofs, mesh=whole.mesh, materials=whole.materials)
    tip = make_interface(model, name="tip", nodes=where(model, 0, 0.8), coupling="rigid")
    with Problem(model, [tip]) as problem:
        assert problem.rigid.shape[1] == free
        assert np.abs(problem.K @ problem.rigid).max() < 1e-12 * abs(problem.K).max() * np.abs(problem.rigid).max()
        reduced = reducer.reduce(problem)
        exact = reduced.V.T @ (problem.K @ reduced.V)
        assert np.abs(reduced.K - exact).max() < 1e-9 * np.abs(exact).max()
        values = sl.eigvalsh(reduced.K, reduced.M)
        dense = sl.eigvalsh(problem.K.toarray(), problem.M.toarray())
    assert np.abs(values[:free]).max() < 1e-8 * dense[free]
    assert values[free] == pytest.approx(dense[free], rel=1e-2 if isinstance(reducer, CraigBampton) else 1e-8)


def test_unconnected_parts_are_reported():
    with refusal("model", "", "12"):
        Problem(steel(hexes((0, 0, 0), (3, 0, 0))))


def test_interfaces_that_leave_motion_free_are_refused_by_craig_bampton():
    model = bar()
    interface = make_interface(model, name="p", nodes=where(model, 0, 0.0)[:1], coupling="direct")
    with Problem(model, [interface]) as problem:
        with refusal("model", "interfaces"):
            CraigBampton(modes=3).reduce(problem)
        assert FreeInterface(modes=3).reduce(problem).order == 6 + 3 + 3
    with Problem(model) as problem, refusal("unsupported", "", '"guyan"', "[[interface]]"):
        Guyan().reduce(problem)


def test_options_out_of_range_are_refused():
    model = bar(n=(2, 1, 1))
    with Problem(model, ends(model, "rigid")) as problem:
        with refusal("unsupported", "", "10000", "60"):
            CraigBampton(modes=10_000).reduce(problem)
        with refusal("missing", "modes"):
            CraigBampton().reduce(problem)
        with refusal("missing", "modes"):
            Modal(modes=3, up_to_hz=3.0).reduce(problem)
        with refusal("value", "interfaces"):
            Modal(modes=3, interfaces="fxed").reduce(problem)


def test_damping_leaves_rigid_motion_alone_and_damps_modes_as_asked():
    model = bar()
    for damping in (Damping(alpha=5.0, beta=2e-6), Damping(modal=0.01)):
        with Problem(model, ends(model, "rigid"), damping=damping) as problem:
            reduced = CraigBampton(modes=6).reduce(problem)
        values, Y = sl.eigh(reduced.K, reduced.M)
        D = Y.T @ reduced.D @ Y
        omega = np.sqrt(values[6:])
        wanted = 2 * 0.01 * omega if damping.modal else 5.0 + 2e-6 * omega**2
        assert np.diag(D)[6:] == pytest.approx(wanted, rel=1e-9)
        off = D - np.diag(np.diag(D))
        assert np.abs(off).max() < 1e-8 * wanted.max() and np.abs(D[:6]).max() < 1e-8 * wanted.max()


def test_grounded_model_is_reduced_without_rigid_modes():
    mesh = box("hex20", (4, 1, 1), (0.5, 0.05, 0.03))
    free = steel(mesh)
    held = np.flatnonzero(free.nodes.xyz[:, 0] == 0.0)
    keep = np.setdiff1d(np.arange(free.size), free.dofs.of_nodes(held).ravel())
    model = FEModel(
        K=free.K[keep][:, keep],
        M=free.M[keep][:, keep],
        nodes=free.nodes,
        dofs=DofMap(node=free.dofs.node[keep], component=free.dofs.component[keep]),
    )
    tip = make_interface(model, name="tip", nodes=where(free, 0, 0.5), coupling="average")
    with Problem(model, [tip]) as problem:
        assert problem.rigid.shape[1] == 0
        reduced = CraigBampton(modes=10).reduce(problem)
        exact = sl.eigh(model.K.toarray(), model.M.toarray(), eigvals_only=True, subset_by_index=[0, 3])
    assert sl.eigh(reduced.K, reduced.M, eigvals_only=True)[:3] == pytest.approx(exact[:3], rel=1e-3)
    assert isinstance(tip, Interface) and reduced.rigid_count == 0
