"""Rooms, names of plug-ins and the argument ``progress`` as 0.1 had them: they go on working until 1.0, and a warning
gives the new way."""

from __future__ import annotations

import importlib
import inspect
import sys
import warnings
from collections.abc import Callable, ItemsView, KeysView, Mapping, Sequence
from functools import wraps
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, ParamSpec, Self, TypeVar

from morembs.base.progress import SILENT, listener, listening

Class = TypeVar("Class")
P = ParamSpec("P")
R = TypeVar("R")

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
# A module alone.
MODULES = {
    "reducers.switching_tables": "responses.static_mode_tables",
    "storage.body_file": "body.file",
    "storage.model_file": "importers.model_file",
}


def place_now(name: str) -> str:
    """Dotted name of today of the module that was called ``name``; "" where it, or its room, has not moved."""
    package, _, inner = name.partition(".")
    room, _, rest = inner.partition(".")
    if package == "morembs" and inner in MODULES:
        return f"{package}.{MODULES[inner]}"
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


class FormerMapping:
    """What was a mapping of names to ``datasets`` in 0.1, where it was read from a file, and is an object now: keys
    warn, and give the same."""

    @property
    def datasets(self) -> Mapping[str, Any]:
        """Names to values as a file keeps them."""
        raise NotImplementedError

    def _former(self) -> Mapping[str, Any]:
        text = f"keys of a {type(self).__name__} are now its attributes, or keys of its datasets; they go with 1.0"
        warnings.warn(text, DeprecationWarning, 3)
        return self.datasets

    def __getitem__(self, name: str) -> Any:
        return self._former()[name]

    def __contains__(self, name: object) -> bool:
        return name in self._former()

    def get(self, name: str, default: Any = None) -> Any:
        return self._former().get(name, default)

    def keys(self) -> KeysView[str]:
        return self._former().keys()

    def items(self) -> ItemsView[str, Any]:
        return self._former().items()


def with_progress_argument(function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a function that once took its listener as ``progress``, by keyword or as its last positional argument.

    It warns; the listener hears the call.
    """
    parameters = inspect.signature(function).parameters.values()
    count = sum(each.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD for each in parameters)

    @wraps(function)
    def accept(*values: Any, **keys: Any) -> Any:
        if "progress" not in keys and len(values) != count + 1:
            return function(*values, **keys)
        warnings.warn(
            f"progress of {function.__qualname__} goes with 1.0; call it inside "
            "`with morembs.base.progress.listening(progress):`",
            DeprecationWarning,
            2,
        )
        listener = keys.pop("progress") if "progress" in keys else values[-1]
        with listening(listener):
            return function(*values[:count], **keys)

    return accept


def with_budget_argument(function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a function that once took a ``budget``, by keyword: it warns, and works within that budget."""

    @wraps(function)
    def accept(*values: Any, **keys: Any) -> Any:
        budget = keys.pop("budget", None)
        if budget is None:
            return function(*values, **keys)
        name = function.__qualname__.removesuffix(".__init__")
        warnings.warn(
            f"budget of {name} goes with 1.0; call it inside `with morembs.base.budget.Budget(...):`",
            DeprecationWarning,
            2,
        )
        with budget.in_use():
            return function(*values, **keys)

    return accept


def accept_progress(plugin: type, **counts: int) -> None:
    """Have methods of ``plugin`` called with ``counts[name]`` positional arguments where they still take ``progress``
    as well, and with ``progress`` where they no longer do."""
    for name, count in counts.items():
        method = vars(plugin).get(name)
        if method is None:
            continue
        code = method.__code__
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        # The one positional argument too many may have any name.
        positional = code.co_argcount > count
        wants = positional or "progress" in names
        if wants:
            warnings.warn(
                f"{name} of {plugin.__name__} takes progress, which goes with 1.0; leave it out and tell news to "
                "morembs.base.progress.update",
                DeprecationWarning,
                4,
            )
        setattr(plugin, name, _adapted(method, count, wants, positional))


def accept_former_methods(plugin: type, **names: str) -> None:
    """Take what ``plugin`` calls ``old`` for its method ``names[old]``, where it does not have that."""
    for old, new in names.items():
        if old in vars(plugin) and getattr(getattr(plugin, new), "__isabstractmethod__", False):
            text = f"{old} of {plugin.__name__} is now called {new}; the old name goes with 1.0"
            warnings.warn(text, DeprecationWarning, 3)
            setattr(plugin, new, vars(plugin)[old])


def _adapted(method: Callable[..., Any], count: int, wants: bool, positional: bool) -> Callable[..., Any]:
    @wraps(method)
    def call(*values: Any, **keys: Any) -> Any:
        keys.pop("progress", None)
        values = values[:count]
        if not wants:
            return method(*values, **keys)
        hearer = listener() or SILENT
        return method(*values, hearer, **keys) if positional else method(*values, progress=hearer, **keys)

    return call


def accept_former_rooms() -> None:
    """Have the rooms of before imported from now on."""
    if not any(isinstance(finder, _FormerRooms) for finder in sys.meta_path):
        sys.meta_path.insert(0, _FormerRooms())
