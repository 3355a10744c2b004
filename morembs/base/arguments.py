"""Arguments of public types and functions, checked against their type hints before anything is done with them.

A hint is a type, or a type with its limits (``morembs.base.limits``). This is the only check of types: arguments,
options and keys of job files go through it, and messages about them say in the same words what was expected.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import operator
import sys
import types
from collections import abc
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from morembs.base.errors import ArgumentError, InputError, nearest, quote_value
from morembs.base.limits import Bounded, Domain, alternatives

Target = TypeVar("Target", bound=Callable[..., Any])
ARRAY_LIKE = frozenset(get_args(ArrayLike))
_SEVERAL = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def refuse_out_of_range(what: str, values: Iterable[float]) -> None:
    """Refuse numbers that are not finite, or so large that the products they go into are not.

    Raises:
        InputError: there is one.
    """
    for value in values:
        check_value(what, value, Bounded)


def checked(target: Target) -> Target:
    """Decorator: a class or function that refuses arguments that are not as its hints say.

    An argument ``name`` tells objects of one class apart in the message.
    Numbers must not be NaN, arrays must hold numbers; shapes are left to the one who is called. Hints that say nothing
    about values, such as those of sparse matrices, take anything.

    Raises:
        InputError: (when called) an argument of another type, or beyond its limits.
        ArgumentError: (when called) an argument that is unknown or missing, or by place where it has a name.
    """
    call: Callable[..., Any] = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    signature = inspect.signature(call)

    @functools.wraps(call)
    def call_checked(*args: Any, **kwargs: Any) -> Any:
        hints = hints_of(target)
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            own_args = args[isinstance(target, type) :]
            raise _misfit(target, own_args, kwargs) or ArgumentError(f"{target.__qualname__}: {error}") from None
        own = target.__qualname__.rpartition("<locals>.")[2]
        if isinstance(given.get("name"), str):
            own += f" {given['name']!r}"
        for name, value in given.items():
            # A default is right whatever its hint.
            if value is not signature.parameters[name].default:
                check_value(f"{own}: {name}", value, hints.get(name, Any))
        return call(*args, **kwargs)

    if isinstance(target, type):
        target.__init__ = call_checked  # type: ignore[misc]
        return target
    return call_checked  # type: ignore[return-value]


def explain_misfit(target: Target) -> Target:
    """Decorator: a class or function that says which arguments it has when a call does not fit; it checks their values
    itself.

    Raises:
        ArgumentError: (when called) an argument that is unknown or missing, or by place where it has a name.
    """
    call: Callable[..., Any] = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    itself = isinstance(target, type)

    @functools.wraps(call)
    def call_or_explain(*args: Any, **kwargs: Any) -> Any:
        misfit = _misfit(target, args[itself:], kwargs)
        if misfit:
            raise misfit
        return call(*args, **kwargs)

    if isinstance(target, type):
        target.__init__ = call_or_explain  # type: ignore[misc]
        return target
    return call_or_explain  # type: ignore[return-value]


def _misfit(target: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]) -> ArgumentError | None:
    """Why these arguments cannot be those of ``target``: unknown, by place in place of by name, or missing."""
    own = target.__qualname__.rpartition("<locals>.")[2]
    every = inspect.signature(target).parameters.values()
    kinds, parameters = {each.kind for each in every}, [each for each in every if each.kind not in _SEVERAL]
    names = [each.name for each in parameters]
    hints = hints_of(target)
    unknown = next((name for name in kwargs if name not in names), None)
    if unknown is not None and inspect.Parameter.VAR_KEYWORD not in kinds:
        advice = nearest(unknown, names) if names else "it takes none"
        return ArgumentError(f"{own} has no argument {unknown!r}; {advice}", kind="unknown", keyword=unknown)
    by_place = [each.name for each in parameters if each.kind is not inspect.Parameter.KEYWORD_ONLY]
    if len(args) > len(by_place) and inspect.Parameter.VAR_POSITIONAL not in kinds:
        if not names:
            return ArgumentError(f"{own} takes no arguments")
        left, named = iter(parameters), []
        for value in args:
            fitting = next((each.name for each in left if fits(value, hints.get(each.name, Any))), None)
            named += [f"{fitting}={quote_value(value)}"] if fitting else []
        count = f"{', '.join(by_place)} by place and others" if by_place else "arguments"
        return ArgumentError(f"{own} takes {count} by name, as in {own}({', '.join(named)})")
    for each in parameters[len(args) :]:
        if each.default is inspect.Parameter.empty and each.name not in kwargs:
            message = f"{own} needs {each.name} = ...: {words(hints.get(each.name, Any))}"
            return ArgumentError(message, kind="missing", keyword=each.name)
    return None


def check_options(options: Any, where: str = "") -> None:
    """Refuse a dataclass ``options`` with a field that is not as its hint says; ``where`` begins the message.

    Raises:
        InputError: there is one.
    """
    hints = hints_of(type(options))
    for entry in fields(options):
        value = getattr(options, entry.name)
        if value is not entry.default:
            check_value(f"{where}{entry.name}", value, hints.get(entry.name, Any))


def check_value(name: str, value: object, hint: Any) -> None:
    """Refuse a ``value`` called ``name`` that is not as ``hint`` says.

    ``name`` may begin with a place, as in "interface 'tip': components", and end with a unit, as in "young in Pa".

    Raises:
        InputError: in these cases.
    """
    if not fits(value, hint):
        keyword = name.rpartition(": ")[2].partition(" ")[0]
        given = quote_value(value)
        if type(value).__module__.startswith("morembs") and not isinstance(value, type):
            # What an object holds says nothing about why it does not fit.
            given = f"one {type(value).__name__}"
        raise InputError(f"{name} = {given} was given; expected {words(hint)}", keyword=keyword)


def hints_of(target: Any) -> dict[str, Any]:
    """Name of each field or parameter -> its hint with limits; hints for type checkers alone are left out."""
    return _hints_of(target)


@functools.cache
def _hints_of(target: Any) -> dict[str, Any]:
    known: dict[str, Any] = {}
    for name, annotation, module in _annotations(target):
        one = types.SimpleNamespace(__annotations__={name: annotation})
        # Types that only type checkers import say nothing here.
        with contextlib.suppress(NameError):
            known |= get_type_hints(one, vars(sys.modules[module]), include_extras=True)
    return known


def _annotations(target: Any) -> Iterator[tuple[str, Any, str]]:
    """Name, annotation and module of each; fields of a dataclass are those of the classes that it derives from too."""
    call: Callable[..., Any] = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    parameters = inspect.signature(call).parameters
    if isinstance(target, type) and is_dataclass(target):
        for holder in reversed(target.__mro__):
            for name, annotation in inspect.get_annotations(holder).items():
                if name in parameters:
                    yield name, annotation, holder.__module__
        return
    for name, parameter in parameters.items():
        if parameter.kind not in _SEVERAL and parameter.annotation is not parameter.empty:
            yield name, parameter.annotation, call.__module__


def fits(value: Any, hint: Any) -> bool:
    """True if ``value`` is of the type ``hint``, numbers of NumPy and arrays in place of sequences included."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        return fits(value, parts[0]) and all(part.passes(value) for part in parts[1:] if isinstance(part, Domain))
    if kind in (Union, types.UnionType):
        return any(fits(value, part) for part in _alternatives(parts))
    if np.ndarray in (hint, kind):
        return _is_array(value, parts)
    if kind is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if isinstance(kind, type) and issubclass(kind, abc.Callable):  # type: ignore[arg-type]
        return callable(value)
    if isinstance(kind, type) and issubclass(kind, abc.Mapping):
        return isinstance(value, abc.Mapping) and all(
            fits(key, parts[0]) and fits(each, parts[1]) for key, each in value.items()
        )
    if kind is tuple and parts[-1] is not Ellipsis:
        return _is_sequence(value) and len(value) == len(parts) and all(map(fits, value, parts))
    if isinstance(kind, type) and issubclass(kind, abc.Iterable):
        # A text is a sequence of texts, and no list.
        return kind is not list if isinstance(value, str) and parts[0] is str else _all_fit(value, parts[0])
    return _is_one(value, hint)


def _is_one(value: Any, hint: Any) -> bool:
    """``fits`` for hints without parts."""
    if hint in (float, int):
        return _is_number(value, hint)
    if hint is bool:
        return isinstance(value, bool | np.bool_)
    if hint is Any or not isinstance(hint, type) or hint.__module__.startswith("scipy"):
        return True
    if getattr(hint, "_is_protocol", False):
        return all(hasattr(value, name) for base in hint.__mro__[:-2] for name in _members(base))
    return isinstance(value, hint)


def _members(protocol: type) -> set[str]:
    return {name for name in (*vars(protocol), *getattr(protocol, "__annotations__", ())) if name[0] != "_"}


def _alternatives(parts: tuple[Any, ...]) -> list[Any]:
    """Parts of a union, an array in place of all that makes up ``ArrayLike``."""
    if not set(parts) >= ARRAY_LIKE:
        return list(parts)
    return [np.ndarray, *(part for part in parts if part not in ARRAY_LIKE)]


def _is_number(value: Any, hint: type) -> bool:
    if isinstance(value, bool | np.bool_ | str | bytes):
        return False
    try:
        if np.ndim(value):
            return False
        number = operator.index(value) if hint is int else float(value)
    except (TypeError, ValueError, OverflowError):
        return False
    return number == number


def _is_array(value: Any, parts: tuple[Any, ...]) -> bool:
    """True if it holds real numbers; ``parts`` of a hint NDArray ask for one axis or more, and maybe integers."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return False
    if array.dtype.kind == "O":
        # Numbers of other kinds, such as fractions.
        try:
            array = array.astype(float)
        except (TypeError, ValueError):
            return False
    whole = parts and np.issubdtype(get_args(parts[1])[0], np.integer)
    numbers = array.dtype.kind in "biu" or (array.dtype.kind == "f" and not (whole and (array % 1 != 0).any()))
    return (numbers or not array.size) and array.ndim >= bool(parts)


def _is_sequence(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, abc.Sequence) and not isinstance(value, str | bytes)


def _all_fit(value: Any, part: Any) -> bool:
    if isinstance(value, np.ndarray) and part in (float, int) and value.ndim == 1:
        return value.dtype.kind in ("biuf" if part is float else "iu")
    return _is_sequence(value) and all(fits(each, part) for each in value)


def words(hint: Any) -> str:
    """What a message says is expected."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        limits = [part.words for part in parts[1:] if isinstance(part, Domain)]
        return limits[-1] if limits else words(parts[0])
    if kind in (Union, types.UnionType):
        # None is what is left out.
        return " or ".join(dict.fromkeys(words(part) for part in _alternatives(parts) if part is not type(None)))
    if np.ndarray in (hint, kind):
        return "an array of numbers"
    if kind is Literal:
        return alternatives(parts)
    if isinstance(kind, type) and issubclass(kind, abc.Callable):  # type: ignore[arg-type]
        return "a function"
    if isinstance(kind, type) and issubclass(kind, abc.Mapping):
        return f"a mapping (each {words(parts[1])})"
    if kind is tuple and parts[-1] is not Ellipsis:
        return f"{len(parts)} values, each {words(parts[0])}"
    if isinstance(kind, type) and issubclass(kind, abc.Iterable):
        return f"a list (each {words(parts[0])})"
    simple = {float: "a number", int: "an integer", str: "a text", bool: "true or false", type(None): "None"}
    made_by = getattr(hint, "made_by", "")
    return simple.get(hint, getattr(hint, "__name__", str(hint))) + (f", which {made_by} makes" if made_by else "")
