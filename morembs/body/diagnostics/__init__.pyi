from .doctor import examine, examine_model, repaired
from .findings import Diagnosis, Finding
from .warnings import examined

__all__ = ["Diagnosis", "Finding", "examine", "examine_model", "examined", "repaired"]
