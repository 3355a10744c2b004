"""The folder beside a report of many parts: pages of parts that are gone, and writes that fail half-way."""

from __future__ import annotations

import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.pages.page import check_report, write_report
from morembs.app.pages.parts import Entry
from morembs.base.errors import OutputError
from morembs.storage.safefile import looked_at
from tests.support import decks
from tests.support.processes import apart, morembs
from tests.support.refusals import refusal

RUNNER = CliRunner()
MANY = 3  # more than a page shall hold


@pytest.fixture(scope="module")
def body(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("body")
    decks.folder(folder, {}, decks.deck(decks.BEAM[:12]))
    done = RUNNER.invoke(cli.app, ["reduce", str(folder / "job.toml"), "-q"])
    assert done.exit_code == 0, done.stderr
    return folder / "part.h5"


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user of the machine can reach."""
    folder = Path(tempfile.mkdtemp(dir="/tmp"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def report(path: Path, names: Sequence[str], body: Path | None = None) -> None:
    """A report of parts; without a ``body`` all of them failed."""
    output, state = ("", "failed") if body is None else (str(body), "done")
    entries = [Entry(name=name, job="/j.toml", output=output, state=state, message="no mesh") for name in names]
    write_report(path, entries, "night", sections=MANY - 1)


def parts(count: int) -> list[str]:
    return [f"part {number}" for number in range(count)]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def page_of(folder: Path, name: str) -> Path:
    (page,) = (page for page in folder.glob("part-*.html") if f"<h1>{name}</h1>" in page.read_text())
    return page


def test_pages_of_parts_that_are_gone_are_removed_and_nothing_of_anybody_else(body: Path, tmp_path: Path) -> None:
    path, folder = tmp_path / "night.html", tmp_path / "night_files"
    report(path, parts(MANY + 3), body)
    gone, edited = page_of(folder, f"part {MANY}"), page_of(folder, f"part {MANY + 1}")
    edited.write_text(edited.read_text().replace("</main>", "<p>my remark</main>"))
    # Of an earlier version, with its mark; of the user, of another report, and a link.
    view = "<!DOCTYPE html>\nof a viewer\n"
    marked = f"<!-- {64 * 'a'} {hashlib.sha256(view.encode()).hexdigest()} -->\n"
    (folder / f"view-{16 * 'a'}.html").write_text(view + marked)
    own = {"notes.txt", f"part-{16 * 'b'}.html", f"part-{16 * 'c'}.png", f"view-{16 * 'b'}.html", "part-1.html"}
    for name in own:
        (folder / name).write_text("mine")
    report(tmp_path / "night.htm", ["another", *parts(MANY)], body)
    other = page_of(folder, "another")
    (folder / f"part-{16 * 'd'}.html").symlink_to(gone.rename(tmp_path / "kept.html"))
    shutil.copy(tmp_path / "kept.html", gone)
    assert gone.with_suffix(".png").is_file()

    report(path, parts(MANY), body)
    stay = own | {f"part-{16 * 'd'}.html"}
    stay |= {page.with_suffix(end).name for page in (edited, other) for end in (".html", ".png")}
    used = {page_of(folder, name).stem for name in parts(MANY)}
    found = contents(folder)
    assert set(found) == stay | {f"{stem}{end}" for stem in used for end in (".html", ".png")}
    assert b"my remark" in found[edited.name] and all(found[name] == b"mine" for name in own)

    # Of few parts a report has no pages there, and a part that fails now no picture.
    report(path, parts(MANY))
    assert not any(page_of(folder, name).with_suffix(".png").exists() for name in parts(MANY))
    report(path, parts(MANY - 1), body)
    assert set(contents(folder)) == stay


@pytest.mark.parametrize(("there", "given"), [("night.html", "night.htm"), ("night.htm", "night.html")])
def test_two_reports_that_would_share_their_pages_are_refused(tmp_path: Path, there: str, given: str) -> None:
    report(tmp_path / there, parts(MANY))
    whole = contents(tmp_path / "night_files")
    with refusal("conflict", "report", given, there):
        check_report(tmp_path / given)
    check_report(tmp_path / there)
    assert contents(tmp_path / "night_files") == whole


def test_what_a_link_in_the_folder_leads_to_is_not_replaced(body: Path, tmp_path: Path) -> None:
    path, folder = tmp_path / "night.html", tmp_path / "night_files"
    report(path, parts(MANY), body)
    whole = contents(folder)
    for name in whole:
        (tmp_path / name).write_text("mine")
        (folder / name).unlink()
        (folder / name).symlink_to(tmp_path / name)
    report(path, parts(MANY), body)
    assert contents(folder) == whole and not any(each.is_symlink() for each in folder.iterdir())
    assert {(tmp_path / name).read_text() for name in whole} == {"mine"}


def test_a_folder_that_is_a_link_keeps_the_pages_of_the_other_report(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir(), (tmp_path / "new").mkdir()
    report(tmp_path / "old/night.html", parts(MANY))
    whole = contents(tmp_path / "old/night_files")
    (tmp_path / "new/night_files").symlink_to(tmp_path / "old/night_files")
    report(tmp_path / "new/night.html", [f"late {name}" for name in parts(MANY)])
    assert contents(tmp_path / "old/night_files").items() > whole.items()


@pytest.mark.parametrize("icon", ["A=A", "QUJD"])
def test_a_picture_that_is_not_the_icon_of_its_page_stays(tmp_path: Path, icon: str) -> None:
    path, page = tmp_path / "night.html", tmp_path / f"night_files/part-{16 * 'e'}.html"
    report(path, parts(MANY))
    text = f'<link rel="icon" href="data:image/png;base64,{icon}">'
    sums = [hashlib.sha256(each.encode()).hexdigest() for each in (path.name, text)]
    page.write_text(f"{text}<!-- {sums[0]} {sums[1]} -->\n")
    page.with_suffix(".png").write_text("mine")
    report(path, parts(MANY))
    assert not page.exists() and page.with_suffix(".png").read_text() == "mine"


@pytest.mark.parametrize("at", [0, 2, MANY])
def test_a_run_that_is_killed_leaves_whole_pages_and_the_next_one_the_same_as_ever(tmp_path: Path, at: int) -> None:
    """The last time is that of the report itself."""
    path, folder, late = tmp_path / "night.html", tmp_path / "night_files", [f"late {name}" for name in parts(MANY)]
    report(path, parts(MANY))
    old = path.read_bytes(), contents(folder)
    left = [at]

    def kill(places: object) -> None:
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1

    def work() -> None:
        with looked_at(kill):
            report(path, late)

    assert apart(work, tmp_path).code == -signal.SIGKILL
    assert path.read_bytes() == old[0] and all((folder / name).read_bytes() == old[1][name] for name in old[1])
    assert len(list(folder.glob("*.html"))) == MANY + at
    report(path, late)
    again = path.read_bytes(), contents(folder)
    shutil.rmtree(folder)
    path.unlink(), path.with_suffix(".json").unlink()
    report(path, late)
    assert (path.read_bytes(), contents(folder)) == again
    assert sorted(each.name for each in tmp_path.iterdir()) == ["night.html", "night.json", "night_files"]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_full_disk_is_one_message_and_loses_nothing(tmp_path: Path, share: float) -> None:
    path, folder = tmp_path / "night.html", tmp_path / "night_files"
    report(path, parts(MANY))
    old = path.read_bytes(), path.with_suffix(".json").read_bytes(), contents(folder)
    limit = int(share * min(len(text) for text in old[2].values()))

    def work() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        free = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, free[1]))
        try:
            report(path, [f"late {name}" for name in parts(MANY)])
        except OutputError as error:
            # What is printed goes to a file too.
            resource.setrlimit(resource.RLIMIT_FSIZE, free)
            sys.stdout.write(str(error))

    ended = apart(work, tmp_path)
    assert ended.code == 0 and not ended.errors and len(ended.output.splitlines()) == 1
    assert "night_files/part-" in ended.output and "File too large" in ended.output
    assert (path.read_bytes(), path.with_suffix(".json").read_bytes(), contents(folder)) == old


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="users are those of POSIX")
def test_a_folder_that_is_read_only_is_one_message(open_folder: Path) -> None:
    path, folder = open_folder / "night.html", open_folder / "night_files"
    report(path, parts(MANY))
    old = path.read_bytes(), contents(folder)
    (open_folder / "x.toml").write_text(decks.job({"model": 'mesh = "nothing.inp"\nunits = "m-kg-s"'}))
    open_folder.chmod(0o777), path.chmod(0o666)
    folder.chmod(0o555)

    def work() -> None:
        if os.geteuid() == 0:
            os.seteuid(65534)  # nobody
        try:
            report(path, parts(MANY + 1))
        except OutputError as error:
            sys.stdout.write(str(error))

    ended = apart(work, open_folder)
    assert ended.code == 0 and not ended.errors and len(ended.output.splitlines()) == 1
    assert str(folder) in ended.output and (path.read_bytes(), contents(folder)) == old


def test_a_page_of_the_viewer_that_cannot_be_written_is_one_message(body: Path, tmp_path: Path) -> None:
    """On a full disk the page of before stays, and the exit code says it."""
    page = tmp_path / "page.html"
    page.write_text("old")

    def work() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        done = RUNNER.invoke(cli.app, ["view", str(body), "-o", str(page), "--no-open"])
        sys.stdout.write(f"{done.exit_code} {done.stderr}")

    ended = apart(work, tmp_path)
    lines = [line for line in ended.output.splitlines() if line]
    assert len(lines) == 1 and lines[0].startswith("2 ") and "page.html" in lines[0], ended.output
    assert contents(tmp_path) == {"page.html": b"old"}
    assert morembs("view", body, "-o", page, "--no-open", folder=tmp_path).code == 0
    assert page.read_text().startswith("<!DOCTYPE html>")
