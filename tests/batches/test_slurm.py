"""A batch on workers that Slurm starts: the queue of a cluster, on this machine alone."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs import batch
from morembs.app.cli import app
from tests.batches.test_cluster import jobs, strays, sums
from tests.support.slurm import slurm, why_not

pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")
pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "Slurm is here")

CLUSTER = """
[cluster]
kind = "slurm"
workers = 2
cores = 1
memory = "1 GB"
walltime = "01:00:00"
queue = "night"
prologue = ["export OPENBLAS_NUM_THREADS=1", "export PYTHONPATH={root}"]

[cluster.options]
scheduler_options = {{ host = "127.0.0.1" }}
local_directory = "{folder}"
log_directory = "{folder}/logs"
"""


@pytest.mark.usefixtures("forked_jobs")
def test_slurm_runs_a_batch(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path = tmp_path_factory.mktemp("slurm")
    here = jobs(tmp_path / "here", 2)
    batch([here])
    folder, place = jobs(tmp_path / "there", 2), tmp_path / "cluster.toml"
    place.write_text(CLUSTER.format(root=Path(__file__).parents[2], folder=tmp_path))
    (tmp_path / "queue").mkdir()
    with slurm(tmp_path / "queue") as environment:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        done = CliRunner().invoke(app, ["batch", str(folder), "--cluster", str(place)])
        accounts = subprocess.run(["squeue", "-h"], capture_output=True, text=True, check=True).stdout
    assert done.exit_code == 0 and "2 done" in done.stdout, done.stderr
    assert sums(folder) == sums(here) and len(sums(folder)) == 2 and strays(folder) == []
    events = [json.loads(line) for line in (folder / "batch.manifest").read_text().splitlines()]
    assert sum(event["event"] == "ended" for event in events) == 2
    # Workers that are not needed any more have been sent away, or are on their way out.
    assert all(line.split()[4] == "CG" for line in accounts.splitlines()), accounts
