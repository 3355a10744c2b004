"""Commands where Python lacks what only some systems have, and where files in use cannot be removed: simulated here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from morembs.body.file import read_body
from tests.support import decks

ROOT = Path(__file__).parents[1]
# Each command of the list of arguments in a process of its own would be start-up for the most part.
COMMANDS = """
import contextlib, sys
import morembs.app.cli
for arguments in {commands!r}:
    sys.argv = ["morembs", *arguments]
    with contextlib.suppress(SystemExit):
        morembs.app.cli.main()
        raise RuntimeError("a command does not end")
    print(arguments[0], "done", flush=True)
{more}
"""
# Arrays in files: one that is given up, one that is held beyond the end of the budget.
ARRAYS = """
from pathlib import Path
import numpy as np
from morembs.base.budget import Budget
scratch = Path("arrays")
budget = Budget(1, scratch, in_memory=0)
held, given_up = budget.empty(10_000), budget.empty(10_000)
held[:] = 1.0
assert budget.files == 2
del given_up
assert budget.files == 1
print("names", len(list(scratch.glob("*/array-*"))))
budget.close()
assert held.sum() == 10_000
print("left", len(list(scratch.glob("*/array-*"))))
"""
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="open and mapped files are looked up in /proc")


def run(system: str, folder: Path, code: str) -> str:
    """What ``code`` prints in a Python that looks like that of ``system``."""
    path = os.pathsep.join([str(ROOT / "tests" / "support" / "other_system"), str(ROOT)])
    environment = {**os.environ, "OTHER_SYSTEM": system, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.parametrize("system", ["windows", "macos"])
def test_commands_without_what_only_linux_has(tmp_path: Path, system: str) -> None:
    (tmp_path / "scratch").mkdir()
    solver = 'name = "mumps-embedded"\nout_of_core = true\nmemory = "4 GB"\nscratch = "scratch"'
    # A factor on disk compares with no frequencies unless it is asked to, and warns of it.
    tables = {"solver": solver, "check": "full_modes = 10"}
    job = decks.folder(tmp_path, tables, decks.deck(decks.BEAM))
    done = run(
        system,
        tmp_path,
        COMMANDS.format(
            commands=[["reduce", job.name], ["info", "part.h5"], ["export", "part.h5", "--to", "exudyn"]], more=ARRAYS
        ),
    )
    assert "error" not in done and "warning" not in done, done
    assert read_body(tmp_path / "part.h5").bodies["cb"].rigid_count == 6
    assert all(f"{verb} done" in done for verb in ("reduce", "info", "export"))
    # Windows keeps the names of mapped files: the next run removes what is left.
    assert f"names {1 if system == 'windows' else 0}" in done
    assert f"left {1 if system == 'windows' else 0}" in done
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".morembs")] == []
    run(
        system,
        tmp_path,
        "from morembs.base.scratch import *; [remove_abandoned(Path(f)) for f in ('scratch', 'arrays')]",
    )
    assert not list((tmp_path / "scratch").iterdir()) and not list((tmp_path / "arrays").iterdir())


def test_a_batch_where_there_are_no_locks_nor_fork(tmp_path: Path) -> None:
    job = decks.folder(tmp_path, {}, decks.deck(decks.BEAM[:12]))
    twice = COMMANDS.format(commands=[["batch", job.name, "-q"], ["batch", job.name, "-q"]], more="")
    done = run("windows", tmp_path, twice)
    assert "1 done" in done and "1 unchanged" in done and "error" not in done


# As on Windows, whose own class of processes is not there to be tried; what is asked for is told at the end.
SPAWNING = """
import multiprocessing
asked, context = [], multiprocessing.get_context
multiprocessing.get_all_start_methods = lambda: ["spawn"]
multiprocessing.get_context = lambda method=None: asked.append(method) or context(method)
"""


def test_processes_are_spawned_in_a_folder_with_spaces_and_letters_beyond_ascii(tmp_path: Path) -> None:
    folder = tmp_path / "Größe 1, 部品 & co"
    folder.mkdir()
    tables = {
        "reduce": 'name = "few"\nmethod = "krylov"\nshifts_hz = [100.0, 400.0, 900.0]',
        "solver": "workers = 2",
        "check": "full_modes = 0",
        "output": 'path = "Körper 1.h5"',
    }
    job = decks.folder(folder, tables, decks.deck(decks.BEAM))
    job = job.rename(folder / "Auftrag ü.toml")
    commands = [["reduce", job.name], ["info", "Körper 1.h5"], ["export", "Körper 1.h5", "--to", "exudyn"]]
    done = run("macos", folder, SPAWNING + COMMANDS.format(commands=commands, more="print('asked for', set(asked))"))
    assert "error" not in done and "asked for {'spawn'}" in done, done
    assert all(f"{verb} done" in done for verb in ("reduce", "info", "export"))
    assert read_body(folder / "Körper 1.h5").bodies["few"].rigid_count == 6


def test_names_in_the_repository_are_names_everywhere() -> None:
    """No two differ by case alone, and none has what Windows refuses."""
    for top in ("morembs", "tests", "docs", "data", "scripts", "benchmarks", "pipelines", "studies"):
        names = [
            path.relative_to(ROOT).as_posix() for path in (ROOT / top).rglob("*") if "__pycache__" not in path.parts
        ]
        assert len({name.lower() for name in names}) == len(names)
        for name in names:
            assert not set(name) & set('<>:"|?*\\') and not name.endswith((".", " ")), name
            assert Path(name).stem.lower() not in ("con", "prn", "aux", "nul"), name
