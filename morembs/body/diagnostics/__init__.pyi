from .doctor import examine, examine_model, repaired
from .findings import Diagnosis, Finding
from .warnings import list_warnings

__all__ = ["Diagnosis", "Finding", "examine", "examine_model", "list_warnings", "repaired"]
