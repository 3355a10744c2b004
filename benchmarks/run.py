"""Benchmarks: each measurement is a child process of its own; the operating system counts its peak memory.

usage: python benchmarks/run.py [CASE ...] [--quick] [--repeat 3] [--resume]

Measurements are taken in turn within each round, so that a drift of the machine's speed hits all alike; medians
and ratios are printed and written to benchmarks/results/CASE.json, and from there to the tables of README and docs
(figures.py; parts that are named replace their own rows alone). Figures of one machine say little on another: compare
within one run.
"""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import figures
import parts
from measure import Settings, required

# Module -> its cases. It is imported when one of them is run: a child begins with the peak memory of this process, and
# the cases that come first have small children.
MODULES = {
    "startup": ("startup",),
    "solvers": ("small", "medium", "large", "factor", "modes", "many-modes"),
    "krylov": ("krylov",),
    "frames": ("frames",),
    "published": ("published",),
    "jobs": ("million", "forecast"),
    "job_times": ("forecast-time",),
    "switching": ("switching",),
    "deck_text": ("deck-text",),
    "budgets": ("budgets",),
    "certify": ("certify",),
    "fmus": ("fmu",),
    "mechanisms": ("steps", "gmp"),
    "products": ("products",),
    "workers": ("workers",),
}
CASES = {case: module for module, cases in MODULES.items() for case in cases}
# These are run only if they are named; what a round of them takes on two cores.
LONG = {
    "million": "80 minutes",
    "forecast": "an hour",
    "forecast-time": "10 minutes",
    "krylov": "20 minutes",
    "budgets": "15 minutes",
    "workers": "10 minutes",
    "published": "5 minutes",
    "many-modes": "three hours",
}
ROUNDS = 3


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    known = [*CASES, *parts.NAMES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "cases",
        nargs="*",
        metavar="CASE",
        help=f"{', '.join(known)}; without any: all but the long ones, which are "
        + ", ".join(f"{case} ({time} a round)" for case, time in LONG.items()),
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, once: a test of the benchmarks themselves")
    parser.add_argument("--repeat", "--runs", type=int, help="rounds (3; 1 with --quick and for the long ones)")
    parser.add_argument("--resume", action="store_true", help="long cases keep the rows that were written before")
    parser.add_argument("--threads", type=int, help="threads of the BLAS libraries; without it what they take")
    parser.add_argument("--folder", type=Path, help="keeps meshes and matrices; without it a temporary one")
    parser.add_argument(
        "--results", type=Path, help="folder for JSON (benchmarks/results, and tables of the docs; none with --quick)"
    )
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
            folder=folder,
            results=given.results or (None if given.quick else figures.RESULTS),
            quick=given.quick,
            repeat=given.repeat or (1 if given.quick else ROUNDS),
            threads=given.threads,
            resume=given.resume,
        )
        hardware = required("machine", settings)
        print(f"{hardware['cores']} cores, {hardware['blas_threads']} threads of the BLAS")
        for case in cases:
            if case in CASES:
                once = case in LONG and given.repeat is None
                measured = importlib.import_module(CASES[case]).CASES[case]
                measured(replace(settings, repeat=1) if once else settings)
        if single := [case for case in cases if case in parts.NAMES]:
            parts.measured(single, settings)
    if settings.results == figures.RESULTS:
        figures.write()


if __name__ == "__main__":
    main()
