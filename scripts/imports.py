"""Counts imports that run back up and circles between the packages of morembs, imports for type checking included,
and what tests put in the place of names of the package.

The order of the packages is the layers contract in pyproject.toml. Tests may replace what stands for the world outside
(``OUTSIDE``), and no private name; that they read none is a rule of ruff (SLF001). Exit code 1 where there are any.
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
# Names of the package that tests may replace, each a door to the world outside.
OUTSIDE = {
    # Libraries and packages, and what their headers say.
    "find_library",
    "find_spec",
    "metis_library",
    "metis_ordering",
    "mkl_file",
    "casadi_folder",
    "cholmod_library",
    "fill_of",
    "parse_header",
    "fcntl",
    # The clock, and the size and speed of the machine.
    "LineProgress",
    "blas_threads",
    "processor_time",
    # Tables that users extend, a size of files that no test can write, and an eigensolver that misses a mode.
    "COUPLINGS",
    "SOLVERS",
    "FORMULATIONS",
    "STAGES",
    "large_file_notes",
    "largest",
    "ShiftedInverse",
}
REPLACING = {"setattr", "delattr", "setitem", "delitem"}


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


def replaced(file: Path) -> Iterator[str]:
    """Places in a test ``file`` that put something in the place of a private name, or of a name of the package."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    # Package that each imported name comes from.
    origin = {
        name.asname or name.name.partition(".")[0]: (getattr(node, "module", None) or name.name).partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in node.names
    }
    for node in ast.walk(tree):
        called = node.func if isinstance(node, ast.Call) else None
        if called is None or getattr(called, "attr", getattr(called, "id", "")) not in REPLACING:
            continue
        given = [ast.unparse(argument).strip("'") for argument in node.args[:2]]
        path = (given[0] if "." in given[0] and isinstance(node.args[0], ast.Constant) else ".".join(given)).split(".")
        source = origin.get(path[0], path[0])
        private = any(part.startswith("_") and not part.endswith("__") for part in path)
        if source == "morembs":
            allowed = not private and bool(OUTSIDE & set(path))
        else:
            # Other packages are the world outside; what a variable stands for is not known here.
            allowed = not private or source in origin.values()
        if not allowed:
            yield f"{file.relative_to(ROOT)}:{node.lineno}: {'.'.join(path)}"


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
    circles = [chain for edges in (by_package, by_module) if (chain := circle(edges))]
    print(f"{len(contract['layers'])} layers; imports that run back up: {len(back)}; circles: {len(circles)}")
    for line in (*sorted(back), *(" -> ".join(found) for found in circles)):
        print(" ", line)
    patches = [place for file in sorted((ROOT / "tests").rglob("*.py")) for place in replaced(file)]
    print(f"names of the package that tests replace, and should not: {len(patches)}")
    for place in patches:
        print(" ", place)
    return 1 if back or circles or patches else 0


if __name__ == "__main__":
    sys.exit(main())
