"""``[effective_mass]``: modes of a body whose interfaces are held, and the mass that each moves as the support does."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from morembs.app.jobs.stages.body import recommended_body
from morembs.app.jobs.stages.stage import BODIES, JobStage, Result, Results, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tables import Job, OptionalTable, Three
from morembs.app.report.sections import Section
from morembs.base.errors import InputError, nearest
from morembs.base.key_tables import declare_key
from morembs.base.limits import number, text
from morembs.body.effective_mass import EffectiveMasses, held_modes
from morembs.reducers import ProblemSummary
from morembs.storage.safefile import replacing

MASSES: Result[tuple[str, EffectiveMasses]] = Result("effective masses")
WAYS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True)
class EffectiveMassTable(OptionalTable):
    """``[effective_mass]``: a table of modes with interfaces held, and the mass that each of them moves."""

    path: Annotated[str, text("the path of a .csv file", r"\.csv$")]
    held: list[str] = declare_key("names of the interfaces that the support moves; by default all", [])
    point: Three = declare_key("the point that rotations of the support are about, [x, y, z]", [0.0, 0.0, 0.0])
    body: str | None = declare_key("the name of a reduction; by default the one with the smallest error", None)
    shown: Annotated[int, number("a count of modes that reports show", ge=1, le=1000)] = 20


class EffectiveMass(JobStage):
    """The modes of one body with interfaces held: frequencies, participation factors and effective masses."""

    tables = (EffectiveMassTable,)
    needs = (BODIES, WRITTEN)
    gives = (MASSES, WRITTEN)
    tells = (MASSES,)
    step = "effective mass"
    on_page = True

    def is_asked(self, job: Job) -> bool:
        return EffectiveMassTable.of(job) is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"[effective_mass] path": job.result(EffectiveMassTable.require(job).path)}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse names that there are not, and bodies that no support moves as a whole."""
        given, names = EffectiveMassTable.require(job), [interface.name for interface in facts.interfaces]
        if not names:
            raise InputError(
                "[effective_mass] holds interfaces, and there are none; add at least one [[interface]]",
                kind="missing",
                keyword="effective_mass",
            )
        for name in given.held:
            if name not in names:
                raise InputError(
                    f"[effective_mass] held = {name!r} was given; {nearest(name, names)}",
                    kind="unknown",
                    keyword="held",
                )
        if given.body is not None and given.body not in job.reducers:
            raise InputError(
                f"[effective_mass] body = {given.body!r} was given; {nearest(given.body, job.reducers)}",
                kind="unknown",
                keyword="body",
            )
        if rigid != 6:
            raise InputError(
                f"[effective_mass]: the model has {rigid} rigid-body motions; expected a free body with six, whose "
                "support is its interfaces",
                kind="model",
                keyword="effective_mass",
            )
        return ()

    def run(self, work: Work) -> None:
        job, given, bodies = work.job, EffectiveMassTable.require(work.job), work[BODIES]
        body = recommended_body(bodies) if given.body is None else next(b for b in bodies if b.name == given.body)
        held = given.held or [interface.name for interface in body.part.interfaces]
        found = held_modes(body, held, [job.units.length * value for value in given.point])
        written = io.StringIO()
        table = csv.writer(written, lineterminator="\n")
        units = [f"{way}_kg" if way in WAYS[:3] else f"{way}_kgm2" for way in WAYS]
        table.writerow(["mode", "hz", *(f"participation_{way}" for way in WAYS), *units])
        for k, (hz, factors, masses) in enumerate(
            zip(found.frequencies_hz, found.participation, found.masses, strict=True), start=1
        ):
            table.writerow([k, *(repr(float(value)) for value in (hz, *factors, *masses))])
        with replacing(job.result(given.path)) as file:
            file.write(written.getvalue().encode())
        work.give(MASSES, (body.name, found))

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        given, (name, found) = EffectiveMassTable.require(job), results[MASSES]
        return {
            "effective_mass": {
                "body": name,
                "held": given.held or "all interfaces",
                "shown": given.shown,
                "frequencies_hz": found.frequencies_hz,
                "participation": found.participation,
                "masses": found.masses,
                "total": found.total,
            }
        }

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        if "effective_mass" not in document:
            return ()
        values = document["effective_mass"]
        hz, total = values["frequencies_hz"], np.asarray(values["total"])
        shares = 100 * np.asarray(values["masses"]).reshape(-1, 6) / total
        rows = [
            (str(k + 1), f"{hz[k]:,.2f}", *(f"{x:.2f}" for x in shares[k]))
            for k in range(min(len(hz), values["shown"]))
        ]
        rows += [("all modes", "", *(f"{x:.2f}" for x in shares.sum(axis=0)))]
        rows += [("kg, kg m2", "", *(f"{x:.5g}" for x in total))]
        held = values["held"] if isinstance(values["held"], str) else ", ".join(values["held"])
        return [
            Section(
                title=f"effective masses of {values['body']} with {held} held, in % of the body",
                columns=("mode", "Hz", *WAYS),
                rows=rows,
                lines=["  the remainder to 100 % moves with the support, or in modes that the body does not have"],
            )
        ]
