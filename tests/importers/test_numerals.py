"""Numbers of decks: the values of ``float``, to the last bit, and nothing else taken for a number."""

from __future__ import annotations

import random
import re

import numpy as np
import pytest

from morembs.importers.decks.numerals import fixed_integers, words_of

# Between two doubles, at the limits of exact products, beyond the digits of an integer, tiny and huge.
SPECIAL = (
    "9007199254740993", "9007199254740992.5", "1e22", "1e23", "9007199254740993e-22", "5e-324", "1e-70", "-0.0",
    "123456789012345678901234567890", "2.2250738585072014e-308", "0.000000000000000000000000012345", "1.7e308", ".5",
)  # fmt: skip


def written(rng: random.Random) -> str:
    """A number as programs write it."""
    value, digits = rng.uniform(-1e3, 1e3), rng.randrange(19)
    sign, end = rng.choice(["", "+", "-"]), rng.choice(["", "e5", "E-3", "D+02", "+3", "-12", "d7", "e+003"])
    return rng.choice(
        (
            repr(value),
            f"{value:.{digits}g}",
            f"{value * 10.0 ** rng.randrange(-30, 30):.{digits}e}",
            str(rng.randrange(10 ** rng.randrange(1, 20))),
            f"{sign}{rng.randrange(1000)}.{rng.choice(['', str(rng.randrange(10**6))])}{end}",
            # An odd multiple of half the space of two doubles.
            str(rng.randrange(2**52, 2**53) * 2 + 1),
            rng.choice(SPECIAL),
        )
    )


def as_float(word: str) -> float:
    """What Python has for it, with exponents as Fortran reads them."""
    text = word.upper().replace("D", "E")
    return float(text if "E" in text else re.sub(r"([0-9.])([+-])", r"\1E\2", text))


def test_numbers_are_those_of_float_to_the_last_bit():
    rng = random.Random(1)
    for _ in range(5):
        given = [*SPECIAL, *(written(rng) for _ in range(3000))]
        blanks = (" " * rng.randrange(3) for _ in given)
        text = "".join(f"{blank}{word}{blank}" + rng.choice(",,\n") for word, blank in zip(given, blanks, strict=True))
        words = words_of(text.encode())
        assert words is not None
        values = words.reals(np.arange(len(given)))
        assert values is not None
        assert np.array_equal(values.view(np.uint64), np.array(list(map(as_float, given))).view(np.uint64))


@pytest.mark.parametrize(
    "word",
    ["1..2", "--5", "5-", "e5", "1e", "1e+", "1.5.2", "+", "-", ".", "1e5.", "1e5e5", "nan", "inf", "0x1", "1_0", "1 2",
     "1e500", "1+-3", "5+3+2", "1e99999", "1.0E+00x"],
)  # fmt: skip
def test_what_is_no_finite_number_is_none(word):
    words = words_of(f"{word},1\n".encode())
    assert words is None or words.reals() is None


def test_exponents_without_a_letter_are_read_where_they_may_be():
    words = words_of(b"5+000,-1.5-3\n")
    assert words is not None
    assert np.array_equal(words.reals(), [5.0, -1.5e-3])
    assert words.reals(implied=False) is None


def test_lines_and_empty_words():
    words = words_of(b"\n1, -2 ,,+4\n\n 5,6,7,8")
    assert words is not None and words.width == 4
    assert np.array_equal(words.integers(), [1, -2, 0, 4, 5, 6, 7, 8])
    assert np.array_equal(np.flatnonzero(words.is_empty), [2])
    assert words_of(b"1,2\n3\n").width == 0
    for word in (b"1.", b"--1", b"+", b"1234567890123456", b"a"):
        assert words_of(word + b",1\n").integers() is None


@pytest.mark.parametrize("width", [5, 8, 9, 10, 16])
def test_integers_in_columns_have_blanks_in_front_only(width):
    rng = random.Random(width)
    texts = [f"{rng.randrange(10 ** rng.randrange(1, min(width, 15) + 1)):>{width}}" for _ in range(500)]
    columns = np.frombuffer("".join(texts).encode(), dtype=np.uint8).reshape(-1, 2, width)
    assert np.array_equal(fixed_integers(columns).ravel(), list(map(int, texts)))
    for text in texts:
        at, strange = rng.randrange(width), chr(rng.randrange(256))
        changed = text[:at] + strange + text[at + 1 :]
        digits = changed.lstrip(" ")
        is_plain = not digits or (digits.isascii() and digits.isdigit() and len(digits) < 16)
        values = fixed_integers(np.frombuffer(changed.encode("latin-1"), dtype=np.uint8).reshape(1, 1, width))
        assert (None if values is None else int(values[0, 0])) == (int(digits or 0) if is_plain else None)
