"""Counts words that the field does not use, and sentences that are too long: the prose of ``scripts/house.py``.

``words.toml`` beside this file has both lists: words with the plain word for each, and the long sentences that are
allowed, with a reason. A word of ``[names]`` counts where code defines it (functions, classes, parameters, variables).
A word of ``[prose]`` counts in the pages of docs and README, and in docstrings and messages.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
WORDS = tomllib.loads((Path(__file__).parent / "words.toml").read_text(encoding="utf-8"))
# A sentence with more words is split, or has a reason in ``words.toml``.
WORDS_OF_A_SENTENCE = 35
# Tables and lists that scripts write have their words in the code.
_GENERATED = re.compile(
    r"<!-- (?:table|measured|figure): .*?<!-- end -->|^```.*?^```$|^(?: {4}|\t)(?! *[-*\d]).*?$", re.S | re.M
)
# Ends of sentences; a cell of a table, an item of a list and a heading end one as well.
_ENDS = re.compile(r"(?<=[.!?])[)*\"]?\s+|\||\n\s*(?:[-*]|\d+\.)\s|\n#+\s[^\n]*\n|\n\s*\n")


class Line(NamedTuple):
    """A piece of prose and where it begins."""

    place: str
    text: str


def pages() -> Iterator[Line]:
    """Prose of README and docs; code blocks and generated tables become blank lines."""
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        if "built" not in path.relative_to(ROOT).parts:
            text = path.read_text(encoding="utf-8")
            blank = _GENERATED.sub(lambda found: "\n" * (found[0].count("\n")) or "\n\n", text)
            yield Line(str(path.relative_to(ROOT)), blank)


def texts_of_code(tree: ast.AST, place: str) -> Iterator[Line]:
    """Docstrings and messages: all text constants of more than one word."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            yield Line(f"{place}:{node.lineno}", node.value)


def names_of_code(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Lines and names of everything that a file defines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id


def dialect_in(lines: Iterator[Line]) -> Iterator[str]:
    """``place: word -> plain word`` for each word of ``[prose]``."""
    search = re.compile(r"\b(" + "|".join(map(re.escape, WORDS["prose"])) + r")\b")
    for place, text in lines:
        for found in search.finditer(re.sub(r"\s+", " ", text)):
            yield f"{place}: {found[1]} -> {WORDS['prose'][found[1]]}"


def dialect_in_names(tree: ast.AST, place: str) -> Iterator[str]:
    """``place:line: name -> plain name`` for each name of ``[names]``; a leading underscore is left out."""
    for line, name in names_of_code(tree):
        if plain := WORDS["names"].get(name.lstrip("_")):
            yield f"{place}:{line}: {name} -> {plain}"


def participles_in(tree: ast.Module, place: str, decorators: frozenset[str]) -> Iterator[str]:
    """``place:line: name`` for each function that is called by a participle alone, such as ``joined`` or ``left_out``.

    Properties, context managers and ``decorators`` may be: ``with listening(...)`` and ``@checked`` read as they do.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            marks = " ".join(ast.unparse(mark) for mark in node.decorator_list)
            may_be = node.name in decorators or re.search(r"property|contextmanager|derived|setter", marks)
            if is_participle(node.name) and not may_be:
                yield f"{place}:{node.lineno}: {node.name}"


def is_participle(name: str) -> bool:
    """True for a participle that no noun follows; a leading underscore is left out."""
    first, *others = name.strip("_").split("_")
    words = WORDS["participles"]
    ends = first.endswith(("ed", "ing")) and len(first) > 4
    return (ends or first in words["irregular"]) and first not in words["nouns"] and {*others} <= {*words["particles"]}


def decorators_of(tree: ast.Module) -> Iterator[str]:
    """Names that decorate functions and classes of a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            for mark in node.decorator_list:
                called = mark.func if isinstance(mark, ast.Call) else mark
                if isinstance(called, ast.Name):
                    yield called.id


def sentences(text: str) -> Iterator[str]:
    """Sentences of a page; a link counts by its words alone."""
    for sentence in _ENDS.split(re.sub(r"\]\([^)]*\)", "]", text)):
        yield " ".join(sentence.split())


def long_sentences(lines: Iterator[Line]) -> Iterator[str]:
    """Sentences above the limit that have no reason in ``[long_sentences]`` (first words -> reason)."""
    for place, text in lines:
        for sentence in sentences(text):
            count = len(re.findall(r"\w\S*", sentence))
            if count > WORDS_OF_A_SENTENCE and not any(map(sentence.startswith, WORDS["long_sentences"])):
                yield f"{place}: {count} words: {sentence}"
