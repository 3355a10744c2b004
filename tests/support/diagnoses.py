"""What a diagnosis holds."""

from __future__ import annotations

from morembs.diagnostics.findings import Diagnosis, Finding


def grave(diagnosis: Diagnosis) -> set[str]:
    """Codes of errors and warnings."""
    return {one.code for one in diagnosis.findings if one.severity != "note"}


def finding(diagnosis: Diagnosis, code: str) -> Finding:
    """The first finding of that code."""
    return next(one for one in diagnosis.findings if one.code == code)
