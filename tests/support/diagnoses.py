"""What a diagnosis holds."""

from __future__ import annotations

from morembs.body.diagnostics.findings import Diagnosis, Finding


def grave(diagnosis: Diagnosis) -> set[str]:
    """Codes of errors and warnings."""
    return {finding_.code for finding_ in diagnosis.findings if finding_.severity != "note"}


def finding(diagnosis: Diagnosis, code: str) -> Finding:
    """The first finding of that code."""
    return next(candidate for candidate in diagnosis.findings if candidate.code == code)
