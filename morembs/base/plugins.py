"""Tables that other packages add to, by entry points or by assignment.

A package that is installed with this one names its plugins in its ``pyproject.toml``:

    [project.entry-points."morembs.reducers"]
    my-method = "my_package:MyReducer"

It is imported when a table is looked through, or a name is not one of the table's own.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, MutableMapping
from typing import TYPE_CHECKING, Generic, TypeVar

from morembs.base.errors import InputError, Kind, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Entry = TypeVar("Entry")


class UnknownNameError(InputError, KeyError):
    """A table has no entry of that name."""

    kind: Kind = "unknown"

    # KeyError shows its argument in quotes.
    __str__ = Exception.__str__


class Registry(MutableMapping[str, Entry], Generic[Entry]):
    """Name -> entry: the ``own`` entries first, in their order, then those of the entry points of ``group``.

    ``fault`` says what is wrong with a name and what an entry point gives for it; "" where nothing is.
    """

    def __init__(self, group: str, own: dict[str, Entry], fault: Callable[[str, object], str]) -> None:
        self.group, self._entries, self._fault = group, own, fault
        self.own = tuple(own)
        # Short forms that the field uses -> the name here, or a sentence where there is none.
        self.nicknames: dict[str, str] = {}
        self._broken: dict[str, str] = {}
        self._loaded = False

    def advice(self, name: str, *others: str) -> str:
        """Words for a message about ``name``, which is not in the table: why, or what comes near to it."""
        self._load()
        meant = self.nicknames.get(name.lower().replace("_", "-"), "")
        suggestion = f"did you mean {meant!r}?" if meant in self._entries else meant
        return self._broken.get(name) or suggestion or nearest(name, [*others, *self])

    def take(self, own: dict[str, Entry]) -> None:
        """Add entries of this package, where the table must be there before them."""
        self._entries.update(own)
        self.own += tuple(own)

    def reload(self) -> None:
        """Look for entry points again."""
        self._loaded = False
        self._broken.clear()

    def __getitem__(self, name: str) -> Entry:
        if name not in self._entries:
            self._load()
            if name not in self._entries:
                raise UnknownNameError(f"{self.group} has no {name!r}; {self.advice(str(name))}")
        return self._entries[name]

    def __setitem__(self, name: str, entry: Entry) -> None:
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        own = list(self._entries)
        yield from own
        self._load()
        yield from [name for name in self._entries if name not in own]

    def __len__(self) -> int:
        self._load()
        return len(self._entries)

    def _load(self) -> None:
        """The entry points, each once; one that cannot be used gives one warning and stays out."""
        if self._loaded:
            return
        self._loaded = True
        # Not at the top: it takes a third of what NumPy does, and short commands look at no other package.
        from importlib.metadata import entry_points

        for point in entry_points(group=self.group):
            reason = self._take(point)
            if reason:
                self._broken[point.name] = reason
                warnings.warn(reason, stacklevel=2)

    def _take(self, point: EntryPoint) -> str:
        """Take what ``point`` gives into the table; returns why it cannot be, "" where it is."""
        package = point.dist.name if point.dist is not None else point.value
        whole = f"the package {package!r} offers {point.name!r} for {self.group}, which cannot be used: "
        cure = "; update that package or uninstall it"
        if point.name in self._entries:
            return f"{whole}the name is taken{cure}"
        try:
            entry = point.load()
            wrong = self._fault(point.name, entry)
        except Exception as error:  # Whatever foreign code raises must not end the program.
            wrong = f"{type(error).__name__}: {error}"
        if wrong:
            return f"{whole}{wrong}{cure}"
        self._entries[point.name] = entry
        return ""


def subclass_fault(base: type, key: str) -> Callable[[str, object], str]:
    """The check of tables of classes: they derive from ``base``, and their attribute ``key`` is their name."""

    def fault(name: str, entry: object) -> str:
        if not (isinstance(entry, type) and issubclass(entry, base)):
            return f"{entry!r} is no subclass of {base.__module__}.{base.__name__}"
        value = getattr(entry, key, None)
        return "" if value == name else f"its {key} is {value!r}, expected {name!r}"

    return fault
