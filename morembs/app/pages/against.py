"""What changed since an earlier report or batch: frequencies, mass, errors and time of each part."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from morembs.app.batches.manifest import is_manifest, read_ended
from morembs.app.pages.kept import read_document
from morembs.app.report.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.options import pairs


@dataclass(frozen=True, kw_only=True)
class ChangeLimits:
    """How much of a quantity may change, as a part of it, before it is red: errors and times by growing alone."""

    frequencies: float = TOL.changed_frequency
    mass: float = TOL.changed_mass
    error: float = TOL.grown_error
    time: float = TOL.grown_time

    @classmethod
    def of(cls, text: str) -> ChangeLimits:
        """Those of ``frequencies=1e-4,mass=0.01``, others by default.

        Raises:
            InputError: another name, or no number from 0.
        """
        names, values = [each.name for each in fields(cls)], {}
        for name, value in pairs([part.strip() for part in text.split(",") if part.strip()], "--within").items():
            try:
                values[name] = float(value)
            except ValueError:
                values[name] = math.nan
            if name not in names or not 0 <= values[name] < math.inf:
                raise InputError(
                    f"--within {name}={value} was given; expected NAME=NUMBER,NAME=NUMBER with {', '.join(names)} and "
                    "numbers from 0, parts of the old value",
                    keyword="within",
                )
        return cls(**values)


@dataclass(frozen=True, kw_only=True)
class BodyState:
    """A body as reports keep it: elastic frequencies in Hz and the upper limit of the error, None where unknown."""

    order: int
    frequencies_hz: Sequence[float]
    limit: float | None
    certified: bool


@dataclass(frozen=True, kw_only=True)
class PartState:
    """A part as a report or a manifest has it."""

    name: str
    output: Path | None
    state: str
    seconds: float | None = None
    mass: float | None = None
    bodies: Mapping[str, BodyState] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Change:
    """How one quantity ``what`` changed, of a ``body`` where it is one of a body; ``share`` is the largest change over
    the old value, None where there is no number; ``words`` are for people, ``beyond`` says that it is red."""

    what: str
    body: str = ""
    share: float | None = None
    words: str
    beyond: bool


@dataclass(frozen=True, kw_only=True)
class Earlier:
    """An earlier report, or the manifest of a batch, at ``path``, with the ``parts`` in it."""

    path: Path
    parts: Sequence[PartState]
    limits: ChangeLimits = field(default_factory=ChangeLimits)

    @classmethod
    def read(cls, path: Path, limits: ChangeLimits) -> Earlier:
        """What is in a report, its JSON, or a manifest.

        Raises:
            InputError: it cannot be read, or is neither.
        """
        try:
            states = [*_of_manifest(path)] if is_manifest(path) else [*_of_report(read_document(path), path.parent)]
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{path} is damaged, as a report or a manifest ({error!r}); give another --against",
                kind="file",
                keyword=path.name,
            ) from error
        return cls(path=path, parts=states, limits=limits)

    def find(self, part: PartState) -> PartState | None:
        """The same part: by its body file, else by a name that only one has."""
        for other in self.parts:
            if other.output is not None and other.output == part.output:
                return other
        named = [other for other in self.parts if other.name == part.name]
        return named[0] if len(named) == 1 else None

    @staticmethod
    def words(compared: Mapping[str, Any]) -> str:
        """``against old.html: 1 of 12 parts beyond the tolerances, 2 changed within them, 1 new, 0 gone``."""
        counts = Counter(
            "beyond" if any(change["beyond"] for change in each) else "changed" if each else "same"
            for each in compared["changes"]
        )
        return (
            f"against {compared['file']}: {counts['beyond']} of {counts.total()} parts beyond the tolerances, "
            f"{counts['changed']} changed within them, {len(compared['new'])} new, {len(compared['gone'])} gone"
        )

    def compare_parts(self, parts: Sequence[Mapping[str, Any]], folder: Path) -> dict[str, Any]:
        """What a report says of all parts of its document: changes by part, new parts, and missing parts."""
        now = [*_of_report({"parts": parts}, folder)]
        before = [self.find(part) for part in now]
        changes = [
            [] if old is None else [*changes_of(old, new, self.limits)] for old, new in zip(before, now, strict=True)
        ]
        known = {id(old) for old in before}
        return {
            "file": self.path.name,
            "within": asdict(self.limits),
            "changes": [[asdict(change) for change in each] for each in changes],
            "new": [part.name for part, old in zip(now, before, strict=True) if old is None],
            "gone": [old.name for old in self.parts if id(old) not in known],
        }


def changes_of(old: PartState, new: PartState, limits: ChangeLimits) -> Iterator[Change]:
    """What is not the same: state, mass and time of a part, frequencies, errors and order of its bodies."""
    if old.state != new.state and "failed" in (old.state, new.state):
        yield Change(what="state", words=f"{old.state} -> {new.state}", beyond=new.state == "failed")
    if new.state == "failed":
        return
    if old.mass is not None and new.mass is not None and old.mass != new.mass:
        share = new.mass / old.mass - 1 if old.mass else None
        words = f"{old.mass:.6g} -> {new.mass:.6g} kg{_percent(share)}"
        yield Change(what="mass", share=_number(share), words=words, beyond=share is None or abs(share) > limits.mass)
    for name, body in new.bodies.items():
        if name in old.bodies:
            yield from _of_bodies(name, old.bodies[name], body, limits)
        else:
            yield Change(what="body", body=name, words="new", beyond=False)
    for name in old.bodies:
        if name not in new.bodies:
            yield Change(what="body", body=name, words="gone", beyond=True)
    if old.seconds and new.seconds and old.seconds != new.seconds:
        share = new.seconds / old.seconds - 1
        # Short times change with what else runs.
        if abs(share) > limits.time and abs(new.seconds - old.seconds) > TOL.noticed_seconds:
            words = f"{old.seconds:.3g} -> {new.seconds:.3g} s{_percent(share)}"
            yield Change(what="time", share=_number(share), words=words, beyond=share > 0)


def _of_bodies(name: str, old: BodyState, new: BodyState, limits: ChangeLimits) -> Iterator[Change]:
    if old.order != new.order:
        yield Change(what="order", body=name, words=f"{old.order} -> {new.order}", beyond=False)
    both = [(f, g) for f, g in zip(old.frequencies_hz, new.frequencies_hz, strict=False) if f > 0]
    if both:
        number, (f, g) = max(enumerate(both, start=1), key=lambda each: abs(each[1][1] / each[1][0] - 1))
        share = g / f - 1
        if abs(share) > TOL.same_frequency:
            words = f"mode {number}: {f:,.6g} -> {g:,.6g} Hz{_percent(share)}"
            yield Change(
                what="frequencies", body=name, share=_number(share), words=words, beyond=abs(share) > limits.frequencies
            )
    if (old.certified, old.limit) != (new.certified, new.limit):
        shown = [
            "-" if not each.certified else "unbounded" if each.limit is None else f"{each.limit:.2e}"
            for each in (old, new)
        ]
        grown = new.limit / old.limit - 1 if old.limit and new.limit is not None else None
        lost = old.limit is not None and new.limit is None
        beyond = lost or (grown is not None and grown > limits.error)
        if beyond or grown is None or abs(grown) > TOL.same_frequency:
            yield Change(
                what="error", body=name, share=_number(grown), words=" -> ".join(shown) + _percent(grown), beyond=beyond
            )


def _number(value: Any) -> float | None:
    """A finite number; None for what is unknown or unbounded."""
    return float(value) if value is not None and math.isfinite(float(value)) else None


def _percent(share: float | None) -> str:
    known = _number(share)
    return "" if known is None else f" ({100 * known:+.3g} %)"


def _of_report(document: Mapping[str, Any], folder: Path) -> Iterator[PartState]:
    for part in document["parts"]:
        content = part.get("body_file") or {}
        output = part.get("output")
        yield PartState(
            name=str(part["name"]),
            output=Path(os.path.realpath(folder / unquote(output))) if output else None,
            state="failed" if part["state"] == "failed" else "done",
            seconds=_number(part.get("seconds")),
            mass=_number(content.get("mass_kg")),
            bodies={
                name: BodyState(
                    order=int(body["order"]),
                    frequencies_hz=[float(f) for f in body["frequencies_hz"]],
                    limit=_number(body["limits"].get(body["measure"])),
                    certified=body["kind"] != "none",
                )
                for name, body in content.get("bodies", {}).items()
            },
        )


def _of_manifest(path: Path) -> Iterator[PartState]:
    for output, event in read_ended(path).items():
        facts = event["facts"]
        yield PartState(
            name=Path(facts["job"]).stem,
            output=output,
            state="done",
            seconds=_number(event.get("seconds") or sum(facts.get("seconds", {}).values()) or None),
            mass=_number(facts.get("mass")),
            bodies={name: _of_facts(body) for name, body in facts.get("bodies", {}).items()},
        )


def _of_facts(body: Mapping[str, Any]) -> BodyState:
    """A body of ``morembs reduce --json``."""
    known = body.get("certificate") or {}
    limit = known.get("limits", {}).get(known.get("measure"))
    upper = None if limit is None else limit["upper"] if isinstance(limit, Mapping) else limit[1]
    return BodyState(
        order=int(body["order"]),
        frequencies_hz=[float(f) for f in body["frequencies_hz"][int(body["rigid_count"]) :]],
        limit=_number(upper),
        certified=bool(known),
    )
