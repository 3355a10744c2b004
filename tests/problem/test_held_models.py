"""Held and free models of every kind against dense solutions: refused where the spectrum says so, and only there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import InputError, MorembsError, SingularMatrixError
from morembs.body.diagnostics.warnings import list_warnings
from morembs.body.file import read_body
from morembs.fem import FEModel
from morembs.fem.interface import Interface, make_interface, matrix_interface
from morembs.importers.matrices.from_matrices import from_matrices
from morembs.importers.model_file import write_model
from morembs.linalg.null_space import null_space
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.tolerances import TOL
from morembs.problem import Damping, Problem
from morembs.problem.rigid_motions import need_factor
from morembs.reducers import CraigBampton, FreeInterface, Guyan, Krylov, Modal
from tests.support.frames import beams, chain, clamped_beam, eigenvalues, line, model_on, plate, springs, without
from tests.support.refusals import refusal

RNG = np.random.default_rng


def planar_beam(components: tuple[int, ...]) -> FEModel:
    """A clamped beam in the plane: the dofs of the other directions are taken out."""
    whole = clamped_beam(7)
    rows = np.flatnonzero(np.isin(whole.dofs.component, components))
    node, component = whole.dofs.node[rows], whole.dofs.component[rows]
    return replace(
        whole,
        K=sp.csr_array(whole.K[rows][:, rows]),
        M=sp.csr_array(whole.M[rows][:, rows]),
        dofs=replace(whole.dofs, node=node, component=component),
    )


def grounded_chain(stiffness: float = 1e6) -> FEModel:
    """Masses on a line that move along it alone."""
    K = stiffness * (2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    return model_on(K, np.eye(6), line(6), (0,))


def truss(held: tuple[int, ...]) -> FEModel:
    xyz = np.array([[x, y, z] for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0) for z in (0.0, 1.1)])
    pairs = [(a, b) for b in range(len(xyz)) for a in range(b) if np.linalg.norm(xyz[a] - xyz[b]) < 1.9]
    return model_on(*springs(xyz, pairs), xyz, range(3), without(3 * len(xyz), held))


def two_beams(held: tuple[int, ...]) -> FEModel:
    """Two beams that nothing joins, of which the first nodes of ``held`` ones are held."""
    xyz = np.concatenate([line(4), line(4) + np.array([0.0, 1.0, 0.0])])
    K, M = beams(xyz, [*chain(4), *((a + 4, b + 4) for a, b in chain(4))])
    return model_on(K, M, xyz, range(6), without(48, [24 * which + c for which in held for c in range(6)]))


def modal(free: int = 0) -> FEModel:
    """Modal coordinates, ``free`` of them rigid."""
    values = np.r_[np.zeros(free), (2 * np.pi * np.geomspace(0.5, 500.0, 12)) ** 2]
    return from_matrices(np.diag(values), np.eye(len(values)), B=RNG(1).standard_normal((len(values), 2)))


def turned() -> FEModel:
    """Modal coordinates turned by a random rotation: full matrices without nodes."""
    Q = np.linalg.qr(RNG(2).standard_normal((14, 14)))[0]
    values = np.r_[0.0, 0.0, np.geomspace(1e2, 1e6, 12)]
    K = (Q * values) @ Q.T
    return from_matrices(0.5 * (K + K.T), np.eye(14), B=RNG(1).standard_normal((14, 2)))


def lumped_rotations(model: FEModel) -> FEModel:
    """``model`` without mass in its rotations."""
    M = np.diag(model.M.toarray().sum(axis=1) * (model.dofs.component < 3))
    return replace(model, M=sp.csr_array(np.abs(M)))


SOUND: dict[str, tuple[Callable[[], FEModel], int]] = {
    "straight cantilever": (lambda: clamped_beam(6), 0),
    "oblique cantilever": (lambda: clamped_beam(6, axis=(0.6, 0.8, 0.0)), 0),
    **{f"{n} nodes clamped at both ends": ((lambda n=n: clamped_beam(n, (0, -1))), 0) for n in (3, 4, 5)},
    "free straight beam": (lambda: clamped_beam(5, ()), 6),
    "beam on a ball joint": (lambda: ball_joint(), 3),
    "planar beam, three dofs a node": (lambda: planar_beam((0, 1, 5)), 0),
    "planar beam, two dofs a node": (lambda: planar_beam((1, 5)), 0),
    "grounded chain": (grounded_chain, 0),
    "held truss": (lambda: truss(tuple(range(12))), 0),
    "free truss": (lambda: truss(()), 6),
    "two held beams": (lambda: two_beams((0, 1)), 0),
    "held plate": (lambda: plate(3, 2, held=True), 0),
    "free plate": (lambda: plate(3, 2, held=False), 3),
    "lumped cantilever": (lambda: lumped_rotations(clamped_beam(6)), 0),
    "modal coordinates": (modal, 0),
    "free modal coordinates": (lambda: modal(2), 2),
    "turned modal coordinates": (turned, 2),
    "diagonal K and M": (lambda: model_on(np.diag(np.geomspace(1e3, 1e6, 12)), np.eye(12), line(4), range(3)), 0),
}


def ball_joint() -> FEModel:
    xyz = line(6)
    return model_on(*beams(xyz, chain(6)), xyz, range(6), without(36, range(3)))


def interface_of(model: FEModel) -> Interface:
    if model.inputs is not None:
        return matrix_interface(model, name="tip", matrix="B")
    last = int(model.dofs.node.max())
    own = np.flatnonzero(model.dofs.node == last)
    heavy = tuple(model.dofs.component[own[model.M.diagonal()[own] > 0]].tolist())
    return make_interface(model, name="tip", nodes=np.array([last]), coupling="direct", components=heavy)


@pytest.mark.parametrize("name", SOUND)
def test_what_the_spectrum_allows_is_reduced_and_right(name: str) -> None:
    make, free = SOUND[name]
    model = make()
    list_warnings(model)
    tip = interface_of(model)
    size = model.size - free
    with Problem(model, [tip], damping=Damping(beta=1e-5)) as problem:
        assert problem.rigid.shape[1] == free
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        theta = sl.eigh(M, K + 1e3 * np.trace(K) / np.trace(M) * M, eigvals_only=True)
        finite = int((theta > 1e-14 * theta[-1]).sum()) - free
        exact = np.sort(sl.eigvals(K, M).real)[: free + finite][free:]
        for reducer in (
            Modal(modes=min(4, finite)),
            FreeInterface(modes=min(2, finite)),
            Guyan(),
            CraigBampton(modes=2),
            Krylov(shifts_hz=[10.0], moments=1),
            CraigBampton(modes=max(2, B.shape[1]), inertia_modes=True),
        ):
            held = reducer.method in ("craig-bampton", "guyan")
            try:
                body = reducer.reduce(problem)
            except InputError as error:
                # The interface does not hold a free body, or leaves no coordinates: true.
                assert held and (("leave" in str(error) and free) or size - B.shape[1] < 2), str(error)
                continue
            values = body.modes()[0]
            assert np.abs(values[:free]).max(initial=0.0) <= 1e-9 * exact[-1]
            # From above (Rayleigh and Ritz), the lowest ones of modal reductions to the digits of LAPACK.
            lowest = exact[: len(values) - free]
            assert (values[free:] >= lowest * (1 - 1e-6)).all()
            if reducer.method == "modal":
                assert values[free : free + 2] == pytest.approx(exact[:2], rel=1e-6)
            if reducer.method == "krylov":
                s = 2j * np.pi * 10.0
                D = 1e-5 * K
                H = B.T @ np.linalg.solve(s * s * M + s * D + K, B)
                own = body.C @ np.linalg.solve(s * s * body.M + s * body.D + body.K, body.B)
                assert np.abs(own - H).max() <= 1e-5 * np.abs(H).max()


def test_free_parts_are_refused_by_what_their_matrices_say() -> None:
    for held, count, rest in (((), 12, 6), ((0,), 6, 0)):
        model = two_beams(held)
        zero = np.count_nonzero(np.abs(eigenvalues(model)) < 1e-3)
        assert zero == count
        with refusal("model", "", count, rest):
            Problem(model)


@pytest.mark.parametrize(("lean", "error"), [(0.3, SingularMatrixError), (0.0, InputError)])
def test_a_hinge_in_a_held_body_is_counted(lean: float, error: type[MorembsError]) -> None:
    """A square of bars without a diagonal on one that is held; K couples its motion to others where it leans."""
    xyz = np.array([[x + lean * (y == 2.0), y, 0.0] for y in (0.0, 1.0, 2.0) for x in (0.0, 1.0)])
    K, M = springs(xyz, [(0, 2), (1, 3), (2, 3), (0, 3), (2, 4), (3, 5), (4, 5)])
    rows = np.array([3 * node + c for node in range(2, 6) for c in (0, 1)])
    model = model_on(K, M, xyz, range(3), rows)
    assert np.count_nonzero(np.abs(eigenvalues(model)) < 1e-3) == 1
    with refusal("model", "", "1", "0", by=error), Problem(model) as problem:
        Modal(modes=2).reduce(problem)


def test_interfaces_on_rotations_without_mass_keep_the_compliance_of_the_model() -> None:
    """Static compliance of all six dofs of the tip, and the lowest frequency, beside dense matrices."""
    model = lumped_rotations(clamped_beam(6))
    tip = make_interface(model, name="tip", nodes=np.array([5]), coupling="direct")
    with Problem(model, [tip]) as problem:
        body = CraigBampton(modes=4).reduce(problem)
        B = problem.B.toarray()
    K, M = model.K.toarray(), model.M.toarray()
    np.testing.assert_allclose(body.B.T @ np.linalg.solve(body.K, body.B), B.T @ np.linalg.solve(K, B), rtol=1e-9)
    slowest = [np.linalg.eigvals(np.linalg.solve(k, m)).real.max() for k, m in ((K, M), (body.K, body.M))]
    assert slowest[1] == pytest.approx(slowest[0], rel=1e-3)


def test_inertia_modes_that_the_model_has_no_room_for_are_dropped() -> None:
    for nodes, ends in ((3, (0, -1)), (3, (0,)), (4, (0,))):
        model = clamped_beam(nodes, ends)
        tip = interface_of(model)
        exact = eigenvalues(model)
        for reducer in (CraigBampton(modes=6, inertia_modes=True), CraigBampton(up_to_hz=1e5, inertia_modes=True)):
            with Problem(model, [tip]) as problem:
                body = reducer.reduce(problem)
            assert body.order <= model.size
            whole = body.order == model.size
            assert body.modes()[0][:2] == pytest.approx(exact[:2], rel=1e-8 if whole else 1e-6)


def test_the_null_space_of_groups_small_and_large() -> None:
    small, large = 5, TOL.dense_rows + 200
    blocks = [np.array([[0.0]]), np.array([[3.0]])]
    free = [sp.diags_array([2.0] * n) - sp.eye_array(n, k=1) - sp.eye_array(n, k=-1) for n in (small, large, small)]
    for chain_ in free[:2]:
        chain_ = chain_.tolil()
        chain_[0, 0] = chain_[-1, -1] = 1.0
        blocks.append(chain_)
    K = sp.csr_array(sp.block_diag([*blocks, free[2]]))
    assert need_factor(from_matrices(K, sp.eye_array(K.shape[0])), K)
    Z = null_space(K, select_solver())
    assert Z.shape[1] == 3 and np.abs(K @ Z).max() <= 1e-12 * np.abs(Z).max()
    model = from_matrices(K, sp.eye_array(K.shape[0]), B=np.eye(K.shape[0], 1, k=-4))
    with Problem(model, [matrix_interface(model, name="q", matrix="B")]) as problem:
        body = Modal(modes=3).reduce(problem)
    exact = 2 - 2 * np.cos(np.arange(1, 4) * np.pi / large)
    assert body.modes()[0][3:] == pytest.approx(exact, rel=1e-6)


def spring_grid() -> FEModel:
    """Masses on a grid whose springs act along x, y and z alike: free in translations alone."""
    xyz = np.array([[x, y, 0.0] for x in range(3) for y in range(2)])
    K = np.zeros((18, 18))
    for a, b in ((0, 1), (2, 3), (4, 5), (0, 2), (2, 4), (1, 3), (3, 5)):
        for c in range(3):
            v = np.zeros(18)
            v[[3 * a + c, 3 * b + c]] = 1.0, -1.0
            K += 10.0 ** (4 + c) * np.outer(v, v)
    return model_on(K, np.eye(18), xyz, range(3))


def planar_truss() -> FEModel:
    """A truss in space whose displacements along x are taken out."""
    whole = truss(())
    rows = np.flatnonzero(whole.dofs.component > 0)
    return replace(
        whole,
        K=sp.csr_array(whole.K[rows][:, rows]),
        M=sp.csr_array(whole.M[rows][:, rows]),
        dofs=replace(whole.dofs, node=whole.dofs.node[rows], component=whole.dofs.component[rows]),
    )


@pytest.mark.parametrize("make", [spring_grid, planar_truss])
def test_models_that_look_like_wrong_coordinates_are_warned_of_and_reduced(make: Callable[[], FEModel]) -> None:
    model = make()
    list_warnings(model)
    exact = eigenvalues(model)
    with Problem(model) as problem:
        assert problem.rigid.shape[1] == 3
        body = Modal(modes=3).reduce(problem)
    assert body.modes()[0][3:] == pytest.approx(exact[3:6], rel=1e-9)


def test_a_rigid_motion_without_mass_is_named() -> None:
    model = clamped_beam(4, ())
    lumped = replace(model, M=sp.csr_array(np.diag(model.M.diagonal() * (model.dofs.component < 3))))
    with refusal("model", "mass"):
        Problem(lumped)


def test_interfaces_that_rigid_motion_does_not_reach_are_said_to_leave_it_free() -> None:
    """The free motion is that of one beam; round-off of it at the interface on the other was taken for motion."""
    xyz = line(4)
    K, M = beams(xyz, chain(4))
    # Turning about the beam is free, all else is held at the first node.
    model = model_on(K, M, xyz, range(6), without(24, [0, 1, 2, 4, 5]))
    tip = make_interface(model, name="tip", nodes=np.array([3]), coupling="direct", components=(0, 1, 2, 4, 5))
    with Problem(model, [tip]) as problem:
        assert problem.rigid.shape[1] == 1
        with refusal("model", "interfaces"):
            Guyan().reduce(problem)


@pytest.mark.filterwarnings("error")
def test_rotations_alone_have_no_mass_and_are_reduced() -> None:
    whole = truss(())
    xyz = whole.nodes.xyz[:3]
    K, M = beams(xyz, chain(3))
    model = model_on(K, M, xyz, range(6), np.array([6 * node + c for node in range(3) for c in (4, 5)]))
    with Problem(model) as problem:
        assert problem.mass_properties[0] == 0.0 and problem.rigid.shape[1] == 0
        body = Modal(modes=2).reduce(problem)
    assert body.modes()[0] == pytest.approx(eigenvalues(model)[:2], rel=1e-9)


@pytest.mark.parametrize("method", ["modal", "craig-bampton", "free-interface"])
def test_modal_coordinates_are_checked_and_reduced_by_jobs(tmp_path: Path, method: str) -> None:
    write_model(tmp_path / "m.h5", modal(2))
    text = '[model]\nfile = "m.h5"\n[[interface]]\nname = "q"\nmatrix = "B"\n[[reduce]]\nname = "a"\n'
    text += f'method = "{method}"\n'
    (tmp_path / "job.toml").write_text(text + 'modes = 3\n[output]\npath = "o.h5"\n')
    for verb in ("check", "reduce"):
        done = CliRunner().invoke(app, [verb, str(tmp_path / "job.toml")])
        assert done.exit_code == 0, done.stderr
    body = read_body(tmp_path / "o.h5").bodies["a"]
    values = sl.eigh(body.stiffness_matrix, body.mass_matrix, eigvals_only=True)
    exact = (2 * np.pi * np.geomspace(0.5, 500.0, 12)) ** 2
    assert np.abs(values[:2]).max() <= 1e-9 * exact[0] and (values[2:] >= exact[: len(values) - 2] * (1 - 1e-9)).all()


@pytest.mark.parametrize("free", [0, 2, 6])
def test_coordinates_without_places_are_held_to_no_ground(free: int, tmp_path: Path) -> None:
    write_model(tmp_path / "modal.h5", modal(free))
    (tmp_path / "job.toml").write_text(
        '[model]\nfile = "modal.h5"\n[[interface]]\nname = "q"\nmatrix = "B"\n[[reduce]]\nname = "m"\n'
        'method = "modal"\nmodes = 2\n[output]\npath = "body.h5"\n'
    )
    done = CliRunner().invoke(app, ["reduce", str(tmp_path / "job.toml")])
    assert done.exit_code == 0 and "held to the ground" not in done.output
    assert read_body(tmp_path / "body.h5").bodies["m"].floating is None


def sprung_tetrahedron() -> FEModel:
    """Four masses about the origin on rods between them, the first on springs to the ground along x, y and z."""
    xyz = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    K, M = springs(xyz, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
    ground = np.zeros(12)
    ground[:3] = 1e6, 2e6, 3e6
    return model_on(K + np.diag(ground), M, xyz, range(3))


def test_a_model_that_one_frame_at_the_origin_moves_has_the_motions_of_its_matrix() -> None:
    """The places that are left say nothing of its size: rotations were scaled by round-off of the frame's place."""
    model = sprung_tetrahedron()
    frame = make_interface(model, name="all", nodes=np.arange(4), point=(1e-17, 0.0, 0.0), components=(2,))
    with Problem(model, [frame]) as problem:
        K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
        values = sl.eigvalsh(K, M)
        assert Z.shape[1] == (values < 1e-9 * values[-1]).sum() == 3
        assert np.abs(K @ Z).max() < 1e-12 * np.abs(K).max()
        elastic = Krylov(shifts_hz=[0.0]).reduce(problem)
        assert elastic.order == 4


def test_damping_of_a_guided_beam_leaves_its_free_motion_alone() -> None:
    # Rows that stand still as the beam slides have the round-off of the rigid motion, and nothing that it cancels in.
    for k, length in enumerate((0.3, 0.746438, 1.7, 41.0)):
        xyz = line(2, length)
        K, _ = beams(xyz, chain(2))
        M = np.diag(RNG(k).uniform(0.3, 3.0, 2).repeat(6) * np.tile([1, 1, 1, 0.02, 0.03, 0.04], 2))
        model = model_on(K, M, xyz, range(6), np.array([1, 4, 5, 7, 8, 9]))
        model = replace(model, D=1e-5 * model.K)
        problem = Problem(
            model, [make_interface(model, name="slide", nodes=np.arange(2), coupling="direct", components=[1])]
        )
        assert problem.rigid.shape[1] == 1
        assert not problem.system.damps_rigid_motion
        grounded = replace(model, D=model.D + sp.csr_array(np.diag([1e-3, 0, 0, 0, 0, 0])))
        assert Problem(grounded, problem.interfaces).system.damps_rigid_motion
