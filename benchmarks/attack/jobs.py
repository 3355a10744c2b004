"""Whole jobs across features at random, against truths in extended arithmetic.

    python -m benchmarks.attack jobs --count 5000 --seed 1
    python -m benchmarks.attack jobs --seed 1 --only 17 --keep FOLDER

The generator, the truth and the judge are in tests/fuzz. A failure is printed with the command that repeats it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.attack import preload  # noqa: E402
from benchmarks.measure import HERE  # noqa: E402
from tests.fuzz import cases  # noqa: E402
from tests.fuzz.trials import FAULTS, RESULTS, Outcome, trial  # noqa: E402


def campaign(count: int, seed: int, folder: Path, *, only: int | None = None, fixed: bool = True) -> list[Outcome]:
    """Outcomes of the fixed cases and of ``count`` jobs of ``seed``."""
    preload.package()
    outcomes = []
    if fixed and only is None:
        for name in cases.CASES:
            outcomes.append(cases.run(name, folder))
            _tell(outcomes[-1])
    for number in range(count) if only is None else [only]:
        begun = time.perf_counter()
        try:
            outcome = trial(number, seed, folder, keep=only is not None)
        except Exception:
            outcome = Outcome(number, result="wrong", words=f"the generator failed: {traceback.format_exc(limit=-3)}")
            outcome.command = f'make attack ARGS="jobs --seed {seed} --only {number}"'
        outcome.seconds = time.perf_counter() - begun
        outcomes.append(outcome)
        _tell(outcome, always=only is not None)
        if only is None and (number + 1) % 100 == 0:
            print(f"{number + 1} of {count}: {dict(Counter(each.result for each in outcomes))}", flush=True)
    return outcomes


def _tell(outcome: Outcome, *, always: bool = False) -> None:
    if outcome.result in (*FAULTS, "refused") or always:
        what = ", ".join(f"{key} {value}" for key, value in outcome.features.items())
        print(f"{outcome.result}: {outcome.words}\n    {what}\n    {outcome.command}", flush=True)


def table(outcomes: list[Outcome]) -> str:
    """Results by feature, refusals by reason, and what became of certificates."""
    lines = ["result                     jobs"]
    kinds = Counter(outcome.result for outcome in outcomes)
    lines += [f"{kind:25s} {kinds[kind]:5d}" for kind in RESULTS if kinds[kind]]
    valid = [o for o in outcomes if o.valid and isinstance(o.number, int)]
    good = sum(o.result != "refused" for o in valid)
    lines.append(f"valid by construction: {len(valid)}, of which {good} ({good / max(len(valid), 1):.1%}) gave a body")
    proven, estimates = sum(o.proven for o in outcomes), sum(o.estimates for o in outcomes)
    excess, points = sum(o.excess for o in outcomes), sum(o.points for o in outcomes)
    lines.append(f"certificates: {proven} proven, {estimates} estimates ({excess} exceeded), at {points} frequencies")
    for kind in ("refused", "refused as it must be"):
        lines += [f"\n{kind}:"] if kinds[kind] else []
        for words, number in Counter(o.words for o in outcomes if o.result == kind).most_common():
            example = next(o.number for o in outcomes if o.result == kind and o.words == words)
            lines.append(f"{number:5d}  (such as {example}) {words}")
    after = Counter(o.features.get("afterwards", "") for o in outcomes)
    lines += ["\nrefused afterwards:", *(f"{n:5d}  {words}" for words, n in after.most_common() if words)]
    for key in sorted({key for o in outcomes for key in o.features if key != "afterwards"}):
        each = Counter(o.features[key] for o in outcomes if key in o.features)
        lines.append(f"{key}: " + ", ".join(f"{name} {n}" for name, n in each.most_common(14)))
    return "\n".join(lines)


def main() -> int:
    """The command line; 1 where something failed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.attack jobs",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="the job with this number")
    parser.add_argument("--case", choices=list(cases.CASES), help="one of the fixed cases")
    parser.add_argument("--keep", type=Path, help="folder that keeps the files of what failed")
    parser.add_argument("--results", type=Path, help="folder for JSON (benchmarks/results; none with --only)")
    given = parser.parse_args()
    if importlib.util.find_spec("flint") is None:
        raise SystemExit("truths in extended arithmetic need python-flint; give: pip install python-flint")
    folder = given.keep or Path(tempfile.mkdtemp(prefix="attack-"))
    try:
        if given.case:
            preload.package()
            outcome = cases.run(given.case, folder.resolve(), keep=given.keep is not None)
            _tell(outcome, always=True)
            return int(outcome.result in FAULTS)
        begun = time.perf_counter()
        outcomes = campaign(given.count, given.seed, folder.resolve(), only=given.only)
        print(f"seed {given.seed}, {time.perf_counter() - begun:.0f} s\n{table(outcomes)}")
        if given.only is None:
            results = given.results or HERE / "results"
            results.mkdir(parents=True, exist_ok=True)
            rows = [asdict(outcome) for outcome in outcomes if outcome.result != "good"]
            (results / "attack-jobs.json").write_text(
                json.dumps({"seed": given.seed, "count": given.count, "not good": rows}, indent=1)
            )
        return int(any(outcome.result in FAULTS for outcome in outcomes))
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
