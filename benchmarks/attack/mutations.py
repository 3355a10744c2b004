"""Ways to damage a file; each has a name, and for each it is known whether readers can see it.

``TEXT`` and ``BINARY`` take bytes and dice and return bytes; for arrays within files see ``arrays``. ``REASONS`` says
why damage of a kind may pass without a word: what comes out is a valid file that says something else.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

from benchmarks.attack.arrays import INSIDE

Dice = random.Random
_NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?(?![\w.])")
_WORD = re.compile(rb"[A-Za-z_]{3,}")
_MARKS = b"0123456789+-.,;:=*$'\"/\\#%&<>[]{}() \t\r\0abcdeEDXYZ\x1a\x7f\x80\xc3\xff"
_ODD = (
    b"nan",
    b"NaN",
    b"inf",
    b"-inf",
    b"1e400",
    b"1e308",
    b"-1e30",
    b"1e80",
    b"99999999999",
    b"-1",
    b"0",
    b"1e-320",
    b"0x10",
    b"1_000",
    b"1,5",
    b"1.0.0",
    b"--1",
    b"1e",
    b"+",
    "\u0661".encode(),
    b"1d3",
    b"1+3",
    b"2147483648",
)


def _lines(data: bytes) -> list[bytes]:
    return data.split(b"\n")


def _cut(data: bytes, dice: Dice) -> bytes:
    return data[: dice.randrange(len(data))]


def _cut_at_line(data: bytes, dice: Dice) -> bytes:
    rows = _lines(data)
    return b"\n".join(rows[: dice.randrange(len(rows))]) + b"\n"


def _bytes(data: bytes, dice: Dice) -> bytes:
    out = bytearray(data)
    for _ in range(dice.randrange(1, 4)):
        out[dice.randrange(len(out))] = dice.choice(_MARKS)
    return bytes(out)


def _of_lines(change: Callable[[list[bytes], Dice], object]) -> Callable[[bytes, Dice], bytes]:
    def mutate(data: bytes, dice: Dice) -> bytes:
        rows = _lines(data)
        change(rows, dice)
        return b"\n".join(rows)

    return mutate


def _swap(rows: list[bytes], dice: Dice) -> None:
    i, j = dice.randrange(len(rows)), dice.randrange(len(rows))
    rows[i], rows[j] = rows[j], rows[i]


def _double(rows: list[bytes], dice: Dice) -> None:
    i = dice.randrange(len(rows))
    rows.insert(i, rows[i])


def _move(rows: list[bytes], dice: Dice) -> None:
    rows.insert(dice.randrange(len(rows)), rows.pop(dice.randrange(len(rows))))


def _delete(rows: list[bytes], dice: Dice) -> None:
    start = dice.randrange(len(rows))
    del rows[start : start + dice.choice((1, 1, 1, 2, 5))]


def _blank(rows: list[bytes], dice: Dice) -> None:
    rows.insert(dice.randrange(len(rows)), dice.choice((b"", b"   ", b"\t", b"0", b"-1", b"**", b"$", b"!")))


def _join(rows: list[bytes], dice: Dice) -> None:
    if len(rows) > 1:
        i = dice.randrange(len(rows) - 1)
        rows[i : i + 2] = [rows[i] + rows[i + 1]]


def _split(rows: list[bytes], dice: Dice) -> None:
    i = dice.randrange(len(rows))
    at = dice.randrange(len(rows[i]) + 1)
    rows[i : i + 1] = [rows[i][:at], rows[i][at:]]


def _of_match(pattern: re.Pattern[bytes], change: Callable[[bytes, Dice], bytes]) -> Callable[[bytes, Dice], bytes]:
    def mutate(data: bytes, dice: Dice) -> bytes:
        matches = list(pattern.finditer(data))
        if not matches:
            return _bytes(data, dice)
        match = dice.choice(matches)
        return data[: match.start()] + change(match[0], dice) + data[match.end() :]

    return mutate


def _digit(number: bytes, dice: Dice) -> bytes:
    places = [i for i, c in enumerate(number) if 48 <= c <= 57]
    i = dice.choice(places)
    return number[:i] + bytes([48 + (number[i] - 48 + dice.randrange(1, 10)) % 10]) + number[i + 1 :]


def _sign(number: bytes, _: Dice) -> bytes:
    return number[1:] if number[:1] in b"+-" else b"-" + number


def _exponent(number: bytes, dice: Dice) -> bytes:
    mantissa = re.split(rb"[eEdD]", number)[0]
    return mantissa + dice.choice((b"", b"e1", b"E-3", b"e+12", b"d2", b"e-30", b"E40"))


def _typo(word: bytes, dice: Dice) -> bytes:
    i = dice.randrange(len(word) - 1)
    how = dice.randrange(3)
    if how == 0:
        return word[:i] + word[i + 1 :]
    if how == 1:
        return word[:i] + word[i + 1 : i + 2] + word[i : i + 1] + word[i + 2 :]
    return word[:i] + bytes([dice.choice(b"abcxyzQW_")]) + word[i + 1 :]


def _field(data: bytes, dice: Dice) -> bytes:
    """A separator more or less."""
    places = [i for i, c in enumerate(data) if c in b" ,\t="] or [0]
    i = dice.choice(places)
    return data[:i] + data[i : i + 1] * dice.choice((0, 0, 2, 9)) + data[i + 1 :]


def _nothing(data: bytes, dice: Dice) -> bytes:
    return dice.choice((b"", b"\n", b" ", b"\0" * 512, b"\n" * 100))


def _insert(*pieces: bytes) -> Callable[[bytes, Dice], bytes]:
    def mutate(data: bytes, dice: Dice) -> bytes:
        at = dice.randrange(len(data) + 1)
        return data[:at] + dice.choice(pieces) + data[at:]

    return mutate


def _block(data: bytes, dice: Dice) -> tuple[int, int]:
    start = dice.randrange(len(data))
    return start, min(len(data), start + dice.choice((1, 2, 4, 8, 16, 64, 256)))


def _fill(data: bytes, dice: Dice) -> bytes:
    a, b = _block(data, dice)
    return data[:a] + bytes([dice.choice((0, 1, 127, 128, 255))]) * (b - a) + data[b:]


def _remove(data: bytes, dice: Dice) -> bytes:
    a, b = _block(data, dice)
    return data[:a] + data[b:]


def _bit(data: bytes, dice: Dice) -> bytes:
    out = bytearray(data)
    out[dice.randrange(len(out))] ^= 1 << dice.randrange(8)
    return bytes(out)


def _head(data: bytes, dice: Dice) -> bytes:
    """Bytes near the beginning, where sizes and kinds are."""
    out = bytearray(data)
    for _ in range(dice.randrange(1, 4)):
        out[min(len(out) - 1, int(dice.expovariate(1 / 60)))] = dice.randrange(256)
    return bytes(out)


def _integer(data: bytes, dice: Dice) -> bytes:
    at = 4 * dice.randrange(max(1, len(data) // 4))
    value = dice.choice((0, 1, -1, 2**31 - 1, -(2**31), 10**6, 10**9))
    return data[:at] + value.to_bytes(4, dice.choice(("little", "big")), signed=True) + data[at + 4 :]


def _exchange(data: bytes, dice: Dice) -> bytes:
    a, b, c = sorted(dice.randrange(len(data) + 1) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


_COMMON: dict[str, Callable[[bytes, Dice], bytes]] = {
    "cut": _cut,
    "bytes": _bytes,
    "nothing": _nothing,
    "twice": lambda data, dice: data + data,
    "parts exchanged": _exchange,
}
TEXT: dict[str, Callable[[bytes, Dice], bytes]] = {
    **_COMMON,
    "cut at a line": _cut_at_line,
    "line swapped": _of_lines(_swap),
    "line doubled": _of_lines(_double),
    "line moved": _of_lines(_move),
    "line deleted": _of_lines(_delete),
    "line added": _of_lines(_blank),
    "lines joined": _of_lines(_join),
    "line split": _of_lines(_split),
    "digit": _of_match(_NUMBER, _digit),
    "sign": _of_match(_NUMBER, _sign),
    "exponent": _of_match(_NUMBER, _exponent),
    "odd number": _of_match(_NUMBER, lambda _, dice: dice.choice(_ODD)),
    "typo": _of_match(_WORD, _typo),
    "word lost": _of_match(_WORD, lambda _, dice: b""),
    "separator": _field,
    "line ends": lambda data, dice: data.replace(b"\n", dice.choice((b"\r\n", b"\r", b"\n\r", b"\r\r\n"))),
    "not UTF-8": _insert(b"\xff", b"\xc3\x28", b"\xe4", b"\x80\x80"),
    "NUL": _insert(b"\0", b"\0\0\0\0"),
    "UTF-16": lambda data, dice: data.decode("latin-1").encode(dice.choice(("utf-16", "utf-16-le", "utf-32"))),
    "byte order mark": lambda data, dice: b"\xef\xbb\xbf" + data,
    "no last line end": lambda data, dice: data.rstrip(b"\r\n"),
    "tabs": lambda data, dice: data.replace(b" ", b"\t"),
    "upper case": lambda data, dice: data.upper(),
}
BINARY: dict[str, Callable[[bytes, Dice], bytes]] = {
    **_COMMON,
    "bit": _bit,
    "filled": _fill,
    "removed": _remove,
    "head": _head,
    "integer": _integer,
    "inserted": _insert(b"\0", b"\xff\xff\xff\xff", b"0000", b"\r\n"),
}


_OTHER_NUMBER = "another number in its place is as valid as the one before"
_NO_COUNT = "the format announces no counts: a part that is missing or there twice is a smaller or another file"
_OTHER_ORDER = "the format gives lines a meaning by their order or their block; they are valid where they are now"
_OTHER_NAME = "a name or an option that is free to be chosen, or text that is a comment now"
# Kind of damage -> why a reader may take it without a word.
REASONS: dict[str, str] = {
    **dict.fromkeys(
        (
            "digit",
            "sign",
            "exponent",
            "odd number",
            "bit",
            "filled",
            "integer",
            "bytes",
            "head",
            "array value small",
            "array value huge",
            "array scalar",
            "array kind",
            "array reversed",
            "array transposed",
            "array other's",
        ),
        _OTHER_NUMBER,
    ),
    **dict.fromkeys(
        (
            "cut at a line",
            "line deleted",
            "cut",
            "nothing",
            "removed",
            "array lost",
            "array group lost",
            "array renamed",
            "line doubled",
            "line added",
        ),
        _NO_COUNT,
    ),
    **dict.fromkeys(
        ("line swapped", "line moved", "parts exchanged", "lines joined", "line split", "separator"), _OTHER_ORDER
    ),
    **dict.fromkeys(("typo", "word lost", "upper case"), _OTHER_NAME),
}


# Formats that announce how much there is, so that no part of them may be missing or there twice without a word.
COUNTED = frozenset(
    (
        "msh",
        "vtk",
        "vtu",
        "mesh",
        "xdmf",
        "med",
        "matrix-market",
        "op4",
        "ansys-full",
        "npz",
        "matlab",
        "hdf5",
        "exudyn",
        "native",
        "body",
        "gmp",
    )
)


def reason(kind: str, format: str) -> str | None:
    """Why damage of a kind may pass in a format without a word; None: it may not."""
    because = REASONS.get(kind)
    return None if because == _NO_COUNT and format in COUNTED else because


def damage(path: Path, dice: Dice) -> tuple[str, str]:
    """Damage a file in one way: name of the kind, and words on what changed."""
    inside = INSIDE.get(path.suffix)
    if inside is not None and dice.random() < 0.6:
        words = inside(path, dice)
        return words.split(":")[0], words
    old = path.read_bytes()
    table = BINARY if b"\0" in old or not old.isascii() else TEXT
    kind, new = "", old
    # Some ways leave some files as they are.
    for _ in range(20):
        kind = dice.choice(list(table))
        new = table[kind](old, dice)
        if new != old:
            break
    path.write_bytes(new)
    return kind, f"{path.name}: {difference(old, new)}"


def difference(old: bytes, new: bytes) -> str:
    """The first place where two files differ."""
    at = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
    start = max(old.rfind(b"\n", 0, at) + 1, at - 60)
    return f"byte {at}, {old[start : at + 40]!r} -> {new[start : at + 40]!r}"
