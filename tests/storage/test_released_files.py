"""Files that 0.1.0 and 0.2.0 wrote are read for ever, and those of a later version are refused in one message.

``tests/support/released.py`` made the files, and says how.
"""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from rich.console import Console

from morembs import read_body
from morembs.app.report.certificates import Certified, certificate_sections
from morembs.app.report.text import print_sections
from morembs.body.recovery_shapes import read_recovery
from morembs.dynamics.gmp.stored import read_members, write_members
from morembs.importers.model_file import read_model
from morembs.importers.native import import_native
from tests.support.refusals import refusal
from tests.support.released import body_file, described, member

RELEASED = Path(__file__).parents[1] / "data" / "0.1.0"
LATER = Path(__file__).parents[1] / "data" / "0.2.0"
EXPECTED = {**json.loads((RELEASED / "expected.json").read_text()), **json.loads((LATER / "expected.json").read_text())}


@pytest.fixture
def unpacked(tmp_path: Path) -> Path:
    for packed in (*RELEASED.glob("*.gz"), *LATER.glob("*.gz")):
        (tmp_path / packed.stem).write_bytes(gzip.decompress(packed.read_bytes()))
    return tmp_path


def compare(name: str, values: dict[str, object]) -> None:
    """All that was found then; there may be more by now."""
    expected = EXPECTED[name]
    assert {place: values.get(place, "missing") for place in expected} == expected


@pytest.mark.parametrize("name", ["symmetric.h5", "two_sided.h5", "limits.h5", "design.h5", "turning.h5"])
def test_body_files(unpacked: Path, name: str) -> None:
    compare(name, body_file(unpacked / name, read_body, read_recovery))


def test_what_the_body_files_hold(unpacked: Path) -> None:
    """Every part of the format is in one of them."""
    symmetric, two_sided = (read_body(unpacked / f"{name}.h5", whole=True) for name in ("symmetric", "two_sided"))
    rail, (both,) = symmetric.bodies["rail"], two_sided.bodies.values()
    assert (symmetric.format_version, two_sided.format_version) == (1, 2)
    assert rail.has_switching and rail.has_recovery and rail.certificate and rail.ranking
    assert rail.floating is not None and rail.floating.stiffening is not None and rail.floating.kind == "tangent"
    assert not np.array_equal(both.input_matrix.T, both.output_matrix)


def test_what_files_of_0_2_hold_beyond(unpacked: Path) -> None:
    limits, design, turning = (read_body(unpacked / f"{name}.h5") for name in ("limits", "design", "turning"))
    certificate = limits.bodies["craig-bampton"].certificate
    assert certificate is not None and certificate.kind == "proven" and 0 < certificate.limit.upper < np.inf
    assert certificate.proof and "limits" in certificate.datasets
    parametric = design.bodies["parametric"].parametric
    assert parametric is not None and parametric.names == ("E",)
    softest, stiffest = (parametric.at(E=value).frequencies_hz for value in (2e11, 2.2e11))
    assert stiffest[-1] == pytest.approx(softest[-1] * 1.1**0.5, rel=1e-6)
    (body,) = turning.bodies.values()
    assert turning.format_version == 3 and not np.allclose(body.damping_matrix, body.damping_matrix.T)


@pytest.mark.parametrize(("name", "version"), [("tied", 2), ("turning", 3)])
def test_models_of_0_2(unpacked: Path, name: str, version: int) -> None:
    path = unpacked / f"{name}.model.h5"
    compare(path.name, described(read_model(path)))
    with h5py.File(path) as file:
        assert file["format_version"][()] == version


def test_certificates_of_the_first_version(unpacked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They were errors at samples, and are told as such beside those that hold at every frequency."""
    stored = read_body(unpacked / "symmetric.h5")
    for body in stored.bodies.values():
        certificate = body.certificate
        assert certificate is not None and not certificate.limits and certificate.limit.upper == np.inf
        values = certificate.datasets
        assert "version" not in values and "limits" not in values and "damping_floor" not in values
        assert values["bound_kind"] == "bound" and (values["error"] <= values["bound"]).all()
        known = Certified(name=body.name, order=8, values=values)
        print_sections(Console(width=200), certificate_sections([known], []))
        assert (
            f"{body.name}: certificate at samples: error at most {values['error'].max():.1e}, bound "
            f"{values['bound'].max():.1e} at 2 frequencies from 10 to 2,000 Hz"
        ) in capsys.readouterr().out


def test_a_model_file(unpacked: Path) -> None:
    compare("coupled.model.h5", described(import_native(unpacked / "coupled.model.h5")))
    assert list(read_model(unpacked / "coupled.model.h5").couplings) == ["RBE2_1", "RBE3 2"]


def test_members_with_large_deflections(unpacked: Path) -> None:
    compare("members.h5", described(read_members(unpacked / "members.h5")))


def test_a_run_goes_on_from_equilibria(unpacked: Path) -> None:
    resumed = member(checkpoint=unpacked / "equilibria.h5")
    assert resumed.report.solved == 0 and resumed.report.restored
    then = read_members(unpacked / "members.h5")["rod"]
    now, before = resumed.data.table.coefficients, then.table.coefficients
    # Modes and fields of the file have the signs of its own version.
    now = now * np.sign((now * before).sum(axis=(0, 1)))
    # Other processors round otherwise.
    assert now == pytest.approx(before, rel=1e-6, abs=1e-9 * np.abs(before).max())


@pytest.mark.parametrize("name", ["symmetric.h5", "coupled.model.h5", "members.h5", "equilibria.h5"])
def test_a_later_version_is_refused(unpacked: Path, name: str) -> None:
    path = unpacked / name
    if name == "members.h5":
        write_members(path, read_members(path))
    with h5py.File(path, "r+") as file:
        if name == "equilibria.h5":
            file.attrs["kind"] = "morembs equilibria 9"
        else:
            file["format_version"][()] = 9
    read = {"symmetric.h5": read_body, "coupled.model.h5": read_model, "members.h5": read_members}
    with refusal("file", name, "9;"):
        read.get(name, lambda path: member(checkpoint=path))(path)
