"""Options of reducers, importers and exporters: the keyword-only parameters of what is called with them.

A frozen ``dataclass(kw_only=True)`` is such a schema, and so is a function with keyword-only parameters. Names, types
and required options are checked in one place, so that all of them are refused with the same words.
"""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from morembs.base.errors import InputError, nearest, quote_value


class Text(str):
    """The text of a value, as the command line has it: it becomes what the type of its option asks for."""

    __slots__ = ()


def pairs(texts: Iterable[str], flag: str = "--set") -> dict[str, Text]:
    """KEY=VALUE of the command line.

    Raises:
        InputError: no "=", or a key twice.
    """
    options: dict[str, Text] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError(f"{flag} {text!r} was given; expected {flag} {key or 'KEY'}=VALUE", keyword=key)
        if key in options:
            raise InputError(f"{flag} {key} was given twice; give it once", kind="conflict", keyword=key)
        options[key] = Text(value)
    return options


def list_options(schema: Callable[..., object]) -> dict[str, bool]:
    """Name of each option -> whether it must be given."""
    parameters = inspect.signature(schema).parameters.values()
    return {option.name: option.default is option.empty for option in parameters if option.kind is option.KEYWORD_ONLY}


def read_options(
    schema: Callable[..., object],
    given: Mapping[str, object],
    owner: str,
    *,
    where: str = "",
    word: str = "option",
    besides: Iterable[str] = (),
    hidden: Iterable[str] = (),
    cure: str = "",
) -> dict[str, Any]:
    """The options ``given`` as ``schema`` takes them.

    Args:
        owner: whose options they are, such as ``export to 'sid'``.
        where: beginning of a message, such as "[[reduce]] 'cb': ".
        word: the word for an option.
        besides: names that are known too, for advice.
        cure: what to do about a missing option {key}.
        hidden: parameters of ``schema`` that are no options.

    Raises:
        InputError: an option that there is not, one of a wrong type, or one that is missing.
    """
    # Not at the top: commands without options do without NumPy.
    from morembs.base.arguments import hints_of

    names = {name: must for name, must in list_options(schema).items() if name not in set(hidden)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key not in names:
            advice = nearest(key, [*names, *besides]) if names else f"it has no {word}s"
            raise InputError(f"{where}{owner} has no {word} {key!r}; {advice}", kind="unknown", keyword=key)
        values[key] = _convert_option(hints_of(schema).get(key, Any), key, value, where or f"{owner}: ")
    missing = [name for name, must in names.items() if must and name not in values]
    if missing:
        raise InputError(
            f"{where}{owner} needs the {word} {', '.join(missing)}{cure.format(key=missing[0])}",
            kind="missing",
            keyword=missing[0],
        )
    return values


def _convert_option(hint: Any, key: str, value: object, where: str) -> Any:
    """``value`` if it is one of the type ``hint``; of a ``Text`` the first reading that is."""
    from morembs.base.arguments import fits, words

    for reading in readings(value) if isinstance(value, Text) else [value]:
        if fits(reading, hint):
            return reading
    given = f"{key}={value}" if isinstance(value, Text) else f"{key} = {in_toml(value)}"
    raise InputError(f"{where}{given} was given; expected {words(hint)}", keyword=key)


def readings(text: Text) -> list[object]:
    """Readings of a text: a TOML value, itself, or words between commas. The last is the most likely one."""
    values: list[object] = []
    for spelling in (text, text.lower()):
        try:
            values.append(tomllib.loads(f"value = {spelling}")["value"])
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            continue
    return [*values, str(text), [part for part in text.split(",") if part], *values[-1:]]


def in_toml(value: object) -> str:
    """A value as it stands in a file, cut to a readable length."""
    return str(value).lower() if isinstance(value, bool) else quote_value(value)
