"""Warnings of Python and of other packages are lines of the program on the command line, without places in code."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

NOISY = """
import warnings
import numpy as np
np.float64(1e308) * np.float64(10)
warnings.warn("the first\\n line, the second")
"""


def test_warnings_of_python_are_one_line_each(tmp_path: Path) -> None:
    place = tmp_path / "site-packages"
    info = place / "noisy-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: noisy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[morembs.reducers]\nnoise = noisy:Noise\n")
    (place / "noisy.py").write_text(NOISY)
    job = '[model]\nfile = "a.h5"\n[[reduce]]\nmethod = "noise"\n[output]\npath = "b.h5"\n'
    (tmp_path / "job.toml").write_text(job)

    def said(**more: str) -> list[str]:
        done = subprocess.run(
            [sys.executable, "-m", "morembs", "check", "job.toml"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(place), **more},
            check=False,
        )
        assert done.returncode == 2
        *warned, error = done.stderr.splitlines()
        assert "cannot be used" in error and error.startswith("error: ")
        return warned

    first, second = said()
    assert first == "warning: noisy: the first line, the second"
    assert second.startswith("warning: the package 'noisy' offers 'noise'")
    # Who asks Python for warnings gets them with their places, those of NumPy among them.
    raw = "\n".join(said(PYTHONWARNINGS="default"))
    assert "noisy.py:4: RuntimeWarning: overflow encountered" in raw and "noisy.py:5: UserWarning" in raw
