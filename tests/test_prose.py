"""The counts of prose find the words and the sentences that they are made for."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

import prose


def test_words_of_the_dialect_have_their_plain_word() -> None:
    lines = [prose.Line("page.md", "It is made\nanew. A renewal stays. It ends as\n    told, unless told otherwise.")]
    assert list(prose.dialect_in(iter(lines))) == [
        "page.md: anew -> again",
        "page.md: as told -> as given",
        "page.md: unless told -> by default",
    ]


def test_names_of_the_dialect_count_where_they_are_defined() -> None:
    tree = ast.parse("class Facts:\n    pass\n\ndef examine(told, rows):\n    return told.apart\n")
    found = list(prose.dialect_in_names(tree, "a.py"))
    assert [line.split(" -> ")[0] for line in found] == ["a.py:1: Facts", "a.py:4: told"]


def test_functions_that_are_participles_count_and_noun_phrases_do_not() -> None:
    text = "@property\ndef held(): ...\n@marked\ndef joined(): ...\ndef _left_out(): ...\ndef scaled_norm(): ...\n"
    tree = ast.parse(text + "def damping(): ...\ndef marked(): ...\ndef solved(): ...\n")
    decorators = frozenset(prose.decorators_of(tree))
    assert list(prose.participles_in(tree, "a.py", decorators)) == [
        "a.py:4: joined",
        "a.py:5: _left_out",
        "a.py:9: solved",
    ]


def test_messages_and_docstrings_are_read_and_single_words_are_not() -> None:
    tree = ast.parse('"""Seen anew."""\nraise ValueError("it was told")\nkey = "told"\n')
    found = list(prose.dialect_in(prose.texts_of_code(tree, "a.py")))
    assert [line.split(" -> ")[0] for line in found] == ["a.py:1: anew", "a.py:2: told"]


def test_long_sentences_end_at_stops_cells_items_and_headings() -> None:
    word = "word " * 20
    split = f"{word}.\n{word}\n\n| {word} | {word} |\n# Head\n{word}\n- {word}\n- {word}\n"
    assert not list(prose.long_sentences(iter([prose.Line("a.md", split)])))
    found = list(prose.long_sentences(iter([prose.Line("a.md", f"{word}; [link]({'x' * 9}) {word}.")])))
    assert len(found) == 1 and found[0].startswith("a.md: 41 words: word")


def test_blocks_of_code_are_no_sentences() -> None:
    assert not any("```" in text or "morembs reduce rod.toml" in text for _, text in prose.pages())
