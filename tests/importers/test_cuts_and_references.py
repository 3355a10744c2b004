"""Cuts of bolts and references of distributing couplings: where own assembly and CalculiX could be models apart."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.importers import import_file
from morembs.importers.to_model import model_of
from tests.support.calculix import independent, needs_ccx, on_plane, solids, stored_matrices
from tests.support.decks import refusals

# Both programs have these elements alike.
BAR = solids("C3D20", (1, 1, 4), (0.1, 0.1, 0.4)) + "*NODE\n90, 1., 0., 0.\n91, 0.05, 0.05, 0.4\n"
END = on_plane(BAR, 2, 0.4)
BOLT = BAR + "*SURFACE, NAME=CUT\n2, S2\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=90\n0., 0., 1.\n"
HELD = "*BOUNDARY\n90, 1\n"
SKIP = {"skip": "PRE-TENSION SECTION"}
# The reference is away from the middle of the end (90), or in it (91).
COUPLINGS = {
    "COUPLING": "*SURFACE, NAME=END\n4, S2\n*COUPLING, REF NODE={0}, SURFACE=END, CONSTRAINT NAME=C\n"
    "*DISTRIBUTING\n1, 6\n",
    "DISTRIBUTING COUPLING": "*ELEMENT, TYPE=DCOUP3D, ELSET=C\n999, {0}\n*DISTRIBUTING COUPLING, ELSET=C\n"
    + "".join(f"{node}, 1.\n" for node in END),
}
# A corner of the other end moves along x as the reference does.
EQUATION = "*EQUATION\n2\n1, 1, 1., {0}, 1, -1.\n"


def elastic(K: np.ndarray, M: np.ndarray) -> np.ndarray:
    """The first frequencies in Hz of a free body, without those of its rigid motion and mechanisms."""
    hertz = np.sqrt(np.abs(sl.eigh(K, M, eigvals_only=True))) / (2 * np.pi)
    return hertz[hertz > 1.0][:10]


@pytest.fixture
def frequencies(tmp_path):
    """Frequencies of a deck as it is imported, and the notes of the import."""

    def imported(deck: str, **options: object):
        (tmp_path / "deck.inp").write_text(deck)
        engine = options.pop("engine", None)
        read = import_file(tmp_path / "deck.inp", engine=engine, options=options)
        return elastic(*(A.toarray() for A in independent(model_of(read)))), " ".join(read.notes)

    return imported


@pytest.fixture
def ccx_frequencies(tmp_path):
    """Frequencies of the matrices that ccx stores of a deck."""

    def stored(deck: str) -> np.ndarray:
        read, said = stored_matrices(deck, tmp_path)
        assert read is not None, said[-500:]
        return elastic(read.K.toarray(), read.M.toarray())

    return stored


def test_a_cut_bolt_is_refused_and_the_cure_locks_it(tmp_path):
    (tmp_path / "deck.inp").write_text(BOLT)
    line = ["import", str(tmp_path / "deck.inp"), "--units", "m-kg-s", "-o", str(tmp_path / "a.h5")]
    refused = CliRunner().invoke(app, line)
    assert refused.exit_code == 2 and "--pretension locked" in refused.output and "--pretension cut" in refused.output
    for option in (["--skip", "PRE-TENSION SECTION"], ["--pretension", "locked"]):
        done = CliRunner().invoke(app, [*line, *option])
        assert done.exit_code == 0 and "is locked" in " ".join(done.output.split())
    done = CliRunner().invoke(app, [*line, "--pretension", "cut"])
    assert done.exit_code == 0 and "of node 90 is cut" in " ".join(done.output.split())


@needs_ccx
def test_both_roads_say_whether_a_bolt_is_cut(frequencies, ccx_frequencies):
    """A held node locks the bolt, as own assembly has it; a free one leaves the cut, which takes stretching modes."""
    cut, locked = ccx_frequencies(BOLT), ccx_frequencies(BOLT + HELD)
    assert np.abs(cut[:8] / locked[:8] - 1).max() > 0.1
    for deck, options, wanted, said in (
        (BOLT, SKIP, locked, "is locked"),
        (BOLT, {"pretension": "locked"}, locked, "of node 90 is locked"),
        (BOLT, {"pretension": "cut"}, cut, "of node 90 is cut"),
        (BOLT.replace("0., 0., 1.\n", ""), {"pretension": "cut"}, cut, "of node 90 is cut"),
        (BOLT, {"engine": "calculix", "pretension": "locked"}, locked, "of node 90 is locked"),
        (BOLT, {"engine": "calculix", "pretension": "cut"}, cut, "of node 90 is cut"),
        (BOLT, {"engine": "calculix"}, cut, "of node 90 is cut"),
        (BOLT + HELD, {"engine": "calculix"}, cut, "of node 90 is cut"),
        (BOLT + HELD, {"engine": "calculix", "boundary": "keep"}, locked, "of node 90 is locked"),
        (BOLT, {"engine": "calculix", **SKIP}, locked, "of node 90 is locked"),
    ):
        own, notes = frequencies(deck, **options)
        assert said in notes
        assert own == pytest.approx(wanted, rel=1e-6)


@needs_ccx
def test_programs_differ_in_what_moves_the_reference_of_a_coupling(frequencies, ccx_frequencies):
    """The premise: ccx and the meaning of Abaqus are other bodies, but where the reference is amid its nodes."""
    for kind, reference, same in (
        ("COUPLING", 90, False),
        ("COUPLING", 91, False),
        ("DISTRIBUTING COUPLING", 90, False),
        ("DISTRIBUTING COUPLING", 91, True),
    ):
        deck = BAR + COUPLINGS[kind].format(reference) + EQUATION.format(reference)
        own, _ = frequencies(deck, dialect="abaqus")
        assert (np.abs(own / ccx_frequencies(deck) - 1).max() < 1e-6) == same
        if same:
            assert frequencies(deck, dialect="calculix")[0] == pytest.approx(own, rel=1e-12)


@pytest.mark.parametrize("kind", COUPLINGS)
@pytest.mark.parametrize("terms", ["1, 1, 1., 90, 1, -1.", "90, 1, 1., 1, 1, -1."])
def test_an_equation_on_a_reference_is_refused_where_its_meaning_is_not_told(kind, terms, frequencies):
    deck = BAR + COUPLINGS[kind].format(90) + f"*EQUATION\n2\n{terms}\n"
    assert refusals(lambda: frequencies(deck, dialect="calculix")) == [("EQUATION", 0, ("--skip EQUATION",))]
    assert len(frequencies(deck, dialect="calculix", skip="EQUATION")[0])


@needs_ccx
@pytest.mark.parametrize("kind", COUPLINGS)
@pytest.mark.parametrize(
    ("lines", "keyword"),
    [
        (EQUATION.format(90), "EQUATION"),
        ("*MPC\nPIN, 1, 90\n", "MPC"),
        ("*BOUNDARY\n90, 1, 3\n", "BOUNDARY"),
        ("*STEP\n*STATIC\n*BOUNDARY\n90, 1\n*END STEP\n", "BOUNDARY"),
    ],
)
def test_the_engine_refuses_what_acts_on_a_reference(kind, lines, keyword, frequencies):
    """Its matrices do not hold the coupling, so the equation or support would be lost."""
    deck = BAR + COUPLINGS[kind].format(90) + lines
    cure = "--boundary drop" if keyword == "BOUNDARY" else f"--skip {keyword}"
    assert (keyword, 0, (cure,)) in refusals(lambda: frequencies(deck, engine="calculix", boundary="keep"))
