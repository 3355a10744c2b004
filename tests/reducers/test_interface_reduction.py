"""Interfaces at scale: characteristic constraint modes against dense solutions, and interfaces that overlap."""

import meshio
import numpy as np
import psutil
import pytest
import scipy.linalg as sl

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.base.budget import Budget
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.fem.interface import make_interface
from morembs.linalg.sparse.select import select_solver
from morembs.problem import Problem
from morembs.reducers import CraigBampton, Guyan
from morembs.reducers.interface_modes import FixedInterfaceBody, interface_modes
from morembs.reducers.tolerances import TOL as REDUCERS
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

SIZE = (0.4, 0.1, 0.08)


def bar(n=(6, 3, 3)):
    return steel(box("hex8", n, SIZE))


def wide_bar(lengthwise):
    """So many interface motions that characteristic modes come from block Lanczos, with the rows left out."""
    model = bar((lengthwise, 8, 8))
    assert 2 * 3 * len(where(model, 0, 0.0)) > REDUCERS.dense_interface
    return model


def faces(model, coupling="direct"):
    return [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x in (("left", 0.0), ("right", SIZE[0]))
    ]


def elastic(reduced):
    return np.sqrt(np.maximum(reduced.modes()[0][reduced.rigid_count :], 0)) / (2 * np.pi)


def characteristic(problem):
    """Elastic eigenvalues of the constraint part and its Craig-Bampton matrices, dense, from the partitioned K."""
    K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
    saddle = np.block([[K, B], [B.T, np.zeros((B.shape[1],) * 2)]])
    Psi = np.linalg.solve(saddle, np.vstack([np.zeros_like(B), np.eye(B.shape[1])]))[: len(K)]
    return sl.eigh(Psi.T @ K @ Psi, Psi.T @ M @ Psi, eigvals_only=True)[6:]


@pytest.mark.parametrize("coupling", ["rigid", "average", "direct"])
@pytest.mark.parametrize("inertia", [False, True])
def test_all_characteristic_modes_are_craig_bampton(coupling, inertia):
    model = bar()
    with Problem(model, faces(model, coupling)) as problem:
        m = problem.B.shape[1]
        whole = CraigBampton(modes=8 + inertia * m, inertia_modes=inertia).reduce(problem)
        turned = CraigBampton(modes=8 + inertia * m, inertia_modes=inertia, interface_modes=m - 6).reduce(problem)
    assert turned.order == whole.order
    assert turned.mode_kind[:6] == ("rigid",) * 6 and turned.mode_kind.count("characteristic") == m - 6
    assert elastic(turned) == pytest.approx(elastic(whole), rel=1e-10 if not inertia else 1e-8)
    assert "statics" not in turned.recipe


@pytest.mark.parametrize("coupling", ["rigid", "average", "direct"])
@pytest.mark.parametrize("lanczos", [False, True])
def test_the_modes_are_those_of_the_constraint_part(coupling, lanczos):
    model = bar()
    with Problem(model, faces(model, coupling)) as problem, FixedInterfaceBody(problem, by_rows=lanczos) as inside:
        assert (inside.rows is not None) == (lanczos and coupling != "average")
        exact = characteristic(problem)
        modes = interface_modes(problem, inside, count=5, from_all=not lanczos)
        assert modes.eigenvalues == pytest.approx(exact[:5], rel=1e-8)
        assert 2 * np.pi * modes.next_hz == pytest.approx(np.sqrt(exact[5]), rel=1e-6)
        V = modes.vectors
        assert np.abs(V.T @ problem.M @ V - np.eye(5)).max() < 1e-10
        assert np.abs(problem.rigid.T @ problem.M @ V).max() < 1e-10
        assert np.diag(V.T @ problem.K @ V) == pytest.approx(modes.eigenvalues, rel=1e-9)
        # Constraint modes carry no load inside: K V = B lambda.
        load = problem.K @ V
        rest = load - problem.B @ np.linalg.lstsq(problem.B.toarray(), load, rcond=None)[0]
        assert np.abs(rest).max() < 1e-6 * np.abs(load).max()


@pytest.mark.parametrize("lanczos", [False, True])
def test_a_limit_takes_all_modes_below_it(lanczos):
    """The larger count needs a second look, as nobody knows how many modes there are."""
    model = wide_bar(2) if lanczos else bar()
    with Problem(model, faces(model)) as problem, FixedInterfaceBody(problem) as inside:
        exact = np.sqrt(characteristic(problem)) / (2 * np.pi)
        assert (inside.rows is not None) == lanczos
        for count in (2, 60):
            limit = 0.5 * (exact[count - 1] + exact[count])
            modes = interface_modes(problem, inside, below=(2 * np.pi * limit) ** 2)
            assert len(modes.eigenvalues) == count


@pytest.mark.parametrize(("inertia", "lanczos"), [(False, True), (True, False)])
def test_fewer_interface_modes_keep_the_frequencies_in_the_band(inertia, lanczos):
    """Below a third of the limit of both kinds of modes the frequencies are those of the model, from above."""
    model = wide_bar(3) if lanczos else bar((8, 3, 3))
    with Problem(model, faces(model)) as problem:
        full = problem.elastic_modes(count=10).frequencies_hz
        limit = 3 * full[5]
        reduced = CraigBampton(up_to_hz=limit, interface_up_to_hz=limit, inertia_modes=inertia).reduce(problem)
        assert reduced.order < 0.6 * problem.B.shape[1]
        error = elastic(reduced)[:6] / full[:6] - 1
        assert error.min() > -1e-9 and error.max() < 0.01
        if inertia:
            assert reduced.mode_kind.count("attachment") > 0
        # Rigid-body motion exactly.
        R = problem.rigid
        coordinates = np.linalg.lstsq(reduced.V, R, rcond=None)[0]
        assert np.abs(reduced.V @ coordinates - R).max() < 1e-10 * np.abs(R).max()
        assert np.abs(reduced.K @ coordinates).max() < 1e-10 * np.abs(reduced.K).max()
        assert reduced.rigid_count == 6
        # The stiffness is that of the basis, and B holds all interface dofs.
        K = reduced.V.T @ (problem.K @ reduced.V)
        assert np.abs(K - reduced.K).max() < 1e-8 * np.abs(K).max()
        assert reduced.C.shape == (problem.B.shape[1], reduced.order)
        assert np.abs(reduced.C - problem.B.T @ reduced.V).max() < 1e-9 * np.abs(reduced.C).max()
        body = elastic_body(problem, reduced, make_part(problem))
        assert body.floating is not None and body.floating.count == reduced.order - 6


def test_the_recipe_says_what_the_statics_lost():
    """Compliance under the resultant loads of each face, against that of all constraint modes."""
    model = bar()
    with Problem(model, faces(model)) as problem:
        lost = []
        for count in (6, 20):
            reduced = CraigBampton(modes=0, interface_modes=count).reduce(problem)
            every = Guyan().reduce(problem)
            values, Y = every.modes()
            R = problem.coupling.R
            B = problem.B.toarray()
            worst = 0.0
            for columns in problem.coupling.columns.values():
                F = B[:, columns] @ B[:, columns].T @ R
                whole = ((Y[:, 6:].T @ every.V.T @ F) ** 2 / values[6:, None]).sum(axis=0)
                f = reduced.V[:, 6:].T @ F
                compliance = np.einsum("ij,ij->j", f, np.linalg.solve(reduced.K[6:, 6:], f))
                worst = max(worst, float((1 - compliance / whole).max()))
            assert reduced.recipe["interface_static_error"] == pytest.approx(worst, rel=1e-4)
            assert "not exact at the interfaces" in reduced.recipe["statics"]
            lost.append(worst)
        assert lost[1] < lost[0] and lost[1] > 1e-6
        all_of_them = CraigBampton(modes=0, interface_modes=problem.B.shape[1] - 6).reduce(problem)
        assert elastic(all_of_them) == pytest.approx(elastic(Guyan().reduce(problem)), rel=1e-10)


def test_a_direct_face_beside_an_average_and_a_rigid_one():
    """Rows held by leaving them out, and an average interface by its six equations."""
    model = bar()
    interfaces = [
        make_interface(model, name="left", nodes=where(model, 0, 0.0), coupling="direct"),
        make_interface(model, name="right", nodes=where(model, 0, SIZE[0]), coupling="rigid"),
        make_interface(model, name="top", nodes=where(model, 2, SIZE[2]), coupling="average"),
    ]
    with Problem(model, interfaces) as problem, FixedInterfaceBody(problem, by_rows=True) as inside:
        assert inside.constrained.count == 6
        exact = characteristic(problem)
        modes = interface_modes(problem, inside, count=6, from_all=False)
        assert modes.eigenvalues == pytest.approx(exact[:6], rel=1e-8)
        fixed = inside.modes(5, None)
        assert fixed.eigenvalues == pytest.approx(problem.fixed_modes(count=5).eigenvalues, rel=1e-8)
        assert np.abs(problem.B.T @ fixed.vectors).max() < 1e-9 * np.abs(fixed.vectors).max()


def test_a_budget_changes_nothing(tmp_path):
    model, results = wide_bar(2), []
    # What other tests left in this process may be more than a gigabyte.
    for memory in (None, psutil.Process().memory_info().rss + 10**9):
        with Budget(memory, tmp_path):
            solver = select_solver(memory=memory, scratch=tmp_path)
            with Problem(model, faces(model), solver=solver) as problem:
                results.append(elastic(CraigBampton(modes=5, interface_modes=10).reduce(problem)))
    assert results[1] == pytest.approx(results[0], rel=1e-9)


def test_average_interfaces_that_share_nodes():
    """Two patches that overlap, and one that lies on a rigid face: statics and modes as the dense saddle system."""
    model = bar((8, 3, 3))
    top, x = where(model, 2, SIZE[2]), model.nodes.xyz[:, 0]
    front, back = top[x[top] < 0.26], top[x[top] > 0.14]
    shared = np.intersect1d(front, back)
    assert len(shared) >= 8
    interfaces = [
        make_interface(model, name="front", nodes=front, coupling="average"),
        make_interface(model, name="back", nodes=back, coupling="average"),
    ]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=problem.K.shape[0] - 12).reduce(problem)
        K, M = problem.K.toarray(), problem.M.toarray()
        Psi, F = problem.fixed_interface.solve_constraint_modes()
    assert elastic(reduced)[:20] == pytest.approx(
        np.sqrt(sl.eigh(K, M, eigvals_only=True)[6:26]) / (2 * np.pi), rel=1e-8
    )
    B = problem.B.toarray()
    saddle = np.block([[K, B], [B.T, np.zeros((12, 12))]])
    both = np.linalg.solve(saddle, np.vstack([np.zeros_like(B), np.eye(12)]))
    assert np.abs(Psi - both[: len(K)]).max() < 1e-8 * np.abs(Psi).max()
    assert np.abs(F + both[len(K) :]).max() < 1e-8 * np.abs(F).max()


def test_an_average_interface_over_the_edge_of_a_rigid_one():
    model = bar()
    top = where(model, 2, SIZE[2])
    interfaces = [
        make_interface(model, name="left", nodes=where(model, 0, 0.0), coupling="rigid"),
        make_interface(model, name="top", nodes=top, coupling="average"),
    ]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=problem.K.shape[0] - 12).reduce(problem)
        assert (
            np.abs(
                problem.B.T @ problem.coupling.R
                - np.vstack([problem.B[:, s].T @ problem.coupling.R for s in problem.coupling.columns.values()])
            ).max()
            == 0
        )
        exact = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:26]
    assert elastic(reduced)[:20] == pytest.approx(np.sqrt(exact) / (2 * np.pi), rel=1e-8)


def test_an_average_interface_inside_a_rigid_or_direct_one_is_refused():
    """Its motion is that of the other: one motion exposed twice."""
    model = bar()
    left = where(model, 0, 0.0)
    for coupling in ("rigid", "direct"):
        interfaces = [
            make_interface(model, name="whole", nodes=left, coupling=coupling),
            make_interface(model, name="part", nodes=left[:-3], coupling="average"),
        ]
        for reducer in (CraigBampton(modes=3), CraigBampton(modes=3, interface_modes=2)):
            with Problem(model, interfaces) as problem, refusal("model", "interfaces"):
                reducer.reduce(problem)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"interface_modes": 3, "interface_up_to_hz": 10.0}, ("conflict", "interface_modes")),
        ({"interface_modes": -1}, ("value", "interface_modes")),
        ({"interface_up_to_hz": 0.0}, ("value", "interface_up_to_hz")),
        ({"interface_up_to_hz": float("nan")}, ("value", "interface_up_to_hz")),
    ],
)
def test_wrong_limits_are_refused(options, words):
    with refusal(*words):
        CraigBampton(modes=3, **options)


def test_more_modes_than_there_are_and_too_few_for_inertia_are_refused():
    model = bar()
    with Problem(model, faces(model, "rigid")) as problem:
        with refusal("value", "interface_modes", "12", "6"):
            CraigBampton(modes=3, interface_modes=7).reduce(problem)
        with refusal("value", "modes", "8"):
            CraigBampton(modes=7, interface_modes=2, inertia_modes=True).reduce(problem)


JOB = """
[model]
mesh = "bar.vtk"
[[material]]
young = 2.1e11
poisson = 0.3
density = 7850.0
[[interface]]
name = "left"
nodes = "box:-1e-9,-1,-1,1e-9,1,1"
coupling = "direct"
[[interface]]
name = "right"
nodes = "box:0.399999,-1,-1,0.400001,1,1"
coupling = "direct"
{extra}
[[reduce]]
method = "{method}"
{options}
[output]
path = "bar.h5"
"""


def job(folder, options, extra="", n=(6, 3, 3), method="craig-bampton"):
    mesh = box("hex8", n, SIZE)
    meshio.Mesh(np.array(mesh.nodes.xyz), [("hexahedron", mesh.blocks[0].nodes)]).write(folder / "bar.vtk")
    (folder / "job.toml").write_text(JOB.format(options=options, extra=extra, method=method))
    return load_job(folder / "job.toml")


def test_a_job_reduces_its_interfaces_and_the_file_tells(tmp_path):
    options = "modes = 34\ninertia_modes = true\ninterface_modes = 20"
    result = run_job(job(tmp_path, options, "[certify]\nband_hz = [0, 6000]\npoints = 20"))
    delivered = result.bodies[0]
    file = read_body(tmp_path / "bar.h5")
    body = next(iter(file.bodies.values()))
    assert body.mode_kind == delivered.reduced.mode_kind and body.mode_kind.count("characteristic") == 20
    assert body.input_matrix.shape == (6 + 20 + 34, 96)
    assert body.recipe["interface_motions"] == 96 and body.recipe["interface_static_error"] > 0
    # The static error is that of unit loads on single nodes, and says what the recipe says in words.
    assert delivered.certificate.static_error > 1e-3
    inside = delivered.certificate.mode_deviation[delivered.certificate.mode_frequencies_hz < 4000]
    assert len(inside) and inside.max() < 0.02
    again = tmp_path / "again.h5"
    write_body(again, result.bodies, recipe={}, provenance={})
    assert next(iter(read_body(again).bodies.values())).mode_kind == body.mode_kind


@pytest.mark.parametrize(
    ("options", "extra", "words"),
    [
        ("modes = 3\ninterface_modes = 2.5", "", ("value", "interface_modes", "2.5")),
        ("modes = 3\ninterface_modes = 2\ninterface_up_to_hz = 9.0", "", ("conflict", "interface_modes")),
        ("modes = 3\ninterface_mode = 2", "", ("unknown", "interface_mode", "interface_modes")),
        ("modes = 3\ninterface_modes = 999", "", ("value", "reduce", "96")),
    ],
)
def test_wrong_lines_in_a_job_are_refused(tmp_path, options, extra, words):
    with refusal(*words):
        run_job(job(tmp_path, options, extra))


@pytest.mark.parametrize(
    ("method", "options", "extra", "words"),
    [
        ("craig-bampton", "modes = 3", "[certify]\nband_hz = [0, 100]", ("unsupported", "certify", "[certify]", "726")),
        (
            "craig-bampton",
            "modes = 3",
            "[response]\nfrom_hz = 1.0\nto_hz = 100.0",
            ("unsupported", "response", "[response]"),
        ),
        ("auto", "band_hz = [0, 100]\ntolerance = 1e-3", "", ("model", "method", "500")),
    ],
)
def test_thousands_of_motions_are_refused_where_each_has_a_response(tmp_path, method, options, extra, words):
    with refusal(*words):
        run_job(job(tmp_path, options, extra, n=(2, 10, 10), method=method))


def test_floating_frames_of_a_reduced_interface_hold_rigid_motion():
    model = bar()
    with Problem(model, faces(model)) as problem:
        reduced = CraigBampton(modes=4, interface_modes=12).reduce(problem)
        frame = floating_frame(problem, reduced)
        mass, _, _ = problem.mass_properties
    assert frame.integrals.mass == pytest.approx(mass, rel=1e-12)
    shapes = reduced.V @ frame.rigid
    assert np.abs(reduced.K @ frame.rigid).max() < 1e-10 * np.abs(reduced.K).max()
    assert shapes[0::3, 0].std() < 1e-9
