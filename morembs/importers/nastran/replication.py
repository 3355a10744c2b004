"""Replicated cards of Nastran: fields that are copied or counted up from the card above, as often as asked.

``=`` copies a field and ``==`` all further ones, ``*x`` adds x, and a line ``=n`` or ``=(n)`` applies the line above n
times more (Quick Reference Guide, replication). A line that begins with a name of its own may copy the further fields.
"""

from __future__ import annotations

import re
from decimal import Decimal

from morembs.base.errors import InputError
from morembs.importers.tolerances import TOL

# A line that begins with "=", or copies a field below a name of its own: between commas, or in columns of eight.
_BETWEEN_COMMAS = rb"[A-Za-z][^\n=]*,[ \t]*==?[ \t]*(?:,[^\n]*)?"
_IN_COLUMNS = rb"[A-Za-z][^\n=,*]{7}(?:[^\n=,]{8})*(?:==?[ \t]*|= {7}[^\n,]*)"
BLOCK = re.compile(rb"(?:^(?:[ \t]*=[^\n]*|%b|%b)\n(?:[ \t]*\n)*)+" % (_BETWEEN_COMMAS, _IN_COLUMNS), re.MULTILINE)
_AGAIN = re.compile(r"=\(?(\d{1,6})\)?")
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EDed]?([+-]\d+)|[EDed](\d+))?")


def replicate(above: bytes, block: bytes, where: str) -> bytes:
    """The cards, in free fields, that the lines of a block mean below the card ``above``.

    Raises:
        InputError: the card above has continuations, or a field cannot be counted up.
    """
    card = _fields(above)
    is_wide = b"*" in above[:8] and b"," not in above
    if not above.strip() or not above[:1].isalpha() or is_wide:
        what = "fields of 16 columns" if is_wide else "continuations"
        raise InputError(
            f"{where}: cards with {what} are replicated, which is not read; write them out", kind="unsupported"
        )
    rule: list[str] = []
    cards: list[str] = []
    for line in block.split(b"\n"):
        fields = _fields(line)
        again = _AGAIN.fullmatch("".join(fields))
        if not any(fields):
            continue
        if again and not rule:
            raise InputError(
                f"{where}: {line.decode('latin-1').strip()!r} repeats no line; write the cards out", kind="file"
            )
        rule = rule if again else fields
        count = int(again[1]) if again else 1
        if len(cards) + count > TOL.max_replicated:
            raise InputError(
                f"{where}: more than {TOL.max_replicated} cards are replicated; check the count", kind="unsupported"
            )
        for _ in range(count):
            card = _next(card, rule, where)
            cards.append(",".join(card))
    return "".join(f"{card}\n" for card in cards).encode("latin-1")


def _fields(line: bytes) -> list[str]:
    text = line.decode("latin-1")
    parts = text.split(",") if "," in text else [text[at : at + 8] for at in range(0, len(text), 8)]
    return [part.strip() for part in parts]


def _next(card: list[str], rule: list[str], where: str) -> list[str]:
    result: list[str] = []
    for at, word in enumerate(rule):
        given = card[at] if at < len(card) else ""
        if word == "==":
            return [*result, *card[at:]]
        if word == "=":
            result.append(given)
        elif word.startswith("*"):
            result.append(_sum(given, word[1:].strip("()"), where))
        else:
            result.append(word)
    return result


def _sum(given: str, step: str, where: str) -> str:
    numbers = [_NUMBER.fullmatch(text) for text in (given, step)]
    if None in numbers:
        raise InputError(f"{where}: {given!r} cannot be counted up by {step!r}; write the cards out", kind="file")
    a, b = (Decimal(f"{match[1]}e{match[2] or match[3] or 0}") for match in numbers if match)
    whole = "." not in given and "." not in step
    total = a + b
    return str(int(total)) if whole else f"{float(total)!r}"
