"""Numbers of decks, many at once: words of digits become integers by arithmetic on eight characters at a time.

A decimal number is an integer of at most 19 digits times a power of ten. Where the integer is below 2^53 and the power
at most 10^22, both are doubles and one operation rounds once (Clinger 1990, How to read floating-point numbers
accurately); else the product is taken in two doubles (Dekker 1971), which gives the rounding but for one number in
10^13. That one, and numbers that are written otherwise, are left to ``float``. So all values agree with ``float``.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints

_Whole = NDArray[np.uint64]


class Eight:
    """Masks over eight characters of ASCII in one integer, whose lowest byte is the first of them."""

    EACH = 0x0101010101010101
    BLANKS = 0x20 * EACH
    ZEROS = 0x30 * EACH
    # Letters have it, digits, signs and blanks have not.
    OF_LETTERS = 0x40 * EACH
    # Digits have it, signs and blanks have not.
    OF_DIGITS = 0x10 * EACH
    LOW_HALVES = 0x0F * EACH
    HIGH_HALVES = 0xF0 * EACH
    # Lower halves above 9 carry into the higher ones.
    TO_SIXTEEN = 6 * EACH
    # Pairs of digits and fours of them, once these have been joined.
    PAIRS = 0x00FF00FF00FF00FF
    FOURS = 0x0000FFFF0000FFFF


class Double:
    """Decimal numbers and doubles (IEEE 754): digits of an integer of 64 bits, of a label, of an exponent; integers and
    powers of ten up to which all are doubles; powers of ten that are kept in two doubles."""

    DIGITS = 19
    LABEL_DIGITS = 15
    EXPONENT_DIGITS = 4
    INTEGERS = 2**53
    EXACT_POWER = 22
    POWERS = 60


_COMMA, _NEWLINE, _DOT, _PLUS, _MINUS, _BLANK, _TAB = b",\n.+- \t"
_TENS = np.array([10**k for k in range(Double.DIGITS + 1)], dtype=np.uint64)
_EXACT_TENS = np.array([10.0**k for k in range(Double.EXACT_POWER + 1)])
_IS_LETTER = np.isin(np.arange(256), list(b"eEdD"))


class Words:
    """Words (k,) of a text without blanks, each ended by a comma or an end of line; an empty one is 0.

    ``begin`` and ``end`` (k,) are their places, ``ends_line`` (k,) says which are the last of their lines.
    """

    def __init__(self, text: bytes) -> None:
        # Words are loaded by their ends, up to three times eight characters.
        front = 3 * 8
        self._text = b"0" * front + text
        codes = np.frombuffer(self._text, dtype=np.uint8)
        self._loads = np.ndarray(len(codes) - 7, "<u8", self._text, 0, (1,))
        # All that is no digit.
        self._marks = np.flatnonzero(codes - np.uint8(ord("0")) > 9)
        self._kinds = codes[self._marks]
        self._last = np.flatnonzero((self._kinds == _COMMA) | (self._kinds == _NEWLINE))
        self._first = np.concatenate([[0], self._last[:-1] + 1])[: len(self._last)]
        self.end = self._marks[self._last]
        self.begin = np.concatenate([[front], self.end[:-1] + 1])[: len(self.end)]
        self.ends_line: NDArray[np.bool_] = self._kinds[self._last] == _NEWLINE

    def __len__(self) -> int:
        return len(self.end)

    @cached_property
    def is_empty(self) -> NDArray[np.bool_]:
        """Which words have no characters (k,)."""
        return np.asarray(self.begin == self.end)

    @property
    def width(self) -> int:
        """Words of a line, 0 where lines differ."""
        lines = int(np.count_nonzero(self.ends_line))
        width, rest = divmod(len(self), lines) if lines else (0, 0)
        return 0 if rest or not self.ends_line[width - 1 :: width].all() else width

    def integers(self, chosen: slice | Ints = slice(None)) -> Ints | None:
        """Integers, None where a word is another."""
        begin, end, at, last = (part[chosen] for part in (self.begin, self.end, self._first, self._last))
        has_sign = at != last
        is_negative = has_sign
        if has_sign.any():
            kind = self._kinds[at]
            is_negative = kind == _MINUS
            signed = (is_negative | (kind == _PLUS)) & (self._marks[at] == begin) & (at + 1 == last) & (end - begin > 1)
            if not signed[has_sign].all():
                return None
            begin = begin + has_sign
        if (end - begin).max(initial=0) > Double.LABEL_DIGITS:
            return None
        value = self._digits(begin, end).astype(np.int64)
        return np.where(is_negative, -value, value) if has_sign.any() else value

    def reals(self, chosen: slice | Ints = slice(None), *, implied: bool = True) -> Floats | None:
        """Decimal numbers with exponents 1E3, 1D3 or, where a letter may be ``implied``, 1+3; None where a word is none
        or is not finite."""
        marks, kinds = self._marks, self._kinds
        begin, end, at, last = (part[chosen] for part in (self.begin, self.end, self._first, self._last))
        whole_word = begin
        # What stands at the next mark that is not looked at yet; the end of a word is a mark too.
        kind = kinds[at]
        is_negative = kind == _MINUS
        has_sign = (is_negative | (kind == _PLUS)) & (marks[at] == begin)
        begin, at = begin + has_sign, at + has_sign
        point = marks[at]
        has_point = kinds[at] == _DOT
        at = at + has_point
        stop = marks[at]
        plain = at == last
        is_fine = (stop - begin) > has_point
        power = point + has_point - stop
        if not plain.all():
            exponent, fits = self._exponents(at, stop, end, last, implied)
            is_fine &= fits
            power = power + exponent
        empty = end == whole_word
        if not (is_fine | empty).all():
            return None
        digits = stop - begin - has_point
        short = digits <= Double.DIGITS
        if not short.all():
            begin, stop, point, power = (np.where(short, part, 0) for part in (begin, stop, point, power))
            has_point = has_point & short
        value, is_sure = _scale(self._mantissa(begin, point, point + has_point, stop), power)
        for i in np.flatnonzero(~(is_sure & short)).tolist():
            value[i] = abs(_float(self._text[whole_word[i] : end[i]]))
        return None if not np.isfinite(value).all() else np.where(is_negative & has_sign, -value, value)

    def _exponents(self, at: Ints, stop: Ints, end: Ints, last: Ints, implied: bool) -> tuple[Ints, NDArray[np.bool_]]:
        """Exponents behind mantissas that end at ``stop``, and which of these can be."""
        has_letter = _IS_LETTER[self._kinds[at]]
        at = at + has_letter
        kind = self._kinds[at]
        has_sign = ((kind == _MINUS) | (kind == _PLUS)) & (self._marks[at] == stop + has_letter)
        begin = stop + has_letter + has_sign
        length = end - begin
        given = has_letter | has_sign
        fits = (at + has_sign == last) & ((length > 0) & (length <= Double.EXPONENT_DIGITS) | ~given)
        if not implied:
            fits &= has_letter | ~has_sign
        own = np.where(fits & given, begin, end)
        value = self._digits(own, end).astype(np.int64)
        return np.where(has_sign & (kind == _MINUS), -value, value), fits

    def _mantissa(self, begin: Ints, point: Ints, behind: Ints, stop: Ints) -> _Whole:
        """The digits before and behind a point as one integer."""
        before: _Whole = self._digits(begin, point) * _TENS[stop - behind]
        return before + self._digits(behind, stop)

    def _digits(self, begin: Ints, end: Ints) -> _Whole:
        """Integers of at most 19 digits, 0 where there are none."""
        length = end - begin
        longest = int(length.max(initial=0))
        value = _eight_digits(self._loads[end - 8], np.minimum(length, 8) if longest > 8 else length)
        for k in range(1, -(-longest // 8)):
            more = _eight_digits(self._loads[end - 8 * (k + 1)], np.clip(length - 8 * k, 0, 8))
            value += more * _TENS[8 * k]
        return value


def words_of(text: bytes) -> Words | None:
    """The words of a text with blanks and empty lines; None where a blank stands within a word."""
    if b" " in text or b"\t" in text:
        codes = np.frombuffer(text, dtype=np.uint8)
        is_end = (codes == _COMMA) | (codes == _NEWLINE)
        is_apart = is_end | (codes == _BLANK) | (codes == _TAB)
        text = text.translate(None, b" \t")
        compact = np.frombuffer(text, dtype=np.uint8)
        if _count_words(is_apart) != _count_words((compact == _COMMA) | (compact == _NEWLINE)):
            return None
    while b"\n\n" in text:
        text = text.replace(b"\n\n", b"\n")
    return Words(text.removeprefix(b"\n") if text.endswith(b"\n") else text.removeprefix(b"\n") + b"\n")


def fixed_integers(columns: NDArray[np.uint8]) -> Ints | None:
    """Integers of columns (n, k, width) with blanks in front, 0 of blank ones; None where a column is otherwise."""
    count, width = -(-columns.shape[2] // 8), columns.shape[2]
    if width > 16 or not columns.size:
        return None
    if width % 8:
        whole = np.full((*columns.shape[:2], 8 * count), _BLANK, dtype=np.uint8)
        whole[:, :, -width:] = columns
        columns = whole
    eights = columns.view("<u8")
    value = np.zeros(columns.shape[:2], dtype=np.uint64)
    odd = np.zeros_like(value)
    before = np.zeros_like(value)
    for k in range(count):
        load = eights[:, :, k]
        # Digits have the bit 16, blanks have not; 255 for each digit.
        is_digit = ((load & np.uint64(Eight.OF_DIGITS)) >> np.uint64(4)) * np.uint64(255)
        digits = (load ^ np.uint64(Eight.ZEROS)) & is_digit
        odd |= (digits | (digits + np.uint64(Eight.TO_SIXTEEN))) & np.uint64(Eight.HIGH_HALVES)
        odd |= (load ^ np.uint64(Eight.BLANKS)) & ~is_digit
        # Behind a digit stands no blank.
        odd |= ((is_digit << np.uint64(8)) | before) & ~is_digit
        before = is_digit >> np.uint64(56)
        value = value * _TENS[8] + _eight_digits(digits, None)
    return None if odd.any() or (value >= _TENS[Double.LABEL_DIGITS]).any() else value.astype(np.int64)


def _count_words(is_apart: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(is_apart[1:] > is_apart[:-1])) + int(len(is_apart) > 0 and not is_apart[-1])


def _eight_digits(load: _Whole, length: Ints | None) -> _Whole:
    """Integers of the last ``length`` (None: all) of eight digits each, the last of which is the highest byte (Lemire
    2021, Number parsing at a gigabyte per second)."""
    if length is not None:
        shift = ((8 - length) * 8).astype(np.uint64)
        load = load >> shift
        load <<= shift
    load &= np.uint64(Eight.LOW_HALVES)
    load *= np.uint64(10 * 2**8 + 1)
    load >>= np.uint64(8)
    load &= np.uint64(Eight.PAIRS)
    load *= np.uint64(100 * 2**16 + 1)
    load >>= np.uint64(16)
    load &= np.uint64(Eight.FOURS)
    load *= np.uint64(100**2 * 2**32 + 1)
    load >>= np.uint64(32)
    return load


def _scale(mantissa: _Whole, power: Ints) -> tuple[Floats, NDArray[np.bool_]]:
    """Mantissas times powers of ten, and which are rounded right for sure."""
    size = np.abs(power)
    is_exact = (mantissa <= Double.INTEGERS) & (size <= Double.EXACT_POWER)
    whole = mantissa.astype(np.float64)
    tens = _EXACT_TENS[np.minimum(size, Double.EXACT_POWER)]
    value = np.where(power < 0, whole / tens, whole * tens)
    rest = np.flatnonzero(~is_exact & (size <= Double.POWERS))
    if len(rest):
        value[rest], is_exact[rest] = _product(mantissa[rest], power[rest])
    return value, is_exact | (mantissa == 0)


def _product(mantissa: _Whole, power: Ints) -> tuple[Floats, NDArray[np.bool_]]:
    """As ``_scaled``, in pairs of doubles; the second one of a result tells how near it is to the next rounding."""
    tens, tens_rest = (part[power + Double.POWERS] for part in _powers())
    whole = mantissa.astype(np.float64)
    whole_rest = (mantissa - whole.astype(np.uint64)).astype(np.int64).astype(np.float64)
    product = whole * tens
    (a, b), (c, d) = _halves(whole), _halves(tens)
    rest = ((a * c - product) + a * d + b * c) + b * d
    rest += whole * tens_rest + whole_rest * tens
    value = product + rest
    rest -= value - product
    space = np.spacing(value)
    # Half the space to the next double, a quarter below a power of two; the error of ``rest`` is 2^-51 of the space.
    doubt = np.minimum(np.abs(np.abs(rest) - space / 2), np.abs(np.abs(rest) - space / 4))
    return value, doubt > space * 2.0**-44


def _halves(value: Floats) -> tuple[Floats, Floats]:
    """Two doubles of 26 bits each that make ``value`` (Veltkamp, in Dekker 1971)."""
    high = value * (2.0**27 + 1)
    high = high - (high - value)
    return high, value - high


@cache
def _powers() -> tuple[Floats, Floats]:
    """Powers of ten from -60 to 60 as two doubles each."""
    exact = [Fraction(10) ** k for k in range(-Double.POWERS, Double.POWERS + 1)]
    first = [float(x) for x in exact]
    return np.array(first), np.array([float(x - Fraction(y)) for x, y in zip(exact, first, strict=True)])


def _float(word: bytes) -> float:
    """A word whose form was checked."""
    text = word.decode("ascii").upper().replace("D", "E")
    for sign in "+-":
        if "E" not in text and sign in text[1:]:
            text = text[0] + text[1:].replace(sign, f"E{sign}")
    return float(text)
