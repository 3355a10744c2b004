"""Signals that end a run, remembered so that none is lost.

The handler of a signal raises an exception, and Python drops exceptions where nobody could catch them: in callbacks of
weak references, in ``__del__``, in callbacks from foreign libraries; libraries turn them into errors of their own. So
the signal is kept too: what was dropped is raised again a moment later, work looks at ``check`` between its steps and
before it gives a file its name, and ``stop_signal`` tells at the end how the run has to end. A library can end the
process too, and with a code of its own (STOP in Fortran is exit code 0): ``end_with`` sets the code that counts. That
is for a process that does nothing else: a program that calls the command line keeps its own end and its own handlers.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from morembs.base.errors import ExitCode
from morembs.base.tolerances import TOL

# SIGHUP is none of Windows, nor is the timer.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_HAS_TIMER = hasattr(signal, "setitimer")

_asked: list[tuple[int, float]] = []
_waiting: list[bool] = []


def stop_signal() -> int | None:
    """The signal that asks this process to end, None without one."""
    return _asked[0][0] if _asked else None


def check() -> None:
    """Raise KeyboardInterrupt or SystemExit if a signal has come that was not heeded."""
    if _asked:
        _set_timer(0.0)
        _stop()


@contextmanager
def whole_step() -> Iterator[None]:
    """A short step that is not interrupted: a signal within it is heeded at its end."""
    before = stop_signal()
    _waiting.append(True)
    try:
        yield
    finally:
        _waiting.pop()
    if not _waiting and before is None:
        check()


@contextmanager
def handle_signals(*, ends: bool = False, clock: Callable[[], float] = time.monotonic) -> Iterator[None]:
    """Heed SIGINT, SIGTERM and SIGHUP within; signals that this process ignored before stay ignored.

    Python lets the main thread alone take signals: in another one they do what the program has them do.

    A second request ends the process at once. ``ends`` says that the process ends afterwards: with the
    code of the signal on every way out, and by the system when one comes later. Otherwise handlers are as before.
    """

    def handle(number: int, _: object) -> None:
        now = clock()
        if not _asked:
            _asked.append((number, now))
            if ends:
                end_with(ExitCode.of_signal(number))
        elif now - _asked[0][1] >= TOL.same_request_seconds:
            os._exit(ExitCode.of_signal(_asked[0][0]))
        else:
            return
        if not _waiting:
            _stop()

    def drop_unless_stopping(what: Any) -> None:
        # A library may have made an error of its own of the exception.
        if _asked and _stops(what.exc_value):
            _set_timer(TOL.raise_again_seconds)
        else:
            drop(what)

    def print_unless_stopping(kind: type[BaseException], error: BaseException, trace: Any) -> None:
        # Cython prints what it drops before it says so.
        if _asked and _stops(error):
            _set_timer(TOL.raise_again_seconds)
        else:
            show(kind, error, trace)

    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    handlers: dict[int, Any] = {number: handle for number in numbers if signal.getsignal(number) is not signal.SIG_IGN}
    if _HAS_TIMER:
        handlers[signal.SIGALRM] = lambda *_: check()
    if threading.current_thread() is not threading.main_thread():
        handlers.clear()
    _asked.clear()
    drop, sys.unraisablehook = sys.unraisablehook, drop_unless_stopping
    show, sys.excepthook = sys.excepthook, print_unless_stopping
    replaced = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        _set_timer(0.0)
        for number, handler in replaced.items():
            # None stands for one that was not made in Python.
            signal.signal(number, signal.SIG_DFL if ends or handler is None else handler)
        sys.unraisablehook, sys.excepthook = drop, show


def end_with(code: int) -> None:
    """Have this process end with ``code`` on each call of ``exit`` from now on; the last call counts.

    The functions that the C library calls at the end run in the reverse of their order, and ``_exit`` is the last of
    any process. Where the C library cannot be asked nothing changes.
    """
    try:
        c_library = ctypes.CDLL(None)
        c_library.__cxa_atexit(ctypes.cast(c_library._exit, ctypes.c_void_p), ctypes.c_void_p(code), None)
    except (OSError, TypeError, AttributeError):
        return


def _stops(error: BaseException | None) -> bool:
    return error is not None and (
        isinstance(error, KeyboardInterrupt | SystemExit) or _stops(error.__cause__ or error.__context__)
    )


def _stop() -> None:
    number = _asked[0][0]
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(ExitCode.of_signal(number))


def _set_timer(seconds: float) -> None:
    if _HAS_TIMER:
        signal.setitimer(signal.ITIMER_REAL, seconds)
