"""Case about FMUs: steps of a body of order 40 for co-simulation, one set of loads, one step and all outputs at a time.

The target is a million steps a minute on one core, with memory that does not grow.
"""

from __future__ import annotations

import ctypes
import re
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from measure import Report, Row, Settings, child, in_rounds
from startup import bar_body

from morembs.base.memory import resident_bytes
from morembs.exporters import export_body

MODES, STEP = 28, 1e-5
STRUCTURES = ("linear", "floating")
_STEPS, _QUICK = 200_000, 2_000
_COLUMNS = (
    ("steps", "steps", "n"),
    ("cpu_seconds", "processor s", "s"),
    ("steps_a_minute", "steps a minute", "n"),
    ("growth_bytes", "growth MB", "MB"),
    ("process_peak_bytes", "peak MB", "MB"),
    ("file_bytes", "FMU MB", "MB"),
)


def fmu(settings: Settings) -> None:
    """Steps a minute of linear and floating bodies."""
    bar_body(settings.folder / "fmu.h5", MODES)
    measures: dict[str, Callable[[], Row]] = {
        kind: lambda kind=kind: child("fmu", settings, structure=kind, quick=settings.quick) for kind in STRUCTURES
    }
    report = Report("fmu", settings)
    report.add(in_rounds(measures, settings.repeat))
    report.table("fmu: co-simulation of a body of order 40, 12 loads in and all motions out at each step", _COLUMNS)
    report.write()


def measure(spec: dict[str, Any]) -> Row:
    """Processor time of the steps, from Python through the C interface; the first hundred are not counted."""
    folder, structure = Path(spec["folder"]), spec["structure"]
    path = export_body(
        folder / "fmu.h5", "fmu", path=folder / f"{structure}.fmu", options={"structure": structure}
    ).paths[0]
    with zipfile.ZipFile(path) as archive:
        (library,) = (name for name in archive.namelist() if name.startswith("binaries"))
        archive.extract(library, folder / structure)
        text = archive.read("modelDescription.xml").decode()
    body, loads, outputs = _instance(folder / structure / library, text)
    steps = _QUICK if spec["quick"] else _STEPS
    for k in range(100):
        body.step(k * STEP, loads, outputs)
    before, start = resident_bytes(), time.process_time()
    for k in range(100, 100 + steps):
        body.step(k * STEP, loads, outputs)
    seconds = time.process_time() - start
    return {
        "steps": steps,
        "cpu_seconds": seconds,
        "steps_a_minute": 60 * steps / seconds,
        "growth_bytes": resident_bytes() - before,
        "file_bytes": path.stat().st_size,
    }


class _Body:
    """An instance of the library with arrays for its loads and outputs."""

    def __init__(self, library: Path, token: str) -> None:
        self.library = ctypes.CDLL(str(library))
        instantiate = self.library.fmi2Instantiate
        instantiate.restype = ctypes.c_void_p
        self.place = ctypes.c_void_p(instantiate(b"body", 1, token.encode(), b"", None, 0, 0))
        if not self.place:
            sys.exit("the FMU was not instantiated")

    def step(self, at: float, loads: tuple[Any, Any], outputs: tuple[Any, Any]) -> None:
        library, size = self.library, ctypes.c_size_t
        failed = library.fmi2SetReal(self.place, loads[0], size(len(loads[0])), loads[1])
        failed += library.fmi2DoStep(self.place, ctypes.c_double(at), ctypes.c_double(STEP), 1)
        failed += library.fmi2GetReal(self.place, outputs[0], size(len(outputs[0])), outputs[1])
        if failed:
            sys.exit(f"a step at {at} s failed")


def _instance(library: Path, description: str) -> tuple[_Body, tuple[Any, Any], tuple[Any, Any]]:
    """The body, and references and values of its loads and of its outputs."""
    token = re.search(r'guid="([^"]+)"', description)
    variables = re.findall(r'<ScalarVariable name="([^"]+)" valueReference="(\d+)".*? causality="(\w+)"', description)
    loads = [int(number) for name, number, kind in variables if kind == "input" and not name.startswith("gravity")]
    outputs = [int(number) for _, number, kind in variables if kind == "output"]
    values = [0.01 * (k + 1) for k in range(len(loads))]
    return (
        _Body(library, "" if token is None else token[1]),
        ((ctypes.c_uint * len(loads))(*loads), (ctypes.c_double * len(loads))(*values)),
        ((ctypes.c_uint * len(outputs))(*outputs), (ctypes.c_double * len(outputs))()),
    )


CASES = {"fmu": fmu}
