"""What is said of keywords of an input deck that a model does not carry: notes, warnings and refusals."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from morembs.importers.abaqus.keywords import Card
from morembs.importers.abaqus.words import CURES, EFFECTS, LEFT_OUT, SILENT, WARNED, WHY_REFUSED, WORDS
from morembs.importers.tolerances import TOL

PRETENSION = "PRE-TENSION SECTION"
LOCKED = "The *PRE-TENSION SECTION{} is locked: the faces of its cut are joined."
CUT = (
    "The *PRE-TENSION SECTION{} is cut: its faces part along the normal by one dof, a scalar of the model, so the bolt "
    "carries no force there; --pretension locked joins them."
)


def warning_of(card: Card) -> str | None:
    """What to say beside the notes of a keyword that is left out, None where nothing depends on it."""
    word = card.keyword
    option, effect = WARNED.get(word, ("", ""))
    if effect and (not option or option in card.options):
        return f"*{word} was left out: {effect} [keyword-effect]"
    if word in LEFT_OUT and not WORDS[word].source:
        return (
            f"*{word} was left out: no line of a manual is known that stiffness and mass do not depend on "
            "it, so check that they do not [keyword-unsourced]"
        )
    return None


def refusal_of(card: Card) -> str:
    """Why a keyword cannot be read, with its cure."""
    word = card.keyword
    named = next((card.options[key] for key in ("NAME", "ELSET", "NSET") if card.options.get(key)), "")
    why = WHY_REFUSED.get(word, "morembs does not know this keyword, which may change stiffness or mass")
    like = difflib.get_close_matches(word, WORDS, n=1, cutoff=TOL.misspelt_keyword) if word not in WORDS else []
    plain = f"{f'did you mean *{like[0]}? ' if like else ''}If the model is right without it, add --skip {word!r}"
    return f"{card}{f' ({named})' if named else ''} cannot be read: {why}; {CURES.get(word, plain)}"


def notes_of(words: Iterable[str]) -> list[str]:
    """A sentence for each class of keywords that were left out, with what the model loses."""
    notes, by_kind = [], dict[str, list[str]]()
    for word in words:
        if word == "END STEP":
            notes.append("The last step is not ended (*END STEP is missing).")
        elif word not in LEFT_OUT:
            notes.append(f"*{word} is not carried over.")
        elif word not in SILENT:
            by_kind.setdefault(WORDS[word].kind, []).append(f"*{word}")
    return [*notes, *(f"{', '.join(listed)}: {EFFECTS[kind]}." for kind, listed in by_kind.items())]
