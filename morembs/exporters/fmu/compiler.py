"""The C compiler of the system, and what single precision and steps cost."""

from __future__ import annotations

import ctypes
import errno
import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from morembs.base.types import Floats
from morembs.exporters.fmu.sources import Code
from morembs.exporters.tolerances import TOL

_CURE = (
    "install one (Debian: sudo apt-get install gcc libc6-dev; macOS: xcode-select --install), or name it by CC=..., "
    "and export again"
)
_FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)


def compiler() -> list[str]:
    """The command of the C compiler: CC of the environment, or what the system has; empty where there is none."""
    named = shlex.split(os.environ.get("CC", ""))
    for command in [named] if named else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return command
    return []


def compile_source(sources: Mapping[str, str], *flags: str) -> bytes | str:
    """The shared library of these sources, or why there is none.

    Raises:
        OSError: the disk is full.
    """
    command = compiler()
    if not command:
        return f"there is no C compiler here ({os.environ.get('CC') or 'cc, gcc, clang'}); {_CURE}"
    with TemporaryDirectory(prefix="morembs-") as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="ascii")
        units = [name for name in sources if name.endswith(".c")]
        options = ["-O2", "-ftree-vectorize", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden", "-pipe", *flags]
        try:
            ended = subprocess.run(
                [*command, *options, *units, "-o", "body.so", "-lm"],
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                env={**os.environ, "LC_ALL": "C", "TMPDIR": folder},
                check=False,
            )
        except OSError as error:
            return f"the C compiler {command[0]} cannot be run ({error.strerror}); {_CURE}"
        if ended.returncode == 0:
            return (Path(folder) / "body.so").read_bytes()
    for code in _FULL:
        if os.strerror(code) in ended.stderr:
            raise OSError(code, os.strerror(code))
    start = ended.stderr.strip()[: TOL.shown_compiler_words]
    first = next((line for line in ended.stderr.splitlines() if "error" in line.lower()), start)
    return f"the C compiler {command[0]} failed ({first}); {_CURE}"


def single_error(code: Code) -> float | str:
    """Largest difference of the outputs of ``code`` to those in double precision, relative to the largest of their
    kind, over ``single_precision_steps`` of random inputs (infinite where a step fails); or why that is not known.
    """
    results = []
    for precision in ("single", "double"):
        same = replace(code, precision=precision)
        library = compile_source(
            {f"{same.name}.h": same.header(), f"{same.name}.c": same.source()}, "-fvisibility=default"
        )
        if isinstance(library, str):
            return library
        results.append(_outputs(same, library))
    kinds = [variable.name.rpartition(".")[0] for variable in code.system.outputs]
    short, exact = results
    worst = 0.0 if np.isfinite(short).all() else np.inf
    for kind in dict.fromkeys(kinds) if not worst else ():
        at = [k for k, other in enumerate(kinds) if other == kind]
        size = float(np.abs(exact[:, at]).max())
        worst = max(worst, float(np.abs(short[:, at] - exact[:, at]).max()) / size if size else 0.0)
    return worst


def seconds_of_step(code: Code, size: float) -> float | None:
    """Processor time in s of one step of ``code`` of ``size`` in s, the mean of ``timed_steps`` after the first, which
    makes matrices; None where there is no compiler, or a step fails."""
    library = compile_source({f"{code.name}.h": code.header(), f"{code.name}.c": code.source()}, "-fvisibility=default")
    if isinstance(library, str):
        return None
    with _loaded(code, library, size) as (step, _):
        failed = bool(step())
        start = time.process_time()
        failed = failed or any(step() for _ in range(TOL.timed_steps))
        return None if failed else (time.process_time() - start) / TOL.timed_steps


@contextmanager
def _loaded(code: Code, library: bytes, size: float = 0.0) -> Iterator[tuple[Callable[[], int], Any]]:
    """A body that has started: its function that makes a step, of ``size`` in s where any can be, and its fields."""
    real: Any = ctypes.c_double if code.precision == "double" else ctypes.c_float
    fields = [(key, (ctypes.c_int if kind == "int" else real) * size) for key, (kind, size) in code.fields().items()]
    body = type("Body", (ctypes.Structure,), {"_fields_": fields})()
    with TemporaryDirectory(prefix="morembs-") as folder:
        path = Path(folder) / "body.so"
        path.write_bytes(library)
        loaded = ctypes.CDLL(str(path))
        getattr(loaded, f"{code.name}_start")(ctypes.byref(body))
        if code.fixed is None:
            yield partial(getattr(loaded, f"{code.name}_advance"), ctypes.byref(body), real(0.0), real(size)), body
        else:
            yield partial(getattr(loaded, f"{code.name}_step"), ctypes.byref(body)), body


def _outputs(code: Code, library: bytes) -> Floats:
    """Outputs (steps, m) under random inputs of about one."""
    steps = TOL.single_precision_steps
    inputs = np.random.default_rng(1).standard_normal((steps, len(code.system.inputs)))
    outputs = np.full((steps, len(code.system.outputs)), np.inf)
    with _loaded(code, library) as (step, body):
        for k in range(steps):
            body.u[: inputs.shape[1]] = inputs[k].tolist()
            if step():
                break
            outputs[k] = body.y[: outputs.shape[1]]
    return outputs
