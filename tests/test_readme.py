"""The Python example of the README runs as it stands."""

import re
from pathlib import Path

import numpy as np
import pytest

from morembs.body.file import read_body
from morembs.importers.model_file import read_model
from tests.support.processes import morembs, python

ROOT = Path(__file__).parent.parent


def test_python_example(tmp_path):
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL).group(1)
    assert len(code.strip().splitlines()) < 15
    code = code.replace("data/small_meshes", str(ROOT / "data" / "small_meshes"))
    done = python(code, tmp_path)
    assert done.code == 0, done.errors
    body = read_body(tmp_path / "conrod.h5").bodies["cb30"]
    assert np.linalg.matrix_rank(body.stiffness_matrix, tol=1e-9 * np.abs(body.stiffness_matrix).max()) == 42 - 6
    assert body.frequencies_hz[6] > 1000


def blocks(document):
    """Python of a page of docs."""
    text = (ROOT / "docs" / document).read_text()
    return [block.replace("data/small_meshes", str(ROOT / "data" / "small_meshes"))
            for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)]  # fmt: skip


def printed(code, folder):
    """Numbers that ``code`` prints, line by line."""
    done = python(code, folder)
    assert done.code == 0, done.errors
    return [list(map(float, re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", line))) for line in done.output.splitlines()]


def test_switching_example(tmp_path):
    first, second = blocks("switching.md")
    code = first + second + "print(body.inner.size, switching.xyz[0, 0], switching.length)\n"
    (deflection, changes), (size, start, length) = printed(code, tmp_path)
    # A beam that is clamped at both ends, 10 N in its middle; the load crosses it in a tenth of a second.
    static = 10 * 0.5**3 / (192 * 2e9 * 0.05 * 0.03**3 / 12)
    assert static < -deflection < 1.15 * static
    assert changes > 10 and size == 6
    # What the page says of positions.
    assert start == pytest.approx(0.025) and length == pytest.approx(0.45)


def test_contact_examples(tmp_path):
    ground, plate = blocks("contact.md")
    times, (gap, force, *_, complementarity), (balance,) = printed(ground, tmp_path)
    fall = np.sqrt(2 / 9.81)
    assert times[:2] == pytest.approx([fall, fall * (1 + 2 * 0.8)], abs=1e-9)
    assert gap > 0 and force == 0 and complementarity < 1e-9
    assert balance == pytest.approx(9.81, abs=1e-9)
    ((touch, least, law),) = printed(plate, tmp_path)
    # 10 mm down to the plate, which sags by some micrometres.
    assert touch == pytest.approx(np.sqrt(2 * 0.01 / 9.81), rel=1e-3)
    assert least > -1e-9 and law < 1e-9


def test_import_example(tmp_path):
    """The first command of docs/formats.md needs nothing but the repository; others name files of the reader."""
    text = (ROOT / "docs" / "formats.md").read_text()
    first, *others = re.search(r"```\n(morembs import.*?)```", text, re.DOTALL).group(1).splitlines()
    name, *arguments = first.replace("data/", f"{ROOT}/data/").split()
    assert name == "morembs" and morembs(*arguments, folder=tmp_path).code == 0
    assert read_model(tmp_path / "conrod.model.h5").size == 10_956
    for word in " ".join(others).split():
        assert "." not in word or word.startswith("part.model") or word.partition(".")[0].isupper(), word


def test_solver_example(tmp_path):
    """The example of docs/solvers.md: a count that the analytic eigenvalues 2 - 2 cos(k pi / 1001) confirm."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "solvers.md").read_text(), re.DOTALL).group(1)
    code = code.replace("solver.negative_eigenvalues", "print(solver.negative_eigenvalues", 1).replace(
        "eye_array(1000))    #", "eye_array(1000)))  #"
    )
    done = python(code, tmp_path)
    exact = 2 - 2 * np.cos(np.arange(1, 1001) * np.pi / 1001)
    assert int(done.output.split()[-1]) == int((exact < 0.5).sum())


def test_documents_that_are_named_exist():
    for document in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", document.read_text()):
            assert target.startswith("http") or (document.parent / target).exists(), (document.name, target)
