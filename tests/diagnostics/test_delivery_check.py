"""The check before delivery, against pyYeti's cbcheck and with planted defects."""

import io
from dataclasses import replace

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.body import elastic_body, make_part
from morembs.body.build import body_of as body_of_reduced
from morembs.body.delivery_check import check_delivery
from morembs.body.file import read_body, write_body
from morembs.fem import FEModel
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, FreeInterface, Guyan, Krylov
from tests.support.diagnoses import finding, grave
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal

SIZE = (0.5, 0.06, 0.04)
WAYS = ("geometry", "stiffness", "eigenvectors")


def body_of(reducer=None, coupling="rigid", damping=None, model=None):
    model = steel(box("hex20", (6, 1, 1), SIZE)) if model is None else model
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x in (("left", 0.0), ("right", SIZE[0]))
    ]
    with Problem(model, ends, damping=damping) as problem:
        reduced = (reducer or CraigBampton(modes=8)).reduce(problem)
        return elastic_body(problem, reduced, make_part(problem))


def with_matrices(body, **matrices):
    known = {name: getattr(body, name) for name in ("frequencies_hz", "full_frequencies_hz", "certificate", "floating")}
    return body_of_reduced(replace(body.reduced, **matrices), body.part, **known)


@pytest.mark.parametrize("coupling", ["rigid", "average", "direct"])
@pytest.mark.parametrize("reducer", [CraigBampton(modes=8), FreeInterface(modes=8), Guyan()], ids=repr)
def test_sound_bodies_pass_with_the_mass_of_the_book(reducer, coupling):
    body = body_of(reducer, coupling, Damping(modal=0.02))
    seen = check_delivery(body)
    assert grave(seen) == set(), seen.text()
    mass = STEEL["density"] * np.prod(SIZE)
    a, b, c = SIZE
    assert seen.facts["mass"] == pytest.approx(mass)
    assert seen.facts["center_of_mass"] == pytest.approx(np.array(SIZE) / 2)
    book = mass / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    assert np.diag(seen.facts["inertia"]) == pytest.approx(book, rel=1e-6)
    assert tuple(seen.facts["rigid_hz"]) == WAYS
    assert max(seen.facts["rigid_hz"].values()) < 1e-2
    for way in WAYS:
        assert seen.facts["rigid_mass"][way][:3, :3] == pytest.approx(mass * np.eye(3), abs=1e-6 * mass)
    assert seen.facts["damping_ratios"] == pytest.approx(0.02, rel=1e-6)


def test_quantities_are_those_of_cbcheck():
    """Craig-Bampton body, pyYeti's cbcheck as an independent program."""
    cb = pytest.importorskip("pyyeti.cb")
    nastran = pytest.importorskip("pyyeti.nastran.n2p")
    body = body_of()
    r = body.reduced
    constraint = np.flatnonzero(np.array(r.mode_kind) == "constraint")
    assert len(constraint) == 12
    uset = None
    for label, interface in enumerate(body.part.interfaces, start=1):
        uset = nastran.addgrid(uset, label, "b", 0, interface.point.tolist(), 0)
    reference = cb.cbcheck(
        io.StringIO(), r.M, r.K, constraint, constraint[:6], uset, uref=(0, 0, 0), rb_norm=True, n_freefree_modes=10
    )
    facts = check_delivery(body).facts
    fixed = reference.cb_frq if hasattr(reference, "cb_frq") else reference.effmass.index
    assert facts["fixed_hz"] == pytest.approx(fixed)
    assert facts["effective_mass"] == pytest.approx(reference.effmass.to_numpy(), rel=1e-6, abs=1e-9)
    share = reference.effmass_percent.to_numpy().sum(axis=0) / 100
    assert facts["effective_mass_share"] == pytest.approx(share, rel=1e-8)
    rigid = {
        "geometry": np.vstack([reference.rbg, np.zeros((r.order - 12, 6))]),
        "stiffness": reference.rbs,
        "eigenvectors": reference.rbe,
    }
    scale = np.abs(facts["rigid_mass"]["geometry"]).max()
    for way, q in rigid.items():
        tolerance = 1e-6 if way == "eigenvectors" else 1e-9
        assert facts["rigid_mass"][way] == pytest.approx(q.T @ reference.m @ q, abs=tolerance * scale)
        assert np.abs(facts["ground_force"][way]).max() < 1e-8 * np.abs(r.K).max()
        assert np.abs(reference.k @ q).max() < 1e-8 * np.abs(r.K).max()


def test_a_reduced_model_without_frame():
    body = body_of()
    seen = check_delivery(body.reduced, body.part)
    assert grave(seen) == set() and tuple(seen.facts["rigid_hz"]) == WAYS[1:]
    known = check_delivery(body).facts
    assert seen.facts["effective_mass"] == pytest.approx(known["effective_mass"], rel=1e-6, abs=1e-9)
    with refusal("missing", "part"):
        check_delivery(body.reduced)


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_round_off_as_stiffness_does_not_decide_on_rigid_motion(noise):
    """A Guyan body of one interface has rigid-body motion alone; its stiffness is what round-off left."""
    model = steel(box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)))
    end = make_interface(model, name="end", nodes=where(model, 0, 0.0))
    with Problem(model, [end]) as problem:
        reduced, part = Guyan().reduce(problem), make_part(problem)
    K = np.diag([-3.5, 0.0, 0.0, 0.0, 1.3, 1.6])
    K[0, 4:], K[2, 4], K[4, 5] = (1.4, 1.5), -0.7, -0.4
    seen = check_delivery(replace(reduced, K=noise * np.maximum(K, K.T)), part)
    assert grave(seen) <= {"frequencies"}, seen.text()
    for mass in seen.facts["rigid_mass"].values():
        assert mass == pytest.approx(seen.facts["rigid_mass"]["eigenvectors"], rel=1e-9, abs=1e-6)


def test_grounding_energy_is_that_of_the_springs():
    """Springs of 1e7 N/m from the frame of one interface to the ground, known to no one."""
    body = body_of()
    K = body.reduced.K.copy()
    K[:3, :3] += 1e7 * np.eye(3)
    seen = check_delivery(with_matrices(body, K=K))
    grounded = finding(seen, "grounded")
    assert grounded.severity == "error" and "ground" in grounded.cure
    arm = body.part.center_of_mass - body.part.interfaces[0].point
    turned = 0.5e7 * np.array([arm[1] ** 2 + arm[2] ** 2, arm[0] ** 2 + arm[2] ** 2, arm[0] ** 2 + arm[1] ** 2])
    assert seen.facts["rigid_energy_J"]["geometry"][:3] == pytest.approx([0.5e7] * 3, rel=1e-6)
    assert seen.facts["rigid_energy_J"]["geometry"][3:] == pytest.approx(turned, rel=1e-4, abs=1.0)
    assert "frequencies" in grave(seen)


def test_a_body_held_to_the_ground():
    model = steel(box("hex20", (6, 1, 1), SIZE))
    K = model.K.tolil()
    for row in model.dofs.of_nodes(where(model, 1, 0.0)).ravel():
        K[row, row] += 1e9
    held = FEModel(K=K.tocsr(), M=model.M, nodes=model.nodes, dofs=model.dofs, mesh=model.mesh)
    ends = [make_interface(held, name="left", nodes=where(held, 0, 0.0))]
    with Problem(held, ends) as problem:
        body = elastic_body(problem, CraigBampton(modes=4).reduce(problem), make_part(problem))
    assert grave(check_delivery(body)) == {"held"}


def test_defects_of_the_matrices():
    body = body_of(damping=Damping(modal=0.01))
    r = body.reduced
    bad = {name: getattr(r, name).copy() for name in "MKD"}
    bad["M"][0, 5] *= 1.001
    bad["M"][0, 5] += 1e-3
    assert "not-symmetric" in grave(check_delivery(with_matrices(body, M=bad["M"])))
    bad["K"][-1, -1] *= -1
    seen = check_delivery(with_matrices(body, K=bad["K"]))
    assert "K of the reduced body" in finding(seen, "indefinite").sentence
    bad["D"][-1, -1] *= -0.5
    assert {"indefinite", "negative-damping"} <= grave(check_delivery(with_matrices(body, D=bad["D"])))
    assert grave(check_delivery(with_matrices(body, M=r.M * np.nan))) == {"not-finite"}
    assert "indefinite" in grave(check_delivery(with_matrices(body, M=-r.M)))
    seen = check_delivery(with_matrices(body, M=1.01 * r.M))
    assert {"mass", "frequencies"} <= grave(seen)
    assert seen.facts["mass"] == pytest.approx(1.01 * body.part.mass)
    dragged = with_matrices(body, D=3.0 * r.M)
    assert grave(check_delivery(dragged)) == {"grounded-damping", "frame"}
    assert "De are not what follows" in finding(check_delivery(dragged), "frame").sentence
    assert "3 1/s" in finding(check_delivery(dragged), "grounded-damping").sentence


def test_interface_points_that_are_not_where_the_matrices_have_them():
    body = body_of()
    left, right = body.part.interfaces
    moved = replace(right, point=right.point + np.array([0, 0.01, 0]))
    seen = check_delivery(replace(body, part=replace(body.part, interfaces=(left, moved))))
    assert finding(seen, "interfaces").where == ("right x", "right z")


def test_frequencies_below_those_of_the_full_model():
    body = body_of()
    hz = body.frequencies_hz.copy()
    full = hz[:9].copy()
    full[7] *= 1.001
    seen = check_delivery(replace(body, full_frequencies_hz=full))
    assert grave(seen) == {"below-full-model"} and "mode 2" in finding(seen, "below-full-model").sentence
    assert grave(check_delivery(replace(body, full_frequencies_hz=0.999 * hz[:9]))) == set()


def test_effective_mass_of_all_modes_is_the_mass_inside():
    """With every mode kept, the shares are those of the full model with its ends held."""
    model = steel(box("hex8", (4, 1, 1), SIZE))
    ends = [make_interface(model, name="left", nodes=where(model, 0, 0.0))]
    with Problem(model, ends) as problem:
        inside = problem.K.shape[0] - 6
        body = elastic_body(problem, CraigBampton(modes=inside).reduce(problem), make_part(problem))
        held = problem.coupling.columns["left"]
        rest = np.setdiff1d(np.arange(problem.K.shape[0]), problem.B.tocoo().coords[0])
        M, R = problem.M.toarray(), problem.coupling.R
        assert held is not None
    # Rows inside see the rigid motion through the whole mass matrix.
    b = M[rest] @ R[:, :3]
    expected = np.einsum("ia,ia->a", b, np.linalg.solve(M[np.ix_(rest, rest)], b))
    share = check_delivery(body).facts["effective_mass_share"][:3]
    assert share == pytest.approx(expected / body.part.mass, rel=1e-8)
    assert "effective-mass" in check_delivery(body_of(CraigBampton(modes=1))).codes
    assert ("effective-mass" in check_delivery(body).codes) == (share.min() < 0.8)


def test_stored_bodies_are_checked_alike(tmp_path):
    body = body_of(damping=Damping(modal=0.01))
    write_body(tmp_path / "body.h5", [body], recipe={})
    file = read_body(tmp_path / "body.h5")
    stored = file.bodies[body.name]
    here, there = check_delivery(body), check_delivery(stored, file)
    assert grave(there) == set() and there.codes == here.codes
    assert there.facts["effective_mass"] == pytest.approx(here.facts["effective_mass"], rel=1e-9, abs=1e-12)
    assert tuple(there.facts["rigid_hz"]) == WAYS
    spoilt = replace(stored, stiffness_matrix=stored.stiffness_matrix * 1.1)
    assert grave(check_delivery(spoilt, file)) == {"frequencies", "frame"}
    with refusal("missing", "bodies"):
        check_delivery(stored)


@pytest.mark.parametrize("size", [1.3e-5, 1e-6, 1e3])
@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_bodies_of_any_size_are_judged_alike(size, coupling):
    """Rigid motion by stiffness was swamped in bodies of some micrometres, and interfaces could be anywhere in them."""
    model = steel(box("hex8", (6, 2, 2), tuple(size * np.array(SIZE))))
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x * size), coupling=coupling)
        for name, x in (("left", 0.0), ("right", SIZE[0]))
    ]
    with Problem(model, ends, damping=Damping(modal=0.02)) as problem:
        body = elastic_body(problem, CraigBampton(modes=8).reduce(problem), make_part(problem))
    assert grave(check_delivery(body)) == set(), check_delivery(body).text()
    left, right = body.part.interfaces
    moved = replace(right, point=right.point + np.array([0, 1e-3 * size, 0]))
    seen = check_delivery(replace(body, part=replace(body.part, interfaces=(left, moved))))
    assert finding(seen, "interfaces").where == ("right x", "right z")


def scaled(name, factor):
    def change(file):
        file[name][...] = file[name][()] * factor

    return change


def uneven(name):
    def change(file):
        A = file[name][()]
        A[-1, -2] += 1e-3 * np.sqrt(A[-1, -1] * A[-2, -2])
        file[name][...] = A

    return change


def without_mass(name):
    def change(file):
        A = file[name][()]
        A[-2:], A[:, -2:] = 0.0, 0.0
        file[name][...] = A

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (scaled("bodies/BODY/stiffness_matrix", 1.1), "frequencies that come with the body are not those"),
        (scaled("bodies/BODY/mass_matrix", 1.1), "has another mass than the model"),
        (scaled("bodies/BODY/mass_matrix", -1.0), "M of the reduced body is not positive semidefinite"),
        (without_mass("bodies/BODY/mass_matrix"), "frequencies that come with the body are not those of its matrices"),
        (scaled("mass_properties/mass", 1.01), "has another mass than the model"),
        (scaled("bodies/BODY/frequencies_hz", 1.001), "frequencies that come with the body are not those"),
        (uneven("bodies/BODY/stiffness_matrix"), "K is not symmetric"),
        (uneven("bodies/BODY/damping_matrix"), "D is not symmetric"),
        (scaled("bodies/BODY/floating_frame/Ke", 1.001), "floating frame does not belong to the matrices: Ke are"),
        (scaled("bodies/BODY/floating_frame/integrals/Me", 1.001), "integrals/Me"),
        (scaled("bodies/BODY/floating_frame/integrals/mass", 1.001), "integrals/mass, first and inertia"),
        (scaled("bodies/BODY/floating_frame/markers/left/motion", 1.001), "markers/left"),
        (scaled("interfaces/left/point", 0.9), "interface degrees of freedom do not follow rigid motion"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_by_info(tmp_path, change, words):
    """Every number is readable and finite, and the file is wrong all the same."""
    body = body_of(damping=Damping(modal=0.01))
    path = tmp_path / "body.h5"
    write_body(path, [body], recipe={})
    assert CliRunner().invoke(app, ["info", str(path)]).exit_code == 0
    with h5py.File(path, "r+") as file:
        names = list(file["bodies"])

        class Named:
            def __getitem__(self, name):
                return file[name.replace("BODY", names[0])]

        change(Named())
        del file["checksums"]
    for more in ([], ["--json"]):
        seen = CliRunner().invoke(app, ["info", str(path), *more])
        assert seen.exit_code == 2 and words in seen.stderr and len(seen.stderr.strip().splitlines()) == 1, seen.stderr


def test_two_sided_bodies_need_not_be_symmetric(tmp_path):
    body = body_of(Krylov(shifts_hz=[2000.0], two_sided=True, inputs=["left"], outputs=["right"]))
    assert not body.reduced.symmetric
    write_body(tmp_path / "body.h5", [body], recipe={})
    seen = CliRunner().invoke(app, ["info", str(tmp_path / "body.h5")])
    assert seen.exit_code == 0, seen.stderr


def test_round_off_of_dashpots_between_nodes_that_move_as_one_is_no_negative_damping():
    """It has either sign; against critical damping it is nothing, while a millionth of that is reported."""
    body = body_of(damping=None)
    r = body.reduced
    noise = np.random.default_rng(3).standard_normal(r.M.shape) * 1e-13
    assert np.linalg.eigvalsh(noise + noise.T).min() < 0
    assert not grave(check_delivery(with_matrices(body, D=noise + noise.T))) & {"indefinite", "negative-damping"}
    w = np.sqrt(np.abs(r.K).max())
    assert "indefinite" in grave(check_delivery(with_matrices(body, D=1e-6 * w * (noise + noise.T) / 1e-13)))
