"""Says in plain words what is wrong with the matrices of a model, before they are used."""

from morembs.doctor.examine import examine, examine_model, repaired
from morembs.doctor.findings import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "examine", "examine_model", "repaired"]
