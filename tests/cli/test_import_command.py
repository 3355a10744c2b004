"""The verb ``import`` from every format to a model file, and jobs on model files."""

from __future__ import annotations

import gzip
import hashlib
import json
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs import CraigBampton, Damping, Problem, make_interface, read_body
from morembs.app.cli import app
from morembs.fem import FEModel
from morembs.importers import IMPORTERS, import_file
from morembs.importers.model_file import read_model, write_model
from tests.support import commands
from tests.support.decks import BEAM, deck, folder
from tests.support.meshes import box, steel

OLD = b"what was there before"
CONROD_HZ = [5931.72907, 10572.56166, 13006.48953, 14286.39617]
BLOCK_HZ = [451.333341, 452.009851, 607.870197, 1026.459420]


run = partial(commands.run, "import")


def refused(folder: Path, *arguments: object) -> str:
    """The one message of an import that must fail; the old file is kept and nothing is left behind."""
    out = folder / "out.model.h5"
    out.write_bytes(OLD)
    before = sorted(folder.iterdir())
    result = CliRunner().invoke(app, ["import", *map(str, arguments), "-o", str(out)])
    assert result.exit_code == 2 and isinstance(result.exception, SystemExit), (result.stdout, result.exception)
    assert result.stdout == "" and result.stderr.startswith("error: ") and result.stderr.count("error: ") == 1
    # Problems of a deck are lines of their own.
    more = result.stderr.strip().splitlines()[1:]
    assert all(line.startswith(("    ", "(", "cure of all problems: ", "CalculiX would")) for line in more)
    assert out.read_bytes() == OLD and sorted(folder.iterdir()) == before
    return result.stderr


def block() -> FEModel:
    return steel(box("hex8", (3, 2, 1), (0.2, 0.1, 0.08)))


def write_nodes(path: Path, model: FEModel, factor: float = 1.0) -> Path:
    """The mesh of ``model`` as a deck of CalculiX (*NODE FILE), whose C3D8 is ours."""
    places = zip(model.nodes.ids, (factor * model.nodes.xyz).tolist(), strict=True)
    nodes = [f"{i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in places]
    cells = model.mesh.blocks[0]
    rows = [f"{i}, " + ", ".join(map(str, model.nodes.ids[row])) for i, row in zip(cells.ids, cells.nodes, strict=True)]
    text = ["*NODE, NSET=ALL", *nodes, "*NODE FILE", "U", "*ELEMENT, TYPE=C3D8, ELSET=BODY", *rows, ""]
    path.write_text("\n".join(text))
    return path


def octave_group(group: h5py.Group, A: sp.csr_array) -> None:
    """A sparse matrix as Octave saves it with -hdf5."""
    C = sp.csc_array(A)
    value = group.create_group("value")
    for name, data in (("cidx", C.indptr), ("ridx", C.indices), ("data", C.data)):
        value[name] = data
    value["nr"], value["nc"], value["nz"] = C.shape[0], C.shape[1], C.nnz


def written(folder: Path, kind: str, model: FEModel | SimpleNamespace) -> list[object]:
    """Files of K and M of one kind, and the arguments that import them."""
    K, M = model.K, model.M
    path = folder / f"part.{kind}"
    if kind == "mtx":
        half = "symmetric" if np.abs(K - K.T).max() == 0 else "general"
        scipy.io.mmwrite(folder / "k.mtx", K, symmetry=half, precision=17)
        scipy.io.mmwrite(folder / "m.mtx", M, symmetry="general", precision=17)
        return ["--stiffness", folder / "k.mtx", "--mass", folder / "m.mtx"]
    if kind == "mat":
        scipy.io.savemat(path, {"stiff": sp.csc_matrix(K), "M": sp.csc_matrix(M), "other": np.eye(3)})
        return [path, "--set", "K=stiff"]
    if kind == "v73.mat":
        with h5py.File(path, "w") as file:
            for name, A in (("K", K), ("M", M)):
                C, group = sp.csc_array(A), file.create_group(name)
                group["data"], group["ir"] = C.data, C.indices.astype(np.uint64)
                group["jc"] = C.indptr.astype(np.uint64)
                group.attrs["MATLAB_sparse"] = C.shape[0]
        return [path]
    if kind == "octave.h5":
        with h5py.File(path, "w") as file:
            octave_group(file.create_group("K"), K)
            octave_group(file.create_group("M"), M)
        return [path]
    if kind == "h5":
        with h5py.File(path, "w") as file:
            for name, A in (("fe/stiffness", K), ("fe/mass", M)):
                group = file.create_group(name)
                for part in ("data", "indices", "indptr"):
                    group[part] = getattr(A, part)
                group["shape"] = A.shape
        return [path]
    if kind == "exudyn":
        with h5py.File(folder / "fem.hdf5", "w") as file:
            file["type"], file["fileVersion"], file["nodes/Position"] = "FEMinterface", 4, model.nodes.xyz
            for name, A in (("stiffnessMatrix", K), ("massMatrix", M)):
                group = file.create_group(name)
                group.attrs["datatype"] = "csr_matrix"
                for part in ("data", "indices", "indptr"):
                    group[part] = getattr(A, part)
                group["shape"] = A.shape
            file["nodeSets/item_0/Name"], file["nodeSets/item_0/NodeNumbers"] = "TIP", np.array([2, 1])
        return [folder / "fem.hdf5"]
    if kind == "save_npz":
        sp.save_npz(folder / "k.npz", sp.csr_matrix(K))
        sp.save_npz(folder / "m.npz", sp.csc_matrix(M))
        return ["--stiffness", folder / "k.npz", "--mass", folder / "m.npz"]
    parts = {f"{n}_{p}": getattr(A, p) for n, A in (("K", K), ("M", M)) for p in ("data", "indices", "indptr", "shape")}
    np.savez(folder / "part.npz", **parts)
    return [folder / "part.npz"]


@pytest.mark.parametrize("kind", ["mtx", "mat", "v73.mat", "octave.h5", "h5", "exudyn", "save_npz", "npz"])
def test_matrices_of_every_format_arrive_as_they_were(tmp_path: Path, kind: str) -> None:
    model, out = block(), tmp_path / "part.model.h5"
    arguments = written(tmp_path, kind, model)
    if kind != "exudyn":
        arguments += ["--nodes", write_nodes(tmp_path / "nodes.inp", model)]
    (document,) = json.loads(run(*arguments, "-o", out, "--check", "--json"))
    again = read_model(out)
    assert np.abs(again.K - model.K).max() <= 1e-15 * np.abs(model.K).max()
    assert np.abs(again.M - model.M).max() <= 1e-15 * np.abs(model.M).max()
    assert again.nodes.xyz == pytest.approx(model.nodes.xyz, rel=1e-15) and again.dofs.is_solid
    assert document["dofs"] == model.size and document["matrices"] == ["K", "M"]
    assert [finding for finding in document["findings"] if finding["severity"] != "note"] == []
    assert ("TIP" if kind == "exudyn" else "ALL") in document["sets"]
    if kind == "mat":
        assert any("other" in note for note in document["notes"]) and (again.mesh is not None)


@pytest.mark.parametrize("kind", ["mtx", "mat", "v73.mat", "octave.h5", "h5", "save_npz", "npz"])
def test_unsymmetric_matrices_are_not_turned_over(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(5)
    K, M = (sp.csr_array(sp.random_array((9, 9), density=0.4, rng=rng) + sp.eye_array(9)) for _ in range(2))
    given = SimpleNamespace(K=K, M=M)
    run(*written(tmp_path, kind, given), "-o", tmp_path / "a.model.h5")
    again = read_model(tmp_path / "a.model.h5")
    assert np.array_equal(again.K.toarray(), K.toarray()) and np.array_equal(again.M.toarray(), M.toarray())


def test_source_files_and_units_are_kept(tmp_path: Path) -> None:
    deck, out = write_nodes(tmp_path / "nodes.inp", block(), 1000.0), tmp_path / "a.model.h5"
    material = "young=210e3,poisson=0.3,density=7.85e-9"
    text = run(deck, "--format", "mesh", "--material", material, "--units", "mm-t-s", "-o", out, "--check")
    assert "read as mesh" in text and "nothing was found" in text
    with h5py.File(out) as file:
        assert file["source/files"][0] == b"nodes.inp" and file["source/units"][()] == b"mm-t-s"
        assert file["source/sha256"][0].decode() == hashlib.sha256(deck.read_bytes()).hexdigest()
    here, model = read_model(out), block()
    assert np.abs(here.K - model.K).max() <= 1e-11 * np.abs(model.K).max()
    assert here.M.sum() == pytest.approx(model.M.sum(), rel=1e-12)
    # Once more from the model file itself: nothing changes.
    run(out, "-o", tmp_path / "b.model.h5")
    assert (read_model(tmp_path / "b.model.h5").K != here.K).nnz == 0


def test_dof_map_brings_rows_of_any_order_home(tmp_path: Path) -> None:
    model, out = block(), tmp_path / "a.model.h5"
    order = np.random.default_rng(1).permutation(model.size)
    for name in ("K", "M"):
        sp.save_npz(tmp_path / f"{name}.npz", sp.csr_matrix(getattr(model, name)[order][:, order]))
    labels, words = model.nodes.ids[model.dofs.node[order]], np.array(["x", "Y", "3"])[model.dofs.component[order]]
    table = ["# of the other program", "dof;node"] + [f"{w};{i}" for i, w in zip(labels, words, strict=True)]
    (tmp_path / "map.csv").write_text("\n".join(table))
    matrices = ["--stiffness", tmp_path / "K.npz", "--mass", tmp_path / "M.npz"]
    nodes = ["--nodes", write_nodes(tmp_path / "nodes.inp", model)]
    run(*matrices, *nodes, "--dofs", tmp_path / "map.csv", "-o", out, "--strict")
    with Problem(read_model(out)) as a, Problem(model) as b:
        f, g = (problem.elastic_modes(count=4).frequencies_hz for problem in (a, b))
        assert f == pytest.approx(g, rel=1e-9)
        assert a.mass_properties[2] == pytest.approx(b.mass_properties[2], rel=1e-9)
    # Without the map the examination sees that rigid motion would strain the body.
    message = refused(tmp_path, *matrices, *nodes, "--strict")
    assert "stiffness matrix" in message or "dofs" in message
    for text, words in (
        ("node,dof\n1,x\n", "expected one for each"),
        ("node,dof\n1,w\n", "line 2"),
        ("node,dof\n1,x\n1,1\n", "twice"),
        ("", "empty"),
        ("node,dof\n99999,x\n", "node 99999"),
    ):
        (tmp_path / "map.csv").write_text(text)
        assert words in refused(tmp_path, *matrices, *nodes, "--dofs", tmp_path / "map.csv")
    assert "cannot be read" in refused(tmp_path, *matrices, *nodes, "--dofs", tmp_path / "none.csv")


def job_on(folder: Path, model: str, output: str, material: str, extra: str = "") -> Path:
    path = folder / f"{output}.toml"
    path.write_text(
        f'[model]\n{model}\nunits = "mm-t-s"\n{material}\n[[interface]]\nname = "a"\n'
        f'nodes = "box:-1,-1,-1,1,200,200"\npoint = [0, 20, 30]\n'
        f'[[interface]]\nname = "b"\nnodes = "box:199,-1,-1,201,200,200"\ncoupling = "average"\n{extra}\n'
        f'[[reduce]]\nmethod = "craig-bampton"\nmodes = 4\n[frame]\nkind = "tangent"\ninterfaces = ["a"]\n'
        f'[stress]\n[output]\npath = "{output}.h5"\n'
    )
    return path


def test_a_job_on_the_model_file_gives_the_body_of_the_job_on_the_mesh(tmp_path: Path) -> None:
    write_nodes(tmp_path / "part.inp", block(), 1000.0)
    steel_mm = "[[material]]\nyoung = 210e3\npoisson = 0.3\ndensity = 7.85e-9"
    run(
        tmp_path / "part.inp",
        "--format",
        "mesh",
        "--units",
        "mm-t-s",
        "-o",
        tmp_path / "part.model.h5",
        "--material",
        "young=210e3,poisson=0.3,density=7.85e-9",
    )
    jobs = [
        job_on(tmp_path, 'mesh = "part.inp"', "mesh", steel_mm),
        job_on(tmp_path, 'file = "part.model.h5"', "native", ""),
    ]
    for verb in ("check", "reduce"):
        result = CliRunner().invoke(app, [verb, *map(str, jobs)])
        assert result.exit_code == 0, result.stderr
    a, b = (read_body(tmp_path / f"{name}.h5").bodies["craig-bampton"] for name in ("mesh", "native"))
    assert a.has_recovery and b.has_recovery and a.floating is not None and b.floating is not None
    for name in ("mass_matrix", "stiffness_matrix", "input_matrix"):
        x, y = getattr(a, name), getattr(b, name)
        assert y == pytest.approx(x, rel=1e-12, abs=1e-12 * np.abs(x).max()), name
    assert b.frequencies_hz == pytest.approx(a.frequencies_hz, rel=1e-12, abs=1e-6)


def test_a_job_on_a_coupling_of_the_model_file(tmp_path: Path) -> None:
    """An Abaqus deck with a rigid body, from the file to the body."""
    model = block()
    deck = write_nodes(tmp_path / "part.inp", model)
    ends = [model.nodes.ids[np.isclose(model.nodes.xyz[:, 0], x)] for x in (0.0, 0.2)]
    more = [
        "*NODE",
        "900, 0.25, 0.05, 0.05",
        "*NSET, NSET=END",
        ", ".join(map(str, ends[1])),
        "*NSET, NSET=START",
        ", ".join(map(str, ends[0])),
        "*RIGID BODY, REF NODE=900, TIE NSET=END",
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        "2.1e11, 0.3",
        "*DENSITY",
        "7850.",
        "*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL",
        "*ELEMENT, TYPE=MASS, ELSET=P",
        "901, 900",
        "*MASS, ELSET=P",
        "2.0",
        "",
    ]
    deck.write_text(deck.read_text() + "\n".join(more))
    (document,) = json.loads(run(deck, "-o", tmp_path / "part.model.h5", "--json"))
    (name,) = document["couplings"]
    reduce = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 5\n[output]\npath = "part.h5"\n'
    start = '[[interface]]\nname = "start"\nnodes = "set:START"\n'
    job = tmp_path / "job.toml"
    job.write_text(
        f'[model]\nfile = "part.model.h5"\n[[interface]]\nname = "end"\nnodes = "coupling:{name}"\n{start}{reduce}'
    )
    for verb in ("check", "reduce"):
        result = CliRunner().invoke(app, [verb, str(job)])
        assert result.exit_code == 0, result.stderr
    body = read_body(tmp_path / "part.h5").bodies["craig-bampton"]
    first, last = (np.flatnonzero(np.isclose(model.nodes.xyz[:, 0], x)) for x in (0.0, 0.2))
    interfaces = [
        make_interface(model, name="end", nodes=last, point=[0.25, 0.05, 0.05]),
        make_interface(model, name="start", nodes=first),
    ]
    with Problem(model, interfaces) as problem:
        # The mass sits in the frame of the end: add it to the reduced model.
        assert problem.mass_properties[0] + 2.0 == pytest.approx(read_body(tmp_path / "part.h5").mass, rel=1e-12)
        same = CraigBampton(modes=5).reduce(problem)
    at_end = same.B[:, :3]
    heavy = same.M + 2.0 * at_end @ at_end.T
    for omega in 2 * np.pi * np.array([50.0, 4000.0]):
        B, A = body.input_matrix, body.stiffness_matrix - omega**2 * body.mass_matrix
        response = B.T @ np.linalg.solve(A, B)
        expected = same.B.T @ np.linalg.solve(same.K - omega**2 * heavy, same.B)
        assert response == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())
    interface = read_body(tmp_path / "part.h5").interfaces["end"]
    assert interface.point == pytest.approx([0.25, 0.05, 0.05])
    for change, words in (
        (f'nodes = "coupling:{name}x"', "has no coupling"),
        (f'nodes = "coupling:{name}"\ncoupling = "average"', "leave the key out"),
        ('nodes = "set:END"', "follows the element"),
    ):
        job.write_text(f'[model]\nfile = "part.model.h5"\n[[interface]]\nname = "end"\n{change}\n{start}{reduce}')
        result = CliRunner().invoke(app, ["reduce", str(job)])
        assert result.exit_code == 2 and words in result.stderr and len(result.stderr.strip().splitlines()) == 1


def test_a_dry_run_overwrites_nothing_whatever_its_name(tmp_path, monkeypatch):
    """Nor is it refused for the name that it would have; matrices have no elements."""
    model = block()
    write_model(tmp_path / "dry.model.h5", replace(model, mesh=None, materials=()))
    before = (tmp_path / "dry.model.h5").read_bytes()
    monkeypatch.chdir(tmp_path)
    (told,) = json.loads(run("dry.model.h5", "--dry-run", "--json"))
    assert (told["importable"], told["elements"], told["dofs"]) == (True, 0, model.size)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ('mesh = "a.inp"\nfile = "a.model.h5"', "choose one"),
        ("", "mesh is missing"),
        ('file = "none.model.h5"', "does not exist"),
        ('file = "old.h5"', "not an HDF5 file"),
        ('file = "ready.h5"\nmass_integration = "exact"', "mass_integration was given for a model file"),
        ('file = "ready.h5"\nmass_integration = "element"', "mass_integration was given for a model file"),
    ],
)
def test_bad_model_tables(tmp_path: Path, model: str, words: str) -> None:
    (tmp_path / "old.h5").write_bytes(OLD)
    write_model(tmp_path / "ready.h5", steel(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0))))
    job = tmp_path / "job.toml"
    for verb in ("check", "reduce"):
        job.write_text(f'[model]\n{model}\n[[reduce]]\nmethod = "modal"\nmodes = 1\n[output]\npath = "part.h5"\n')
        result = CliRunner().invoke(app, [verb, str(job)])
        assert result.exit_code == 2 and words in result.stderr and len(result.stderr.strip().splitlines()) == 1


def test_material_beside_a_model_file(tmp_path: Path) -> None:
    write_model(tmp_path / "ready.h5", steel(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0))))
    job = folder(tmp_path, {"model": 'file = "ready.h5"'})
    for verb in ("check", "reduce"):
        result = CliRunner().invoke(app, [verb, str(job)])
        assert result.exit_code == 2 and "[[material]] was given for a model file" in result.stderr


@pytest.mark.parametrize(
    ("name", "content", "arguments", "words"),
    [
        ("k.mtx", b"%%MatrixMarket matrix coordinate real general\n3 3 2\n1 1 1.0\n", [], "cannot be read"),
        ("k.mtx", b"%%MatrixMarket matrix coordinate real general\n3 3 1\n1 9 1.0\n", [], "row or column 9"),
        ("k.mtx", b"%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1\n", [], "pattern"),
        ("k.mtx", b"%%MatrixMarket matrix coordinate real general\n2 3 1\n1 1 1.0\n", [], "square"),
        ("k.mtx", b"%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 nan\n", [], "finite"),
        ("k.mtx", b"%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 2\n", [], "no M"),
        ("k.mat", b"not a mat file at all, but long enough to be read as one " * 9, [], "cannot be read as a MATLAB"),
        ("k.npz", b"PK\x03\x04 broken", [], "cannot be read as a NumPy"),
        ("k.h5", b"\x89HDF\r\n\x1a\n broken", [], "cannot be read"),
        ("k.model.h5", b"text", [], "cannot be read"),
        ("k.xyz", b"text", [], "give --format"),
        ("k.msh", b"rubbish", [], "cannot be read as a mesh"),
        ("k.mat", b"", ["--format", "mtlab"], "did you mean 'matlab'?"),
        ("k.mat", b"", ["--set", "K"], "--set K=VALUE"),
        ("k.mat", b"", ["--set", "Q=1"], "has no option 'Q'"),
        ("k.mat", b"", ["--units", "mm-t"], "length-mass-time"),
        ("k.mat", b"", ["--material", "young=1"], "--material"),
        ("k.mat", b"", ["k2.mat"], "2 files were given"),
        ("k.mat", b"", ["--stiffness", "k.mat"], "give one file"),
    ],
)
def test_bad_files_and_options(tmp_path: Path, name: str, content: bytes, arguments: list[str], words: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert words in refused(tmp_path, tmp_path / name, *arguments)


TWICE = "1 1 2\n2 1 -1\n2 2 2\n"
LABELLED = "7,1,7,1,2\n9,1,7,1,-1\n9,1,9,1,2\n"
CARDS = "DMIG,K,0,6,2,0\nDMIG,K,7,1,,7,1,2.\nDMIG,K,7,1,,7,1,2.\n"
LOWER = b"%%MatrixMarket matrix coordinate real symmetric\n2 2 6\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("k.mtx", LOWER + 2 * TWICE.encode(), "3 entries twice, with the same value: the first in row 1, column 1"),
        (
            "k.mtx",
            LOWER.replace(b"symmetric", b"general").replace(b"6", b"4") + TWICE.encode() + b"2 1 -3\n",
            "1 entry twice: the first in row 2, column 1 (-1 and -3)",
        ),
        (
            "k.mtx",
            LOWER.replace(b"6", b"4").replace(b"real", b"complex") + b"1 1 2 1\n2 1 -1 1\n2 2 2 1\n2 2 2 1\n",
            "1 entry twice, with the same value: the first in row 2, column 2",
        ),
        ("k_STIF1.mtx", 2 * TWICE.encode(), "3 entries twice, with the same value: the first in row 1, column 1"),
        ("k_STIF1.mtx", 2 * LABELLED.encode(), "the first in the row of node 7, dof 1, the column of node 7, dof 1"),
        ("k.pch", CARDS.encode(), "the first in the row of grid 7, component 1, the column of grid 7, component 1"),
    ],
)
def test_entries_that_a_text_gives_twice_are_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    """The sum would be a part of twice the stiffness, whose frequencies are too high by 41 %."""
    (tmp_path / name).write_bytes(content)
    format = ["--format", "abaqus-matrix"] if "STIF" in name else []
    assert words in refused(tmp_path, tmp_path / name, *format)


def test_entries_that_calculix_gives_twice_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.dof").write_text("7.1\n9.1\n")
    upper = "1 1 2.0\n1 2 -1.0\n2 2 2.0\n"
    for end, text in (("sti", 2 * upper), ("mas", upper)):
        (tmp_path / f"a.{end}").write_text(text)
    assert "3 entries twice, with the same value" in refused(tmp_path, tmp_path / "a.sti")


@pytest.mark.parametrize("kind", ["csr", "csc", "named", "h5", "v4.mat"])
def test_stored_matrices_with_a_place_given_twice_are_refused(tmp_path: Path, kind: str) -> None:
    data, indices, indptr = np.array([2.0, -1.0, 5.0, 1.0, 2.0]), np.array([0, 1, 0, 0, 1]), np.array([0, 2, 5])
    path = tmp_path / f"a.{ {'h5': 'h5', 'v4.mat': 'mat'}.get(kind, 'npz') }"
    if kind == "h5":
        with h5py.File(path, "w") as file:
            for name, value in (("data", data), ("indices", indices), ("indptr", indptr)):
                file[f"K/{name}"] = value
    elif kind == "named":
        np.savez(path, K_data=data, K_indices=indices, K_indptr=indptr, K_shape=(2, 2))
    elif kind == "v4.mat":
        row = np.repeat([0, 1], np.diff(indptr))
        scipy.io.savemat(path, {"K": sp.coo_matrix((data, (row, indices)), (2, 2))}, format="4")
    else:
        np.savez(path, format=kind.encode(), shape=(2, 2), data=data, indices=indices, indptr=indptr)
    places = "row 1, column 2" if kind == "csc" else "row 2, column 1"
    assert f"1 entry twice: the first in {places} (5 and 1)" in refused(tmp_path, path)


def test_triplets_are_added_unless_all_come_twice(tmp_path: Path) -> None:
    """SciPy means the sum; but no assembly of elements gives every entry twice with the same value."""
    row, column, value = np.array([0, 1, 1, 1]), np.array([0, 0, 1, 1]), np.array([2.0, -1.0, 1.0, 1.0])
    once = sp.coo_array((value, (row, column)), (2, 2))
    sp.save_npz(tmp_path / "a.npz", once)
    imported = import_file(tmp_path / "a.npz")
    assert imported.K is not None and np.array_equal(imported.K.toarray(), [[2, 0], [-1, 2]])
    assert "1 triplets at places of others were added" in imported.notes[0]
    once = sp.coo_array((value[:3], (row[:3], column[:3])), (2, 2))
    both = sp.coo_array(tuple((np.tile(once.data, 2), (np.tile(once.row, 2), np.tile(once.col, 2)))), (2, 2))
    sp.save_npz(tmp_path / "a.npz", both)
    assert "gives every entry 2 times with the same value" in refused(tmp_path, tmp_path / "a.npz")


def test_more_ways_to_be_wrong(tmp_path: Path) -> None:
    assert "does not exist" in refused(tmp_path, tmp_path / "none.mat")
    assert "is not a file" in refused(tmp_path, tmp_path)
    assert "give one file" in refused(tmp_path)
    scipy.io.savemat(tmp_path / "a.mat", {"A": np.eye(3), "B": np.eye(3)})
    assert "say which" in refused(tmp_path, tmp_path / "a.mat")
    assert "no matrix 'C'" in refused(tmp_path, tmp_path / "a.mat", "--set", "K=C")
    model = block()
    deck = write_nodes(tmp_path / "nodes.inp", model)
    assert "no materials" in refused(tmp_path, deck, "--format", "mesh")
    steel_text = ["--material", "young=1,poisson=0.3,density=1"]
    assert "belongs to matrices" in refused(tmp_path, deck, "--format", "mesh", *steel_text, "--dofs", deck)
    assert "poisson" in refused(tmp_path, deck, "--format", "mesh", "--material", "young=1,poisson=0.6,density=1")
    eyes = ["--stiffness", tmp_path / "k.npz", "--mass", tmp_path / "m.npz"]
    sp.save_npz(tmp_path / "k.npz", sp.csr_matrix(model.K))
    sp.save_npz(tmp_path / "m.npz", sp.csr_matrix(model.M[:9, :9]))
    assert "shape" in refused(tmp_path, *eyes, "--nodes", deck)
    sp.save_npz(tmp_path / "m.npz", sp.csr_matrix(model.M))
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["K"] = np.eye(3)
    same = CliRunner().invoke(app, ["import", str(tmp_path / "m.h5"), "-o", str(tmp_path / "m.h5")])
    assert "would overwrite" in same.stderr and h5py.is_hdf5(tmp_path / "m.h5")
    assert "ends in .h5" in CliRunner().invoke(app, ["import", str(deck), "-o", "x.inp"]).stderr
    assert "-o nodes.model.h5" in CliRunner().invoke(app, ["import", str(deck)]).stderr
    assert "does not exist" in CliRunner().invoke(app, ["import", str(deck), "-o", "/nowhere/x.h5"]).stderr


def test_check_finds_but_writes_and_strict_does_not(tmp_path: Path) -> None:
    model = block()
    K = model.K.tolil()
    K[0, 5] += 1e9
    sp.save_npz(tmp_path / "k.npz", sp.csr_matrix(K))
    sp.save_npz(tmp_path / "m.npz", sp.csr_matrix(model.M))
    files = ["--stiffness", tmp_path / "k.npz", "--mass", tmp_path / "m.npz", "--nodes"]
    files.append(write_nodes(tmp_path / "nodes.inp", model))
    assert "not symmetric" in refused(tmp_path, *files, "--strict")
    assert "error: the stiffness matrix K is not symmetric" in run(*files, "-o", tmp_path / "a.model.h5", "--check")
    with h5py.File(tmp_path / "a.model.h5") as file:
        assert b"not symmetric" in b" ".join(file["source/findings"][()])
    job = tmp_path / "job.toml"
    job.write_text(
        '[model]\nfile = "a.model.h5"\n[[reduce]]\nmethod = "modal"\nmodes = 2\n[output]\npath = "part.h5"\n'
    )
    for verb in ("check", "reduce"):
        result = CliRunner().invoke(app, [verb, str(job)])
        assert result.exit_code == 2 and "not symmetric" in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1
    # A half-stored matrix is completed, and that is said.
    sp.save_npz(tmp_path / "k.npz", sp.csr_matrix(sp.triu(model.K)))
    assert "completed" in run(*files, "-o", tmp_path / "b.model.h5")
    assert np.abs(read_model(tmp_path / "b.model.h5").K - model.K).max() <= 1e-9


def test_list_names_every_format() -> None:
    lines = run("--list").strip().splitlines()
    named = [line.split(":")[0] for line in lines]
    assert [name for name in named if not name.startswith("--engine")] == list(IMPORTERS)
    assert {entry["name"] for entry in json.loads(run("--list", "--json"))} >= set(IMPORTERS)


# Models from elsewhere.


def test_four_masses_reduced_as_published(tmp_path: Path, shared_data: Path) -> None:
    case = json.loads((shared_data / "craig_bampton_4dof" / "case.json").read_text())
    np.savez(tmp_path / "case.npz", K=np.array(case["K"], dtype=float), M=np.diag(case["M_diag"]).astype(float))
    assert "every dof became a node" in run(tmp_path / "case.npz", "-o", tmp_path / "case.model.h5")
    model = read_model(tmp_path / "case.model.h5")
    end = make_interface(model, name="end", nodes=[case["retained_dof_1based"][0] - 1], coupling="direct")
    for modes, damping, key in ((3, None, "n3"), (1, Damping(modal=0.8), "n1_damped_c0.8")):
        with Problem(model, [end], damping=damping) as problem:
            reduced = CraigBampton(modes=modes).reduce(problem)
        M = np.array(case[key]["Mred"])
        values, _ = sl.eigh(reduced.K, reduced.M)
        K = np.diag(case[key].get("Kred_diag", np.diag(case[key].get("Kred", [0]))))
        # The basis is another one of the same space: what does not depend on it is compared.
        assert values == pytest.approx(sl.eigh(K, M, eigvals_only=True), rel=1e-5)
        pencils = ((reduced.K + reduced.M, reduced.B), (K + M, np.eye(len(M))[:, :1]))
        flexibility = [B.T @ np.linalg.solve(A, B) for A, B in pencils]
        assert flexibility[0] == pytest.approx(flexibility[1], rel=1e-5)


def test_second_order_models_of_a_collection(tmp_path: Path, shared_data: Path) -> None:
    there = shared_data / "nlevp_second_order"
    out = tmp_path / "a.model.h5"
    run(there / "shaft.mat", "-o", out)
    shaft = read_model(out)
    flexible = sl.eigh(shaft.M.toarray(), shaft.K.toarray(), eigvals_only=True)
    assert np.sqrt(1 / flexible[::-1][:4]) == pytest.approx([56.29270, 355.41134, 1000.52587, 1968.59959], rel=1e-7)
    assert shaft.D is not None and np.linalg.matrix_rank(shaft.D.toarray()) == 1
    beams = []
    for name in ("Ke", "Kv"):
        run(there / "sandwich_beam_3360.mat", "--set", f"K={name}", "-o", out)
        beams.append(read_model(out))
    K, M = sp.csc_array(beams[0].K + 350.4e3 * beams[1].K), sp.csc_array(beams[0].M)
    values = sp.linalg.eigsh(K, 4, M, sigma=0, return_eigenvectors=False)
    expected = [20.07106, 96.55243, 234.70213, 423.06882]
    assert np.sort(np.sqrt(values)) / 2 / np.pi == pytest.approx(expected, rel=3e-5)
    given = scipy.io.loadmat(there / "sandwich_beam_3360.mat")
    assert all((sp.csr_array(given[name]) != beam.K).nnz == 0 for beam, name in zip(beams, ("Ke", "Kv"), strict=True))
    run(there / "foundation.mat", "-o", out)
    kept = read_model(out)
    given = scipy.io.loadmat(there / "foundation.mat")
    assert kept.K.dtype == complex and (sp.csr_array(given["K"]) != kept.K).nnz == 0
    run(there / "cd_player.mat", "--set", "M=identity", "-o", out)
    assert (sp.eye_array(60) != read_model(out).M).nnz == 0


def test_matrices_of_calculix_on_the_mesh_by_labels(tmp_path: Path, shared_data: Path) -> None:
    there = shared_data / "conrod_abaqus"
    for end in (".sti", ".mas"):
        (tmp_path / f"rod{end}").write_bytes(gzip.decompress((there / f"conrod_ccx{end}.gz").read_bytes()))
    (tmp_path / "rod.dof").write_bytes((there / "conrod_ccx.dof").read_bytes())
    message = refused(tmp_path, tmp_path / "rod.sti")
    assert "--nodes" in message
    nodes = there / "job_matrix_generate_conrod.inp"
    text = run(tmp_path / "rod.sti", "--nodes", nodes, "-o", tmp_path / "a.model.h5", "--check")
    assert "error:" not in text
    with Problem(read_model(tmp_path / "a.model.h5")) as problem:
        assert problem.mass_properties[0] == pytest.approx(0.1379211513593743, rel=1e-10)
        assert problem.elastic_modes(count=4).frequencies_hz == pytest.approx(CONROD_HZ, rel=1e-7)


def test_matrices_of_abaqus_without_labels(tmp_path: Path, shared_data: Path) -> None:
    there = shared_data / "abaqus_block"
    run(
        "--stiffness",
        there / "blockC3D10_STIF1.mtx",
        "--mass",
        there / "blockC3D10_MASS1.mtx",
        "--nodes",
        there / "blockC3D10.inp",
        "-o",
        tmp_path / "a.model.h5",
        "--strict",
    )
    with Problem(read_model(tmp_path / "a.model.h5")) as problem:
        assert problem.mass_properties[0] == pytest.approx(11600, rel=1e-6)
        assert problem.elastic_modes(count=4).frequencies_hz == pytest.approx(BLOCK_HZ, rel=1e-6)


def test_decks_and_meshes_of_others(tmp_path: Path, shared_data: Path) -> None:
    out = tmp_path / "a.model.h5"
    run(shared_data / "finetools" / "unit_cube_modes_h20.inp", "-o", out)
    with Problem(read_model(out)) as problem:
        assert problem.elastic_modes(count=1).frequencies_hz[0] == pytest.approx(0.26, abs=0.005)
    material = ["--material", "young=2.1e11,poisson=0.3,density=7850"]
    run(shared_data / "amfe_meshes" / "pleuel_7000.msh", *material, "-o", out)
    model = read_model(out)
    assert model.mesh is not None and len(model.mesh.blocks[0].ids) == 4123
    assert len(model.nodes) == 1251 and list(model.mesh.element_sets) == ["physical:361"]
    run(shared_data / "juliafem_med" / "JuliaFEMSMP18.med", *material, "-o", out)
    model = read_model(out)
    assert model.mesh is not None and model.mesh.blocks[0].type == "tet10" and model.nodes.sets
    blocks = shared_data / "finetools" / "twoblocks.nas"
    assert "PSOLID 2 names no material" in refused(tmp_path, blocks)
    both = [part for n in (1, 2) for part in ("--material", f"young={n},poisson=0.3,density=1,set=PSOLID_{n}")]
    (document,) = json.loads(run(blocks, *both, "-o", out, "--json"))
    assert document["nodes"] == 119 and [entry.set for entry in read_model(out).materials] == ["PSOLID_1", "PSOLID_2"]


def test_an_import_says_what_body_its_units_make(tmp_path: Path) -> None:
    """Coordinates in m, read as mm beside steel in MPa and t/mm3: everything is right but the size."""
    text = deck(BEAM, size=0.1)
    (tmp_path / "a.inp").write_text(text)
    given = ("--material", "young=210e3,poisson=0.3,density=7.85e-9", "-o", tmp_path / "a.model.h5")
    for unit, size in (("mm-t-s", "0.0006 x 0.0002 x 0.0002 m"), ("mm-t-s", "0.6 x 0.2 x 0.2 m")):
        (tmp_path / "a.inp").write_text(text if size.startswith("0.0006") else deck(BEAM, size=100.0))
        output = run(tmp_path / "a.inp", "--units", unit, *given)
        assert f"the body: {size}, " in output and " kg; a solid bar of this size vibrates from about " in output
        assert ("warning: taken in mm-t-s, the body is tiny" in output) == size.startswith("0.0006")
    (document,) = json.loads(run(tmp_path / "a.inp", "--units", "mm-t-s", *given, "--json"))
    assert document["body"]["extent"] == pytest.approx([0.6, 0.2, 0.2]) and document["warnings"] == []
    assert document["body"]["mass"] == pytest.approx(7850 * 0.6 * 0.2 * 0.2)


def test_the_answer_keeps_the_command_line_and_can_be_pasted(tmp_path, monkeypatch):
    """Names with blanks and quotes; the options that were given stay, and the answer runs as it is pasted."""
    monkeypatch.chdir(tmp_path)
    text = deck(BEAM).replace("TYPE=C3D8", "TYPE=C3D8, ELSET=EALL")
    law = "*SOLID SECTION, ELSET=EALL, MATERIAL=M\n*MATERIAL, NAME=M\n*ELASTIC\n210e3, .3\n*DENSITY\n7.85e-9\n"
    Path("my part's.inp").write_text(text + law + "*CONTACT PAIR\nA, B\n*FANCY THING\n*CONTACT PAIR\nA, B\n")
    given = ["import", "my part's.inp", "--units", "mm-t-s", "-o", "my part.model.h5", "--dialect", "calculix"]
    told = CliRunner().invoke(app, given)
    *problems, answer = told.stderr.splitlines()
    assert told.exit_code == 2 and answer.startswith("cure of all problems: morembs import")
    # Each problem with its line, one cure in a line at most, cards of one kind together.
    assert problems[0].startswith("error: my part's.inp has 3 problems: (1) 2 times (lines ")
    assert sum("*FANCY THING" in line for line in problems) == 1 and "line " in problems[-2]
    assert all(line.count("--") <= 1 for line in problems)
    words = shlex.split(answer.partition(": ")[2])
    assert words == ["morembs", *given, "--contact", "skip", "--skip", "FANCY THING"]
    assert CliRunner().invoke(app, words[1:]).exit_code == 0 and Path("my part.model.h5").is_file()


def test_a_dry_run_tells_all_and_writes_nothing(tmp_path):
    text = deck(BEAM) + "*CONTACT PAIR\nA, B\n*FANCY\n*SOLID SECTION, ELSET=EALL, MATERIAL=M\n*MATERIAL, NAME=M\n"
    path = tmp_path / "part.inp"
    path.write_text(text.replace("TYPE=C3D8", "TYPE=C3D8, ELSET=EALL") + "*ELASTIC\n210e3, .3\n")
    result = CliRunner().invoke(app, ["import", str(path), "--dry-run"])
    lines = [line for line in result.stdout.splitlines() if not line.startswith("    ")]
    assert result.exit_code == 2 and [line.split(":")[0] for line in lines[:3]] == ["problem"] * 3
    answer = f"morembs import {shlex.quote(str(path))} --dry-run --contact skip --skip FANCY --density X"
    assert lines[3] == f"cure of all problems: {answer}" and lines[4].endswith("cannot be imported: 3 problems")
    (told,) = json.loads(CliRunner().invoke(app, ["import", str(path), "--dry-run", "--json"]).stdout)
    assert (
        told["importable"] is False
        and told["command"] == answer.replace("--dry-run", "--dry-run --json")
        and len(told["problems"]) == 3
    )
    given = ["--contact", "skip", "--skip", "FANCY", "--density", "7.85e-9", "--units", "mm-t-s"]
    assert run(path, "--dry-run", *given).startswith("can be imported: 189 dofs at 63 nodes, read as abaqus; nothing")
    (told,) = json.loads(run(path, "--dry-run", *given, "--json"))
    assert (told["importable"], told["elements"], told["dofs"]) == (True, 24, 189)
    assert sorted(tmp_path.iterdir()) == [path]
    # A material that is given answers what is lacking.
    message = refused(tmp_path, path, "--material", "young=1e3,poisson=.3,density=1e-9,set=EALL")
    assert "2 problems" in message and "no *DENSITY" not in message
    (document,) = json.loads(run(path, *given, "--json", "-o", tmp_path / "part.model.h5"))
    model = read_model(document["written"])
    assert model.materials[0].density == pytest.approx(7850.0)
    codes = {warning.rsplit("[", 1)[-1] for warning in model.warnings}
    assert codes >= {"keywords-skipped]", "contact-skipped]", "density-given]"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--density", "-1"], "--density '-1' was given; expected X or X,set=NAME"),
        (["--density", "1", "--density", "2"], "a positive number once a set"),
        (["--density", "1,set=NO"], "--density was given for the set 'NO', which the deck does not have"),
        (["--contact", "melt"], "contact = 'melt' was given"),
    ],
)
def test_options_of_decks_that_make_no_sense(tmp_path, arguments, words):
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM))
    assert words in refused(tmp_path, path, "--material", "young=1e3,poisson=.3,density=1e-9", *arguments)


def test_options_of_decks_belong_to_decks(tmp_path):
    path = tmp_path / "k.mtx"
    path.write_text("%%MatrixMarket matrix array real general\n1 1\n1.0\n")
    message = refused(tmp_path, "--stiffness", path, "--mass", path, "--contact", "skip")
    assert "--contact skip was given without a deck that can take it" in message


def test_a_job_says_which_program_its_deck_is_for(tmp_path):
    text = deck(BEAM).replace("*NODE FILE\nU\n", "")
    written = []
    for dialect in ("abaqus", "calculix"):
        (tmp_path / dialect).mkdir()
        job = folder(tmp_path / dialect, {"model": f'mesh = "part.inp"\nunits = "mm-t-s"\ndialect = "{dialect}"'}, text)
        result = CliRunner().invoke(app, ["reduce", str(job)])
        assert result.exit_code == 0 and "dialect-guessed" not in result.stderr, result.stderr
        written.append(read_body(tmp_path / dialect / "part.h5").bodies["cb"].frequencies_hz)
    # B-bar and lumped masses against full integration.
    assert len(written[0]) == len(written[1]) and not np.allclose(*written, rtol=1e-3)
    job = folder(tmp_path, {"model": 'mesh = "a.msh"\ndialect = "abaqus"'})
    refusal = CliRunner().invoke(app, ["reduce", str(job)])
    assert refusal.exit_code == 2 and "without a deck .inp" in refusal.stderr


def test_help_groups_options_by_what_the_file_is() -> None:
    page = CliRunner().invoke(app, ["import", "--help"]).stdout
    heads = ["Options", "Files of matrices", "Decks", "Decks that another program assembles"]
    places = [page.index(f"─ {head} ─") for head in heads]
    assert places == sorted(places)
    of_matrices, of_decks, of_engines = (
        page[begin:end] for begin, end in zip(places[1:], [*places[2:], len(page)], strict=True)
    )
    assert "--stiffness" in of_matrices
    assert "--contact" in of_decks
    assert "--material" in of_decks
    assert "--keep-files" in of_engines
