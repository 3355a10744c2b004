"""The package runs no code of files: what its source may not contain, as SECURITY.md says."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "morembs").rglob("*.py"))
# Modules whose readers run code that a file names.
UNSAFE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
# Messages between a process and its own children, through pipes and a private folder.
OWN_MESSAGES = "morembs/base/worker_pool.py"


def findings(text: str) -> Iterator[str]:
    """Calls and imports of a source by which a file, or a name in it, could run code."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (f"import {one.name}" for one in node.names if one.name.split(".")[0] in UNSAFE)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in UNSAFE:
            yield f"import {node.module}"
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in ("eval", "exec", "compile", "__import__") or name.startswith("builtins."):
                yield f"call {name}"
            if name in ("os.system", "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput"):
                yield f"call {name}"
            for key in node.keywords:
                given = ast.unparse(key.value)
                if (key.arg, given) == ("shell", "True") or (key.arg == "allow_pickle" and given != "False"):
                    yield f"call {name}({key.arg}={given})"


def test_the_package_runs_no_code_of_files() -> None:
    found = {path.relative_to(ROOT).as_posix(): set(findings(path.read_text(encoding="utf-8"))) for path in FILES}
    assert {path: words for path, words in found.items() if words} == {OWN_MESSAGES: {"import pickle"}}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("x = eval('1')", ["call eval"]),
        ("exec(text)", ["call exec"]),
        ("import pickle as p", ["import pickle"]),
        ("from yaml import load", ["import yaml"]),
        ("np.load(file, allow_pickle=True)", ["call np.load(allow_pickle=True)"]),
        ("np.load(file, allow_pickle=given)", ["call np.load(allow_pickle=given)"]),
        ("subprocess.run(words, shell=True)", ["call subprocess.run(shell=True)"]),
        ("os.system(words)", ["call os.system"]),
        ("np.load(file, allow_pickle=False); model.eval(); re.compile('a')", []),
    ],
)
def test_unsafe_code_is_found(text: str, found: list[str]) -> None:
    assert list(findings(text)) == found


def test_the_page_of_threats_is_linked_and_names_this_file() -> None:
    assert "tests/test_safe_code.py" in (ROOT / "docs" / "background" / "threats.md").read_text(encoding="utf-8")
    assert "threats.md" in (ROOT / "SECURITY.md").read_text(encoding="utf-8")
