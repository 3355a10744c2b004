"""Counts imports that run back up and circles between the packages of morembs, imports for type checking included.

The order of the packages is the layers contract in pyproject.toml. Exit code 1 where there are any.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
Edges = dict[str, set[str]]


def modules() -> dict[str, Path]:
    """Dotted name of every module of the package, and its file."""
    files = sorted((ROOT / "morembs").rglob("*.py"))
    names = (".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files)
    return {name.removesuffix(".__init__"): file for name, file in zip(names, files, strict=True)}


def imported(file: Path, known: dict[str, Path]) -> Iterator[str]:
    """Modules of the package that ``file`` imports anywhere in its text."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            for name in node.names:
                inner = f"{node.module}.{name.name}"
                yield inner if inner in known else node.module
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def package(module: str) -> str:
    """Package or top-level module that ``module`` belongs to."""
    return ".".join(module.split(".")[:2])


def circle(edges: Edges) -> list[str]:
    """One circle of imports, empty if there is none."""
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        return [*reversed(error.args[1])]
    return []


def main() -> int:
    """Print both counts and what they count."""
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    level = {name.strip(): at for at, line in enumerate(contract["layers"]) for name in line.split(":")}
    # The package itself offers what all of them do, so none of them may import it.
    level["morembs"] = -1
    known = modules()
    by_module: Edges = defaultdict(set)
    by_package: Edges = defaultdict(set)
    back = []
    for module, file in known.items():
        for other in set(imported(file, known)) & set(known) - {module}:
            by_module[module].add(other)
            here, there = package(module), package(other)
            if here == there or module == "morembs":
                continue
            by_package[here].add(there)
            if level[there] <= level[here]:
                back.append(f"{module} -> {other}")
    circles = [found for edges in (by_package, by_module) if (found := circle(edges))]
    print(f"{len(contract['layers'])} layers; imports that run back up: {len(back)}; circles: {len(circles)}")
    for line in (*sorted(back), *(" -> ".join(found) for found in circles)):
        print(" ", line)
    return 1 if back or circles else 0


if __name__ == "__main__":
    sys.exit(main())
