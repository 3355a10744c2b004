"""Kills of the workers of a cluster and of their processes at random instants, while a batch runs on them.

usage: python -m benchmarks.attack cluster [--kills N] [--jobs N] [--seed S]

All bodies must be there and be those of an undisturbed run, with at most one start more for each kill; nothing may stay
behind.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.attack.scenarios import ROOT
from morembs.storage.checksums import whole_sum

sys.path.insert(0, str(ROOT))

from tests.support import decks
from tests.support.dask_cluster import Cluster, children_of_jobs, cluster, until

# Seconds between two kills at most.
LONGEST = 8.0


def jobs(folder: Path, count: int) -> Path:
    """So many jobs with decks of their own, one thread each."""
    for number in range(count):
        place = folder / f"p{number}"
        place.mkdir(parents=True)
        text = decks.deck(decks.BEAM[: 8 + 4 * (number % 5)], size=10.0 + number)
        decks.folder(place, {"solver": "threads = 1"}, text).rename(place / f"p{number}.toml")
    return folder


def sums(folder: Path) -> dict[str, str]:
    """Name of each job -> sum of its body."""
    return {path.parent.name: whole_sum(path) for path in sorted(folder.rglob("part.h5"))}


def begin(folder: Path, *options: str) -> subprocess.Popen[str]:
    """A batch of the folder in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "morembs", "batch", str(folder), *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def _worker(started: Cluster) -> subprocess.Popen[bytes]:
    """A worker for one job at a time, so that no kill ends two."""
    return started.worker("MB=4000 cores=1", threads=1)


def kill_once(started: Cluster, workers: list[subprocess.Popen[bytes]], folder: Path, dice: random.Random) -> str:
    """Kill a worker, a child, or both; a worker that was killed is replaced."""
    what = dice.choice(("worker", "child", "both"))
    worker = dice.choice([each for each in workers if each.poll() is None])
    own = [child for child in children_of_jobs(folder) if child.ppid() == worker.pid]
    with contextlib.suppress(psutil.Error):
        if what != "child":
            worker.kill()
            worker.wait()
        for child in own[:1] if what == "child" else own if what == "both" else ():
            child.kill()
    if what != "child":
        workers.append(_worker(started))
    return what


def main() -> int:
    """Attack one batch after another until all kills are spent."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    dice = random.Random(given.seed)
    with tempfile.TemporaryDirectory() as name, cluster(Path(name)) as started:
        whole = jobs(Path(name) / "whole", given.jobs)
        begin(whole, "--jobs", "2").communicate()
        expected, workers = sums(whole), [_worker(started), _worker(started)]
        kills, starts, killed_jobs, batches = 0, 0, 0, 0
        while kills < given.kills:
            batches += 1
            folder = jobs(Path(name) / f"batch-{batches}", given.jobs)
            process = begin(folder, "--cluster", started.address, "--retries", "50")
            before = kills
            until(lambda: children_of_jobs(folder) or process.poll() is not None)  # noqa: B023
            while process.poll() is None and kills < given.kills:
                time.sleep(dice.uniform(0.0, LONGEST))
                if process.poll() is None:
                    print(kill_once(started, workers, folder, dice), flush=True)
                    kills += 1
            output, _ = process.communicate()
            events = [json.loads(line) for line in (folder / "batch.manifest").read_text().splitlines()]
            begun = sum(event["event"] == "started" for event in events)
            lost = sum(event["event"] == "lost" for event in events)
            starts, killed_jobs = starts + begun, killed_jobs + lost
            until(lambda: not children_of_jobs(folder))  # noqa: B023
            left = [path.name for path in folder.rglob(".*")]
            sound = process.returncode == 0 and sums(folder) == expected and not left
            words = "sound" if sound else output
            print(f"batch {batches}: {kills - before} kills, {begun} starts, {lost} lost, {words}", flush=True)
            if not sound or begun > given.jobs + kills - before:
                print(f"FAILED: {left}")
                return 1
    print(f"{kills} kills in {batches} batches of {given.jobs} jobs: {starts} starts, {killed_jobs} lost, 0 faults")
    return 0


if __name__ == "__main__":
    sys.exit(main())
