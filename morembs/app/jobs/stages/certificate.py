"""``[certify]``: limits of the errors of the reductions at every frequency of a band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from morembs.app.jobs.stages.couple import PROBLEM
from morembs.app.jobs.stages.preflight import refuse_responses
from morembs.app.jobs.stages.reduction import REDUCED
from morembs.app.jobs.stages.spin import SPINS
from morembs.app.jobs.stages.stage import JobStage, Result, Results, Work
from morembs.app.jobs.stages.unreduced import PARTS
from morembs.app.jobs.tables import CurvePoints, Job, OptionalTable
from morembs.app.jobs.tolerances import TOL
from morembs.app.report.certificates import Certified, certificate_sections
from morembs.app.report.sections import Section
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import DampingFloor
from morembs.linalg.sparse.threads import machine_slowness
from morembs.reducers import ProblemSummary
from morembs.reducers.cost import response_seconds
from morembs.reducers.problem_summary import ShiftedFactorisations
from morembs.responses.band import Band
from morembs.responses.measures import Sharpness
from morembs.responses.tolerances import TOL as RESPONSES

if TYPE_CHECKING:
    from morembs.certificate.record import Certificate

CERTIFICATES: Result[Sequence[Certificate]] = Result("certificates")


@dataclass(frozen=True, kw_only=True)
class CertifyTable(OptionalTable):
    """``[certify]``: limits of the errors at every frequency of a band."""

    band_hz: Band
    points: CurvePoints = 200
    bound: bool = True
    measure: Literal["envelope", "peak", "pointwise"] = "envelope"
    damping_floor: DampingFloor | None = None
    sharpness: Sharpness = RESPONSES.sharpness
    witness: bool | None = declare_key(
        "true: a file beside the body, with which its certificates can be verified", None
    )

    def refuse_conflicts(self) -> None:
        if self.witness and not self.bound:
            raise InputError(
                "[certify] witness = true was given with bound = false; there is nothing to prove without",
                kind="conflict",
                keyword="witness",
            )


def refuse_witness(facts: ProblemSummary) -> None:
    """Refuse a witness of what is not proven, or is no model of one part.

    Raises:
        InputError: in these cases.
    """
    model = facts.model
    if any(A is not None for A in (model.G, model.N)) or len(facts.damping.jumps):
        raise InputError(
            "[certify] witness = true was given for a model with a gyroscopic or circulatory matrix, or a modal "
            "damping table that jumps, whose limits are not proven; leave it out",
            kind="unsupported",
            keyword="witness",
        )


def witness_bytes(size: int, inputs: int, damped: bool = False) -> int:
    """Bytes of a witness, within a factor of two: two blocks of vectors and one of solutions, ten modes and rigid
    motions; with a damping matrix solutions for two loads of each vector."""
    return 8 * size * (3 * inputs + 16) * (3 if damped else 1)


class Certify(JobStage):
    """The certificates, against the unreduced parts of an assembly where they are known."""

    tables = (CertifyTable,)
    needs = (PROBLEM, PARTS, REDUCED, SPINS)
    gives = (CERTIFICATES,)
    tells = (CERTIFICATES,)
    step = "certify"

    def is_asked(self, job: Job) -> bool:
        return certified_band(job) is not None

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        """Refuse to certify what has no responses."""
        if CertifyTable.of(job) is None:
            return ()
        if not facts.inputs:
            raise InputError(
                "[certify] compares interface degrees of freedom, and there are none; add at least one [[interface]]",
                kind="missing",
                keyword="certify",
            )
        refuse_responses("certify", facts)
        return ()

    def plan_factorisations(self, job: Job, facts: ProblemSummary) -> Mapping[str, Sequence[ShiftedFactorisations]]:
        given = CertifyTable.of(job)
        return {} if given is None else {"[certify]": facts.at_frequencies(given.points)}

    def followed_seconds(self, job: Job, facts: ProblemSummary) -> Mapping[str, float]:
        return {} if CertifyTable.of(job) is None else {"[certify]": response_seconds(facts.size, facts.inputs)}

    def seconds(self, job: Job, facts: ProblemSummary, factor_entries: int) -> Mapping[str, float]:
        if CertifyTable.of(job) is None:
            # The reductions have proven it on their way.
            return {}
        proof = TOL.certificate_dof_seconds * facts.size * machine_slowness()
        return {self.step: proof + response_seconds(facts.size, facts.inputs, factor_entries)}

    def computes_modes(self, job: Job) -> bool:
        return CertifyTable.of(job) is not None

    def run(self, work: Work) -> None:
        band, given, parts = certified_band(work.job), CertifyTable.of(work.job), work.get(PARTS)
        # Not at the top: many jobs do without, and it takes a part of the memory of small ones.
        from morembs.certificate.certify import certify

        problem, reduced = work[PROBLEM], work[REDUCED]
        options = {} if given is None else given.values(but={"band_hz", "witness"})
        against = problem if parts is None else parts.problem
        spanned = reduced if parts is None else [parts.expand(body) for body in reduced]
        certificates = certify(against, spanned, band or (), **options)
        notes = () if parts is None else (parts.note,)
        work.give(CERTIFICATES, [replace(each, notes=(*notes, *each.notes)) for each in certificates])

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        names = job.reducers
        return {
            "bodies": {
                name: {"certificate": _document(certificate)}
                for name, certificate in zip(names, results[CERTIFICATES], strict=True)
            }
        }

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        if not document["bodies"]:
            return ()
        known = []
        for name, body in document["bodies"].items():
            if body["certificate"] is not None:
                limits = {measure: list(each.values()) for measure, each in body["certificate"]["limits"].items()}
                notes = [str(body["recipe"]["choice"])] if "choice" in body["recipe"] else []
                values = {"version": 2, **body["certificate"], "limits": limits}
                known.append(Certified(name=name, order=body["order"], values=values, notes=notes))
        return certificate_sections(known, list(document["interfaces"]))


def _document(certificate: Certificate) -> dict[str, Any]:
    notes = list(certificate.notes)
    values = {name: value for name, value in asdict(certificate).items() if name != "notes"}
    kinds = {"absolute_error": certificate.absolute_error, "bound_kind": certificate.bound_kind}
    return {**values, **kinds, "notes": notes}


def certified_band(job: Job) -> Sequence[float] | None:
    """The band of [certify], or the widest that a reduction was made for with a tolerance."""
    given = CertifyTable.of(job)
    if given is not None:
        return given.band_hz
    bands = [band for reducer in job.reducers.values() if (band := reducer.certified_band) is not None]
    return (min(band[0] for band in bands), max(band[1] for band in bands)) if bands else None
