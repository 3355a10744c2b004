"""Rooms and names of plug-ins as 0.1 had them: they go on working until 1.0, and a warning gives the new one."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Self, TypeVar

Class = TypeVar("Class")

# A room with all that is in it.
ROOMS = {
    **dict.fromkeys(("arguments", "budget", "closing", "errors", "memory", "options", "plugins", "progress"), "base"),
    **dict.fromkeys(("scratch", "stopping", "summary", "units"), "base"),
    **dict.fromkeys(("diagnostics", "floating", "recovery"), "body"),
    **dict.fromkeys(("assembly", "gmp", "multibody", "nonlinear"), "dynamics"),
    **dict.fromkeys(("batches", "cli", "jobs"), "app"),
    "interface": "fem",
}
WHOLE = {"model": "fem"}


def place_now(name: str) -> str:
    """Dotted name of today of the module that was called ``name``; "" where no room of that name has moved."""
    package, _, inner = name.partition(".")
    room, _, rest = inner.partition(".")
    new = WHOLE.get(room) or (f"{ROOMS[room]}.{room}" if room in ROOMS else "")
    return ".".join(part for part in (package, new, rest) if part) if package == "morembs" and new else ""


class _FormerRooms(MetaPathFinder, Loader):
    """Finds modules in rooms that have moved."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return ModuleSpec(name, self, is_package=True) if place_now(name) else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        new = place_now(spec.name)
        warnings.warn(f"{spec.name} is now {new}; the old name goes with 1.0", DeprecationWarning, 2)
        module = importlib.import_module(new)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The import system has put the specification of the old name in place of its own.
        module.__spec__ = self._spec


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """``__getattr__`` of ``module``, which gives what it now calls ``names[old]`` for an old name, and warns."""

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        new = names[name]
        warnings.warn(f"{module}.{name} is now {new}; the old name goes with 1.0", DeprecationWarning, 2)
        return getattr(sys.modules[module], new)

    return find


def with_old_names(**names: str) -> Callable[[type[Class]], type[Class]]:
    """Decorates a class whose fields, properties or methods had other names: ``old="new"``.

    An old name warns, as an attribute and as a keyword of the constructor.
    """

    def decorate(cls: type[Class]) -> type[Class]:
        construct = cls.__init__

        def warned(old: str) -> str:
            text = f"{old} of {cls.__name__} is now {names[old]}; the old name goes with 1.0"
            warnings.warn(text, DeprecationWarning, 3)
            return names[old]

        @wraps(construct)
        def accept(self: Any, *values: Any, **keys: Any) -> None:
            for old in names.keys() & keys.keys():
                keys[warned(old)] = keys.pop(old)
            construct(self, *values, **keys)

        cls.__init__ = accept  # type: ignore[method-assign]

        def reader(old: str) -> Callable[[Any], Any]:
            return lambda self: getattr(self, warned(old))

        for name in names:
            setattr(cls, name, property(reader(name)))
        return cls

    return decorate


class FormerMethod:
    """What a method gave in 0.1 and a property gives now: the call of before warns, and gives the same."""

    def __call__(self) -> Self:
        text = f"the {type(self).__name__} is there without a call now; brackets behind it go with 1.0"
        warnings.warn(text, DeprecationWarning, 2)
        return self


def accept_former_rooms() -> None:
    """Have the rooms of before imported from now on."""
    if not any(isinstance(finder, _FormerRooms) for finder in sys.meta_path):
        sys.meta_path.insert(0, _FormerRooms())
