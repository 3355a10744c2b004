"""What commands say and do."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from typer.testing import CliRunner

from morembs.app.cli import app

# Whoever makes a factor says so here.
FACTORISING = "morembs.linalg.sparse.factorization"
OLD_RESULT = b"what was there before"


def factorisations(records: Sequence[logging.LogRecord]) -> int:
    """How many matrices were factorised, by what was logged from the level INFO on."""
    return sum(record.name == FACTORISING and "factor entries" in record.msg for record in records)


def without_progress(errors: str) -> str:
    """Standard error of a command without its lines of progress, which only work that takes long writes."""
    return "".join(line for line in errors.splitlines(keepends=True) if not line.startswith("["))


def run(*arguments: object, code: int = 0) -> str:
    """Standard output of a command that succeeds; standard error of one that ends with another ``code``."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code and isinstance(result.exception, SystemExit | None), (result.output, result.stderr)
    return result.stderr if code else result.stdout


def refused(job: Path, verbs: Sequence[str] = ("reduce", "check")) -> str:
    """The message of a job that must fail; checks all that holds for every failure."""
    message = ""
    output = job.parent / "part.h5"
    for verb in verbs:
        output.write_bytes(OLD_RESULT)
        before = sorted(job.parent.iterdir())
        result = CliRunner().invoke(app, [verb, str(job)])
        assert result.exit_code == 2, (verb, result.stdout, result.stderr)
        assert isinstance(result.exception, SystemExit), result.exception
        assert result.stdout == ""
        message = result.stderr
        assert message.startswith("error: ")
        assert message.count("error: ") == 1
        assert len(message.strip().splitlines()) == 1
        assert "Traceback" not in message
        assert output.read_bytes() == OLD_RESULT
        assert sorted(job.parent.iterdir()) == before
    return message
