"""The site of the documents builds without a warning, and what its tutorials print is right."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from morembs.exporters.exudyn_system import exudyn_missing

ROOT = Path(__file__).parents[1]
PIPELINES = [path for path in (ROOT / "pipelines").iterdir() if path.suffix in (".py", ".toml")]
PROGRAMS = {path.stem.removesuffix("_system") for path in PIPELINES} - {"common"}
# A test of the pipelines looks at the files of this one.
PICTURES = PROGRAMS | {f"plots_{kind}" for kind in ("response", "density", "mac", "campbell", "cost")}
pytest.importorskip("sphinx_gallery")
if exudyn_missing():
    pytest.skip(exudyn_missing(), allow_module_level=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built from a copy of the pages beside the rest of the repository; pictures of pipelines are blank.

    Without the meshes of the repository: tutorials run wherever they are downloaded.
    """
    root = tmp_path_factory.mktemp("repository")
    for path in ROOT.iterdir():
        if path.name not in ("docs", "data") and not path.name.startswith("."):
            (root / path.name).symlink_to(path)
    for path in (ROOT / "docs").rglob("*"):
        here = path.relative_to(ROOT)
        if path.is_file() and "built" not in here.parts:
            (root / here).parent.mkdir(parents=True, exist_ok=True)
            (root / here).write_bytes(path.read_bytes())
    pictures = root / "docs" / "built" / "pipelines"
    pictures.mkdir(parents=True)
    for name in PICTURES:
        plt.imsave(pictures / f"{name}.png", [[[1.0, 1.0, 1.0]]])
    # Names of the interface in the list of contents of every page take a fifth of the time, and link within pages only.
    options = ["--fail-on-warning", "--keep-going", "--quiet", "-D", "toc_object_entries=0"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", "html"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, env={**os.environ, "MPLBACKEND": "agg"})
    assert done.returncode == 0, done.stderr[-5000:]
    return root


def printed(site, tutorial):
    """What the cells of a tutorial printed, and its notebook."""
    (page,) = (site / "docs" / "built" / "tutorials").glob(f"*_{tutorial}.rst")
    notebook = json.loads(page.with_suffix(".ipynb").read_text())
    assert len([cell for cell in notebook["cells"] if cell["cell_type"] == "code"]) >= 4
    return "\n".join(re.findall(r"\.\. code-block:: none\n\n(.*?)\n\n\n", page.read_text(), re.DOTALL))


def test_pages_link_to_each_other(site):
    """Everything that is linked within the site is there."""
    for page in (site / "html").rglob("*.html"):
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text()):
            if ":" not in target:
                assert (page.parent / target).exists(), (page.name, target)


def test_the_gallery_shows_every_pipeline(site):
    page = (site / "html" / "start" / "gallery.html").read_text()
    assert set(re.findall(r"_images/(\w+)\.png", page)) == PICTURES


def test_bodies_of_the_mesh_tutorial_are_those_of_the_model(site):
    above = [float(error) for error in re.findall(r"body: (\S+) above", printed(site, "mesh_to_body"))]
    # Rayleigh: from above, and the lowest are nearest.
    assert len(above) >= 10 and all(0 < error < 0.01 for error in above) and max(above[:3]) < 2e-4


def test_matrices_of_another_code_give_the_frequency_of_the_beam(site):
    text = printed(site, "matrices")
    assert "nothing looks wrong" in text
    solid, euler = map(float, re.findall(r"([\d.]+) Hz", text))
    # Shear and rotary inertia take one to two per cent off (Timoshenko 1921, at height/length = 1/15).
    assert 0.98 < solid / euler < 0.99


def test_certificates_of_the_tutorial_hold_the_tolerance(site):
    ranges = re.findall(r"between (\S+) and ([\d.e+-]+),", printed(site, "certificate"))
    limits = [(float(lower), float(upper)) for lower, upper in ranges]
    assert len(limits) == 3 and all(lower <= upper <= 1.051 * lower for lower, upper in limits)
    assert limits[2][1] < 1e-4 < limits[1][0] < limits[0][0]


def test_the_bound_of_the_tutorial_of_parameters_holds(site):
    text = printed(site, "parameters")
    least, largest = map(float, re.search(r"bound: (\S+) to (\S+) times the error", text).groups())
    assert 1 <= least < largest < 100
    # The bracket of 80 x 40 mm and a lug of 40 mm, 8 mm thick, with its holes; the lug is 2 mm longer.
    volume = 8 * (3 * 40**2 + 8 * 80 + 2 * 40 - np.pi * (2 * 5.5**2 + 8**2))
    assert f"at.h5 has {7.85e-6 * volume:.5f} kg" in text


def test_both_simulators_of_the_tutorial_agree(site):
    assert float(re.search(r"m, (\S+) of the length", printed(site, "exudyn"))[1]) < 2e-6
