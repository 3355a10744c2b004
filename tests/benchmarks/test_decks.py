"""The standing comparison of decks: a fixed sample of Debian's tests of CalculiX, and what counts as a failure."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import decks
from benchmarks.deck_programs import Spectrum, difference, holds
from tests.support.calculix import needs_ccx, solids
from tests.support.structures import plate

pytestmark = needs_ccx
SAMPLE = (
    *(
        "achtelc",
        "achteld",
        "achtelg",
        "b31",
        "beamcom",
        "beamft",
        "beamlin",
        "beampisof",
        "boxprofile",
        "c3d15",
        "c3d6",
    ),
    *("changefric", "contact1", "contact10", "contact4", "contact7", "contact8", "cube2", "equrem1", "equrem3"),
)


@pytest.mark.skipif(not decks.EXAMPLES.is_dir(), reason="Debian's package calculix-ccx-test is not installed")
def test_a_sample_of_decks_comes_in_as_its_program_computes_it(tmp_path, capsys):
    kept = tmp_path / "decks.json"
    code = decks.main([str(decks.EXAMPLES), "--only", *SAMPLE, "--json", str(kept)])
    results = {result["deck"].removesuffix(".inp"): result for result in json.loads(kept.read_text())}
    assert set(results) == set(SAMPLE), capsys.readouterr().out
    for name, result in results.items():
        assert result["program"] == "computes" and result["ways"]["auto"]["taken"], name
        assert result["ways"]["auto"]["difference"] <= decks.SAME, name
        if result["solids"]:
            assert result["ways"]["own"]["taken"], name
    refused = [name for name, result in results.items() if decks.failures(result)]
    assert code == (1 if refused else 0)


def test_what_own_assembly_refuses_and_ccx_computes_is_a_failure(tmp_path, capsys):
    layers = plate("S8R", section=", COMPOSITE", data="0.1,,STEEL\n0.1,,STEEL").replace(
        "PLATE, MATERIAL=STEEL", "PLATE"
    )
    (tmp_path / "layers.inp").write_text(layers)
    (tmp_path / "box.inp").write_text(solids("C3D8", (2, 1, 1), (2.0, 1.0, 1.0)).replace("*DENSITY\n7850.\n", ""))
    assert decks.main([str(tmp_path), "--json", str(tmp_path / "results.json")]) == 1
    said = capsys.readouterr().out
    box, shell = json.loads((tmp_path / "results.json").read_text())
    assert box["ways"]["own"]["cures"] == ["density"] and not decks.failures(box)
    assert not shell["ways"]["own"]["taken"] and shell["ways"]["auto"]["taken"]
    assert [words.split(":")[0] for words in decks.failures(shell)] == ["own refuses"]
    assert "1 of 2 decks failed" in said and "1 own: DECK has # problems" in said
    row = next(line for line in said.splitlines() if line.startswith("own "))
    assert row.split()[1:6] == ["1", "of", "2", "50", "%"]


def test_a_difference_counts_unless_a_warning_has_a_code():
    row = {"taken": True, "difference": 1e-3, "codes": [], "cures": []}
    result = {"program": "computes", "ways": {"own": row}}
    assert decks.failures(result) == ["own differs by 1.0e-03 without a warning"]
    row["codes"] = ["formulation-differs"]
    assert not decks.failures(result)


def test_frequencies_are_compared_behind_rigid_motions():
    theirs = Spectrum(values=np.array([-1.0, 0.0, 2.0, 1e4, 2e4]), error=5.0)
    assert difference(Spectrum(values=np.array([0.5, 1.0, -3.0, 1e4, 2e4]), error=1.0), theirs) == 0
    assert difference(Spectrum(values=np.array([0.5, 1.0, 3.0, 1e4, 2.04e4]), error=1.0), theirs) == pytest.approx(
        0.01, rel=0.02
    )
    # Another number of rigid motions.
    assert difference(Spectrum(values=np.array([0.0, 0.0, 0.0, 0.0, 1e4]), error=1.0), theirs) > 0.1


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.inp", "*NODE\n1,0,0,0\n*ELEMENT,TYPE=C3D8R,ELSET=E\n", (True, True, False)),
        ("a.inp", solids("C3D8", (1, 1, 1), (1.0, 1.0, 1.0)), (True, True, True)),
        ("a.inp", solids("C3D8", (1, 1, 1), (1.0, 1.0, 1.0)) + "*INCLUDE,INPUT=no.inp\n", (True, True, False)),
        ("a.inp", "*NODE\n*ELEMENT,TYPE=S8R\n*ELEMENT,TYPE=C3D4\n", (True, False, False)),
        ("a.inp", "*NODE\n*ELEMENT,TYPE=CPS4\n*ELEMENT,TYPE=C3D4\n", (False, False, False)),
        ("a.bdf", "GRID,1\nCHEXA,1,1\nMAT1,1,2.+11\nRBE2,1\n", (True, True, True)),
        ("a.bdf", "GRID,1\nCHEXA,1,1\nCQUAD4  1\nINCLUDE 'no.bdf'\nMAT1,1\n", (True, False, False)),
        ("a.cdb", "ET,1,186\nMPDATA,EX,1,1,2.\nEBLOCK,19\n", (True, True, True)),
        ("a.cdb", "ET,1,181\nEBLOCK,19\n", (True, False, False)),
    ],
)
def test_what_decks_hold_is_told_by_their_words(tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    held = holds(tmp_path / name)
    assert (held.structure, held.solids, held.complete) == expected
