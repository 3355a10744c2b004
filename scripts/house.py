"""Counts the things that a reader of morembs must know: rooms, numbers without a derivation, repeated names, lines.

Every count in ``LIMITS`` may fall and not rise: exit code 1 where one is above its limit. A limit is lowered to the
count once work has brought it down. ``--list COUNT`` shows the places of one count.

What counts as a number:

- A module constant is an assignment of numbers, their sums and products, or up to three numbers in parentheses, outside
  a class. A tolerance belongs into the dataclass ``*Tolerances`` of its room (``morembs/ROOM/tolerances.py``), where a
  comment above each field derives or cites it. Codes of a file format or a library belong into an ``IntEnum`` or a
  class whose docstring names the format. Long tables (weights, elements) are not counted.
- A literal in a function counts where it is a float other than 0.5 and whole numbers up to 12, or an integer beyond 64
  that is no power of two, unless it changes units (``UNITS``) or a comment stands in its line or in the line above.
  Defaults of parameters are literals too.

Tests of wording are those that go by the words of a message (``pytest.raises(..., match=...)``) in place of the kind
and the keyword of its error (``tests/support/refusals.py``).

Words that the field does not use, participles in place of verbs and sentences of more than 35 words are counted by
``prose.py``, from ``words.toml``.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import prose

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "morembs"
MATHEMATICS = (
    *("linalg", "fem", "problem", "responses", "reducers", "certificate"),
    *("parametric", "body", "dynamics", "importers"),
)
BODIES = {"ElasticBody", "StoredBody", "BodyAt", "Body"}
# Per cent, degrees, seconds, thousands.
UNITS = {60, 90, 100, 180, 360, 3600, 10**3, 10**6, 10**9}
# The greatest count that is allowed, and the one that is aimed at.
LIMITS = {
    "rooms": (16, 16),
    "context parameters": (0, 0),
    "module constants": (0, 0),
    "names of several constants": (0, 0),
    "tolerances without a line": (0, 0),
    "literals": (0, 0),
    "formatter switched off": (2, 20),
    "aliases defined twice": (0, 0),
    "types of a body": (1, 1),
    "dialect in names": (0, 0),
    "functions that are participles": (0, 0),
    "dialect in code texts": (0, 0),
    "dialect in docs": (0, 0),
    "long sentences in docs": (0, 0),
    "tests of wording": (20, 20),
}


@dataclass(frozen=True)
class Module:
    """One file of the package, parsed."""

    path: Path
    text: str
    tree: ast.Module
    lines: list[str]

    @property
    def room(self) -> str:
        """First part of its path in the package; modules at the top stand for themselves."""
        return self.path.relative_to(PACKAGE).parts[0].removesuffix(".py")

    def place(self, node: ast.stmt | ast.expr | ast.arg, words: str) -> str:
        """``path:line: words``."""
        return f"{self.path.relative_to(ROOT)}:{node.lineno}: {words}"

    def commented(self, line: int) -> bool:
        """Whether a comment stands in this line or above it (lines count from 1)."""
        lines = self.lines
        return "  # " in lines[line - 1] or (line > 1 and lines[line - 2].lstrip().startswith("# "))


def read() -> list[Module]:
    """All files of the package."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        found.append(Module(path, text, ast.parse(text), text.splitlines()))
    return found


def is_number(node: ast.expr) -> bool:
    """Numbers, sums and products with at least one, and up to three of them in parentheses."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float | complex) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) or is_number(node.right)
    return isinstance(node, ast.Tuple) and 0 < len(node.elts) <= 3 and all(map(is_number, node.elts))


def assigned(statements: list[ast.stmt]) -> Iterator[tuple[ast.Name, ast.expr]]:
    """Names and values of the assignments among ``statements``, with tuples taken apart."""
    for node in statements:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        for target in targets:
            if isinstance(target, ast.Name) and isinstance(value, ast.expr):
                yield target, value
            elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = zip(target.elts, value.elts, strict=True)
                yield from ((name, part) for name, part in pairs if isinstance(name, ast.Name))


def rooms(_: list[Module]) -> Iterator[str]:
    """Packages and modules at the top, without ``__init__``, ``__main__`` and the version."""
    for path in sorted(PACKAGE.iterdir()):
        if (path.is_dir() or path.suffix == ".py") and not path.name.startswith("__") and path.name != "version.py":
            yield path.name


def context_parameters(modules: list[Module]) -> Iterator[str]:
    """Parameters that hand budget or progress on, in rooms of mathematics."""
    for module in modules:
        functions = (n for n in ast.walk(module.tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
        for function in functions if module.room in MATHEMATICS else ():
            given = function.args
            for one in (*given.posonlyargs, *given.args, *given.kwonlyargs):
                kind = ast.unparse(one.annotation) if one.annotation else ""
                if one.arg in ("budget", "progress") or re.search(r"\b(Budget|Progress)\b", kind):
                    yield module.place(one, f"{function.name}({one.arg})")


def module_constants(modules: list[Module]) -> Iterator[str]:
    """Numbers at module level."""
    for module in modules:
        for name, value in assigned(module.tree.body):
            if is_number(value):
                yield module.place(name, f"{name.id} = {ast.unparse(value)}")


def names_of_several(modules: list[Module]) -> Iterator[str]:
    """Names that stand for more than one number, a leading underscore left out."""
    values = defaultdict(set)
    for place in module_constants(modules):
        name, _, value = place.split(": ", 1)[1].partition(" = ")
        values[name.lstrip("_")].add(value)
    for name, several in sorted(values.items()):
        if len(several) > 1:
            yield f"{name}: {', '.join(sorted(several))}"


def tolerances_without_line(modules: list[Module]) -> Iterator[str]:
    """Fields of tolerances classes without a comment above."""
    for module in modules:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and node.name.endswith("Tolerances"):
                for field in node.body:
                    if isinstance(field, ast.AnnAssign) and not module.commented(field.lineno):
                        yield module.place(field, ast.unparse(field.target))


def literals(modules: list[Module]) -> Iterator[str]:
    """Numbers in functions that nothing derives."""
    for module in modules:
        seen = set()
        for function in ast.walk(module.tree):
            if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                continue
            for node in ast.walk(function):
                value = node.value if isinstance(node, ast.Constant) else None
                if isinstance(value, float):
                    counts = value != 0.5 and not (value.is_integer() and value <= 12)
                elif isinstance(value, int) and not isinstance(value, bool):
                    counts = value > 64 and value & (value - 1) != 0
                else:
                    continue
                place = (node.lineno, node.col_offset)
                if counts and value not in UNITS and place not in seen and not module.commented(node.lineno):
                    seen.add(place)
                    yield module.place(node, str(value))


def formatter_off(modules: list[Module]) -> Iterator[str]:
    """Lines that the formatter leaves alone."""
    for module in modules:
        for at, line in enumerate(module.lines, start=1):
            if re.search(r"# fmt: (skip|off)", line):
                yield f"{module.path.relative_to(ROOT)}:{at}"


def aliases_twice(modules: list[Module]) -> Iterator[str]:
    """Names of kinds of arrays that several files define."""
    files = defaultdict(set)
    for module in modules:
        for name, value in assigned(module.tree.body):
            if "NDArray[" in ast.unparse(value):
                files[name.id].add(str(module.path.relative_to(ROOT)))
    for name, places in sorted(files.items()):
        if len(places) > 1:
            yield f"{name}: {', '.join(sorted(places))}"


def bodies(modules: list[Module]) -> Iterator[str]:
    """Classes that carry a body."""
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ClassDef) and node.name in BODIES:
                yield module.place(node, node.name)


def dialect_in_names(modules: list[Module]) -> Iterator[str]:
    """Names that the field does not use."""
    for module in modules:
        yield from prose.dialect_in_names(module.tree, str(module.path.relative_to(ROOT)))


def participles(modules: list[Module]) -> Iterator[str]:
    """Functions that are called by a participle, where functions are verbs."""
    decorators = frozenset(name for module in modules for name in prose.decorators_of(module.tree))
    for module in modules:
        yield from prose.participles_in(module.tree, str(module.path.relative_to(ROOT)), decorators)


def dialect_in_code(modules: list[Module]) -> Iterator[str]:
    """Words in docstrings and messages that the field does not use."""
    for module in modules:
        yield from prose.dialect_in(prose.texts_of_code(module.tree, str(module.path.relative_to(ROOT))))


def dialect_in_docs(_: list[Module]) -> Iterator[str]:
    """Words in README and docs that the field does not use."""
    return prose.dialect_in(prose.pages())


def long_sentences(_: list[Module]) -> Iterator[str]:
    """Sentences of README and docs that are too long, without a reason."""
    return prose.long_sentences(prose.pages())


def tests_of_wording(_: list[Module]) -> Iterator[str]:
    """Refusals that a test knows by the words of the message."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        calls = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)) if "match=" in text else ()
        for call in calls:
            if ast.unparse(call.func) == "pytest.raises" and any(given.arg == "match" for given in call.keywords):
                yield f"{path.relative_to(ROOT)}:{call.lineno}"


COUNTS: dict[str, Callable[[list[Module]], Iterator[str]]] = {
    "rooms": rooms,
    "context parameters": context_parameters,
    "module constants": module_constants,
    "names of several constants": names_of_several,
    "tolerances without a line": tolerances_without_line,
    "literals": literals,
    "formatter switched off": formatter_off,
    "aliases defined twice": aliases_twice,
    "types of a body": bodies,
    "dialect in names": dialect_in_names,
    "functions that are participles": participles,
    "dialect in code texts": dialect_in_code,
    "dialect in docs": dialect_in_docs,
    "long sentences in docs": long_sentences,
    "tests of wording": tests_of_wording,
}


def main() -> int:
    """Print the table, or the places of one count."""
    modules = read()
    if "--list" in sys.argv[1:]:
        for place in COUNTS[" ".join(sys.argv[sys.argv.index("--list") + 1 :])](modules):
            print(place)
        return 0
    failed = False
    print(f"{'count':28} {'now':>6} {'limit':>6} {'aim':>6}")
    for name, count in COUNTS.items():
        now, (limit, aim) = sum(1 for _ in count(modules)), LIMITS[name]
        failed |= now > limit
        words = "too many: --list " + name if now > limit else "lower the limit" if now < limit != aim else ""
        print(f"{name:28} {now:6} {limit:6} {aim:6}  {words}".rstrip())
    by_room: dict[str, int] = defaultdict(int)
    for module in modules:
        by_room[module.room] += module.text.count("\n")
    print("lines:", ", ".join(f"{room} {count}" for room, count in by_room.items() if not room.startswith("__")))
    print(f"lines in all: {sum(by_room.values())}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
