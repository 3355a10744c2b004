"""Exports of several files: all of the new set or all of the old one, names of their own, labels that fit."""

import itertools
import os
import re
import resource
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError, OutputError
from morembs.body import elastic_body, make_part
from morembs.body.build import body_of
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.exporters import EXPORTERS, export_body
from morembs.fem import NamedColumns
from morembs.fem.interface import make_interface, matrix_interface
from morembs.importers.matrices.abaqus import align, read_abaqus_matrix
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.reducers import CraigBampton, Krylov, Modal, StaticModesSwitching
from morembs.storage.safefile import replacing_all
from tests.support.meshes import box, steel, where
from tests.support.processes import apart
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[2]


def part():
    """A beam and its two faces."""
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.04)))
    return model, [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left", 0.0), ("right", 0.4))]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Body files of one beam: "a" damped and small, "b" damped and larger, "c" undamped, "rigid" without modes."""
    model, faces = part()
    folder, paths = tmp_path_factory.mktemp("files"), {}
    damping = Damping(modal_table=[[0.0, 0.01], [2000.0, 0.1]])
    for name, modes, damped in (("a", 4, damping), ("b", 7, damping), ("c", 4, None)):
        with Problem(model, faces, **({"damping": damped} if damped else {})) as problem:
            reduced = CraigBampton(modes=modes).reduce(problem, name)
            frame = floating_frame(problem, reduced, kind="tangent", interfaces=["left"])
            body = elastic_body(problem, reduced, make_part(problem), floating=frame)
            paths[name] = write_body(folder / f"{name}.h5", [body])
    with Problem(model) as problem:
        modal = Modal(modes=1).reduce(problem, "rigid")
        rigid = replace(
            modal,
            M=np.eye(6),
            K=np.zeros((6, 6)),
            D=np.zeros((6, 6)),
            B=modal.B[:6],
            C=modal.C[:, :6],
            V=modal.V[:, :6],
            mode_kind=modal.mode_kind[:6],
        )
        body = body_of(rigid, make_part(problem), np.zeros(6))
        paths["rigid"] = write_body(folder / "rigid.h5", [body])
    return paths


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def exported(source, to, folder):
    folder.mkdir()
    return export_body(source, to, path=folder / f"x{EXPORTERS[to].suffix}")


@pytest.mark.parametrize("to", ["abaqus", "matrix-market"])
@pytest.mark.parametrize("stuck", range(4))
def test_a_name_that_cannot_be_taken_brings_the_old_set_back(files, tmp_path, monkeypatch, to, stuck):
    done = exported(files["a"], to, tmp_path / "x")
    old, rename = contents(tmp_path / "x"), os.replace
    assert len(old) == len(done.paths) == 4

    def fails(source, target):
        if Path(target) == done.paths[stuck] and ".tmp-" in str(source):
            raise PermissionError(1, "Operation not permitted")
        rename(source, target)

    monkeypatch.setattr(os, "replace", fails)
    with refusal("output", "", done.paths[stuck].name, by=OutputError) as caught:
        export_body(files["b"], to, path=tmp_path / "x" / f"x{EXPORTERS[to].suffix}")
    assert done.paths[stuck].name in str(caught.value)
    assert contents(tmp_path / "x") == old
    # Where nothing was before, nothing is left.
    for path in done.paths:
        path.unlink()
    with pytest.raises(OutputError):
        export_body(files["b"], to, path=tmp_path / "x" / f"x{EXPORTERS[to].suffix}")
    assert not contents(tmp_path / "x")
    monkeypatch.undo()
    export_body(files["b"], to, path=tmp_path / "x" / f"x{EXPORTERS[to].suffix}")
    assert contents(tmp_path / "x") == contents(exported(files["b"], to, tmp_path / "y").paths[0].parent)


def test_a_set_that_stays_mixed_says_so(tmp_path, monkeypatch):
    """A disk without second names cannot give the old files back."""
    paths = [tmp_path / name for name in ("one", "two", "three")]
    for path in paths:
        path.write_bytes(b"old")
    rename = os.replace

    def fails(source, target):
        if Path(target).name == "three":
            raise OSError(5, "Input/output error")
        rename(source, target)

    def none(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "replace", fails)
    monkeypatch.setattr(os, "link", none)
    with refusal("output", "", paths[2], "two,", "one", by=OutputError):
        written(paths)
    assert contents(tmp_path) == {"one": b"new", "three": b"old", "two": b"new"}


def written(paths):
    with replacing_all(paths) as opened:
        for file in opened:
            file.write(b"new")


@pytest.mark.parametrize("at", ["write", "fsync"])
def test_a_failure_that_nobody_asked_for_counts_in_the_end(tmp_path, monkeypatch, at):
    """A library may go on after a failed write; the set is refused all the same, before any name is taken."""
    paths = [tmp_path / "one", tmp_path / "two"]
    paths[0].write_bytes(b"old")
    full, sync, seen = OSError(28, "No space left on device"), os.fsync, []

    def fails(handle):
        seen.append(handle)
        if len(seen) == 2:
            raise full
        sync(handle)

    if at == "fsync":
        monkeypatch.setattr(os, "fsync", fails)
    with refusal("output", "", str(paths[1]), by=OutputError) as caught, replacing_all(paths) as opened:
        opened[1].error = full if at == "write" else None
        for file in opened:
            file.write(b"new")
    assert full.strerror in str(caught.value)
    assert contents(tmp_path) == {"one": b"old"}


@pytest.mark.parametrize("error", [RuntimeError("halt"), KeyboardInterrupt()], ids=repr)
def test_interruption_leaves_the_old_set(tmp_path, error):
    paths = [tmp_path / "one", tmp_path / "two"]
    paths[0].write_bytes(b"old")
    with pytest.raises(type(error)), replacing_all(paths) as opened:
        opened[0].write(b"new")
        raise error
    assert contents(tmp_path) == {"one": b"old"}
    with refusal("output", "", paths[0], by=OutputError):
        written([paths[0], tmp_path / "." / "one"])
    with refusal("output", "", tmp_path / "no" / "two", by=OutputError):
        written([paths[0], tmp_path / "no" / "two"])
    assert contents(tmp_path) == {"one": b"old"}
    written(paths)
    assert contents(tmp_path) == {"one": b"new", "two": b"new"}


@pytest.mark.parametrize("before", [True, False])
def test_a_full_disk_leaves_the_old_set_or_nothing(files, tmp_path, monkeypatch, before):
    """All targets under file-size limits from nothing to one byte less than the largest file needs."""
    if not before:
        monkeypatch.setenv("CC", "false")
    tasks, old = [], {}
    for to, exporter in EXPORTERS.items():
        sizes = sorted(path.stat().st_size for path in exported(files["b"], to, tmp_path / f"{to}-sizes").paths)
        # Nothing at all, and around the end of each file; or in the midst and at the end of the last.
        limits = {0, *(size + d for size in sizes for d in (-1, 0))} if before else {sizes[-1] // 2, sizes[-1] - 1}
        exported(files["a"], to, tmp_path / to) if before else (tmp_path / to).mkdir()
        old[to] = contents(tmp_path / to)
        path = str(tmp_path / to / f"x{exporter.suffix}")
        tasks += [(to, path, limit) for limit in sorted(limits - {sizes[-1]})]

    def work():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        free, lines = resource.getrlimit(resource.RLIMIT_FSIZE), []
        for to, path, limit in tasks:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, free[1]))
            try:
                export_body(files["b"], to, path=path)
            except OutputError as error:
                message = str(error)
            else:
                message = f"no error of {to} with {limit} bytes"
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, free)
            lines.append(message)
        sys.stdout.write("\n".join(lines))

    ran = apart(work, tmp_path)
    assert ran.code == 0 and not ran.errors, ran.errors
    lines = ran.output.splitlines()
    assert len(lines) == len(tasks)
    for (to, _, limit), line in zip(tasks, lines, strict=True):
        assert "File too large" in line and "free space" in line, (to, limit, line)
        assert bool(re.search(r"that (was|were) there before (is|are) unchanged", line)) == before, line
    assert {to: contents(tmp_path / to) for to in EXPORTERS} == old


def test_no_two_targets_share_a_file(files, tmp_path, monkeypatch):
    """All targets beside one body file; each is still what it was when the others were written."""
    monkeypatch.setenv("CC", "false")
    source = tmp_path / "beam.h5"
    source.write_bytes(files["a"].read_bytes())
    exported = {to: {path: path.read_bytes() for path in export_body(source, to).paths} for to in EXPORTERS}
    for (a, files_a), (b, files_b) in itertools.combinations(exported.items(), 2):
        assert not set(files_a) & set(files_b), (a, b)
    for written in exported.values():
        assert all(path.read_bytes() == data for path, data in written.items())
    deck = (tmp_path / "beam.inp").read_text()
    for name in re.findall(r"INPUT=(\S+)", deck):
        assert read_abaqus_matrix(tmp_path / name).symmetric


def test_files_of_another_body_are_named(files, tmp_path):
    for to, stale in (("abaqus", "x_abaqus_D.mtx"), ("matrix-market", "x_D.mtx")):
        first = exported(files["a"], to, tmp_path / to)
        assert not any("left from before" in note for note in first.notes)
        again = export_body(files["c"], to, path=tmp_path / to / f"x{EXPORTERS[to].suffix}")
        assert any("left from before" in note and stale in note for note in again.notes)
        assert (tmp_path / to / stale) not in again.paths and (tmp_path / to / stale).exists()


@pytest.mark.parametrize(("to", "name"), [("abaqus", "x_abaqus_M.mtx"), ("matrix-market", "x_B.mtx")])
def test_the_body_file_is_not_overwritten_by_a_file_beside(files, tmp_path, to, name):
    source = tmp_path / name
    source.write_bytes(files["a"].read_bytes())
    with refusal("output", "out", name):
        export_body(source, to, path=tmp_path / f"x{EXPORTERS[to].suffix}")
    assert contents(tmp_path) == {name: files["a"].read_bytes()}


def test_damping_of_an_abaqus_deck(files, tmp_path):
    """The deck names the damping matrix, and with it the response is that of the body."""
    for name, line in (
        ("a", "*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M, VISCOUS DAMPING=D"),
        ("c", "*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M"),
    ):
        done = exported(files[name], "abaqus", tmp_path / name)
        deck = done.paths[0].read_text().splitlines()
        assert deck[-1] == line
        given = dict(re.findall(r"\*MATRIX INPUT, NAME=(\w), INPUT=(\S+)", "\n".join(deck)))
        assert list(given) == (["M", "K", "D"] if name == "a" else ["M", "K"])
        body = read_body(files[name]).bodies[name]
        back, node, dof = align(*(read_abaqus_matrix(tmp_path / name / given[key]) for key in given))
        matrices = dict(zip(given, (A.toarray() for A in back), strict=True))
        s = 2j * np.pi * 3000.0
        H = np.linalg.inv(s * s * matrices["M"] + s * matrices.get("D", 0) + matrices["K"])[:12, :12]
        exact = s * s * body.mass_matrix + s * body.damping_matrix + body.stiffness_matrix
        wanted = body.output_matrix @ np.linalg.solve(exact, body.input_matrix)
        assert np.abs(H - wanted).max() < 1e-9 * np.abs(wanted).max()
        assert dof[:12].tolist() == [1, 2, 3, 4, 5, 6] * 2 and len(set(node[:12].tolist())) == 2


@pytest.mark.parametrize("to", ["abaqus", "dmig"])
def test_labels(files, tmp_path, to):
    most = {"abaqus": 999_999_999, "dmig": 99_999_999}[to]
    target = tmp_path / f"x{EXPORTERS[to].suffix}"
    for label in (0, -3, most - 4, 9_999_999_999_999_999_999_999):
        with refusal("value", "", "first_label", label):
            export_body(files["a"], to, path=target, options={"first_label": label})
    assert not contents(tmp_path)
    for label, noted in ((None, False), (10, True), (1000, False), (most - 5, False)):
        done = export_body(files["a"], to, path=target, options={} if label is None else {"first_label": label})
        highest = int(read_body(files["a"]).node_ids.max())
        note = f"labels count from 10, though the model had labels up to {highest}"
        assert any(note in line for line in done.notes) == noted
        text = target.read_text()
        first = highest + 1 if label is None else label
        if to == "abaqus":
            assert re.search(rf"^{first}, ", text, re.M) and re.search(rf"^{first + 5}, 0., 0., 0.$", text, re.M)
        else:
            assert re.search(rf"^GRID\* +{first}\b", text, re.M) and re.search(rf"THRU *{first + 5}$", text, re.M)


def test_labels_beside_direct_interfaces(tmp_path):
    """Nodes keep their labels; all other points come behind those of the model, or where they were told to."""
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.04)))
    rows = where(model, 0, 0.0)
    used, highest = model.nodes.ids[rows].max(), model.nodes.ids.max()
    with Problem(model, [make_interface(model, name="l", nodes=rows, coupling="direct")]) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        path = write_body(tmp_path / "d.h5", [elastic_body(problem, reduced, make_part(problem))])
    assert used < highest
    for options, first in (({}, highest + 1), ({"first_label": 500}, 500)):
        deck = export_body(path, "abaqus", options=options).paths[0].read_text()
        assert re.search(rf"^{first}, 0., 0., 0.$\n.*\n.*\n^{first + 3}, 0., 0., 0.$", deck, re.M)
        assert re.findall(r"^(\d+), (?!0\., )", deck, re.M) == [str(label) for label in sorted(model.nodes.ids[rows])]
    with refusal("value", "", "999999996"):
        export_body(path, "abaqus", options={"first_label": int(used)})


@pytest.mark.parametrize("to", ["abaqus", "dmig", "op4", "matrix-market"])
def test_a_body_without_stiffness(files, tmp_path, to):
    target = tmp_path / f"x{EXPORTERS[to].suffix}"
    if to in ("abaqus", "dmig"):
        with refusal("unsupported", "modes", "stiffness_matrix", "rigid"):
            export_body(files["rigid"], to, path=target)
        assert not contents(tmp_path)
    else:
        done = export_body(files["rigid"], to, path=target)
        if to == "matrix-market":
            K = scipy.io.mmread(done.paths[1])
            assert not (K.toarray() if sp.issparse(K) else K).any()
            assert sl.eigvalsh(scipy.io.mmread(done.paths[0])) == pytest.approx(np.ones(6))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("simpack", ("unknown", "to", "sid")),
        ("SID", ("unknown", "to", "sid")),
        ("Nastran", ("unknown", "to", "dmig", "op4")),
        ("SID_FEM", ("unknown", "to", "sid")),
        ("exodyn", ("unknown", "to", "exudyn")),
        ("adams", ("unknown", "to")),
        ("matlab", ("unknown", "to", "simscape")),
        ("FMI", ("unknown", "to", "fmu")),
        ("vtk", ("unknown", "to")),
    ],
)
def test_other_names_of_targets(files, given, words):
    with refusal(*words):
        export_body(files["a"], given)


def test_each_frame_has_its_own_file(files, tmp_path):
    source = tmp_path / "beam.h5"
    source.write_bytes(files["a"].read_bytes())
    frames = (None, "mean-axes", "tangent:right", "chord:left, right")
    names = [export_body(source, "sid", frame=frame).paths[0].name for frame in frames]
    assert names == [
        "beam.SID_FEM",
        "beam_mean-axes.SID_FEM",
        "beam_tangent-right.SID_FEM",
        "beam_chord-left-right.SID_FEM",
    ]
    assert len({(tmp_path / name).read_bytes() for name in names}) == 4


def with_static_modes():
    model, faces = part()
    reducer = StaticModesSwitching(
        base="craig-bampton", base_options={"modes": 4}, candidates="box:0.05,0,0.04,0.35,0,0.04", directions=[2]
    )
    with Problem(model, faces) as problem:
        reduced = reducer.reduce(problem, name="rail")
        body = elastic_body(problem, reduced, make_part(problem))
        return replace(body, switching=reducer.tabulate_static_modes(problem, reduced))


def with_forces():
    model, faces = part()
    push = np.linspace(-1.0, 1.0, model.size)[:, None]
    model = replace(model, inputs=NamedColumns(matrix=sp.csc_array(push), names=("push",)))
    with Problem(model, [*faces, matrix_interface(model, name="piezo", matrix="B")]) as problem:
        return elastic_body(problem, CraigBampton(modes=4).reduce(problem, "cb"), make_part(problem))


def two_sided():
    with Problem(*part()) as problem:
        krylov = Krylov(shifts_hz=[400.0], two_sided=True, inputs=["left"], outputs=["right"])
        return elastic_body(problem, krylov.reduce(problem), make_part(problem))


def with_structural_damping():
    with Problem(*part(), damping=Damping(structural=0.02)) as problem:
        return elastic_body(problem, CraigBampton(modes=4).reduce(problem, "cb"), make_part(problem))


@pytest.fixture
def path(tmp_path, tmp_path_factory, monkeypatch, made):
    """A body file of its own, of a body that is made once; what a compiler makes of sources is tested elsewhere."""
    monkeypatch.setenv("CC", "false")
    if made not in MADE:
        MADE[made] = write_body(tmp_path_factory.mktemp("made") / "x.h5", [made()]).read_bytes()
    (tmp_path / "x.h5").write_bytes(MADE[made])
    return tmp_path / "x.h5"


MADE = {}


@pytest.mark.parametrize("made", [with_static_modes])
@pytest.mark.parametrize("to", EXPORTERS)
def test_static_modes_of_candidates_stay_behind_and_a_note_says_so(path, to):
    assert any("static modes of candidate loads; left behind" in note for note in export_body(path, to).notes)


@pytest.mark.parametrize("made", [with_forces])
@pytest.mark.parametrize("to", EXPORTERS)
def test_generalised_forces_pass_or_are_named(path, tmp_path, to):
    try:
        notes = export_body(path, to).notes
    except InputError as error:
        assert "'piezo' has generalised forces" in str(error) and contents(tmp_path).keys() == {"x.h5"}
    else:
        left = "the file cannot hold its generalised forces (piezo); left behind" in notes
        assert left != ("forces" in EXPORTERS[to].holds)


@pytest.mark.parametrize("made", [two_sided])
@pytest.mark.parametrize("to", EXPORTERS)
def test_a_two_sided_body_passes_with_both_matrices_or_is_refused(path, tmp_path, to):
    try:
        paths = export_body(path, to).paths
    except InputError as error:
        assert re.search("two-sided|not symmetric", str(error)) and contents(tmp_path).keys() == {"x.h5"}
    else:
        # These hold C beside B, or equations that were made with both.
        assert to in ("op4", "matrix-market", "statespace", "modelica") and all(path.exists() for path in paths)


@pytest.mark.parametrize("made", [with_structural_damping])
@pytest.mark.parametrize("to", EXPORTERS)
def test_structural_damping_is_refused_or_told_of(path, tmp_path, to):
    try:
        told = "\n".join(export_body(path, to).notes)
    except InputError as error:
        told = str(error)
        assert contents(tmp_path).keys() == {"x.h5"}
    assert "structural damping of 0.02 holds in the frequency domain only" in told
