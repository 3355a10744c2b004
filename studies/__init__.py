"""Longer studies than the pipelines, which they build on: ``python -m studies.NAME``, from the root of the project."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "pipelines"))
