"""Refusals by what they are, not by their words: kind, keyword, and the names and numbers that a message quotes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from morembs.base.errors import InputError, Kind, MorembsError

# Arguments of ``refusal`` in a table of parameters: kind, keyword, names and numbers.
Refusal = tuple[Kind, *tuple[str, ...]]


@contextmanager
def refusal(
    kind: Kind, keyword: str = "", *quoted: object, by: type[MorembsError] = InputError
) -> Iterator[pytest.ExceptionInfo[MorembsError]]:
    """What runs inside raises an error of this kind about this keyword, which quotes some names and numbers.

    ``quoted`` are what the user must find in the message: a path, a name, a card, a value. Words in a row are none.
    """
    assert not [text for text in map(str, quoted) if " " in text], "words are tested by kind and keyword"
    with pytest.raises(by) as caught:
        yield caught
    error = caught.value
    assert (error.kind, error.keyword) == (kind, keyword), str(error)
    assert not [text for text in map(str, quoted) if text not in str(error)], str(error)
