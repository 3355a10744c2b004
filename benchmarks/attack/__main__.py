"""Attacks on the program, for minutes or hours.

usage: python -m benchmarks.attack VERB [--count N] [--seed S] [--kind KIND ...] [--only N]

A failure is printed with the command that repeats it. Tables go to benchmarks/results/attack-VERB.json.
"""

from __future__ import annotations

import argparse
import importlib.util
import runpy
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.attack import report
from benchmarks.measure import HERE, Settings

COUNTS = {"kill": 200, "damage": 2000}
# Verbs with a command line of their own: modules that are run as scripts with the rest of the arguments.
OWN = {
    "cluster": "benchmarks.attack.cluster",
    "decks": "benchmarks.decks",
    "jobs": "benchmarks.attack.jobs",
    "structured": "benchmarks.attack.structured",
}


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.attack", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("verb", choices=[*COUNTS, *OWN])
    parser.add_argument("--count", type=int, help=f"trials ({', '.join(f'{v}: {n}' for v, n in COUNTS.items())})")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn (1)")
    parser.add_argument("--kind", nargs="+", default=[], help="commands to kill, or formats to damage; all without it")
    parser.add_argument("--only", type=int, help="the trial with this number, of one kind")
    parser.add_argument("--keep", type=Path, help="folder that keeps what failed; without it a temporary one")
    parser.add_argument("--results", type=Path, help="folder for JSON (benchmarks/results; none with --only)")
    given = parser.parse_args(arguments)
    if given.only is not None and len(given.kind) != 1:
        parser.error("--only needs one --kind")
    return given


def main(arguments: Sequence[str]) -> int:
    """Run a verb; 1 where something failed."""
    if arguments and arguments[0] in OWN:
        name = OWN[arguments[0]]
        if importlib.util.find_spec(name) is None:
            raise SystemExit(f"{name} is not here")
        sys.argv = [name, *arguments[1:]]
        runpy.run_module(name, run_name="__main__", alter_sys=True)
        return 0
    given = options(arguments)
    count = given.count or COUNTS[given.verb]
    print(f"{given.verb}: seed {given.seed}, {count if given.only is None else 1} trials", flush=True)
    results = given.results or (HERE / "results" if given.only is None and not given.kind else None)
    folder = given.keep or Path(tempfile.mkdtemp(prefix="attack-"))
    settings = Settings(folder=folder.resolve(), results=results)
    settings.folder.mkdir(parents=True, exist_ok=True)
    try:
        return report.VERBS[given.verb](settings, count, given.seed, given.kind, given.only)
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
