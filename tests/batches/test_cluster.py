"""Batches on workers of dask: the same bodies as here, whoever is killed; and what is said of unfit workers."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from morembs import batch
from morembs.app.batches.cluster_file import place_of
from morembs.app.batches.queues import queue_of
from morembs.app.cli import app
from morembs.storage.checksums import whole_sum
from tests.support import decks
from tests.support.dask_cluster import PATIENCE, ROOT, Cluster, cluster, until
from tests.support.refusals import Refusal, refusal

distributed = pytest.importorskip("distributed", reason="dask is not installed")

WRONG = {"material": 'set = "all"\nyoung = 1\npoisson = 0.6\ndensity = 1'}


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with one worker for two jobs at once."""
    with cluster(tmp_path_factory.mktemp("dask")) as started:
        started.worker(forks=True)
        yield started


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("dask")) as started:
        yield started


@pytest.fixture
def alone(scheduler: Cluster) -> Iterator[Cluster]:
    """A scheduler of which workers come and go."""
    yield scheduler
    scheduler.end_workers()


def jobs(folder: Path, count: int) -> Path:
    """So many sound jobs, each of another size, with one thread."""
    folder.mkdir(exist_ok=True)
    for number in range(count):
        place = folder / f"p{number}"
        place.mkdir()
        text = decks.deck(decks.BEAM[: 8 + 4 * number])
        decks.folder(place, {"solver": "threads = 1"}, text).rename(place / f"p{number}.toml")
    return folder


def sums(folder: Path) -> dict[str, str]:
    return {path.parent.name: whole_sum(path) for path in sorted(folder.rglob("part.h5"))}


def events(folder: Path, kind: str) -> list[dict[str, object]]:
    path = folder / "batch.manifest"
    lines = path.read_text().splitlines() if path.exists() else []
    return [event for event in map(json.loads, lines) if event["event"] == kind]


def begin(folder: Path, *options: str) -> subprocess.Popen[str]:
    """A batch in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "morembs", "batch", str(folder), *options],
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def strays(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


@pytest.mark.usefixtures("forked_jobs")
def test_the_same_bodies_come_out_here_and_there(shared: Cluster, tmp_path: Path) -> None:
    """Bit for bit; faults are told as here, and what is up to date needs no workers."""
    written = []
    for place in ("local:2", shared.address):
        folder = jobs(tmp_path / place.replace(":", "_").replace("/", "_"), 2)
        (folder / "wrong").mkdir()
        decks.folder(folder / "wrong", WRONG)
        (folder / "lost.toml").write_text(decks.job())
        done = CliRunner().invoke(app, ["batch", str(folder), "--cluster", place, "--report", str(folder / "n.html")])
        assert done.exit_code == 2, done.stderr
        assert "2 done, 2 failed" in done.stdout and "poisson" in done.stdout and "part.inp" in done.stdout
        lines = done.stderr.splitlines()
        first = min(number for number, line in enumerate(lines) if "done in" in line)
        assert all(number < first for number, line in enumerate(lines) if "failed" in line)
        written.append(sums(folder))
        assert {event["facts"]["body_sha256"] for event in events(folder, "ended")} == set(written[-1].values())  # type: ignore[index]
        assert strays(folder) == []
    assert written[0] == written[1] and len(written[0]) == 2
    shutil.rmtree(folder / "wrong")
    (folder / "lost.toml").unlink()
    again = CliRunner().invoke(app, ["batch", str(folder), "--cluster", "tcp://127.0.0.1:1"])
    assert again.exit_code == 0 and "2 unchanged" in again.stdout


def test_a_client_is_taken_and_left_open(shared: Cluster, tmp_path: Path) -> None:
    folder = jobs(tmp_path, 1)
    with distributed.Client(shared.address) as client:
        (record,) = batch([folder], client=client)
        assert record.state == "done" and client.status == "running"
    with refusal("conflict", "jobs"):
        batch([folder], client=client, workers=1)


def lives(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    return False


@pytest.mark.usefixtures("forked_jobs")
def test_killed_workers_and_children_cost_one_start_each(alone: Cluster, tmp_path: Path) -> None:
    """A child alone, then the only worker, whose children leave by themselves; one that comes does what is left."""
    # More than run at once: forks are short, and some are to be left when others are killed.
    undisturbed = jobs(tmp_path / "a", 4)
    batch([undisturbed])
    folder, worker = jobs(tmp_path / "b", 4), alone.worker(forks=True)
    process = begin(folder, "--cluster", alone.address, "--retries", "5")
    kills, orphans = 0, []
    for what in ("child", "worker"):
        # All have been checked when the first begins; what runs now may have ended at the next look.
        found = until(lambda: (events(folder, "started") and alone.jobs) or process.poll() is not None)
        if found is True:
            break
        kills += 1
        if what == "child":
            with contextlib.suppress(psutil.Error):
                found[0].kill()
        else:
            orphans = alone.jobs
            worker.kill()
            worker.wait()
            kills += 1  # the other job that it may have run
            alone.worker(forks=True)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert kills > 0 and len(events(folder, "started")) <= 4 + kills
    assert sums(folder) == sums(undisturbed) and strays(folder) == []
    until(lambda: not any(map(lives, orphans)) and not alone.jobs)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_batch_that_ends_leaves_no_process(shared: Cluster, tmp_path: Path, number: signal.Signals) -> None:
    """Ended by a signal that can be heeded, or not: the workers see it; the next run does what is left."""
    # More than run at once: forks are short, and some are to be left when the batch ends.
    folder = jobs(tmp_path, 4)
    process = begin(folder, "--cluster", shared.address)
    until(lambda: events(folder, "started") and shared.jobs)
    process.send_signal(number)
    process.communicate(timeout=PATIENCE)
    if number == signal.SIGTERM:
        assert process.returncode == 143 and not shared.jobs and strays(folder) == []
    until(lambda: not shared.jobs)
    before = {event["output"] for event in events(folder, "ended")}
    done = CliRunner().invoke(app, ["batch", str(folder), "--cluster", shared.address])
    assert done.exit_code == 0 and len(sums(folder)) == 4 and strays(folder) == []
    started = [event["output"] for event in events(folder, "started")]
    assert all(started.count(output) == 1 for output in before)


def refused(folder: Path, *options: str) -> str:
    done = CliRunner().invoke(app, ["batch", str(folder), *options])
    assert done.exit_code == 2 and not list(folder.rglob("part.h5")), done.stderr
    assert "Traceback" not in done.stderr and strays(folder) == []
    return done.stderr + done.stdout


def test_workers_that_cannot_be_used_are_named(alone: Cluster, tmp_path: Path) -> None:
    folder = jobs(tmp_path / "jobs", 1)
    assert "no scheduler answers at tcp://127.0.0.1:1" in refused(folder, "--cluster", "tcp://127.0.0.1:1")
    assert "has no workers" in refused(folder, "--cluster", alone.address)
    other = tmp_path / "other" / "morembs"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text('__version__ = "0.0.1"\n')
    (about := other.with_name("morembs-0.0.1.dist-info")).mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: morembs\nVersion: 0.0.1\n")
    worker = alone.worker(environment={"PYTHONPATH": str(other.parent)})
    assert "has morembs 0.0.1, this is" in refused(folder, "--cluster", alone.address)
    worker.kill()
    worker.wait()
    alone.worker(resources="MB=20 cores=2")
    said = refused(folder, "--cluster", alone.address)
    assert "p0.toml needs 0." in said and "the largest worker has 0.02 GB: give [solver] memory" in said


@pytest.mark.skipif(
    subprocess.run(["unshare", "-m", "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True).returncode != 0
    if shutil.which("unshare")
    else True,
    reason="this system gives processes no disks of their own",
)
def test_a_folder_that_a_worker_does_not_see_is_named(alone: Cluster, tmp_path: Path) -> None:
    folder = jobs(tmp_path, 1)
    hidden = 'mount -t tmpfs none "$1" && shift && exec "$@"'
    alone.worker(prefix=("unshare", "-m", "sh", "-c", hidden, "sh", str(folder)))
    said = refused(folder, "--cluster", alone.address)
    assert f"cannot write {folder / 'p0'} (a file made here is not there); give a shared folder" in said


def test_without_dask_a_message_says_how_to_get_it(tmp_path: Path) -> None:
    folder = jobs(tmp_path, 1)
    code = (
        "import sys; sys.modules['distributed'] = None; sys.argv = ['morembs', 'batch', sys.argv[1], '--cluster', "
        "'tcp://x:1']; from morembs.app.cli import console; console()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)], capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert done.returncode == 2 and "--cluster needs dask: pip install 'morembs[cluster]'; local:N" in done.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('kind = "slurm"', ("missing", "memory", "GiB")),
        ('kind = "slum"', ("value", "kind", "'slum'", '"slurm"')),
        ('kind = "pbs"\nmemory = "4"', ("value", "memory", "'4'", "GiB")),
        ('kind = "slurm"\nmemory = "4 GB"\nwall = "1"', ("unknown", "wall", "'walltime'")),
        ('kind = "address"', ("conflict", "address", '"address"')),
        ('kind = "slurm"\nmemory = "4 GB"\nwalltime = "4h"', ("value", "walltime", "'4h'", "04:00:00")),
    ],
)
def test_faults_of_a_cluster_file_are_named(tmp_path: Path, text: str, said: Refusal) -> None:
    path = tmp_path / "cluster.toml"
    path.write_text(f"[cluster]\n{text}\n")
    with refusal(*said, "[cluster]"):
        place_of(path)


@pytest.mark.parametrize(
    ("kind", "lines"),
    [
        ("slurm", ["#SBATCH -p night", "#SBATCH --cpus-per-task=4", "#SBATCH -t 04:00:00", "#SBATCH --account=fem"]),
        ("pbs", ["#PBS -q night", "#PBS -l select=1:ncpus=4:mem=32GB", "#PBS -l walltime=04:00:00"]),
        ("lsf", ["#BSUB -q night", "#BSUB -n 4", "#BSUB -W 04:00"]),
        ("sge", ["#$ -q night", "#$ -l h_rt=04:00:00"]),
    ],
)
def test_scripts_for_queues(tmp_path: Path, kind: str, lines: list[str]) -> None:
    """What is handed to the queue; that of Slurm is run in another test."""
    pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")
    path = tmp_path / "cluster.toml"
    path.write_text(
        f'[cluster]\nkind = "{kind}"\nworkers = 3\ncores = 4\nmemory = "32 GiB"\nwalltime = "04:00:00"\n'
        'queue = "night"\nprologue = ["module load python/3.12"]\ndirectives = ["--account=fem"]\n'
        '[cluster.options]\nscheduler_options = { host = "127.0.0.1" }\n'
    )
    with queue_of(place_of(path)) as queue:
        script = queue.job_script()
    for line in (*lines, "module load python/3.12"):
        assert line in script.splitlines() or any(line in each for each in script.splitlines()), script
    assert "--resources MB=30923,cores=4" in script and "--memory-limit 0" in script


def test_files_to_copy_from_the_documents_are_sound(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "howto" / "scale.md").read_text()
    blocks = {kind: text.split(f"```{kind}\n")[1].split("```")[0] for kind in ("toml", "sh")}
    (tmp_path / "cluster.toml").write_text(blocks["toml"])
    place = place_of(tmp_path / "cluster.toml")
    assert (place.kind, place.workers, place.seconds) == ("slurm", 40, 4 * 3600.0)
    assert subprocess.run(["bash", "-n"], input=blocks["sh"], text=True).returncode == 0
