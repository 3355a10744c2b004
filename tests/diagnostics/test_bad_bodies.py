"""Damaged body files: every dataset is damaged in turn, and the answer is one message that names it."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import InputError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.body.recovery.recover import Trajectory, expand, recover
from morembs.body.stress_shapes import stress_recovery
from morembs.certificate.certify import certify
from morembs.exporters import EXPORTERS, export_body
from morembs.fem import FEModel
from morembs.fem.interface import make_interface
from morembs.importers import import_file
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Krylov
from morembs.storage.checksums import seal
from tests.support import commands
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal
from tests.support.stored import datasets

# What follows from other datasets and is for people or other programs only.
DERIVED = "C4|C6|Cr1|J1|Gr|Ge|Oe|Oe1"
UNREAD = rf"provenance/|VTKHDF/|format|.*/integrals/({DERIVED})$|.*/recovery/coordinates|.*/notes$"
# Sizes that nothing else in the file has.
FREE = r"mode_kinds|.*/(full_frequencies_hz|certificate/.*|components|stiffening/dropped|floating_frame/interfaces)$"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A body with everything: frame, stiffening, stress, certificate, a direct interface."""
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.04)))
    chosen = (("root", 0.0, "rigid"), ("tip", 0.4, "average"), ("middle", 0.2, "direct"))
    faces = [make_interface(model, name=n, nodes=where(model, 0, x), coupling=c) for n, x, c in chosen]
    path = tmp_path_factory.mktemp("whole") / "beam.h5"
    with Problem(model, faces) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"])
        stiff = geometric_stiffening(problem, reduced, frame)
        body = elastic_body(
            problem,
            reduced,
            make_part(problem),
            floating=replace(frame, stiffening=stiff),
            certificate=certify(problem, [reduced], [100.0, 500.0])[0],
        )
        body = replace(body, recovery=stress_recovery(problem, reduced))
        write_body(path, [body])
    with h5py.File(path, "r+") as file:
        del file["checksums"]  # as other writers may: what is wrong must show without them
    return path


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A damped body on springs with a certificate."""
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.04)))
    K = model.K.tolil()
    for row in model.dofs.of_nodes(where(model, 0, 0.0)).ravel():
        K[row, row] += 1e9
    model = FEModel(K=K.tocsr(), M=model.M, nodes=model.nodes, dofs=model.dofs, mesh=model.mesh)
    ends = [make_interface(model, name="tip", nodes=where(model, 0, 0.4))]
    path = tmp_path_factory.mktemp("held") / "beam.h5"
    with Problem(model, ends, damping=Damping(beta=1e-6)) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        certificate = certify(problem, [reduced], [0.0, 2000.0], damping_floor=0.01, points=5)[0]
        write_body(path, [elastic_body(problem, reduced, make_part(problem), certificate=certificate)])
    with h5py.File(path, "r+") as file:
        del file["checksums"]
    return path


def damaged(whole, folder, change):
    path = folder / "bad.h5"
    shutil.copy(whole, path)
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def put(name, value):
    """Another dataset in the place of ``name``."""

    def change(file):
        del file[name]
        file[name] = value

    return change


def used_up(path, folder):
    """All that reads a body file."""
    body = next(iter(read_body(path).bodies.values()))
    body.basis()
    for target in ("exudyn", "sid", "simscape", "mbdyn", "dmig"):
        export_body(path, target, path=folder / "out.hdf5")
    motion = Trajectory(times=np.array([0.0]), coordinates=np.zeros((1, len(body.mass_matrix))))
    recover(path, motion, folder / "out.vtkhdf")


def read_ones(path):
    return {name: value for name, value in datasets(path).items() if not re.match(UNREAD, name)}


def ways(name, value):
    """How a dataset of such values can be wrong, each with a new value."""
    if value.dtype.kind == "f" and value.size:
        first = value.copy() if value.shape else np.array(value)
        first[(-1,) * first.ndim] = np.nan
        if not re.search(r"(frequencies_hz|certificate/.*|share|load)$", name):
            yield "nan", first
    if value.dtype.kind in "fiu":
        # One text, or as many as there were numbers.
        yield "text", np.bytes_(b"hello") if len(name) % 2 else np.full(value.shape or (1,), b"1")
    else:
        yield "numbers", np.ones(value.shape)
    if not re.match(FREE, name) and value.size > 1:
        yield "shorter", value[1:] if value.ndim == 1 else value[:, 1:]
    yield "deeper", value[None]


@pytest.mark.parametrize(
    ("way", "least"), [("nan", 45), ("text", 80), ("numbers", 12), ("shorter", 60), ("deeper", 95)]
)
def test_every_dataset_of_a_damaged_file_is_named(whole, tmp_path, way, least):
    tried = 0
    for name, value in read_ones(whole).items():
        other = dict(ways(name, value)).get(way)
        if other is None:
            continue
        path = damaged(whole, tmp_path, put(name, other))
        with pytest.raises(InputError) as caught:
            used_up(path, tmp_path)
        message = str(caught.value)
        assert message.count("bad.h5") == 1 and "\n" not in message, (name, message)
        # A size that two datasets give is the fault of either.
        assert re.search(rf" /{name}\b", message), (name, message)
        tried += 1
    assert tried >= least


def test_the_whole_file_is_used_up(whole, tmp_path):
    """What the tests above damage is read where it is sound."""
    used_up(whole, tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("mass_properties/mass", -1.0), ("file", "bad.h5", "/mass_properties/mass", "-1")),
        (put("bodies/cb/floating_frame/integrals/mass", -1.0), ("file", "bad.h5", "/mass", "-1")),
        (put("inputs/interface_index", np.full(24, 77)), ("file", "bad.h5", "/inputs/interface_index", "77")),
        (put("inputs/component", np.full(24, 6)), ("file", "bad.h5", "/inputs/component", "6", "5")),
        (put("bodies/cb/mode_kind", np.full(28, 99)), ("file", "bad.h5", "/bodies/cb/mode_kind", "99")),
        (put("bodies/cb/rigid_count", 29), ("file", "bad.h5", "/bodies/cb/rigid_count", "29", "28")),
        (put("bodies/cb/recipe", np.bytes_(b"{bad")), ("file", "bad.h5", "/bodies/cb/recipe")),
        (put("interfaces/tip/coupling", np.bytes_(b"glued")), ("value", "", "glued")),
        (put("interfaces/tip/coupling", np.bytes_(b"\xff")), ("file", "bad.h5", "/interfaces/tip/coupling")),
        (
            put("bodies/cb/floating_frame/kind", np.bytes_(b"loose")),
            ("file", "bad.h5", "floating_frame", "/kind", "loose"),
        ),
        (
            lambda f: f.move("bodies/cb/floating_frame/markers/tip", "bodies/cb/floating_frame/markers/top"),
            ("file", "bad.h5", "/bodies/cb/floating_frame/markers", "top"),
        ),
        (
            lambda f: (
                put("bodies/cb/output_matrix", 1)(f)
                if "output_matrix" in f["bodies/cb"]
                else f.create_group("bodies/cb/output_matrix")
            ),
            ("file", "bad.h5", "/bodies/cb/output_matrix"),
        ),
        (put("interfaces/tip/axes", np.diag([1.0, 1.0, -1.0])), ("file", "bad.h5", "/interfaces/tip/axes")),
        (put("interfaces/tip/axes", np.diag([1.0, 1.0, 1.1])), ("file", "bad.h5", "2.1e-01")),
        (put("unit_system", np.bytes_(b"mm")), ("file", "bad.h5", "/unit_system", "mm")),
        (put("VTKHDF/Points", np.full((20, 3), np.nan)), ("file", "bad.h5", "/VTKHDF/Points")),
        (put("VTKHDF/Points", np.zeros((19, 3))), ("file", "bad.h5", "/VTKHDF/Points", "float64", "19")),
        (put("VTKHDF/Connectivity", np.full(32, 10**9)), ("file", "bad.h5", "/VTKHDF/Connectivity", "1000000000")),
        (put("VTKHDF/Connectivity", np.zeros(32)), ("file", "bad.h5", "/VTKHDF/Connectivity", "float64")),
        (put("VTKHDF/Offsets", np.array([0, 8, 16, 30, 32])), ("file", "bad.h5", "/VTKHDF/Offsets", "12", "14")),
        (put("VTKHDF/Offsets", np.array([0, 8, 24, 16, 32])), ("file", "bad.h5", "/VTKHDF/Offsets", "32")),
        (put("VTKHDF/Types", np.full(3, 12, dtype="u1")), ("file", "bad.h5", "/VTKHDF/Offsets", "5", "4")),
        (lambda f: f.__delitem__("VTKHDF/Types"), ("file", "bad.h5")),
    ],
)
def test_values_that_cannot_be(whole, tmp_path, change, words):
    path = damaged(whole, tmp_path, change)
    for act in (
        lambda: export_body(path, "exudyn", path=tmp_path / "o.hdf5"),
        lambda: recover(path, motion(28), tmp_path / "o.vtkhdf"),
    ):
        with refusal(*words):
            act()
    assert [left_over.name for left_over in tmp_path.iterdir()] == ["bad.h5"]


def test_a_basis_that_was_never_filled(whole, tmp_path):
    def hollow(file):
        data = file["bodies/cb/basis"]
        shape = data.shape
        del file["bodies/cb/basis"]
        file.create_dataset("bodies/cb/basis", shape, "f8", chunks=(shape[0], 1))

    with refusal("file", "bad.h5", "/bodies/cb/basis"):
        read_body(damaged(whole, tmp_path, hollow))


def test_a_compressed_copy_is_the_same_body(whole, tmp_path):
    def packed(file):
        value = file["bodies/cb/basis"][()]
        del file["bodies/cb/basis"]
        file.create_dataset("bodies/cb/basis", data=value, chunks=(len(value), 1), compression="gzip")

    basis = read_body(damaged(whole, tmp_path, packed)).bodies["cb"].basis()
    assert np.array_equal(basis, read_body(whole).bodies["cb"].basis())


@pytest.mark.parametrize("target", ["sid", "mbdyn", "exudyn", "simscape"])
@pytest.mark.parametrize("diagonal", [-1.0, 1.0])
def test_matrices_that_no_body_has(whole, tmp_path, target, diagonal):
    """Finite numbers, but no mass: what linear algebra says becomes one message."""

    def change(file):
        for name in ("bodies/cb/mass_matrix", "bodies/cb/floating_frame/integrals/Me"):
            n = len(file[name])
            file[name][...] = 2 * np.ones((n, n)) + (diagonal - 2) * np.eye(n)

    path = damaged(whole, tmp_path, change)
    with refusal("file", "bad.h5"):
        export_body(path, target, path=tmp_path / "o.hdf5")
    assert [left_over.name for left_over in tmp_path.iterdir()] == ["bad.h5"]


def scaled(name, factor):
    def change(file):
        file[f"bodies/cb/{name}"][...] = factor * file[f"bodies/cb/{name}"][()]

    return change


def unsymmetric(file):
    K = file["bodies/cb/stiffness_matrix"]
    K[1, -1] = K[1, -1] + 0.3 * np.abs(K[()]).max()


def mass_for_stiffness(file):
    file["bodies/cb/stiffness_matrix"][...] = file["bodies/cb/mass_matrix"][()]


def sealed(change):
    """As ``change``, with checksums made again."""

    def changed(file):
        change(file)
        seal(file)

    return changed


CHANGES = {
    "K times 4": scaled("stiffness_matrix", 4.0),
    "K times -1": scaled("stiffness_matrix", -1.0),
    "M for K": mass_for_stiffness,
    "K not symmetric": unsymmetric,
    "B twice": scaled("input_matrix", 2.0),
    "M twice": scaled("mass_matrix", 2.0),
    "sealed again": sealed(scaled("stiffness_matrix", 4.0)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_body_that_contradicts_itself_is_not_read(whole, tmp_path, change):
    path = damaged(whole, tmp_path, change)
    with refusal("file", "bad.h5"):
        read_body(path)


def test_a_body_that_contradicts_itself_leaves_by_no_door(whole, tmp_path):
    path = damaged(whole, tmp_path, CHANGES["sealed again"])
    np.savez(tmp_path / "m.npz", times=[0.0, 0.1], coordinates=np.zeros((2, 28)))
    (tmp_path / "job.toml").write_text(
        '[[substructure]]\nname = "a"\nbody = "bad.h5"\n[[substructure]]\nname = "b"\nbody = "bad.h5"\n'
        'position = [1, 0, 0]\n[[couple]]\nbetween = ["a:tip", "b:root"]\n[[reduce]]\nmethod = "modal"\nmodes = 2\n'
        '[output]\npath = "out.h5"\n'
    )
    doors = [["export", path, "--to", to, "-o", tmp_path / f"out.{to}"] for to in EXPORTERS]
    doors += [
        ["info", path],
        ["recover", path, tmp_path / "m.npz", "-o", tmp_path / "out.vtkhdf"],
        ["evaluate", path, "--at", "E=1"],
        ["campbell", path, "-o", tmp_path / "out.csv"],
        ["reduce", tmp_path / "job.toml"],
    ]
    for door in doors:
        result = CliRunner().invoke(app, [*map(str, door)])
        assert result.exit_code == 2 and "bad.h5 is not sound" in result.stderr, (door, result.stdout, result.stderr)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["bad.h5", "job.toml", "m.npz"]


def test_a_held_body_is_compared_with_the_curve_of_its_certificate(held, tmp_path):
    """No rigid motion tells what its loads and damping are."""
    for change in (scaled("input_matrix", 2.0), scaled("damping_matrix", 3.0)):
        path = damaged(held, tmp_path, change)
        with refusal("file", "bad.h5"):
            export_body(path, "op4", path=tmp_path / "out.op4")
    assert read_body(held).bodies["cb"].rigid_count == 0


def test_a_body_of_two_bases_has_no_stiffness_on_rigid_motion(tmp_path):
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.04)))
    ends = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("root", 0.0), ("tip", 0.4))]
    with Problem(model, ends) as problem:
        reduced = Krylov(shifts_hz=[500.0], two_sided=True, inputs=["root"], outputs=["tip"]).reduce(problem, "cb")
        path = write_body(tmp_path / "bad.h5", [elastic_body(problem, reduced, make_part(problem))])
    assert not read_body(path).bodies["cb"].symmetric
    with h5py.File(path, "r+") as file:
        unsymmetric(file)
        seal(file)
    with refusal("file", "bad.h5", "6"):
        export_body(path, "op4", path=tmp_path / "out.op4")


def motion(n, **other):
    return Trajectory(**{"times": np.array([0.0, 0.1]), "coordinates": np.zeros((2, n)), **other})


def run(*arguments):
    said = commands.run(*arguments, code=2)
    assert said.startswith("error: ") and len(said.strip().splitlines()) == 1
    return said


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"times": 0.0}, "times has the shape ()"),
        ({"times": np.zeros((2, 1))}, "times has the shape (2, 1)"),
        ({"time": [0.0, 0.1], "times": [0.0, 5.0]}, "holds both time and times"),
        ({"times": [0.0, 0.1], "coordinates": np.full((2, 28), 1e308)}, "from numbers up to 1e+308"),
        ({"times": [0.0, 0.1], "coordinates": np.full((2, 28), 1e37)}, "check the units"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_motions_that_cannot_be_recovered(whole, tmp_path, arrays, words):
    np.savez(tmp_path / "m.npz", **{"coordinates": np.zeros((2, 28)), **arrays})
    message = run("recover", whole, tmp_path / "m.npz", "-o", tmp_path / "o.vtkhdf")
    assert words in message and not (tmp_path / "o.vtkhdf").exists()


def test_results_that_are_not_finite_name_their_time(whole):
    source = read_body(whole)
    q = np.zeros((2, 28))
    q[1] = 1e300
    with refusal("value", "", "0.1", "1e+300"):
        expand(source, source.bodies["cb"], motion(28, coordinates=q))


def test_a_body_file_is_no_model(whole, tmp_path):
    export_body(whole, "exudyn", path=tmp_path / "beam.hdf5")
    for path, kind in ((whole, "a body file of morembs"), (tmp_path / "beam.hdf5", "a reduced body for Exudyn")):
        message = run("import", path, "-o", tmp_path / "out.model.h5")
        assert f"{Path(path).name} is {kind}" in message and "not a model" in message
    assert not (tmp_path / "out.model.h5").exists()
    # Who names a matrix in it gets that matrix.
    K = import_file(whole, options={"K": "bodies/cb/stiffness_matrix", "M": "bodies/cb/mass_matrix"}).K
    assert np.array_equal(K.toarray(), read_body(whole).bodies["cb"].stiffness_matrix)
