"""Bands that do not begin at 0 Hz: which modes count as in them, by both ends."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.certificate.certify import certify
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, FreeInterface
from tests.support.decks import folder
from tests.support.meshes import box, steel, where

RUNNER = CliRunner()
DAMPED = Damping(alpha=2.0, beta=4e-7)


def beam(damping=DAMPED, components=None):
    model = steel(box("hex20", (6, 1, 1), (0.5, 0.05, 0.03)))
    options = {} if components is None else {"components": components}
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling="average", **options)
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    return Problem(model, ends, damping=damping)


@pytest.mark.parametrize("damping", [DAMPED, Damping(), Damping(modal_table=((0.0, 0.01), (4000.0, 0.02)))])
def test_modes_below_the_band_are_not_in_it(damping):
    """What is said of the modes in the band is that of the same modes in a band from 0 Hz."""
    with beam(damping) as problem:
        hz = problem.elastic_modes(count=12).frequencies_hz
        body = FreeInterface(modes=8).reduce(problem)
        high = 0.5 * (hz[8] + hz[9])
        (whole,) = certify(problem, [body], [0.0, high])
        (upper,) = certify(problem, [body], [0.5 * (hz[4] + hz[5]), high])
        assert len(whole.mode_mac) == 9
        assert upper.mode_frequencies_hz == pytest.approx(hz[5:9], rel=1e-8)
        for name in ("mode_enclosure_hz", "mode_deviation", "mode_mac", "residue_deviation"):
            assert getattr(upper, name) == pytest.approx(getattr(whole, name)[5:], rel=1e-6, abs=1e-9, nan_ok=True)
        assert upper.verified_below_hz == whole.verified_below_hz > 1.2 * high


@pytest.mark.parametrize(
    ("low", "high", "first", "last"),
    [(1.0, 1.0, 2, 6), (1 + 1e-4, 1 - 1e-4, 3, 5), (1 - 1e-4, 1 + 1e-4, 2, 6), (1.0, 1 - 1e-4, 2, 5)],
)
def test_a_mode_on_an_end_of_the_band_is_in_it(low, high, first, last):
    """The numbers of modes 2 to 5, by ends at, above or below the frequencies of the first and the last."""
    with beam() as problem:
        hz = problem.elastic_modes(count=8).frequencies_hz
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], [low * hz[2], high * hz[5]])
        assert certificate.mode_frequencies_hz == pytest.approx(hz[first:last], rel=1e-8)


def test_a_band_between_two_modes_has_none():
    with beam() as problem:
        hz = problem.elastic_modes(count=4).frequencies_hz
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], [1.05 * hz[1], 0.95 * hz[2]])
        assert not len(certificate.mode_frequencies_hz) and certificate.mode_enclosure_hz.shape == (0, 2)
        assert certificate.kind == "proven" and np.isfinite(certificate.limit.upper)


def test_auto_is_not_blamed_for_modes_below_its_band():
    with beam() as problem:
        hz = problem.elastic_modes(count=10).frequencies_hz
        band = [1.05 * hz[5], 1.05 * hz[9]]
        body = AutoReducer(band_hz=band, tolerance=0.3).reduce(problem)
        (certificate,) = certify(problem, [body], band)
        assert certificate.limit.upper <= 0.3 and not certificate.notes
        assert certificate.mode_deviation.max() < 1e-3 and certificate.mode_mac.min() > 0.9
        (whole,) = certify(problem, [body], [0.0, band[1]])
        assert any("are not in this body" in note for note in whole.notes)


def test_the_commands_speak_of_the_modes_in_the_band(tmp_path):
    """Reports of a body for a band above its first modes, when it is made and from its file."""
    job = folder(
        tmp_path,
        {
            "reduce": 'method = "auto"\nband_hz = [80000.0, 120000.0]\ntolerance = 0.3',
            "damping": "rayleigh = { alpha = 2.0, beta = 1e-8 }",
        },
    )
    made = RUNNER.invoke(cli.app, ["reduce", str(job)])
    assert made.exit_code == 0, made.stderr
    shown = RUNNER.invoke(cli.app, ["info", str(tmp_path / "part.h5")])
    for text in (made.stdout, shown.stdout):
        assert "from 80,000 to 120,000 Hz" in text and "not in this body" not in text
    (document,) = json.loads(RUNNER.invoke(cli.app, ["info", str(tmp_path / "part.h5"), "--json"]).stdout)
    (body,) = document["bodies"].values()
    known = body["certificate"]
    low, high = np.array(known["mode_enclosure_hz"]).reshape(-1, 2).T
    assert len(low) and (high >= 80000.0).all() and (low <= 120000.0).all()
    assert max(known["mode_deviation"]) < 0.1
