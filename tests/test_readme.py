"""The Python example of the README runs as it stands."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from morembs.storage.body_file import read_body

ROOT = Path(__file__).parent.parent


def test_python_example(tmp_path):
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL).group(1)
    assert len(code.strip().splitlines()) < 15
    code = code.replace("data/small_meshes", str(ROOT / "data" / "small_meshes"))
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    body = read_body(tmp_path / "conrod.h5").bodies["cb30"]
    assert np.linalg.matrix_rank(body.stiffness_matrix, tol=1e-9 * np.abs(body.stiffness_matrix).max()) == 42 - 6
    assert body.frequencies_hz[6] > 1000


def test_solver_example():
    """The example of docs/solvers.md: a count that the analytic eigenvalues 2 - 2 cos(k pi / 1001) confirm."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "solvers.md").read_text(), re.DOTALL).group(1)
    code = code.replace("solver.negative_eigenvalues", "print(solver.negative_eigenvalues", 1).replace(
        "eye_array(1000))    #", "eye_array(1000)))  #"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    exact = 2 - 2 * np.cos(np.arange(1, 1001) * np.pi / 1001)
    assert int(done.stdout.split()[-1]) == int((exact < 0.5).sum())


def test_documents_that_are_named_exist():
    for document in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", document.read_text()):
            assert target.startswith("http") or (document.parent / target).exists(), (document.name, target)
