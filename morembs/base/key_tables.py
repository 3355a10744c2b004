"""Tables of keys in TOML files, as frozen dataclasses: read with one message for each wrong key, shown as a schema."""

from __future__ import annotations

import types
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

from morembs.base.arguments import fits, hints_of, words
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Domain
from morembs.base.options import in_toml

_JSON_TYPES = {str: "string", bool: "boolean", int: "integer", float: "number", type(None): "null"}


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of a file. The hint of a key has its limits; messages expect their words, or those of ``declare_key``.

    ``given`` are the keys that were written. ``further`` holds keys without a field, where they are allowed (None: they
    are refused).
    """

    given: ClassVar[frozenset[str]] = frozenset()
    further: ClassVar[Mapping[str, Any] | None] = None

    def refuse_conflicts(self) -> None:
        """Refuse keys that do not go together, each of which is right by itself.

        Raises:
            InputError: in these cases.
        """

    def values(self, *, but: Collection[str] = (), without_none: bool = False) -> dict[str, Any]:
        """All keys ``but`` some, with the further ones; tables in them as dictionaries."""
        own = {entry.name: getattr(self, entry.name) for entry in fields(self)} | dict(self.further or {})
        return {
            key: _plain(value, without_none)
            for key, value in own.items()
            if key not in but and not (without_none and value is None)
        }


def declare_key(expected: str, default: Any = MISSING) -> Any:
    """A key with words of its own for what is expected; without a default it must be given."""
    if isinstance(default, list | dict):
        return field(default_factory=default.copy, metadata={"expected": expected})
    return field(default=default, metadata={"expected": expected})


AnyTable = TypeVar("AnyTable", bound=Table)


def _plain(value: Any, without_none: bool) -> Any:
    if isinstance(value, Table):
        return value.values(without_none=without_none)
    return [_plain(each, without_none) for each in value] if isinstance(value, list) else value


def read_table(
    kind: type[AnyTable], data: Mapping[str, Any], head: str = "", *, besides: Collection[str] = ()
) -> AnyTable:
    """The table ``kind`` that ``data`` holds; ``head`` is what messages call it, such as "[cluster]".

    Args:
        besides: names that are taken elsewhere, for advice.

    Raises:
        InputError: unknown, missing or wrong keys, one line for each.
    """
    faults: list[InputError] = []
    table = _read(kind, data, head, faults, besides)
    if table is None:
        raise faults[0].restate("\n".join(map(str, faults)))
    return table


def _read(
    kind: type[AnyTable], data: Mapping[str, Any], head: str, faults: list[InputError], besides: Collection[str] = ()
) -> AnyTable | None:
    """The table, or None with its ``faults``."""
    hints, values, wrong, at = hints_of(kind), dict[str, Any](), list[InputError](), f"{head}: " if head else ""
    known = kind.further is None
    unknown = {key: nearest(key, [*hints, *besides]) for key in data if known and key not in hints}
    for entry in fields(kind):
        name = entry.name
        if name in data:
            values[name] = _value(entry, hints[name], data[name], head, wrong)
        elif _default(entry) is MISSING and f"did you mean {name!r}?" not in unknown.values():
            message = f"{at}{name} is missing; expected {describe_expected(entry, hints[name])}"
            wrong.append(InputError(message, kind="missing", keyword=name))
    wrong += [
        InputError(f"{at}unknown key {key!r}; {advice}", kind="unknown", keyword=key) for key, advice in unknown.items()
    ]
    faults += wrong
    if wrong:
        return None
    table = kind(**values)
    object.__setattr__(table, "given", frozenset(data))
    if not known:
        object.__setattr__(table, "further", {key: value for key, value in data.items() if key not in hints})
    try:
        table.refuse_conflicts()
    except InputError as error:
        faults.append(InputError(f"{at}{error}", kind=error.kind, keyword=error.keyword))
        return None
    return table


def _value(entry: Field[Any], hint: Any, value: Any, head: str, faults: list[InputError]) -> Any:
    """The value of a key as its hint has it, and what is wrong with it among the ``faults``."""
    name, inner, domain = entry.name, inner_table(hint), _domain(hint)
    if inner is not None and not holds_several(hint) and isinstance(value, dict):
        return _read(inner, value, f"{head}, {name}" if head else f"[{name}]", faults)
    if inner is not None and holds_several(hint) and isinstance(value, list) and (not domain or domain.passes(value)):
        if all(isinstance(each, dict) for each in value):
            return [_read(inner, each, f"[[{name}]] {k}", faults) for k, each in enumerate(value, 1)]
    elif fits(value, hint):
        return _convert(value, hint)
    at = f"{head}: " if head else ""
    message = (
        f"{at}{name} = {in_toml(value)} was given; expected {_limits(entry, hint)}{describe_expected(entry, hint)}"
    )
    faults.append(InputError(message, keyword=name))
    return None


def _limits(entry: Field[Any], hint: Any) -> str:
    """The limits of a number whose name in messages is words of its own."""
    parts = {*(get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,))} - {type(None)}
    numeric = all(_domain(part) is not None and get_args(part)[0] in (int, float) for part in parts)
    return f"{words(hint)}: " if numeric and "expected" in entry.metadata else ""


def _convert(value: Any, hint: Any) -> Any:
    """A value that fits, whole numbers in place of others as ``float``."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        return _convert(value, parts[0])
    if kind in (Union, types.UnionType):
        return next(_convert(value, part) for part in parts if fits(value, part))
    if kind is list:
        return [_convert(each, parts[0]) for each in value]
    if kind is dict:
        return {key: _convert(each, parts[1]) for key, each in value.items()}
    return float(value) if hint is float else value


def describe_expected(entry: Field[Any], hint: Any) -> str:
    """What is to be given for a key."""
    if "expected" in entry.metadata:
        return str(entry.metadata["expected"])
    if inner_table(hint) is None or _domain(hint) is not None:
        return words(hint)
    return f"tables [[{entry.name}]]" if holds_several(hint) else f"a table [{entry.name}]"


def inner_table(hint: Any) -> type[Table] | None:
    """The table inside a hint such as ``list[Table] | None``."""
    if isinstance(hint, type) and issubclass(hint, Table):
        return hint
    return next((inner for part in get_args(hint) if (inner := inner_table(part))), None)


def holds_several(hint: Any) -> bool:
    """True if a hint is that of a list."""
    return get_origin(get_args(hint)[0] if get_origin(hint) is Annotated else hint) is list


def _domain(hint: Any) -> Domain | None:
    """The domain of a hint."""
    parts = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    return next((part for part in parts if isinstance(part, Domain)), None)


def _default(entry: Field[Any]) -> Any:
    return entry.default if entry.default_factory is MISSING else entry.default_factory()


def json_schema(kind: type[Table]) -> dict[str, Any]:
    """The JSON schema of a table, by which editors complete and check keys."""
    tables: dict[str, Any] = {}
    whole = _table_schema(kind, tables)
    return {"$defs": dict(sorted(tables.items())), **whole}


def _table_schema(kind: type[Table], tables: dict[str, Any]) -> dict[str, Any]:
    hints, keys = hints_of(kind), dict[str, Any]()
    for entry in fields(kind):
        value = _default(entry)
        default = {} if value is MISSING else {"default": _plain(value, False)}
        about = {"description": describe_expected(entry, hints[entry.name])}
        keys[entry.name] = {**_schema(hints[entry.name], tables), **default, **about}
    return {
        "title": kind.__name__,
        "description": (kind.__doc__ or "").strip(),
        "type": "object",
        "properties": keys,
        "required": [entry.name for entry in fields(kind) if _default(entry) is MISSING],
        "additionalProperties": kind.further is not None,
    }


def _schema(hint: Any, tables: dict[str, Any]) -> dict[str, Any]:
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        limits = {key: value for part in parts[1:] if isinstance(part, Domain) for key, value in part.schema.items()}
        return {**_schema(parts[0], tables), **limits}
    if kind in (Union, types.UnionType):
        return {"anyOf": [_schema(part, tables) for part in parts]}
    if kind is Literal:
        return {"enum": list(parts)}
    if kind is list:
        return {"type": "array", "items": _schema(parts[0], tables)}
    if kind is dict:
        return {"type": "object", "additionalProperties": _schema(parts[1], tables)}
    if isinstance(hint, type) and issubclass(hint, Table):
        if hint.__name__ not in tables:
            tables[hint.__name__] = _table_schema(hint, tables)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    return {"type": _JSON_TYPES[hint]} if hint in _JSON_TYPES else {}
