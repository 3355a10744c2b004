"""What is wrong with models and with delivered bodies."""

from morembs.diagnostics.doctor import examine, examine_model, repaired
from morembs.diagnostics.findings import Diagnosis, Finding
from morembs.diagnostics.warnings import examined

__all__ = ["Diagnosis", "Finding", "examine", "examine_model", "examined", "repaired"]
