"""One body on several processes, through the command line."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import InputError, SolverError
from morembs.base.worker_pool import WorkerPool
from morembs.fem import DofMap
from morembs.importers.model_file import write_model
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.ranks import why_not
from morembs.linalg.sparse.select import SOLVERS
from tests.support.commands import refused, run, without_progress
from tests.support.matrices import brick, shifted
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal
from tests.support.stored import datasets
from tests.support.tubes import BORE, arch

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


DAMPED = """
[model]
file = "../{model}.model.h5"
{flow}
[[interface]]
name = "one"
nodes = "set:TIP"
coupling = "direct"
components = [0, 2]
[certify]
band_hz = [20.0, 900.0]
points = 4
[solver]
threads = 1
scratch = "."
{solver}
[[reduce]]
method = "krylov"
shifts_hz = [0.0, 500.0, 900.0]
{gramian}
[output]
path = "part.h5"
[check]
full_modes = 0
"""
GRAMIAN = '[[reduce]]\nmethod = "gramian"\ndirect = true\norder = 4\npoints = 3\nband_hz = [20.0, 900.0]'
FLOW = f'[[flow]]\npath = "set:TUBE"\nmass_flow = 0.4\ndensity = 1000.0\narea = {BORE}'


def reduced(folder: Path, solver: str, method: str = KRYLOV) -> dict[str, np.ndarray]:
    """Datasets of the body, all but what tells of the run."""
    folder.mkdir()
    return body_of(written(folder, solver, method))


def body_of(job: Path) -> dict[str, np.ndarray]:
    """As ``reduced``, of a job that is written."""
    run("reduce", job)
    return datasets(job.with_name("part.h5"))


def written(folder: Path, solver: str, method: str = KRYLOV) -> Path:
    job = folder / "job.toml"
    job.write_text(JOB.format(mesh=ROOT / "data/small_meshes/conrod.msh", solver=solver, method=method))
    return job


def damped(folder: Path, solver: str, keys: dict[str, str]) -> Path:
    folder.mkdir()
    job = folder / "job.toml"
    job.write_text(DAMPED.format(solver=solver, **keys))
    return job


def checked(job: Path) -> dict[str, Any]:
    forecast: dict[str, Any] = json.loads(run("check", job, "--json"))[0]
    return forecast


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


@pytest.fixture
def dampers(tmp_path: Path) -> dict[str, str]:
    """A beam held at one end with a damping matrix of its own, too large to be taken whole."""
    model = steel(box("hex8", (10, 3, 3), (1.0, 0.1, 0.12)))
    free = np.setdiff1d(np.arange(model.size), np.flatnonzero(np.isin(model.dofs.node, where(model, 0, 0.0))))
    model = replace(
        model,
        K=model.K[free][:, free],
        M=model.M[free][:, free],
        mesh=None,
        materials=(),
        D=sp.csr_array(sp.diags_array(np.where(np.arange(len(free)) < 40, 30.0, 0.0))),
        dofs=DofMap(node=model.dofs.node[free], component=model.dofs.component[free]),
        nodes=replace(model.nodes, sets={"TIP": where(model, 0, 1.0)[:1]}),
    )
    write_model(tmp_path / "beam.model.h5", model)
    return {"model": "beam", "flow": "", "gramian": GRAMIAN}


@pytest.fixture
def tube(tmp_path: Path) -> dict[str, str]:
    """A tube with flow, whose equations have gyroscopic and circulatory parts."""
    model = replace(arch(mass_flow=0.0), N=None)
    nodes = replace(model.nodes, sets={**model.nodes.sets, "TIP": np.array([13])})
    write_model(tmp_path / "tube.model.h5", replace(model, nodes=nodes))
    return {"model": "tube", "flow": FLOW, "gramian": ""}


# Two shifts, three Gauss points, two frequencies of a reference at a time and four of direct responses.
@pytest.mark.parametrize(("model", "pools"), [("dampers", [2, 2, 2, 2, 3, 2]), ("tube", [2, 2, 2, 3])])
def test_damped_bodies_and_certificates_do_not_depend_on_workers(tmp_path, caplog, request, model, pools):
    keys, made = request.getfixturevalue(model), []
    caplog.set_level("INFO", "morembs.base.worker_pool")
    for workers in (1, 2, 3):
        job = damped(tmp_path / f"w{workers}", f"workers = {workers}", keys)
        made.append(body_of(job))
        assert sorted(path.name for path in job.parent.iterdir()) == ["job.toml", "part.h5"]
    for other in made[1:]:
        assert [name for name in made[0] if not same(made[0][name], other[name])] == []
    assert [record.args[0] for record in caplog.records if "workers of" in record.msg] == pools


@pytest.fixture
def plain_server():
    """A server of forks that has loaded nothing: dask lets those that come after it load all of itself."""
    forkserver._forkserver._stop()  # noqa: SLF001
    forkserver.set_forkserver_preload([])


@pytest.mark.usefixtures("plain_server")
@pytest.mark.parametrize("model", ["dampers", "tube"])
def test_check_forecasts_what_factors_at_shifts_and_workers_take(tmp_path, caplog, request, model):
    """A factor of a matrix that is not symmetric is stored twice, a complex number takes two real ones."""
    if reason := SOLVERS["mumps"].unavailable():
        pytest.skip(reason)
    keys = request.getfixturevalue(model)
    caplog.set_level("INFO", "morembs")
    alone, shared = (damped(tmp_path / f"w{n}", f'name = "mumps"\nworkers = {n}', keys) for n in (1, 2))
    forecast = checked(alone)
    caplog.clear()
    body_of(alone)
    factors = [record.args for record in caplog.records if "factor entries=" in record.msg]
    entries, megabytes = max(args[3] for args in factors), max(args[4] for args in factors)
    # MUMPS counts both triangles of the pivot blocks of symmetric ones before it knows which pivots it takes.
    most = 1.0 if model == "tube" else 1.25
    assert 1 <= forecast["shift_factor_entries"] / entries <= most and forecast["processes"] == 0
    assert 0.999 <= forecast["shift_factor_bytes"] / (1e6 * megabytes) <= 1.001 * most
    assert forecast["shift_factor_bytes"] > (3 if model == "tube" else 1.8) * forecast["factor_bytes"]
    both = checked(shared)
    caplog.clear()
    body_of(shared)
    peak = max(record.args[2] for record in caplog.records if "workers of" in record.msg)
    assert both["processes"] == 2 and 1 <= both["process_bytes"] / (1e6 * peak) < 1.6
    assert both["all_processes_bytes"] > both["peak_memory_bytes"] + 2 * both["process_bytes"]
    assert forecast["all_processes_bytes"] == forecast["peak_memory_bytes"]
    assert both["shift_seconds"] < forecast["shift_seconds"]


def test_a_budget_has_room_for_some_workers_only_and_one_line_says_so(tmp_path, dampers):
    job = damped(tmp_path / "w", 'workers = 3\nmemory = "300 MB"', dampers)
    command = [sys.executable, "-m", "morembs", "reduce", "--quiet", str(job)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    lines = [line for line in ended.stderr.splitlines() if "workers run" in line]
    assert ended.returncode == 0 and (job.parent / "part.h5").exists(), ended.stderr
    # Points of the Gramian are three.
    assert any(re.search(r"[12] of 3 workers run: each needs 0\.\d+ GB", line) for line in lines), ended.stderr
    assert sorted(path.name for path in job.parent.iterdir()) == ["job.toml", "part.h5"]


@pytest.mark.parametrize("name", ["cholmod", "amg"])
def test_check_and_reduce_refuse_solvers_that_cannot_take_a_flow(tmp_path, tube, name):
    if reason := SOLVERS[name].unavailable():
        pytest.skip(reason)
    job = damped(tmp_path / "w", f'name = "{name}"', tube)
    check, reduce = (CliRunner().invoke(app, [verb, str(job)]) for verb in ("check", "reduce"))
    assert (check.exit_code, reduce.exit_code) == (2, 2), (check.stdout, reduce.exception)
    # What reduce warns of comes before its error.
    assert without_progress(check.stderr).splitlines() == without_progress(reduce.stderr).splitlines()[-1:]
    assert "factorises complex-unsymmetric matrices (it takes spd ones)" in check.stderr
    # Statics take a definite matrix only.
    job.write_text(job.read_text().replace("[0.0, 500.0, 900.0]", "[0.0]").replace(tube["flow"], ""))
    job.write_text(job.read_text().replace("[certify]\nband_hz = [20.0, 900.0]\npoints = 4\n", ""))
    assert CliRunner().invoke(app, ["check", str(job)]).exit_code == 0


def same(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind in "fc"))


def power(shared, task):
    if task < 0:
        time.sleep(-0.1 * task)
        raise InputError(f"task {task}")
    return np.full(200_000, float(shared) ** task)


def killed(shared, task):
    os.kill(os.getpid(), signal.SIGKILL)


def test_results_come_in_the_order_of_tasks_and_the_first_failure_counts(tmp_path):
    with WorkerPool(2, 2, scratch=tmp_path) as pool:
        assert [array[-1] for array in pool.each(power, [3, 1, 2])] == [8.0, 2.0, 4.0]
        done = []
        with refusal("value", "", "-3"):
            done.extend(array[0] for array in pool.each(power, [1, -3, -1]))
        assert done == [2.0]
    with WorkerPool(2, 2, scratch=tmp_path) as pool, refusal("result", "", "9", by=SolverError):
        list(pool.each(killed, [1, 2]))
    assert list(tmp_path.iterdir()) == []


UNGUARDED = """
import operator, os, signal
from morembs.base.worker_pool import WorkerPool

print("begun", flush=True)
with WorkerPool(3, 2) as pool:
    print(list(pool.each(operator.mul, [1, 2])), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
GUARDED = """
import operator
from morembs.base.worker_pool import WorkerPool

class Number:
    def __init__(self, value):
        self.value = value

    def __mul__(self, other):
        return self.value * other

if __name__ == "__main__":
    with WorkerPool(Number(3), 2) as pool:
        print(list(pool.each(operator.mul, [1, 2])))
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


def test_a_killed_program_leaves_nothing_that_the_next_one_does_not_remove(tmp_path):
    """The socket of the process that workers are copied from among it, whose name has room in short folders only."""
    with tempfile.TemporaryDirectory(prefix="m", dir="/tmp") as name:
        folder = Path(name)
        for text in (UNGUARDED, UNGUARDED, GUARDED):
            ran(folder, text)
            left = [path.name for path in folder.iterdir() if path.name != "program.py"]
            # That of the killed one alone: not more with each, and none under a name that nobody owns.
            assert len(left) <= 2 and all(name.startswith("morembs-") for name in left), left
        assert left == []


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
        with refusal("result", "", "rank", "9,", by=SolverError):
            factor.solve(np.ones(factor.n))
        psutil.wait_procs(ranks, timeout=20)
        # Also when they have been gone for long, with their folder.
        with refusal("result", "", "mpirun", by=SolverError):
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
