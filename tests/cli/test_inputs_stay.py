"""Results never take the place of files that they are made from, by whatever name; a batch sees where links lead."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import meshio
import pytest

from morembs.app.batches.manifest import Manifest
from morembs.app.batches.run import batch
from morembs.base.errors import OutputError, OverwriteError
from morembs.body.file import read_body
from morembs.importers import read_mesh
from morembs.storage.contents import Content, keeping_ledger, own_files
from morembs.storage.safefile import check_writable, copy_into, replacing, replacing_all
from tests.support import commands, decks
from tests.support.batches import remember
from tests.support.refusals import refusal

MATERIAL = ("--material", "young=210e3,poisson=0.3,density=7.85e-9")
XDMF = {
    "model": 'mesh = "part.xdmf"\nunits = "mm-t-s"',
    "interface": 'name = "left"\nnodes = "box:-1,-1,-1,1,99,99"',
    "interface2": 'name = "right"\nnodes = "box:59,-1,-1,61,99,99"',
}


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def run(*arguments: object, code: int = 0) -> str:
    """What a command says, on one line."""
    return commands.run(*arguments, code=code).replace("\n", " ")


def xdmf(folder: Path, output: str = "part.h5") -> Path:
    """A job on ``part.xdmf``, whose numbers are in ``part.h5`` beside."""
    job = decks.folder(folder, {**XDMF, "output": f'path = "{output}"', "solver": "threads = 1"})
    mesh = read_mesh(folder / "part.inp")
    meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)]).write(folder / "part.xdmf")
    (folder / "part.inp").unlink()
    return job


def included(folder: Path, output: str) -> Path:
    """A job on ``part.inp``, whose nodes are in ``nodes.h5``, which is text."""
    nodes, rest = decks.deck(decks.BEAM[:12]).split("*ELEMENT")
    (folder / "nodes.h5").write_text(nodes)
    return decks.folder(folder, {"output": output}, f"*INCLUDE, INPUT=nodes.h5\n*ELEMENT{rest}")


@pytest.mark.parametrize("verb", ["check", "reduce"])
def test_a_companion_of_the_mesh_stays(tmp_path: Path, verb: str) -> None:
    job = xdmf(tmp_path)
    before = files(tmp_path)
    assert "would overwrite a file that is read" in run(verb, job, "-q", code=2)
    assert files(tmp_path) == before


NAMES: dict[str, Callable[[Path], object]] = {
    "itself": lambda folder: None,
    "a link": lambda folder: (folder / "out.h5").symlink_to("nodes.h5"),
    "a link of a link": lambda folder: [
        (folder / "a.h5").symlink_to(folder / "nodes.h5"),
        (folder / "out.h5").symlink_to("a.h5"),
    ],
    "a second name": lambda folder: os.link(folder / "nodes.h5", folder / "out.h5"),
    "another case": lambda folder: os.link(folder / "nodes.h5", folder / "NODES.h5"),
    "a folder that is a link": lambda folder: (folder / "there").symlink_to(".", target_is_directory=True),
}
PLACES = {"itself": "nodes.h5", "another case": "NODES.h5", "a folder that is a link": "there/nodes.h5"}


@pytest.mark.parametrize("name", NAMES)
def test_an_include_stays_under_all_its_names(tmp_path: Path, name: str) -> None:
    """A name of another case is that of the same file on some disks; here a second name stands for it."""
    job = included(tmp_path, f'path = "{PLACES.get(name, "out.h5")}"')
    try:
        NAMES[name](tmp_path)
    except FileExistsError:
        assert name == "another case"  # this disk ignores it
    before = files(tmp_path)
    for verb in ("check", "reduce"):
        assert "would overwrite a file that is read" in run(verb, job, "-q", code=2)
    assert files(tmp_path) == before


def test_the_other_results_of_a_job_spare_its_include(tmp_path: Path) -> None:
    job = included(tmp_path, 'path = "part.h5"\npicture = "part.png"')
    (tmp_path / "part.png").symlink_to("nodes.h5")
    before = files(tmp_path)
    assert "part.png" in (said := run("reduce", job, "-q", code=2)) and "nodes.h5" in said
    report = tmp_path / "page.html"
    report.symlink_to("nodes.h5")
    other = ["--set", 'output.picture="other.png"']
    assert "nodes.h5" in run("reduce", job, "-q", "--report", report, *other, code=2)
    assert (tmp_path / "nodes.h5").read_bytes() == before["nodes.h5"] and not (tmp_path / "part.h5").exists()


def test_imports_and_tables_spare_what_they_read(tmp_path: Path) -> None:
    xdmf(tmp_path)
    before = files(tmp_path)
    assert "overwrite" in run("import", tmp_path / "part.xdmf", "-o", tmp_path / "part.h5", *MATERIAL, code=2)
    assert files(tmp_path) == before
    deck = included(tmp_path, 'path = "body.h5"').with_name("part.inp")
    before = files(tmp_path)
    assert "overwrite" in run("import", deck, "-o", tmp_path / "nodes.h5", *MATERIAL, code=2)
    table = tmp_path / "modes.csv"
    table.symlink_to("nodes.h5")
    assert "overwrite" in run("modes", tmp_path / "job.toml", "-o", table, code=2)
    table.unlink()
    assert files(tmp_path) == before


def test_the_first_job_of_a_mesh_spares_its_companion(tmp_path: Path) -> None:
    xdmf(tmp_path)
    before = files(tmp_path)
    run("init", tmp_path / "part.xdmf", "-o", tmp_path / "first.toml")
    assert 'path = "part-body.h5"' in (tmp_path / "first.toml").read_text()
    run("init", tmp_path / "part.xdmf", "-o", tmp_path / "first.toml", code=2)
    for _ in range(2):  # once more over the result, which is no input
        run("reduce", tmp_path / "first.toml", "-q", "--set", "reduce.method=modal")
    assert files(tmp_path).items() >= before.items()


@pytest.mark.usefixtures("forked_jobs")
def test_a_batch_spares_what_its_jobs_read_and_what_jobs_that_are_done_have_read(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    included(tmp_path / "a", 'path = "part.h5"').rename(tmp_path / "a" / "a.toml")
    other = decks.folder(tmp_path / "b", {"output": 'path = "../a/nodes.h5"'}, decks.deck(decks.BEAM[:8]))
    before = files(tmp_path / "a")["nodes.h5"]
    for _ in range(2):
        done = {record.name: record for record in batch([tmp_path / "a" / "a.toml", other], workers=1)}
        assert done["a"].state != "failed" and "nodes.h5 would overwrite" in done["job"].message
        assert files(tmp_path / "a")["nodes.h5"] == before
    assert done["a"].state == "unchanged"
    own = included(tmp_path / "a", 'path = "nodes.h5"')
    (record,) = batch([own], workers=1, fresh=True)
    assert "would overwrite" in record.message and files(tmp_path / "a")["nodes.h5"] == before


@pytest.mark.parametrize("turn", [1, -1])
def test_a_command_spares_what_its_later_jobs_read(tmp_path: Path, turn: int) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    reads = included(tmp_path / "a", 'path = "part.h5"')
    writes = decks.folder(tmp_path / "b", {"output": 'path = "../a/nodes.h5"'}, decks.deck(decks.BEAM[:8]))
    before = files(tmp_path)
    said = run("reduce", *[writes, reads][::turn], "-q", code=2)
    assert said.count("error: ") == 1 and "nodes.h5 would overwrite" in said
    assert (tmp_path / "a" / "part.h5").exists() and files(tmp_path).items() >= before.items()


def test_an_export_spares_the_files_that_come_later(tmp_path: Path) -> None:
    job = decks.folder(tmp_path, None, decks.deck(decks.BEAM[:8]))
    run("reduce", job, "-q")
    bodies = [tmp_path / "a.h5", tmp_path / "a.exudyn.hdf5"]
    for body in bodies:
        shutil.copy(tmp_path / "part.h5", body)
    run("export", *bodies, "--to", "exudyn", code=2)
    assert {body.read_bytes() for body in bodies} == {(tmp_path / "part.h5").read_bytes()}


@pytest.mark.usefixtures("forked_jobs")
def test_a_batch_sees_where_links_lead(tmp_path: Path) -> None:
    """The mesh, and a folder on the way to it."""
    for name, count in (("one", 8), ("two", 12)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mesh.inp").write_text(decks.deck(decks.BEAM[:count]))
    jobs = tmp_path / "jobs"
    jobs.mkdir()
    decks.folder(jobs, {"model": 'mesh = "../now/mesh.inp"\nunits = "mm-t-s"'})
    (jobs / "part.inp").unlink()
    masses = []
    for target in ("one", "two"):
        (tmp_path / "now").unlink(missing_ok=True)
        (tmp_path / "now").symlink_to(target, target_is_directory=True)
        assert [batch([jobs], workers=1)[0].state for _ in range(2)] == ["done", "unchanged"]
        body = read_body(jobs / "part.h5")
        masses.append(body.mass)
        origin = body.provenance["inputs"]
        assert [Path(name.decode()) for name in origin["file"]] == [jobs / ".." / "now" / "mesh.inp"]
        assert [Path(name.decode()) for name in origin["target"]] == [tmp_path / target / "mesh.inp"]
    assert masses[1] == pytest.approx(1.5 * masses[0])
    # A link that leads to the same bytes gives the same body.
    shutil.copy(tmp_path / "two" / "mesh.inp", tmp_path / "one" / "mesh.inp")
    (tmp_path / "now").unlink()
    (tmp_path / "now").symlink_to("one", target_is_directory=True)
    assert batch([jobs], workers=1)[0].state == "unchanged"


def test_a_file_of_the_same_size_and_times_is_another(tmp_path: Path) -> None:
    """Links to files that were made at once: a disk counts time in steps."""
    link = tmp_path / "link"
    for name in ("one", "two"):
        (tmp_path / name).write_text(name)
    link.symlink_to("one")
    content = Content.of(link)
    link.unlink()
    link.symlink_to("two")
    other = os.stat(tmp_path / "two")
    settled = Content(
        target=content.target,
        bytes=content.bytes,
        inode=content.inode,
        modified_ns=other.st_mtime_ns,
        changed_ns=other.st_ctime_ns,
        looked_ns=other.st_ctime_ns + 10**12,
        sha256=content.sha256,
    )
    assert not settled.still_in(link)


@pytest.mark.usefixtures("forked_jobs")
def test_a_manifest_of_an_older_version_is_read_and_its_jobs_are_due(tmp_path: Path) -> None:
    decks.folder(tmp_path, None, decks.deck(decks.BEAM[:8]))
    path = tmp_path / "batch.manifest"
    with Manifest(path) as manifest:
        remember(tmp_path, manifest)
    assert batch([tmp_path], check_only=True)[0].state == "unchanged"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    for event in lines:
        for part in ("inputs", "outputs"):
            for content in event.get(part, {}).values():
                del content["target"], content["inode"]
    path.write_text("".join(json.dumps(event) + "\n" for event in lines))
    assert batch([tmp_path], check_only=True)[0].state == "sound"


def test_what_was_read_is_not_replaced_even_if_nobody_said_so_before(tmp_path: Path) -> None:
    """At the rename; what a calculation wrote itself, or keeps of an earlier run, is no input."""
    given, own, new = (tmp_path / name for name in ("given", "own", "new"))
    for path in (given, own):
        path.write_text("old")
    with keeping_ledger():
        with refusal("output", "", given, by=OverwriteError), replacing(given) as file:
            file.write(b"x")
            given.read_text()
        with pytest.raises(OverwriteError), replacing(given) as file:
            file.write(b"x")
        with pytest.raises(OverwriteError), replacing_all([new, given]) as (file, _):
            file.write(b"x")
        assert given.read_text() == "old" and sorted(path.name for path in tmp_path.iterdir()) == ["given", "own"]
        with own_files():
            own.read_text()
        for _ in range(2):
            with replacing(own) as file:
                file.write(b"x")
            assert own.read_text() == "x"
        with pytest.raises(OverwriteError):
            copy_into(tmp_path, own, "given")
        check_writable(new)
        given.rename(new)
        with pytest.raises(OverwriteError):
            new.read_text()


@pytest.mark.parametrize("key", ["output.path", "output.picture", "model.mesh", "solver.scratch"])
def test_a_name_that_no_file_can_have_is_one_message(tmp_path: Path, key: str) -> None:
    job = decks.folder(tmp_path)
    assert r"'a\x00b" in run("reduce", job, "-q", "--set", rf'{key}="a\u0000b.h5"', code=2)


def test_names_with_a_nul_are_refused_wherever_files_are_written(tmp_path: Path) -> None:
    for write in (check_writable, lambda path: replacing(path).__enter__()):
        with refusal("output", "", r"a\x00b", by=OutputError):
            write(tmp_path / "a\0b")
    deck = tmp_path / "part.inp"
    deck.write_text("*INCLUDE, INPUT=a\0b.inp\n")
    run("import", deck, "-o", tmp_path / "m.h5", *MATERIAL, code=2)
