"""Options that messages of importers name, in the form that the user has them: command line, job or Python.

Messages are written with options of the command line, such as ``--contact skip``. Where they leave for a job or for
Python, ``advising`` gives them the form ``contact = "skip"`` (key of ``[model]``) or ``contact="skip"`` (argument).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache

from morembs.base.arguments import hints_of
from morembs.base.errors import InputError
from morembs.base.limits import choices
from morembs.importers.decks.problems import DeckError, Form
from morembs.importers.options import OF_NUMBERS, PATHS, ImportOptions

_QUOTED = r"'[^']*'|\"[^\"]*\""
# Values as messages have them; of options with a few words as values these are the words.
_VALUES = {
    "skip": r"[A-Z\d][\w*-]*(?:,[A-Z\d][\w*-]*)*",
    "density": r"(?:X|[.\d][\w.+-]*)(?:,set=[^\s;]*[^\s;,])?",
    "material": r"young=[^\s;]*[^\s;,]",
    "set": r"[A-Za-z]\w*=[^\s;,]+",
    "units": r"\w+-\w+-\w+",
    "format": r"(?!out\b|was\b)[a-z]+(?:-[a-z]+)*",
    "engine": r"(?!out\b|was\b)[a-z]+(?::[^\s;]+)?",
    "allow_includes_outside": r"(?!)",
}
_NUMBER = r"N\b|\d[\d.e+-]*\b"
_PATH = r"[A-Z]{2,}\b|[^\s;,]+\.[a-z]\w*\b"
_BARE_KEY = re.compile(r"[\w-]+", re.ASCII)


@dataclass(frozen=True)
class Cure:
    """An ``option`` of an import by its name in Python, with the ``value`` that the command line takes, "" for none."""

    option: str
    value: str = ""

    @classmethod
    def of(cls, flag: str) -> Cure:
        """The cure that an option of the command line is, such as "--contact skip"."""
        name, _, value = flag.removeprefix("--").partition(" ")
        return cls(name.replace("-", "_"), value[1:-1] if re.fullmatch(_QUOTED, value) else value)

    def of_set(self) -> tuple[str, str]:
        """The element set that the value is for, "" without one, and the value."""
        value, _, name = self.value.partition("set=")
        return name.strip("'\""), value.rstrip(",")


def spell(option: str, cures: Sequence[Cure], form: Form) -> str:
    """The ``cures`` by one option as a key of ``[model]`` or as an argument."""
    python = isinstance(form, PythonForm)
    values = [cure.value for cure in cures if cure.value]
    if option == "material":
        made = [_material(*cure.of_set(), python=python) for cure in cures if cure.value]
        if python:
            return f"materials=[{', '.join(made)}]" if made else "materials"
        return " and ".join(made) or "[[material]]"
    if option == "allow_includes_outside":
        return f"{option}=True" if python else f"{option} = true"
    if not values:
        return option
    if option == "skip":
        value = json.dumps([word for text in values for word in text.split(",")])
    elif option == "set":
        value = _table([(key, json.dumps(name)) for key, _, name in (text.partition("=") for text in values)], python)
    elif option == "density" and (len(cures) > 1 or cures[0].of_set()[0]):
        value = _table([(name or "all", number) for name, number in (cure.of_set() for cure in cures)], python)
    else:
        value = values[-1] if option in OF_NUMBERS else json.dumps(values[-1])
    return f"{option}={value}" if python else f"{option} = {value}"


def _material(name: str, values: str, *, python: bool) -> str:
    given = [("set", json.dumps(name or "all")), *(part.split("=", 1) for part in values.split(",") if "=" in part)]
    equals = "=" if python else " = "
    words = ", ".join(f"{key}{equals}{value}" for key, value in given)
    return f"isotropic({words})" if python else f"[[material]] with {words}"


def _table(entries: Sequence[tuple[str, str]], python: bool) -> str:
    """A dictionary of Python, or a table of TOML."""
    if python:
        return "{" + ", ".join(f"{json.dumps(key)}: {value}" for key, value in entries) + "}"
    keys = [(key if _BARE_KEY.fullmatch(key) else json.dumps(key), value) for key, value in entries]
    return "{ " + ", ".join(f"{key} = {value}" for key, value in keys) + " }"


class JobForm(Form):
    """Keys of ``[model]`` and tables ``[[material]]``."""

    def phrase(self, text: str) -> str:
        """The text with options as keys; the first says where keys are."""
        named = [Cure.of(match[0]) for match in _pattern().finditer(text)]
        first = next((cure for cure in named if cure.option != "material"), None) if "[model]" not in text else None

        def rewrite(match: re.Match[str]) -> str:
            nonlocal first
            cure = Cure.of(match[0])
            words = spell(cure.option, [cure], self)
            if cure == first:
                first, words = None, f"{words} in [model]"
            return words

        return _pattern().sub(rewrite, text)

    def answer(self, source: str, flags: Sequence[str], command: str) -> str:
        """The keys that answer all problems."""
        groups = _by_option(flags)
        materials = spell("material", groups.pop("material"), self) if "material" in groups else ""
        keys = ", ".join(spell(option, cures, self) for option, cures in groups.items())
        return " and ".join(filter(None, [f"{keys} in [model]" if keys else "", materials]))


class PythonForm(Form):
    """Arguments of ``import_model`` and ``read_deck``."""

    def phrase(self, text: str) -> str:
        """The text with options as arguments."""
        return _pattern().sub(lambda match: spell((cure := Cure.of(match[0])).option, [cure], self), text)

    def answer(self, source: str, flags: Sequence[str], command: str) -> str:
        """The arguments that answer all problems."""
        return ", ".join(spell(option, cures, self) for option, cures in _by_option(flags).items())


JOB, PYTHON = JobForm(), PythonForm()


@contextmanager
def advising(form: Form) -> Iterator[None]:
    """Give the messages of what is refused inside another form.

    Raises:
        InputError: what was refused.
    """
    try:
        yield
    except DeckError as error:
        error.take(form)
        raise
    except InputError as error:
        error.as_typed = error.as_typed or str(error)
        error.args = (form.phrase(error.as_typed),)
        raise


def _by_option(flags: Sequence[str]) -> dict[str, list[Cure]]:
    """Cures by their options, each once."""
    groups: dict[str, list[Cure]] = {}
    for cure in dict.fromkeys(map(Cure.of, flags)):
        groups.setdefault(cure.option, []).append(cure)
    return groups


@cache
def _pattern() -> re.Pattern[str]:
    """Options of an import in a text, each with its value where it has one."""
    words = {name: choices(hint) for name, hint in hints_of(ImportOptions).items()}
    parts = []
    for name in [*(entry.name for entry in fields(ImportOptions)), "material"]:
        known = [rf"(?:{'|'.join(map(re.escape, words[name]))})(?![\w:-])"] if words.get(name) else []
        other = _VALUES.get(name) or (_NUMBER if name in OF_NUMBERS else _PATH if name in PATHS else "")
        values = "|".join(filter(None, [*known, other, _QUOTED]))
        parts.append(rf"{name.replace('_', '[-_]')}(?![\w-])(?: (?:{values}))?")
    return re.compile(rf"(?<![\w-])--(?:{'|'.join(parts)})")
