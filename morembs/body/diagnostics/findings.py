"""What an examination finds: sentences for people, with the cure and the nodes they are about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from morembs.base.arguments import check_options
from morembs.base.errors import InputError
from morembs.base.limits import one_of
from morembs.base.summary import summarised
from morembs.base.types import Ints
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import DofMap, Nodes

SEVERITIES = ("error", "warning", "note")
MOTIONS = ("x", "y", "z", "rotation x", "rotation y", "rotation z", "scalar")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing found: ``code`` for programs, ``severity`` one of ``SEVERITIES``, ``sentence`` what is there, ``cure``
    what to do about it (empty where nothing is to be done), ``where`` labels of nodes or dofs, the first 1000."""

    code: str
    severity: Annotated[str, one_of(*SEVERITIES)]
    sentence: str
    cure: str = ""
    where: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_options(self)

    def __str__(self) -> str:
        return f"{self.severity}: {self.sentence}" + (f"; {self.cure}" if self.cure else "")


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """All findings, the gravest first, and the ``facts`` (numbers by name) that were measured on the way."""

    findings: tuple[Finding, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        order = sorted(self.findings, key=lambda finding: SEVERITIES.index(finding.severity))
        object.__setattr__(self, "findings", tuple(order))
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))

    def _facts(self) -> dict[str, object]:
        counts = {severity: sum(each.severity == severity for each in self.findings) for severity in SEVERITIES}
        return {f"{severity}s": count for severity, count in counts.items()}

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that make results wrong."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that most likely are mistakes."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of all findings."""
        return tuple(finding.code for finding in self.findings)

    def text(self) -> str:
        """All findings, a line each."""
        return "\n".join(map(str, self.findings)) or "nothing was found"

    def refuse_errors(self) -> None:
        """Stop at a model that cannot be used.

        Raises:
            InputError: there are errors; the message holds them all.
        """
        if self.errors:
            raise InputError("; ".join(sentences(self.errors)), kind="model")


@dataclass(frozen=True, kw_only=True, eq=False)
class Names:
    """Labels of dofs and nodes, as far as they are known."""

    nodes: Nodes | None = None
    dofs: DofMap | None = None

    def node_labels(self, rows: Ints) -> tuple[str, ...]:
        """Labels of node rows."""
        rows = np.asarray(rows, dtype=np.int64)[: TOL.kept_labels]
        return tuple(str(label) for label in (rows + 1 if self.nodes is None else self.nodes.ids[rows]).tolist())

    def dof_labels(self, rows: Ints) -> tuple[str, ...]:
        """Labels of dofs: node and motion, or the row counted from 1."""
        rows = np.asarray(rows, dtype=np.int64)[: TOL.kept_labels]
        if self.dofs is None:
            return tuple(f"row {row + 1}" for row in rows.tolist())
        node = self.node_labels(self.dofs.node[rows])
        return tuple(
            f"node {label} {MOTIONS[motion]}"
            for label, motion in zip(node, self.dofs.component[rows].tolist(), strict=True)
        )

    def of_dofs(self, rows: Ints) -> Ints:
        """Node rows (ascending) that carry dofs, the dofs themselves where there is no map."""
        return np.unique(np.asarray(rows, dtype=np.int64) if self.dofs is None else self.dofs.node[rows])

    def places(self, rows: Ints) -> tuple[tuple[str, ...], str]:
        """Where some dofs are: labels of their nodes (of the rows where no map is known), and words for a sentence."""
        labels = self.dof_labels(rows) if self.dofs is None else self.node_labels(self.of_dofs(rows))
        count = len(rows) if self.dofs is None else len(self.of_dofs(rows))
        return labels, list_labels(labels, count, "" if self.dofs is None else "node")


def list_labels(labels: Sequence[str], count: int | None = None, what: str = "") -> str:
    """Words for the first labels of ``count``: "3 nodes (1, 2, 7)"."""
    count = len(labels) if count is None else count
    shown = ", ".join(labels[: TOL.shown_labels]) + (", ..." if count > TOL.shown_labels else "")
    if not what:
        return shown
    return f"{what} {shown}" if count == 1 else f"{count} {what}s ({shown})"


def sentences(findings: Sequence[Finding]) -> tuple[str, ...]:
    """What is found with its cure, a sentence each."""
    return tuple(f"{finding.sentence}; {finding.cure}" if finding.cure else finding.sentence for finding in findings)
