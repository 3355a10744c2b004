"""Everything that is wrong with a deck in one message, with what to do about each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from morembs.base.errors import InputError
from morembs.importers.tolerances import TOL

_OWN_NAMES = re.compile(r"'[^']*'|\"[^\"]*\"|\([^()]*\)|\d+(\.\d*)?(e[-+]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One thing that keeps a deck from being read.

    ``what`` is the sentence that says it, with its cure; ``file``, ``line`` (0: not known) and ``keyword`` say where;
    ``flags`` are the options of the command line that answer it, such as ("--contact skip",), empty if none does;
    ``element_set`` is the set whose material is not complete.
    """

    what: str
    file: str = ""
    line: int = 0
    keyword: str = ""
    flags: tuple[str, ...] = ()
    element_set: str = ""

    @property
    def kind(self) -> str:
        """What problems of one kind have in common: the sentence without names and numbers."""
        return f"{self.keyword}: {_OWN_NAMES.sub('#', self.what)}"


class DeckError(InputError):
    """A deck with ``problems``; the message lists them by kind, and ends with a ``hint`` at another way."""

    def __init__(self, source: str, problems: Sequence[Problem], given: Sequence[str] = (), *, hint: str = "") -> None:
        self.source, self.problems, self.given, self.hint = source, tuple(problems), tuple(given), hint
        super().__init__(_message(source, self.problems, self.given) + (f"; {hint}" if hint else ""))


class Problems:
    """Collects the problems of one deck.

    Args:
        source: the name of its file.
        given: options that the deck is read with, as the command line has them, for the advice.
    """

    def __init__(self, source: str, given: Sequence[str] = ()) -> None:
        self.source, self.given = source, tuple(given)
        self.entries: list[Problem] = []

    def add(self, problem: Problem) -> None:
        """One more."""
        self.entries.append(problem)

    @contextmanager
    def collected(self, where: object = None, flags: tuple[str, ...] = ()) -> Iterator[None]:
        """What is refused inside becomes a problem of the card ``where`` (with file, line and keyword)."""
        try:
            yield
        except DeckError as error:
            self.entries += error.problems
        except InputError as error:
            self.entries.append(
                Problem(
                    what=str(error),
                    file=getattr(where, "file", ""),
                    line=getattr(where, "line", 0),
                    keyword=getattr(where, "keyword", ""),
                    flags=flags,
                )
            )

    @contextmanager
    def ending(self) -> Iterator[None]:
        """What is refused inside ends the reading: it is raised together with all that was found before.

        Raises:
            DeckError: anything was refused.
        """
        try:
            yield
        except DeckError:
            raise
        except InputError as error:
            self.add(Problem(what=str(error), file=self.source))
            self.refuse()

    def refuse(self) -> None:
        """Raise what was found.

        Raises:
            DeckError: anything was.
        """
        if self.entries:
            raise DeckError(self.source, self.entries, self.given)


def _message(source: str, problems: Sequence[Problem], given: Sequence[str]) -> str:
    kinds: dict[str, list[Problem]] = {}
    for problem in problems:
        kinds.setdefault(problem.kind, []).append(problem)
    if len(problems) == 1:
        text = problems[0].what
    else:
        lines = [f"({i}) {_line(same)}" for i, same in enumerate(list(kinds.values())[: TOL.shown_problems], start=1)]
        rest = len(kinds) - TOL.shown_problems
        lines += [f"and {rest} more kinds"] * (rest > 0)
        text = f"{source} has {len(problems)} problems: {'; '.join(lines)}"
    answer = answered_by(source, problems, given)
    return f"{text}; all of it is answered by: {answer}" if answer else text


def answered_by(source: str, problems: Sequence[Problem], given: Sequence[str] = ()) -> str:
    """The command line that answers all problems, empty where options do not answer some of them."""
    if not problems or not all(problem.flags for problem in problems):
        return ""
    return f"morembs import {source} {_flags([*given, *(flag for problem in problems for flag in problem.flags)])}"


def _line(same: list[Problem]) -> str:
    where = [str(problem.line) for problem in same if problem.line]
    places = f" (lines {', '.join(where[:5])}{', ...' if len(where) > 5 else ''})" if len(where) > 1 else ""
    return f"{len(same)} times{places}, first: {same[0].what}" if len(same) > 1 else same[0].what


def _flags(flags: Iterable[str]) -> str:
    """The options once each; those that take a list joined by commas."""
    joined: dict[str, list[str]] = {}
    for flag in dict.fromkeys(flags):
        name, _, value = flag.partition(" ")
        joined.setdefault(name, []).append(value)
    parts = []
    for name, values in joined.items():
        if name == "--skip":
            words = ",".join(values)
            parts.append(f'--skip "{words}"' if " " in words else f"--skip {words}")
        else:
            parts += [f"{name} {value}".rstrip() for value in values]
    return " ".join(parts)
