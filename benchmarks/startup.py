"""Case about starting: processor time of short commands beside that of importing what they cannot do without."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from measure import Report, Row, Settings, in_rounds, ratios

BODY = Path(__file__).parents[1] / "tests" / "data" / "0.1.0" / "symmetric.h5.gz"
BARE, LIBRARIES = "python", "import numpy, scipy.sparse, h5py"
_COLUMNS = (("cpu_seconds", "processor s", "s"),)
# Starts are short: the median of a few more of them than of other cases.
STARTS = 5


def startup(settings: Settings) -> None:
    """--version, --help and info of a small body file; the target of info is 1.3 times the libraries."""
    body = settings.folder / "startup.h5"
    body.write_bytes(gzip.decompress(BODY.read_bytes()))
    commands = {
        BARE: ["-c", "pass"], LIBRARIES: ["-c", LIBRARIES], "morembs --version": ["-m", "morembs", "--version"],
        "morembs --help": ["-m", "morembs", "--help"], "morembs info": ["-m", "morembs", "info", str(body)],
        "morembs info --json": ["-m", "morembs", "info", "--json", str(body)],
    }  # fmt: skip
    measures = {name: _measure([sys.executable, *arguments]) for name, arguments in commands.items()}
    rounds = in_rounds(measures, settings.repeat if settings.quick else max(settings.repeat, STARTS))
    report = Report("startup", settings)
    report.add(rounds)
    report.table("startup: processor time of whole processes", _COLUMNS)
    for name in list(commands)[2:]:
        report.compare(f"{name} over {LIBRARIES}", ratios(rounds, (name, "cpu_seconds"), (LIBRARIES, "cpu_seconds")))
    report.write()


def _measure(command: Sequence[str]) -> Callable[[], Row]:
    def measure() -> Row:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
        return {"cpu_seconds": used.ru_utime + used.ru_stime}

    return measure


CASES = {"startup": startup}
