"""Every error a user can meet; the command line turns each into one message and exit code 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Literal

from morembs.base.tolerances import TOL

Kind = Literal[
    "value", "missing", "unknown", "conflict", "unsupported", "file", "program", "model", "result", "memory", "output"
]


class ExitCode:
    """Exit codes of commands. Those of ``ALL``, also of the jobs of a batch, come with a message of the program."""

    DONE = 0
    FAULT = 1
    BAD_INPUT = 2
    ALL = (FAULT, BAD_INPUT)

    @staticmethod
    def of_signal(number: int) -> int:
        """Exit code of a command that signal ``number`` ended, as shells have it."""
        return 128 + number


class MorembsError(Exception):
    """Base of all errors raised on purpose: the message says what was given, expected, and what to do.

    Attributes:
        kind: what programs go by in place of words; docs/reference/commands.md has the meaning of each.
        keyword: the key, option, argument, card or file that the error is about, "" where there is none.

    >>> issubclass(InputError, MorembsError)
    True
    """

    kind: Kind = "result"
    keyword: str = ""

    def __init__(self, *args: object, kind: Kind | None = None, keyword: str = "") -> None:
        super().__init__(*args)
        self.kind, self.keyword = kind or self.kind, keyword or self.keyword

    def __reduce__(self) -> tuple[object, ...]:
        # Processes send errors to each other, and not every ``__init__`` can be called with the message alone.
        return _error_of, (type(self), self.args), vars(self)

    def restate(self, message: str) -> MorembsError:
        """An ``InputError`` of this kind about this keyword, with another message."""
        return InputError(message, kind=self.kind, keyword=self.keyword)


def _error_of(kind: type[MorembsError], arguments: tuple[object, ...]) -> MorembsError:
    error = kind.__new__(kind)
    MorembsError.__init__(error, *arguments)
    return error


class InputError(MorembsError, ValueError):
    """The input (file, key, set, material, mesh) cannot be used as given.

    >>> try:
    ...     isotropic(set="all", young=-1.0, poisson=0.3, density=7850.0)
    ... except InputError as error:
    ...     print(error)
    ...     print(error.kind, error.keyword)
    material of set 'all': young in Pa = -1.0 was given; expected a positive number
    value young
    """

    kind: Kind = "value"

    # The message with options as the command line has them, where it was given another form.
    as_typed: str = ""


class ArgumentError(InputError, TypeError):
    """A call with arguments that a function does not have, or without required ones."""


class SingularMatrixError(MorembsError, ArithmeticError):
    """A matrix that had to be regular is singular, most often a mechanism or an unconnected part."""

    kind: Kind = "model"


class SolverError(MorembsError, RuntimeError):
    """A linear solver or eigensolver failed, or its result did not pass the check that follows it."""


class BudgetError(SolverError):
    """The memory budget is too small; ``needed`` bytes would do."""

    kind: Kind = "memory"

    def __init__(self, message: str, *, needed: int, kind: Kind | None = None, keyword: str = "") -> None:
        super().__init__(message, kind=kind, keyword=keyword)
        self.needed = needed

    def restate(self, message: str) -> BudgetError:
        """The same with another message."""
        return BudgetError(message, needed=self.needed, kind=self.kind, keyword=self.keyword)


def enough_megabytes(size: float) -> int:
    """Whole megabytes that hold ``size`` bytes, and one more: two runs of a process differ by some pages."""
    return int(size) // 1_000_000 + 2


class OutputError(MorembsError, OSError):
    """A result could not be written; the file that was there before is untouched."""

    kind: Kind = "output"


class OverwriteError(MorembsError):
    """A result would take the place of a file that it is made from; nothing was written.

    No reader takes it for damage of that file, as it is no ``OSError`` and no ``ValueError``.
    """

    kind: Kind = "output"


def quote_value(value: object) -> str:
    """A value as a message quotes it."""
    text = " ".join(repr(value).split())
    return text if len(text) <= TOL.quoted_characters else text[: TOL.quoted_characters - 3] + "..."


def alike(name: str, known: Iterable[str]) -> str:
    """The known name most like ``name``, "" where none is."""
    known = sorted(known)
    same = [spelling for spelling in known if spelling.lower() == name.lower()]
    return next(iter(same or difflib.get_close_matches(name, known, n=1, cutoff=0.5)), "")


def nearest(name: str, known: Iterable[str]) -> str:
    """Words for an error message: the known name most like ``name``, else the list of all."""
    known = sorted(known)
    close = alike(name, known)
    return f"did you mean {close!r}?" if close else "known: " + (", ".join(known) if known else "none")
