"""Benchmarks: each measurement is a child process of its own; the operating system counts its peak memory.

usage: python benchmarks/run.py [CASE ...] [--quick] [--repeat 3] [--resume]

Measurements are taken in turn within each round, so that a drift of the machine's speed hits all alike; medians
and ratios are printed and written to benchmarks/results/CASE.json. Figures of one machine say little on another:
compare within one run.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import budgets
import certify
import fmus
import frames
import jobs
import krylov
import parts
import solvers
import startup
import switching
from measure import HERE, Settings, required

CASES = {
    **solvers.CASES, **krylov.CASES, **frames.CASES, **jobs.CASES, **switching.CASES, **budgets.CASES,
    **startup.CASES, **certify.CASES, **fmus.CASES,
}  # fmt: skip
# These take an hour or more, and are run only if they are named.
LONG = ("million", "forecast")
ROUNDS = 3


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    known = [*CASES, *parts.NAMES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "cases", nargs="*", metavar="CASE",
        help=f"{', '.join(known)}; without any: all but {' and '.join(LONG)}, which take long",
    )  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="small sizes, once: a test of the benchmarks themselves")
    parser.add_argument("--repeat", "--runs", type=int, help="rounds (3; 1 with --quick and for the long ones)")
    parser.add_argument("--resume", action="store_true", help="long cases keep the rows that were written before")
    parser.add_argument("--threads", type=int, help="threads of the BLAS libraries; without it what they take")
    parser.add_argument("--folder", type=Path, help="keeps meshes and matrices; without it a temporary one")
    parser.add_argument("--results", type=Path, help="folder for JSON (benchmarks/results; none with --quick)")
    given = parser.parse_args(arguments)
    if wrong := [case for case in given.cases if case not in known]:
        parser.error(f"no such case: {', '.join(wrong)}; expected some of {', '.join(known)}")
    if min(given.repeat or 1, given.threads or 1) < 1:
        parser.error("--repeat and --threads are 1 or more")
    return given


def chosen(given: argparse.Namespace) -> list[str]:
    """The cases to run."""
    if given.cases:
        return list(dict.fromkeys(given.cases))
    left_out = parts.NOT_QUICK if given.quick else LONG
    return [case for case in (*CASES, *parts.NAMES) if case not in left_out]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases that the command line names."""
    given = options(arguments)
    cases = chosen(given)
    # Leave through every "with" and "except", so that the child ends and the files go.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    with tempfile.TemporaryDirectory(prefix="benchmarks-") as temporary:
        folder = (given.folder or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        settings = Settings(
            folder=folder, results=given.results or (None if given.quick else HERE / "results"), quick=given.quick,
            repeat=given.repeat or (1 if given.quick else ROUNDS), threads=given.threads, resume=given.resume,
        )  # fmt: skip
        hardware = required("machine", settings)
        print(f"{hardware['cores']} cores, {hardware['blas_threads']} threads of the BLAS")
        for case in cases:
            if case in CASES:
                once = case in LONG and given.repeat is None
                CASES[case](replace(settings, repeat=1) if once else settings)
        if single := [case for case in cases if case in parts.NAMES]:
            parts.measured(single, settings)


if __name__ == "__main__":
    main()
