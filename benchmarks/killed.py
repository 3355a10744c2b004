"""Case about ends before the end: a job is killed at random moments, and none of its scratch files may stay.

After SIGTERM the scratch folder is empty at once; after SIGKILL it is empty as soon as another run works in it.
"""

from __future__ import annotations

import random
import signal
import subprocess
import time
from pathlib import Path

from measure import Report, Row, Settings, command, required, run

SHAPE, DOFS, BUDGET = "crankshaft", 60_000, 400_000_000
TIMES, QUICK_TIMES = 20, 2
# The earliest moment, as a part of the time of a whole run; before it the program only loads its libraries.
EARLIEST = 0.15


def killed(settings: Settings) -> None:
    """How many of the killed runs left scratch files."""
    folder = settings.folder / "killed"
    scratch = folder / "scratch"
    scratch.mkdir(parents=True, exist_ok=True)
    wanted = {"shape": SHAPE, "dofs": DOFS, "to": str(folder), "memory": f"{BUDGET} B", "scratch": str(scratch)}
    job = Path(required("job", settings, **wanted)["job"])
    whole = run(command("reduce", job, "--json"), settings)
    if whole.code:
        raise SystemExit(f"the job that was to be killed fails by itself: {whole.last_error()}")
    dice = random.Random(4)
    times = QUICK_TIMES if settings.quick else TIMES
    report = Report("killed", settings)
    for number in (signal.SIGTERM, signal.SIGKILL):
        moments = [dice.uniform(EARLIEST, 1.0) * whole.seconds for _ in range(times)]
        ends = [_ended(job, scratch, number, moment, settings) for moment in moments]
        report.rows[number.name] = {
            "runs": times,
            "in_use": sum(end["files"] > 0 for end in ends),
            "left": sum(end["left"] > 0 for end in ends),
            "codes": " ".join(sorted({str(end["code"]) for end in ends})),
            "left_at_last": _after(job, scratch, settings),
        }
    report.table(
        f"killed: a job of {whole.seconds:.1f} s, at random moments",
        [
            ("runs", "runs", "n"), ("in_use", "had scratch files", "n"), ("left", "left some", "n"),
            ("codes", "exit codes", "text"), ("left_at_last", "left after the next run", "n"),
        ],
    )  # fmt: skip
    report.write()


def _ended(job: Path, scratch: Path, number: signal.Signals, moment: float, settings: Settings) -> Row:
    """Start the job, end it after ``moment`` seconds; how many folders it had, and has."""
    with subprocess.Popen(
        command("reduce", job, "--json"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=settings.environment(),
    ) as process:  # fmt: skip
        time.sleep(moment)
        files = len(list(scratch.iterdir()))
        process.send_signal(number)
        code = process.wait()
    return {"code": code, "files": files, "left": len(list(scratch.iterdir()))}


def _after(job: Path, scratch: Path, settings: Settings) -> int:
    """Folders that are left once another run has ended well."""
    run(command("reduce", job, "--json"), settings)
    return len(list(scratch.iterdir()))
