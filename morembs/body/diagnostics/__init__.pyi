from .doctor import complete_half_stored, examine, examine_model
from .findings import Diagnosis, Finding
from .warnings import list_warnings

__all__ = ["Diagnosis", "Finding", "complete_half_stored", "examine", "examine_model", "list_warnings"]
