"""Verbs on several files, first jobs, the schema of jobs, commands in threads, narrow terminals."""

from __future__ import annotations

import io
import json
import shutil
import sys
from pathlib import Path
from threading import Thread

import pytest
from rich.console import Console
from typer.testing import CliRunner

import morembs.app.cli
from morembs.app.cli import commands
from morembs.app.jobs.job import load_job
from morembs.app.report.text import plain_table, print_table
from tests.support import decks

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a deck, its model file, its job and its body."""
    folder = tmp_path_factory.mktemp("part")
    job = decks.folder(folder, {"check": "full_modes = 12"})
    assert RUNNER.invoke(commands.app, ["reduce", str(job), "-q"]).exit_code == 0
    model = [
        "import",
        str(folder / "part.inp"),
        "--units",
        "mm-t-s",
        "-o",
        str(folder / "part.model.h5"),
        "--material",
        "young=210e3,poisson=0.3,density=7.85e-9",
    ]
    assert RUNNER.invoke(commands.app, model).exit_code == 0
    return folder


def test_info_and_export_take_many_files(part: Path, tmp_path: Path) -> None:
    bodies = [str(shutil.copy(part / "part.h5", tmp_path / f"{name}.h5")) for name in "ab"]
    lost = str(tmp_path / "lost.h5")
    shown = RUNNER.invoke(commands.app, ["info", *bodies])
    assert shown.exit_code == 0 and all(shown.stdout.count(f"{body}: ") == 1 for body in bodies)
    result = RUNNER.invoke(commands.app, ["info", bodies[0], lost, bodies[1], "--json"])
    assert result.exit_code == 2 and result.stderr.startswith(f"error: {lost}: ")
    entries = json.loads(result.stdout)
    assert [entry.get("output", entry.get("file")) for entry in entries] == [bodies[0], lost, bodies[1]]
    done = RUNNER.invoke(commands.app, ["export", *bodies, "--to", "mbdyn", "--json"])
    assert done.exit_code == 0
    written = [path for export in json.loads(done.stdout) for path in export["written"]]
    assert len(set(written)) == len(written) >= 2 and all(Path(path).is_file() for path in written)
    refused = RUNNER.invoke(commands.app, ["export", *bodies, "--to", "mbdyn", "-o", lost])
    assert refused.exit_code == 2 and "was given for 2 files" in refused.stderr
    same = str(shutil.copy(bodies[0], tmp_path / "a.hdf5"))
    for other in (bodies[0], same):
        twice = RUNNER.invoke(commands.app, ["export", bodies[0], other, "--to", "mbdyn"])
        assert twice.exit_code == 2 and "a.fem was just written, from another file or the same" in twice.stderr
        assert twice.stdout.count("written: ") == 1


def test_every_list_is_a_list() -> None:
    for arguments in (["solvers"], ["export", "--list"], ["import", "--list"]):
        entries = json.loads(RUNNER.invoke(commands.app, [*arguments, "--json"]).stdout)
        assert all({"name"} < set(entry) for entry in entries) and len(entries) > 3


def test_compare_takes_many_jobs_and_a_picture_of_one(part: Path, tmp_path: Path) -> None:
    certify = {"certify": "band_hz = [0, 20000]\npoints = 4"}
    jobs = []
    for name in "ab":
        (tmp_path / name).mkdir()
        jobs.append(str(decks.folder(tmp_path / name, certify, decks.deck(decks.BEAM[:12]))))
    result = RUNNER.invoke(commands.app, ["compare", *jobs, "--json", "-q"])
    assert result.exit_code == 0, result.stderr
    assert [entry["job"] for entry in json.loads(result.stdout)] == jobs
    refused = RUNNER.invoke(commands.app, ["compare", *jobs, "-q", "--picture", str(tmp_path / "a.png")])
    assert refused.exit_code == 2 and "was given for 2 jobs" in refused.stderr


def test_info_says_what_a_model_file_is_for(part: Path) -> None:
    refused = RUNNER.invoke(commands.app, ["info", str(part / "part.model.h5")])
    assert refused.exit_code == 2
    assert "is a model file (189 dofs at 63 nodes)" in refused.stderr and "morembs init" in refused.stderr


@pytest.mark.parametrize("source", ["part.inp", "part.model.h5"])
def test_a_first_job_is_sound_and_reduces(part: Path, tmp_path: Path, source: str) -> None:
    file = shutil.copy(part / source, tmp_path / source)
    job = tmp_path / "part.toml"
    done = RUNNER.invoke(commands.app, ["init", str(file)])
    assert done.exit_code == 0 and f"written: {job}" in done.stdout
    text = job.read_text()
    # 60 mm long: whoever means metres sees what was guessed.
    assert source != "part.inp" or ('units = "mm-t-s"' in text and "guessed from its size" in text)
    loaded = load_job(job)
    assert [table.nodes for table in loaded.tables.interface] == ["set:LEFT", "set:RIGHT"]
    # A line of nodes is no rigid interface.
    assert "# There are too: set:LINE" in text
    if source == "part.inp":
        (steel,) = loaded.tables.material
        assert steel.young == pytest.approx(2.1e5) and steel.density == pytest.approx(7.85e-9)
    # The interfaces leave 135 of the 189 dofs, and a tenth of them makes sense as modes.
    assert "modes = 13 " in text
    assert RUNNER.invoke(commands.app, ["reduce", str(job), "-q"]).exit_code == 0
    again = RUNNER.invoke(commands.app, ["init", str(file)])
    assert again.exit_code == 2 and "is there already" in again.stderr
    # What stands in comments is a job too.
    whole = "\n".join(
        line.removeprefix("# ") if line.startswith("# [") or " = " in line else line
        for line in job.read_text().splitlines()
    )
    job.write_text(whole)
    tables = load_job(job).tables
    assert tables.certify is not None and tables.damping.modal == 0.01 and len(tables.reduce) == 2


def test_the_schema_of_jobs_knows_every_table() -> None:
    schema = json.loads(RUNNER.invoke(commands.app, ["schema"]).stdout)
    assert {"model", "reduce", "certify", "output"} < set(schema["properties"]) and "output" in schema["required"]
    assert not schema["additionalProperties"]
    assert "band_hz" in schema["$defs"]["CertifyTable"]["properties"]


def test_a_command_in_a_thread_leaves_the_signals_alone(
    part: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["morembs", "info", str(part / "part.h5")])
    ends: list[object] = []

    def work() -> None:
        try:
            morembs.app.cli.main()
        except SystemExit as end:
            ends.append(end.code)

    thread = Thread(target=work)
    thread.start()
    thread.join()
    assert ends == [0] and "elastic Hz" in capsys.readouterr().out


@pytest.mark.parametrize("width", [30, 80, 200])
def test_a_narrow_terminal_breaks_no_word(width: int) -> None:
    out = io.StringIO()
    table = plain_table("body", *(f"column number{k} <=" for k in range(9)))
    table.add_row("* a-name-that-is-long", *("1.2345e-03",) * 9)
    console = Console(file=out, width=width)
    print_table(console, "certificate", table)
    shown = out.getvalue()
    assert "…" not in shown and shown.count("1.2345e-03") == 9 and "* a-name-that-is-long" in shown
    assert all(f"number{k}" in shown for k in range(9)) and console.width == width
