"""Everything that is wrong with a deck in one message, with what to do about each."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from morembs.base.errors import InputError, Kind
from morembs.importers.tolerances import TOL

# Before a clause that names an option.
_CURE = re.compile(r"; (?=[^;]*--\w)")
# How a message begins that knows its place: the file, the line and mostly the card.
_PLACE = re.compile(r"(?P<file>[^:]+), line (?P<line>\d+): (?:\*?(?P<keyword>[A-Z][A-Z\d -]*[A-Z\d])\b)?")
_OWN_NAMES = re.compile(r"'[^']*'|\"[^\"]*\"|\([^()]*\)|\d+(\.\d*)?(e[-+]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One thing that keeps a deck from being read.

    ``what`` is the sentence that says it, with its cure; ``kind`` is that of an error; ``file``, ``line`` (0: not
    known) and ``keyword`` say where; ``flags`` are the options of the command line that
    answer it, such as ("--contact skip",), empty if none does.
    """

    what: str
    kind: Kind = "unsupported"
    file: str = ""
    line: int = 0
    keyword: str = ""
    flags: tuple[str, ...] = ()

    @classmethod
    def of(cls, error: InputError, source: str, where: object = None, flags: tuple[str, ...] = ()) -> Problem:
        """What an error says of the card ``where``, or of the place that it names itself, in the file ``source``."""
        named = _PLACE.match(str(error))
        of_error = named.groupdict(default="") if named else {"file": source, "line": "0", "keyword": ""}
        return cls(
            what=str(error),
            kind=error.kind,
            file=getattr(where, "file", "") or of_error["file"],
            line=getattr(where, "line", 0) or int(of_error["line"]),
            keyword=getattr(where, "keyword", "")
            or next(map(_skipped_word, flags), "")
            or of_error["keyword"]
            or error.keyword,
            flags=flags,
        )

    @property
    def placed(self) -> str:
        """The sentence with its file and line, where it does not say them itself."""
        if not self.line or re.search(rf"line {self.line}\b", self.what):
            return self.what
        return f"{self.file}, line {self.line}: {self.what.removeprefix(f'{self.file}: ')}"

    def phrase(self, form: Form) -> Problem:
        """The same with options in another form."""
        return replace(self, what=form.phrase(self.what))

    @property
    def pattern(self) -> str:
        """The sentence without names and numbers, by which problems are listed together."""
        return f"{self.keyword}: {_OWN_NAMES.sub('#', self.what)}"


class Form:
    """How messages name options: as the command line has them. ``importers.advice`` has those of jobs and of Python."""

    def phrase(self, text: str) -> str:
        """A text, which names options as the command line has them, in this form."""
        return text

    def answer(self, source: str, flags: Sequence[str], command: str) -> str:
        """What answers all problems of ``source``: a command line, keys or arguments with all ``flags``."""
        plain = " ".join(["morembs import", shlex.quote(source)])
        return " ".join([command or plain, *_join(flags)])


class DeckError(InputError):
    """A deck with ``problems``, each once; the message lists them by pattern, and ends with a ``hint`` at another way.
    Its kind and keyword are those of the first.

    ``command`` is the command line that asked for the deck, quoted for a shell, where there is one; ``form`` is how
    options are named.
    """

    def __init__(
        self, source: str, problems: Sequence[Problem], given: Sequence[str] = (), *, hint: str = "", command: str = ""
    ) -> None:
        self.source, self.problems, self.given = source, tuple(dict.fromkeys(problems)), tuple(given)
        self.hint, self.command, self.form = hint, command, Form()
        super().__init__("; ".join(self._list_problems()))
        if self.problems:
            self.kind, self.keyword = self.problems[0].kind, self.problems[0].keyword

    def take(self, form: Form) -> None:
        """Name options in another form from now on."""
        self.form = form
        self.args = ("; ".join(self._list_problems()),)

    @property
    def answer(self) -> str:
        """What answers all problems, such as a command line; empty where options do not answer some of them."""
        if not self.problems or not all(problem.flags for problem in self.problems):
            return ""
        flags = [flag for problem in self.problems for flag in problem.flags]
        return self.form.answer(self.source, flags if self.command else [*self.given, *flags], self.command)

    def of_command(self, command: str) -> DeckError:
        """The same of another command line."""
        return DeckError(self.source, self.problems, self.given, hint=self.hint, command=command)

    def lines(self) -> list[str]:
        """The message in lines, each with one cure at most."""
        return [line for part in self._list_problems() for line in in_lines(part)]

    def _list_problems(self) -> list[str]:
        """The problems by kind, the command that answers them, and the hint."""
        kinds: dict[str, list[Problem]] = {}
        for problem in self.problems:
            kinds.setdefault(problem.pattern, []).append(problem)
        if len(self.problems) == 1:
            listed = [self.problems[0].placed]
        else:
            listed = [
                f"({i}) {_line(same)}" for i, same in enumerate(list(kinds.values())[: TOL.shown_problems], start=1)
            ]
            rest = len(kinds) - TOL.shown_problems
            listed += [f"and {rest} more kinds"] * (rest > 0)
            listed[0] = f"{self.source} has {len(self.problems)} problems: {listed[0]}"
        answer = [f"cure of all problems: {self.answer}"] if self.answer else []
        lines = [*listed, *([self.hint] if self.hint else [])]
        lines = [self.form.phrase(line) for line in lines]
        return [*lines[: len(listed)], *answer, *lines[len(listed) :]]


class Problems:
    """Collects the problems of one deck.

    Args:
        source: the name of its file.
        given: options that the deck is read with, as the command line has them, for the advice.
        hint: what the message ends with.
    """

    def __init__(self, source: str, given: Sequence[str] = (), *, hint: str = "") -> None:
        self.source, self.given, self.hint = source, tuple(given), hint
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
            self.add(Problem.of(error, self.source, where, flags))

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
            self.add(Problem.of(error, self.source))
            self.refuse()

    def refuse(self) -> None:
        """Raise what was found.

        Raises:
            DeckError: anything was.
        """
        if self.entries:
            raise DeckError(self.source, self.entries, self.given, hint=self.hint)


def _skipped_word(flag: str) -> str:
    """The word that an option leaves out, "" for other options."""
    return flag.removeprefix("--skip ") if flag.startswith("--skip ") else ""


def quote_option(flag: str) -> str:
    """An option of the command line with its value, as a shell takes it."""
    name, _, value = flag.partition(" ")
    return f"{name} {shlex.quote(value)}" if value else name


def in_lines(sentence: str) -> list[str]:
    """A sentence in lines, each cure (an option of the command line) in one of its own."""
    return _CURE.sub("\n    ", sentence).split("\n")


def _line(same: list[Problem]) -> str:
    if len(same) == 1:
        return same[0].placed
    where = [str(problem.line) for problem in same if problem.line]
    places = f" (lines {', '.join(where[:5])}{', ...' if len(where) > 5 else ''})" if len(where) > 1 else ""
    return f"{len(same)} times{places}, first: {same[0].placed}"


def _join(flags: Iterable[str]) -> list[str]:
    """The options once each, quoted for a shell; lists are joined by commas."""
    values: dict[str, list[str]] = {}
    for flag in dict.fromkeys(flags):
        name, _, value = flag.partition(" ")
        values.setdefault(name, []).append(value)
    given = [(name, [",".join(own)] if name == "--skip" else own) for name, own in values.items()]
    return [quote_option(f"{name} {value}".rstrip()) for name, own in given for value in own]
