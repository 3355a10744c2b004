"""One body on several processes, through the command line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest
from typer.testing import CliRunner

from morembs.cli import app
from morembs.crew import Crew
from morembs.errors import InputError, SolverError
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.ranks import why_not
from tests.support.commands import refused
from tests.support.matrices import brick, shifted

ROOT = Path(__file__).parents[2]
KRYLOV = 'method = "krylov"\nshifts_hz = [0.0, 1000.0, 4000.0]\nmoments = [1, 2, 1]'
# Round-off of a factor turns the last directions of a Krylov space, not fixed-interface modes.
MODES = 'method = "craig-bampton"\nmodes = 6'
JOB = """
[model]
mesh = "{mesh}"
units = "mm-t-s"
[[material]]
young = 210000.0
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "big"
nodes = "set:BIGEND"
[[interface]]
name = "small"
nodes = "set:SMALLEND"
[solver]
threads = 1
{solver}
[[reduce]]
{method}
[check]
full_modes = 3
[output]
path = "part.h5"
"""


def reduced(folder: Path, solver: str, method: str = KRYLOV) -> dict[str, np.ndarray]:
    """Datasets of the body, all but what tells of the run."""
    folder.mkdir()
    job = written(folder, solver, method)
    result = CliRunner().invoke(app, ["reduce", str(job)])
    assert result.exit_code == 0, result.stderr
    values: dict[str, np.ndarray] = {}
    with h5py.File(folder / "part.h5") as file:
        file.visititems(lambda name, node: values.update({name: node[()]}) if isinstance(node, h5py.Dataset) else None)
    return {name: value for name, value in values.items() if not name.startswith("provenance")}


def written(folder: Path, solver: str, method: str = KRYLOV) -> Path:
    job = folder / "job.toml"
    job.write_text(JOB.format(mesh=ROOT / "data/small_meshes/conrod.msh", solver=solver, method=method))
    return job


@pytest.fixture
def mpi() -> None:
    if reason := why_not():
        pytest.skip(reason)


def test_bodies_have_the_same_bytes_for_any_number_of_workers(tmp_path):
    alone, together = (reduced(tmp_path / f"w{n}", f'workers = {n}\nscratch = "."') for n in (1, 3))
    assert alone.keys() == together.keys()
    assert [name for name in alone if not np.array_equal(alone[name], together[name])] == []
    # What the workers shared is gone with them.
    assert sorted(path.name for path in (tmp_path / "w3").iterdir()) == ["job.toml", "part.h5"]


def power(shared, task):
    if task < 0:
        time.sleep(-0.1 * task)
        raise InputError(f"task {task}")
    return np.full(200_000, float(shared) ** task)


def killed(shared, task):
    os.kill(os.getpid(), signal.SIGKILL)


def test_results_come_in_the_order_of_tasks_and_the_first_failure_counts(tmp_path):
    with Crew(2, 2, scratch=tmp_path) as crew:
        assert [array[-1] for array in crew.each(power, [3, 1, 2])] == [8.0, 2.0, 4.0]
        done = []
        with pytest.raises(InputError, match="task -3"):
            done.extend(array[0] for array in crew.each(power, [1, -3, -1]))
        assert done == [2.0]
    with Crew(2, 2, scratch=tmp_path) as crew, pytest.raises(SolverError, match=r"worker \d of 2 .* by signal 9"):
        list(crew.each(killed, [1, 2]))
    assert list(tmp_path.iterdir()) == []


UNGUARDED = """
import operator, os, signal
from morembs.crew import Crew

print("begun", flush=True)
with Crew(3, 2) as crew:
    print(list(crew.each(operator.mul, [1, 2])), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
GUARDED = """
import operator
from morembs.crew import Crew

class Number:
    def __init__(self, value):
        self.value = value

    def __mul__(self, other):
        return self.value * other

if __name__ == "__main__":
    with Crew(Number(3), 2) as crew:
        print(list(crew.each(operator.mul, [1, 2])))
"""


def ran(folder: Path, text: str) -> subprocess.CompletedProcess[str]:
    """A program that ends only when all that hold its standard output do."""
    path = folder / "program.py"
    path.write_text(text)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(folder)}
    return subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=600, env=environment)


def test_programs_run_once_and_their_processes_end_with_them(tmp_path):
    """Without a guard by __name__, and by SIGKILL of the program alone."""
    ended = ran(tmp_path, UNGUARDED)
    assert ended.returncode == -signal.SIGKILL and ended.stdout.split("\n")[:2] == ["begun", "[3, 6]"], ended.stderr


def test_what_a_program_defines_goes_to_the_processes(tmp_path):
    ended = ran(tmp_path, GUARDED)
    assert ended.returncode == 0 and ended.stdout.strip() == "[3, 6]", ended.stderr
    ended = ran(tmp_path, GUARDED.replace('if __name__ == "__main__":', "if True:"))
    assert "with exit code 1" in ended.stderr and 'start its work under if __name__ == "__main__"' in ended.stderr


def test_ranks_give_the_body_of_one_process(tmp_path, mpi):
    alone = reduced(tmp_path / "a", 'name = "mumps"', MODES)
    spread = reduced(tmp_path / "b", "ranks = 2", MODES)
    name = next(name for name in alone if name.endswith("full_frequencies_hz"))
    assert np.abs(spread[name] - alone[name]).max() <= 1e-10 * alone[name].max()
    for name in (name for name in alone if name.endswith(("stiffness_matrix", "mass_matrix"))):
        assert np.linalg.norm(spread[name] - alone[name]) <= 1e-9 * np.linalg.norm(alone[name]), name


def test_ranks_count_negative_pivots_and_leave_nothing_when_one_is_killed(tmp_path, mpi):
    A = shifted(brick(4), 13.7)
    with RankedMumps(scratch=tmp_path).factorize(A) as factor:
        assert factor.negative_pivots() == (np.linalg.eigvalsh(A.toarray()) < 0).sum()
        started = psutil.Process().children(recursive=True)
        ranks = [each for each in started if str(tmp_path) in " ".join(each.cmdline())]
        victim = next(each for each in ranks if each.name() != "mpirun")
        victim.kill()
        with pytest.raises(SolverError, match=r"was ended.*leave ranks out"):
            factor.solve(np.ones(factor.n))
        psutil.wait_procs(ranks, timeout=20)
        # Also when they have been gone for long, with their folder.
        with pytest.raises(SolverError, match=r"was ended.*leave ranks out"):
            factor.solve(np.ones(factor.n))
        assert not [each for each in ranks if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]
    assert list(tmp_path.iterdir()) == []


RANKED = """
import os, signal
import psutil
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from tests.support.matrices import brick, shifted

with RankedMumps().factorize(shifted(brick(4), 13.7)):
    print(*(each.pid for each in psutil.Process().children(recursive=True)), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_ranks_end_with_a_program_that_is_killed(tmp_path, mpi):
    ended = ran(tmp_path, RANKED)
    ranks = [psutil.Process(int(pid)) for pid in ended.stdout.split() if psutil.pid_exists(int(pid))]
    _, alive = psutil.wait_procs(ranks, timeout=20)
    assert ended.returncode == -signal.SIGKILL and len(ended.stdout.split()) >= 3, ended.stderr
    assert [each for each in alive if each.is_running() and each.status() != psutil.STATUS_ZOMBIE] == []


def test_solvers_that_take_no_ranks_are_refused(tmp_path):
    assert "ranks" in refused(written(tmp_path, 'name = "cholmod"\nranks = 2'))
    assert "choose one" in refused(written(tmp_path, "workers = 2\nranks = 2"))
    assert "workers" in refused(written(tmp_path, "workers = 0"))
