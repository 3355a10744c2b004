"""Text of cards in fields of 16 columns, every real number with a decimal point."""

from __future__ import annotations

from collections.abc import Iterable

from morembs.importers.nastran.cards import real
from morembs.importers.tolerances import TOL

Field = str | int | float


def number16(value: float) -> str:
    """The text of at most 16 characters, with a decimal point, that is nearest to a number."""
    if value == 0.0:
        return "0."
    sign, size = ("-", -value) if value < 0 else ("", value)
    room = 16 - len(sign)
    mantissa, power = f"{size:.16e}".split("e")
    digits = room - 2 - len(f"{int(power):+d}")
    mantissa, power = f"{size:.{digits}e}".split("e")
    texts = [f"{mantissa}{int(power):+d}"]
    if TOL.plain_from < size < TOL.plain_below:
        whole = len(str(int(size))) if size >= 1 else 0
        texts.append(f"{size:.{room - whole - 1}f}".removeprefix("0"))
    readable = [text for text in texts if len(text) <= room]
    return sign + min(readable, key=lambda text: abs(_value(text) - size))


def _value(text: str) -> float:
    return real(text, text)


def card(name: str, fields: Iterable[Field]) -> str:
    """A card with fields of 16 columns."""
    words = [number16(field) if isinstance(field, float) else str(field) for field in fields]
    while words and not words[-1]:
        words.pop()
    lines = [
        f"{'*' if at else name + '*':8}{''.join(f'{word:>16}' for word in words[at : at + 4])}\n"
        for at in range(0, len(words), 4)
    ]
    # Cards in fields of 16 columns have lines in pairs.
    return "".join(lines) + ("*\n" if len(lines) % 2 else "")
