"""What commands say."""

from __future__ import annotations


def without_progress(errors: str) -> str:
    """Standard error of a command without its lines of progress, which only work that takes long writes."""
    return "".join(line for line in errors.splitlines(keepends=True) if not line.startswith("["))
