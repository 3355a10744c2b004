"""What a command says: errors in one message, the exit codes they mean, documents on standard output."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from morembs.base.errors import ExitCode, MorembsError, OutputError
from morembs.version import VERSION

if TYPE_CHECKING:
    from rich.console import Console


def echo(text: str, stream: TextIO | None = None) -> None:
    """A line on ``stream``, by default standard output; a process may have neither."""
    place = sys.stdout if stream is None else stream
    if place is not None:
        place.write(f"{text}\n")
        place.flush()


def tell(line: str) -> None:
    """A line on standard error; where that cannot be written there is nobody to tell, and the work goes on."""
    with suppress(OSError):
        echo(line, sys.stderr)


def warn(sentence: str) -> None:
    """A warning on standard error, before the work that it is about."""
    tell(f"warning: {sentence}")


class Failure(NamedTuple):
    """What went wrong in words, the exit code for it, and the kind and keyword of an error of this package."""

    message: str
    code: int
    kind: str = ""
    keyword: str = ""

    def document(self) -> dict[str, str]:
        """What ``--json`` says of it."""
        return {"error": self.message, "kind": self.kind, "keyword": self.keyword}


def failure(error: Exception) -> Failure:
    """The message of ``error`` for a user; the traceback of a fault of the program goes to a file."""
    if isinstance(error, MorembsError):
        return Failure(str(error), ExitCode.BAD_INPUT, error.kind, error.keyword)
    if isinstance(error, MemoryError):
        return Failure(
            "the memory did not suffice; give [solver] a memory budget and a scratch folder, take fewer modes, "
            'or see "morembs check" for a forecast',
            ExitCode.BAD_INPUT,
            "memory",
        )
    if isinstance(error, OSError):
        where = "" if error.filename is None else f" at {str(error.filename)!r}"
        reason = error.strerror or str(error) or type(error).__name__
        return Failure(f"the operating system refused a request{where}: {reason}", ExitCode.BAD_INPUT)
    return Failure(_fault(error), ExitCode.FAULT)


def _fault(error: Exception) -> str:
    # Messages of libraries may be long: 200 characters of the first line.
    first = (str(error).strip().splitlines() or [""])[0][:200]
    words = f"a fault of this program, {type(error).__name__}{first and ': '}{first}"
    trace = "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="morembs-fault-", suffix=".txt", encoding="utf-8", errors="replace", delete=False
        ) as file:
            file.write(f"morembs {VERSION}, {sys.platform}, Python {sys.version}\n{' '.join(sys.argv)}\n\n{trace}")
    except OSError:
        tell(trace)
        return f"{words}; please send the traceback above and the input to the authors of morembs"
    return f"{words}; please send {file.name}, which holds the full traceback, and the input to the authors of morembs"


@contextmanager
def printing(written: Sequence[str] = ()) -> Iterator[None]:
    """Around whatever prints results, once the files ``written`` are there.

    Raises:
        OutputError: standard output cannot be written.
    """
    try:
        yield
    except OSError as error:
        there = f"; written: {', '.join(written)}" if written else ""
        reason = error.strerror or type(error).__name__
        raise OutputError(f"the output cannot be printed ({reason}){there}") from error


def console() -> Console:
    """Standard output; a pipe or a file has no width that tables must fit."""
    from morembs.app.cli.screen import Screen
    from morembs.app.report.style import STYLE

    return Screen() if sys.stdout.isatty() else Screen(width=STYLE.pipe_width)


def print_json(documents: Sequence[object]) -> None:
    """A list, whether of one document or of several."""
    echo(json.dumps(list(documents), indent=2, allow_nan=False))


def print_names(about: Mapping[str, str], as_json: bool, before: Mapping[str, str] | None = None) -> None:
    """The names that an option takes and what each is, in text with what stands ``before`` some of them."""
    with printing():
        if as_json:
            print_json([{"name": name, "about": text} for name, text in about.items()])
        else:
            echo("\n".join(f"{(before or {}).get(name, '')}{name}: {text}" for name, text in about.items()))


def without_nan(value: Any) -> Any:
    """Arrays as lists and numbers, what is not finite as None: what JSON can say."""
    if isinstance(value, Mapping):
        return {name: without_nan(inner) for name, inner in value.items()}
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, list | tuple):
        return [without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
