"""Static modes of many candidates: tables against dense solves, exactness, order of paths, files, bad input."""

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.errors import InputError
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.fem.stress_operator import stress_operator
from morembs.problem import Problem
from morembs.reducers import REDUCERS, StaticModesSwitching
from morembs.reducers import candidates as candidate_module
from morembs.responses.static_mode_tables import StaticModeTables, active_set
from morembs.storage.table import read_rows, table_of
from morembs.storage.writer import Writer
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal
from tests.support.sliding import hermite_beam


def bar(cells=(8, 2, 2)):
    model = steel(box("hex8", cells, (0.8, 0.1, 0.1)))
    xyz = model.nodes.xyz
    top = np.flatnonzero((np.abs(xyz[:, 2] - 0.1) < 1e-9) & (np.abs(xyz[:, 1] - 0.05) < 1e-9))
    inner = top[(xyz[top, 0] > 1e-9) & (xyz[top, 0] < 0.8 - 1e-9)]
    return model, "ids:" + ",".join(str(model.nodes.ids[row]) for row in inner)


def ends(model):
    return [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.8))]


def held(model, rows):
    """The same model with all dofs of some nodes taken out."""
    keep = np.flatnonzero(~np.isin(model.dofs.node, rows))
    dofs = DofMap(node=model.dofs.node[keep], component=model.dofs.component[keep])
    K, M = (sp.csr_array(A[keep][:, keep]) for A in (model.K, model.M))
    return FEModel(K=K, M=M, nodes=model.nodes, dofs=dofs, mesh=model.mesh, materials=model.materials)


def load_columns(problem, tables):
    """B (Nc, c) of the candidates, from labels and directions."""
    model = problem.model
    B = np.zeros((model.size, tables.count))
    for column, (node, e) in enumerate(zip(tables.node, tables.direction, strict=True)):
        row = np.flatnonzero(model.nodes.ids == tables.node_ids[node])[0]
        for axis in range(3):
            dof = np.flatnonzero((model.dofs.node == row) & (model.dofs.component == axis))
            B[dof, column] += e[axis]
    return problem.coupling.T.T @ B


def dense_modes(problem, reduced, tables):
    """Psi (Nc, c) from the definition: the answer with V left out, by a dense least-energy solve."""
    K, M, V, B = problem.K.toarray(), problem.M.toarray(), reduced.V, load_columns(problem, tables)
    fixed = "constraint" in reduced.mode_kind or "fixed-interface" in reduced.mode_kind
    C = problem.B.toarray() if fixed else M @ problem.rigid
    k = C.shape[1]
    f = B if fixed else B - M @ problem.rigid @ (problem.rigid.T @ B)
    scale = np.abs(K).max()
    border = np.block([[K / scale, C], [C.T, np.zeros((k, k))]])
    X = np.linalg.solve(border, np.vstack([f / scale, np.zeros((k, B.shape[1]))]))[: len(K)]
    return X - V @ np.linalg.pinv(V.T @ K @ V, rcond=1e-10) @ (V.T @ K @ X)


BASES = [
    ("modal", {"modes": 4}, False),
    ("modal", {"modes": 3, "interfaces": "fixed"}, True),
    ("craig-bampton", {"modes": 4}, True),
    ("krylov", {"shifts_hz": [0.0, 500.0]}, True),
    ("gramian", {"band_hz": [0.0, 2000.0], "order": 6}, True),
]


@pytest.mark.parametrize(("base", "options", "coupled"), BASES)
def test_tables_are_those_of_dense_static_modes(base, options, coupled):
    model, candidates = bar()
    with Problem(model, ends(model) if coupled else ()) as problem:
        reducer = StaticModesSwitching(base=base, base_options=options, candidates=candidates, directions=[2, 0])
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
        Psi = dense_modes(problem, reduced, tables)
        K, M, B = problem.K, problem.M, load_columns(problem, tables)
        moving = problem.coupling.R[:, :3]
    every = np.arange(tables.count)
    R, Q = Psi.T @ (K @ Psi), Psi.T @ (M @ Psi)
    assert np.abs(tables.R(every) - R).max() < 1e-8 * np.abs(R).max()
    assert np.abs(tables.Q(every) - Q).max() < 1e-8 * np.abs(Q).max()
    # K-orthogonal: displacements of candidates are the table itself.
    assert np.abs(tables.R(every) - B.T @ Psi).max() < 1e-8 * np.abs(R).max()
    coupling = reduced.V.T @ (M @ Psi)
    size = np.sqrt(np.diag(reduced.M)[:, None] * np.diag(Q))
    assert (np.abs(tables.coupling - coupling) / size).max() < 1e-7
    assert np.abs(tables.modes - B.T @ reduced.V).max() < 1e-12 * np.abs(tables.modes).max()
    assert np.abs(tables.weight - reduced.V.T @ (M @ moving)).max() < 1e-9 * np.abs(M).sum()
    weight = Psi.T @ (M @ moving)
    heavy = np.sqrt(np.diag(Q).max() * np.abs(moving.T @ (M @ moving)).max())
    assert np.abs(tables.static_weight - weight).max() < 1e-8 * heavy
    invariant = base == "modal"
    assert (tables.notes["mass_coupling"] < 1e-8) == invariant


def test_static_answers_of_a_held_body_are_exact_and_stress_too():
    whole, candidates = bar()
    model = held(whole, where(whole, 0, 0.0))
    reducer = StaticModesSwitching(base_options={"modes": 3}, candidates=candidates, directions=[0, 2], stress=True)
    with Problem(model) as problem:
        assert problem.rigid.shape[1] == 0
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
        B = load_columns(problem, tables)
    f = np.array([0.0] * 5 + [3.0, -7.0] + [0.0] * (tables.count - 7))
    u = np.linalg.solve(model.K.toarray(), B @ f)
    eta = np.linalg.solve(reduced.K, tables.modes.T @ f)
    every = np.arange(tables.count)
    assert np.abs(tables.modes @ eta + tables.R(every) @ f - B.T @ u).max() < 1e-9 * np.abs(u).max()
    full = np.zeros(3 * len(whole.nodes))
    full[3 * model.dofs.node + model.dofs.component] = u
    row = np.flatnonzero(whole.nodes.ids == tables.node_ids[3])
    want = stress_operator(whole, row).stress(full[:, None])[:, 0]
    assert np.abs(tables.stress_at(3, eta, every, f) - want).max() < 1e-5 * np.abs(want).max()


@pytest.mark.parametrize("width", [1, 4])
def test_streaming_in_blocks_changes_nothing(width):
    model, candidates = bar()
    with Problem(model) as problem:
        plain = StaticModesSwitching(base_options={"modes": 4}, candidates=candidates, directions=[2, 0], stress=True)
        reduced = plain.reduce(problem)
        all_pairs = plain.tabulate_static_modes(problem, reduced)
    with Budget(widest=width), Problem(model) as problem:
        reduced = plain.reduce(problem)
        banded = StaticModesSwitching(
            base_options={"modes": 4}, candidates=candidates, directions=[2, 0], stress=True, band=2
        ).tabulate_static_modes(problem, reduced)
    assert len(banded.stiffness) == 6 and len(all_pairs.stiffness) == 14
    some = banded.of_nodes(2, 3)
    for name in ("R", "Q"):
        want = getattr(all_pairs, name)(some)
        assert np.abs(getattr(banded, name)(some) - want).max() < 1e-9 * np.abs(want).max()
    loads = np.zeros(banded.count)
    loads[some] = np.arange(1.0, 7.0)
    every, still = np.arange(banded.count), np.zeros(10)
    assert np.allclose(
        banded.stress_at(3, still, every, loads), all_pairs.stress_at(3, still, every, loads), rtol=1e-5, atol=1e-9
    )
    with refusal("value", "band"):
        banded.R(np.array([0, 13]))


def test_active_set_drops_directions_without_stiffness():
    model, candidates = bar()
    with Problem(model) as problem:
        reducer = StaticModesSwitching(base_options={"modes": 4}, candidates=candidates, directions=[2])
        tables = reducer.tabulate_static_modes(problem, reducer.reduce(problem))
    twice = np.array([1, 2, 2])
    active = active_set(tables, twice)
    assert active.rank == 2
    assert np.abs(active.Y.T @ tables.Q(twice) @ active.Y - np.eye(2)).max() < 1e-9
    scale = np.outer(active.omega, active.omega)
    assert np.abs(active.Y.T @ tables.R(twice) @ active.Y / scale - np.eye(2)).max() < 1e-9


def test_paths_are_chained_and_normals_point_outwards():
    rng = np.random.default_rng(1)
    angle = np.linspace(0.0, 4.5, 60)
    arc = np.stack([-np.cos(angle), np.sin(angle), 0.1 * angle], axis=1)
    mixed = rng.permutation(60)
    order = candidate_module.chain(arc[mixed], np.arange(60))
    assert np.array_equal(mixed[order], np.arange(60)) or np.array_equal(mixed[order], np.arange(60)[::-1])
    for kind in ("hex8", "hex20", "tet10", "wedge6"):
        model = steel(box(kind, (2, 2, 2), (1.0, 1.0, 1.0)))
        normal = candidate_module.vertex_normals(model)
        outside = ((normal * (model.nodes.xyz - 0.5)).sum(axis=1))[np.linalg.norm(normal, axis=1) > 0]
        assert outside.min() > 0.4
    flat = StaticModesSwitching(
        base_options={"modes": 2}, candidates="box:0.4,0.4,0.9,0.6,0.6,1.1", directions="normals", kind="surface"
    )
    with Problem(model) as problem:
        assert np.allclose(flat.tabulate_static_modes(problem, flat.reduce(problem)).direction, [[0, 0, 1]])


def test_rank_of_forces_and_moments_does_not_depend_on_the_size_of_the_part():
    beam = hermite_beam()
    for length in (1.0, 1e-4):
        turned = np.where(beam.dofs.component == 5, length, 1.0)
        K, M = (sp.csr_array(A.toarray() * np.outer(turned, turned)) for A in (beam.K, beam.M))
        nodes = Nodes(ids=beam.nodes.ids, xyz=length * beam.nodes.xyz, sets=beam.nodes.sets)
        small = FEModel(K=K / length**3, M=M * length, nodes=nodes, dofs=beam.dofs)
        with Problem(small) as problem:
            reducer = StaticModesSwitching(base_options={"modes": 4}, candidates="set:RAIL", directions=[1, 5])
            tables = reducer.tabulate_static_modes(problem, reducer.reduce(problem))
        active = tables.of_nodes(12, 6)
        kept = active_set(tables, active)
        assert kept.rank == len(active) == 12 and tables.notes["empty_candidates"] == 0
        R, force = tables.R(active), np.eye(12)[4]
        answer = R @ (kept.Y @ ((kept.Y.T @ (R @ force)) / kept.omega**2))
        assert np.abs(answer - R @ force)[::2].max() < 1e-10 * np.abs(R @ force)[::2].max()


def test_paths_that_are_no_open_line_are_refused_and_graded_ones_are_not():
    ids = np.arange(100, 140)
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    x, y = (part.ravel() for part in np.meshgrid(np.arange(13.0), [0.0, 0.9, 1.8]))
    rows = np.stack([x, y, 0 * x], axis=1)
    for points in (ring, rows):
        with refusal("model", "", "100", '"surface"'):
            candidate_module.chain(points, ids)
    graded = np.cumsum(1.3 ** np.arange(20))[:, None] * [0.6, 0.0, 0.8]
    assert np.array_equal(candidate_module.chain(graded, ids), np.arange(20))
    # Round-off across a line does not turn it round.
    along = np.stack([1e-17 * (-1.0) ** np.arange(9), np.zeros(9), np.arange(9.0)], axis=1)
    assert np.array_equal(candidate_module.chain(along, ids), np.arange(9))


def test_round_trip_through_a_file(tmp_path):
    model, candidates = bar()
    with Problem(model) as problem:
        reducer = StaticModesSwitching(
            base_options={"modes": 4}, candidates=candidates, directions=[2], stress=True, band=3
        )
        tables = reducer.tabulate_static_modes(problem, reducer.reduce(problem))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        Writer(file).rows("switching/", table_of(StaticModeTables), tables)
        back = read_rows(file["switching"], table_of(StaticModeTables), "the switching data lack")
        for name, value in vars(tables).items():
            if isinstance(value, np.ndarray):
                assert np.array_equal(getattr(back, name), value), name
        assert back.kind == tables.kind and dict(back.notes) == dict(tables.notes)
        del file["switching/stiffness"]
        with refusal("file", "stiffness"):
            read_rows(file["switching"], table_of(StaticModeTables), "the switching data lack")


def test_bad_input_is_named():
    model, candidates = bar()

    def message(interfaces=(), **keys):
        with Problem(model, interfaces) as problem, pytest.raises(InputError) as caught:
            reducer = StaticModesSwitching(**{"base_options": {"modes": 3}, "candidates": candidates, **keys})
            reducer.tabulate_static_modes(problem, reducer.reduce(problem))
        return str(caught.value)

    assert "selects no node" in message(candidates="box:5,5,5,6,6,6")
    assert "does not exist or is empty" in message(candidates="set:RAIL")
    assert "belong to the interface 'left'" in message(ends(model), candidates="box:0,0,0,0.1,0.1,0.1")
    assert 'expected "modal", ' in message(base="modall")
    words = message(base_options={"mode": 3})
    assert "'mode' is no key of it; its keys are modes, up_to_hz, interfaces" in words and "__init__" not in words
    assert "'band_hz' is missing" in message(base="gramian", base_options={})
    assert "no candidate node has the component 4" in message(directions=[4])
    first, last = candidates[4:].split(",")[0], candidates.split(",")[-1]
    near = candidates[4:].split(",")[1:3]
    assert "the path jumps" in message(candidates=f"ids:{first},{','.join(near)},{last}")
    assert "a path needs two" in message(candidates=f"ids:{first}")
    # Each coordinate of the model: nothing is left for static modes.
    assert "nothing is left" in message(base_options={"modes": model.size - 6})


def test_job_files_know_the_method():
    assert REDUCERS["static-modes-switching"] is StaticModesSwitching
