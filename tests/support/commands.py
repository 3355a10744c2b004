"""What commands say and do."""

from __future__ import annotations

import logging
from collections.abc import Sequence

# Whoever makes a factor says so here.
FACTORISING = "morembs.linalg.sparse.solver"


def factorisations(records: Sequence[logging.LogRecord]) -> int:
    """How many matrices were factorised, by what was logged from the level INFO on."""
    return sum(record.name == FACTORISING and "factor entries" in record.msg for record in records)


def without_progress(errors: str) -> str:
    """Standard error of a command without its lines of progress, which only work that takes long writes."""
    return "".join(line for line in errors.splitlines(keepends=True) if not line.startswith("["))
