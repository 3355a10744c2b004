"""What rich draws: the console, and a line of progress on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Timer
from typing import Any

from rich.console import Console

from morembs.app.cli.tolerances import TOL
from morembs.base.progress import Progress


class Screen(Console):
    """A console that shows names as they are, and leaves a pipe without a reader to its caller instead of ending."""

    def __init__(self, **options: Any) -> None:
        super().__init__(emoji=False, **options)

    def on_broken_pipe(self) -> None:
        """Called while the error is handled."""
        raise


class TerminalProgress:
    """A line on standard error that says what is going on, once that takes more than ``patience`` seconds."""

    def __init__(self, screen: Console, visible: bool, *, patience: float = TOL.progress_patience_seconds) -> None:
        # Not at the top: what shows tables alone does without.
        from rich.progress import Progress as Bar
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        self._bar = Bar(*columns, console=screen, transient=True, disable=not visible)
        self._task = self._bar.add_task("", total=None)
        self._timer = Timer(patience, self._bar.start)
        self._timer.daemon = True
        self._stage = ""

    def stage(self, name: str) -> None:
        """A new stage begins."""
        self._stage = name
        self._bar.update(self._task, description=name)

    def update(self, text: str) -> None:
        """News within the stage."""
        self._bar.update(self._task, description=f"{self._stage}: {text}" if self._stage else text)

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Show the line while work goes on, and take it away afterwards."""
        self._timer.start()
        try:
            yield self
        finally:
            self._timer.cancel()
            self._timer.join()
            # A terminal that has gone does not end the work.
            with suppress(OSError):
                self._bar.stop()
