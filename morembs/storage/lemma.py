"""Lemmas: the statements that a limit rests on, each with the numbers that it was shown from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from morembs.base.errors import InputError

PROVEN, ESTIMATE = "proven", "estimate"


@dataclass(frozen=True, kw_only=True)
class Lemma:
    """A link of a proof. ``name`` does not change between versions and is that of a section of
    docs/background/proofs.md with the proof; ``statement`` says what holds, by ``numbers`` that are finite; ``kind``
    is "proven" or "estimate".

    >>> count = Lemma(name="sturm-count", statement="3 modes lie below 100 Hz", numbers={"modes": 3.0})
    >>> count.kind, kind_of([count])
    ('proven', 'proven')
    """

    name: str
    statement: str
    numbers: Mapping[str, float]
    kind: str = PROVEN


def kind_of(proof: Iterable[Lemma]) -> str:
    """What follows from all lemmas of a chain: "proven" exactly where all of them are."""
    return PROVEN if all(lemma.kind == PROVEN for lemma in proof) else ESTIMATE


def proof_json(proof: Sequence[Lemma]) -> dict[str, Any] | None:
    """The lemmas of a chain as a file keeps them, None where there are none."""
    return {"lemmas": [asdict(lemma) for lemma in proof]} if proof else None


def read_lemmas(stored: Mapping[str, Any]) -> tuple[Lemma, ...]:
    """The lemmas of a ``stored`` proof, a mapping of JSON.

    Raises:
        InputError: they are none.
    """
    try:
        return tuple(
            Lemma(
                name=str(each["name"]),
                statement=str(each["statement"]),
                kind=str(each["kind"]),
                numbers={str(key): float(value) for key, value in each["numbers"].items()},
            )
            for each in stored["lemmas"]
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the proof of a certificate cannot be read ({error!r}); expected lemmas with a name, a statement, numbers "
            "and a kind; write the file again",
            kind="file",
        ) from error
