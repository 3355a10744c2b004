"""Options of a user for a deck that lacks data, or has features that a linear model cannot carry."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import InputError, alike, nearest
from morembs.base.limits import Positive, one_of
from morembs.base.types import Ints
from morembs.fem.material import Material
from morembs.importers.decks.problems import Problem, quote_option
from morembs.importers.imported import Lacking

Contact = Annotated[str, one_of("refuse", "skip", "tie")]
# What becomes of bolts with a pre-tension section: "auto" refuses them in own assembly and cuts them in CalculiX.
Pretension = Annotated[str, one_of("auto", "locked", "cut")]
# What becomes of supports where a program assembles.
Boundary = Annotated[str, one_of("drop", "keep")]


@dataclass(frozen=True, kw_only=True)
class DeckOptions:
    """``density`` of element sets ("all": of all) whose materials have stiffness only, in the units of the deck; what
    becomes of ``contact``, one of refuse, skip, tie; keywords, cards or element types to ``skip``, in capitals;
    ``pretension`` whether bolts are locked or cut at their pre-tension sections; ``are_taken``: the densities are in
    the sections of the deck already."""

    density: Mapping[str, float] = field(default_factory=dict)
    contact: str = "refuse"
    skip: frozenset[str] = frozenset()
    pretension: str = "auto"
    are_taken: bool = False
    # Words of the deck that could be left out, as far as it was read.
    asked: set[str] = field(default_factory=set, compare=False, repr=False)

    @property
    def flags(self) -> tuple[str, ...]:
        """The options as the command line has them."""
        given = [f"--density {value:g}{'' if key == 'all' else f',set={key}'}" for key, value in self.density.items()]
        return (
            *given,
            *([f"--contact {self.contact}"] if self.contact != "refuse" else []),
            *(f"--skip {word}" for word in sorted(self.skip)),
            *([f"--pretension {self.pretension}"] if self.pretension != "auto" else []),
        )

    def skips(self, *words: str) -> bool:
        """True if one of ``words`` is to be left out."""
        self.asked.update(word.upper() for word in words)
        return any(word.upper() in self.skip for word in words)

    @property
    def idle(self) -> tuple[str, ...]:
        """A sentence for each word to skip that is nowhere in the deck, which was read."""
        close = {word: alike(word, self.asked) for word in sorted(self.skip - self.asked)}
        return tuple(
            f"--skip {word!r} leaves nothing out{f'; did you mean {name!r}?' if name else ''} [skip-unused]"
            for word, name in close.items()
        )

    def complete(
        self, materials: Sequence[Material], lacking: Mapping[str, Lacking], sets: Collection[str] | None = None
    ) -> tuple[tuple[Material, ...], dict[str, Lacking], list[str]]:
        """Materials, completed by the given densities, data that is missing still, and warnings.

        Args:
            sets: those of elements in the deck, where they are known.

        Raises:
            InputError: a density for a set that lacks none, or that is not there.
        """
        done, rest, warnings = list(materials), dict[str, Lacking](), []
        unused = {name.upper(): name for name in self.density if name != "all"}
        for name, lack in lacking.items():
            density = next((self.density[key] for key in self.density if key.upper() == name.upper()), None)
            unused.pop(name.upper(), None)
            density = self.density.get("all") if density is None else density
            if lack.stiffness is None or density is None:
                rest[name] = lack
                continue
            done.append(Material(set=name, stiffness=lack.stiffness, density=density))
            warnings.append(f"{lack.sentence}; {density:g} was given and taken [density-given]")
        for key, name in unused.items():
            is_there = sets is None or key in {own.upper() for own in sets}
            why = "which lacks none" if is_there else "which the deck does not have"
            raise InputError(
                f"--density was given for the set {name!r}, {why}; {nearest(name, lacking)}",
                kind="unknown",
                keyword="density",
            )
        return tuple(done), rest, warnings


def refuse_both(density: float | Mapping[str, float] | None, materials: Sequence[Material]) -> None:
    """Refuse a density and a material for one set: a material that is given is whole, and its density counts.

    Raises:
        InputError: in these cases.
    """
    keys = [] if density is None else density if isinstance(density, Mapping) else ["all"]
    named = {name.upper() for name in keys}
    for material in materials:
        if material.set.upper() in named:
            raise InputError(
                f"--density and --material were both given for {material.set!r}; a material has a density of its own: "
                "leave one out",
                kind="conflict",
                keyword="density",
            )


def density_of(texts: Sequence[str]) -> dict[str, float]:
    """Set -> density of texts "7.85e-9" (of all) and "7.85e-9,set=NAME".

    Raises:
        InputError: another form, or two densities for one set.
    """
    given: dict[str, float] = {}
    for text in texts:
        value, comma, rest = text.partition(",")
        name = rest.removeprefix("set=").strip() if comma else "all"
        try:
            density = float(value)
        except ValueError:
            density = float("nan")
        if not density > 0 or not name or (comma and not rest.startswith("set=")) or name in given:
            raise InputError(
                f"--density {text!r} was given; expected X or X,set=NAME, a positive number once a set",
                keyword="density",
            )
        given[name] = density
    return given


def deck_options(
    density: float | Mapping[str, float] | None, contact: str, skip: Sequence[str] | str, pretension: str = "auto"
) -> DeckOptions:
    """The options as they are given in Python.

    Raises:
        InputError: another word for contact, or densities that are not positive.
    """
    check_value("contact", contact, Contact)
    check_value("pretension", pretension, Pretension)
    given = dict(density) if isinstance(density, Mapping) else {} if density is None else {"all": density}
    for name, value in given.items():
        check_value(f"density of {name!r}", value, Positive)
    words = skip.split(",") if isinstance(skip, str) else skip
    plain = frozenset(" ".join(word.upper().split()).lstrip("*") for word in words if word)
    return DeckOptions(density=given, contact=contact, skip=plain, pretension=pretension)


def describe_left_out(what: str, count: int, *, contact: bool = False) -> str:
    """The warning of what was skipped."""
    code = "contact-skipped" if contact else "keywords-skipped"
    return f"{count} {what} left out as asked; stiffness or mass may depend on them [{code}]"


def lacking_problems(source: str, lacking: Mapping[str, Lacking]) -> list[Problem]:
    """A problem for each set whose material is not complete, to be listed beside others."""
    return [
        Problem(
            what=f"{lack.sentence}; {quote_option((DENSITY if lack.stiffness is not None else MATERIAL) + name)}",
            kind="missing",
            file=source,
            keyword="DENSITY" if lack.stiffness is not None else "MATERIAL",
            flags=(("--density X",) if lack.stiffness is not None else (MATERIAL + name,)),
        )
        for name, lack in lacking.items()
    ]


def material_flags(bare: Ints, sets: Mapping[str, Ints]) -> tuple[str, ...]:
    """Options that give the ``bare`` elements a material and no other a second one: for ``sets`` of members that are
    all bare, the largest first; for "all" where these are not enough, or there are no sets."""
    left, names = bare, list[str]()
    for name, members in sorted(sets.items(), key=lambda item: -len(item[1])):
        if len(members) and np.isin(members, left).all():
            names.append(name)
            left = np.setdiff1d(left, members)
    return tuple(f"{MATERIAL}{name}" for name in (names if names and not len(left) else ["all"]))


def unused_material(name: str) -> str:
    """The sentence on a material that was given for a set where it is not needed."""
    return f"--material was given for {name!r}, where nothing lacks a material; leave it out"


DENSITY = "--density X,set="
MATERIAL = "--material young=..,poisson=..,density=..,set="
