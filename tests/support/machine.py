"""What the operating system says about memory."""

from __future__ import annotations

from types import SimpleNamespace

import psutil
import pytest


def has_memory(monkeypatch: pytest.MonkeyPatch, *, free: int | None = None, resident: int | None = None) -> None:
    """A machine with so many bytes free, and this process with so many of them resident."""
    if free is not None:
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free))
    if resident is not None:
        monkeypatch.setattr(psutil.Process, "memory_info", lambda self: SimpleNamespace(rss=resident))
