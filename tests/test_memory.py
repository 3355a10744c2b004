"""The memory that a job is said to take is its own."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base import memory
from morembs.body.file import read_body
from tests.support.decks import folder

MB = 1_000_000

BATCH = """
import sys
import numpy as np
from morembs.app.cli import main
from morembs.app.jobs import run
real, calls = run.run_job, []

def large_first(*args):
    calls.append(1)
    if len(calls) == 1:
        np.ones(37_500_000)
    if len(calls) == 2:
        # A cycle of references keeps what is large until it is collected.
        holder = [np.ones(1000) for _ in range(37_500)]
        holder.append(holder)
    return real(*args)

run.run_job = large_first
sys.argv = ["morembs", "reduce", *sys.argv[1:], "--json"]
main()
"""


def test_a_job_after_a_large_one_tells_its_own_memory(tmp_path: Path) -> None:
    """Against the same job in a process of its own, whose peak is counted by the operating system."""
    jobs = []
    for name in "abc":
        (tmp_path / name).mkdir()
        jobs.append(str(folder(tmp_path / name)))
    alone = subprocess.run(
        [sys.executable, "-m", "morembs", "reduce", jobs[0], "--json"], capture_output=True, text=True, check=True
    )
    truth = json.loads(alone.stdout)[0]["job_peak_memory_bytes"]
    done = subprocess.run([sys.executable, "-c", BATCH, *jobs], capture_output=True, text=True, check=True)
    documents = json.loads(done.stdout)
    for document in documents[1:]:
        beyond = 320 * MB if document is documents[1] else 40 * MB
        assert 50 * MB < document["job_peak_memory_bytes"] < truth + beyond, document
    # The peak of the job counts what lies between its stages too, where some pages may come.
    stored: dict[str, Any] = read_body(documents[2]["output"]).provenance
    for record in (documents[2], stored):
        stages = max(record["peak_memory_bytes"].values())
        assert stages <= record["job_peak_memory_bytes"] < stages + MB


def test_peaks_between_looks() -> None:
    """What the system counts where it rises; what was seen where it does not; each piece for itself."""
    now, counted = [100], [900]
    peak = memory.PeakMemory(lambda: now[0], lambda: counted[0])
    with peak:
        assert peak.take() == 100
        now[0], counted[0] = 120, 950
        assert peak.take() == 950
        assert peak.take() == 120
        now[0] = 300
        assert peak.take() == 300
    assert not [thread for thread in threading.enumerate() if thread.name == "morembs-memory"]


def test_a_peak_is_seen_while_it_lasts() -> None:
    """By the thread, without anybody's call; however busy the machine is."""
    now, looked = [100], threading.Event()

    def resident() -> int:
        if now[0] == 500:
            looked.set()
        return now[0]

    with memory.PeakMemory(resident, lambda: 900) as peak:
        peak.take()
        now[0] = 500
        assert looked.wait()
        # The second look follows the first's end.
        looked.clear()
        assert looked.wait()
        now[0] = 100
        assert peak.take() == 500


def test_figures_of_the_system() -> None:
    block = np.ones(20_000_000)
    assert memory.resident_bytes() > block.nbytes and memory.peak_memory_bytes() > block.nbytes
    assert memory.available_bytes() > MB
