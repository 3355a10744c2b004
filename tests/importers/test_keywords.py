"""What an import leaves out of a deck: keywords against the matrices of ccx with and without them, and what is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from morembs.importers.abaqus.importer import read_abaqus_deck
from morembs.importers.abaqus.words import COMPARED, EFFECTS, LEFT_OUT, WORDS, of_kind
from morembs.importers.matrices.calculix import CalculixMatrices
from tests.support.calculix import needs_ccx, solids, stored_matrices
from tests.support.refusals import refusal

BODY = (
    solids("C3D8", (1, 1, 2), (0.1, 0.1, 0.2))
    + "*NSET, NSET=ALL, GENERATE\n1, 12\n"
    + ("*SURFACE, NAME=TOP\nBODY, S2\n*SURFACE, NAME=LOW\nBODY, S1\n")
)
LAW = "*SURFACE INTERACTION, NAME=LAW\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e9\n"
PAIR = LAW + "*CONTACT PAIR, INTERACTION=LAW, TYPE=SURFACE TO SURFACE\nLOW, TOP\n"
# Keywords in use, in the model or in the step of the frequencies; in front of "|" what both models have.
IN_MODEL = {
    "SURFACE INTERACTION": LAW,
    "SURFACE BEHAVIOR": LAW,
    "FRICTION": LAW + "|*FRICTION\n0.3, 1e8\n",
    "CONTACT DAMPING": LAW + "|*CONTACT DAMPING\n1e3\n",
    "GAP CONDUCTANCE": LAW + "|*GAP CONDUCTANCE\n100., 1., 20.\n",
    "GAP HEAT GENERATION": LAW + "|*GAP HEAT GENERATION, USER\n",
    "CLEARANCE": PAIR + "|*CLEARANCE, MASTER=TOP, SLAVE=LOW, VALUE=0.01\n",
    "PHYSICAL CONSTANTS": "*PHYSICAL CONSTANTS, ABSOLUTE ZERO=-273., STEFAN BOLTZMANN=5.67e-8\n",
    "RESTART": "*RESTART, WRITE\n",
    "TIME POINTS": "*TIME POINTS, NAME=T\n0.5, 1.\n",
    "HEADING": "*HEADING\nA bar\n",
    "AMPLITUDE": "*AMPLITUDE, NAME=A\n0., 0., 1., 2.\n",
    "DESIGN VARIABLES": "*DESIGN VARIABLES, TYPE=COORDINATE\nALL\n",
    "DISTRIBUTION": "*DISTRIBUTION, NAME=D\n, 1., 0., 0., 0., 1., 0.\n1, 0., 1., 0., 0., 0., 1.\n",
    "DISTRIBUTION TABLE": "*DISTRIBUTION TABLE, NAME=DT\n",
    "INITIAL CONDITIONS": "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 100.\n",
    "VALUES AT INFINITY": "*VALUES AT INFINITY\n1., 2., 3., 4., 5.\n",
}
IN_STEP = {
    "FILM": "*FILM\n1, F1, 20., 10.\n",
    "RADIATE": "*PHYSICAL CONSTANTS, ABSOLUTE ZERO=-273., STEFAN BOLTZMANN=5.67e-8\n|*RADIATE\n1, R1, 20., 0.5\n",
    "OUTPUT": "*OUTPUT, FREQUENCY=1\n",
    "NODE PRINT": "*NODE PRINT, NSET=ALL\nU\n",
    "NODE FILE": "*NODE FILE\nU\n",
    "NODE OUTPUT": "*NODE OUTPUT\nU\n",
    "EL PRINT": "*EL PRINT, ELSET=BODY\nS\n",
    "EL FILE": "*EL FILE\nS\n",
    "ELEMENT OUTPUT": "*ELEMENT OUTPUT\nS\n",
    "CONTACT PRINT": "*CONTACT PRINT\nCSTR\n",
    "CONTACT FILE": "*CONTACT FILE\nCDIS\n",
    "CONTACT OUTPUT": "*CONTACT OUTPUT\nCDIS\n",
    "SECTION PRINT": "*SECTION PRINT, SURFACE=TOP, NAME=SP\nSOF\n",
    "CONTROLS": "*CONTROLS, RESET\n",
}
# Keywords of Abaqus that begin with one of CalculiX, by which ccx reads them.
BEGIN_AS_OTHERS = {"CONSTRAINT CONTROLS", "CONTACT FILE FORMAT", "ORIENTATION NORMAL"}


def ran(folder: Path, model: str = "", step: str = "") -> tuple[CalculixMatrices | None, str]:
    """The body with more lines of the model and of the step, through ccx."""
    return stored_matrices(BODY + model, folder, step)


def same(one: CalculixMatrices, other: CalculixMatrices) -> bool:
    """Whether two models have the same dofs, stiffness and mass."""
    return (
        np.array_equal(one.node, other.node)
        and np.array_equal(one.dof, other.dof)
        and (one.K != other.K).nnz == 0
        and (one.M != other.M).nnz == 0
    )


@needs_ccx
@pytest.mark.parametrize("word", sorted(w for w, entry in WORDS.items() if entry.source == COMPARED))
def test_a_harmless_keyword_leaves_the_matrices_of_ccx_alone(word, tmp_path):
    """Each keyword that the table calls so is in use, is known to ccx, and changes nothing."""
    text = IN_MODEL.get(word) or IN_STEP[word]
    before, _, after = text.rpartition("|")
    plain, _ = ran(tmp_path, before)
    used, said = ran(tmp_path, before + after) if word in IN_MODEL else ran(tmp_path, before, after)
    assert plain is not None and used is not None, said[-800:]
    assert "cannot be inter" not in said and f"*{word}" in after
    assert same(plain, used)


@needs_ccx
@pytest.mark.parametrize(
    "text",
    [
        "*PRE-TENSION SECTION, SURFACE=LOW, NODE=99\n0., 0., 1.\n",
        "*BOUNDARY\n1, 1, 3\n",
        "*EQUATION\n2\n1, 1, 1., 2, 1, -1.\n",
    ],
)
def test_the_comparison_finds_keywords_that_count(text, tmp_path):
    """A support, a bolt's cut and a constraint: other matrices, so none of them is harmless."""
    node = "*NODE\n99, 9., 9., 9.\n"
    (plain, _), (used, said) = ran(tmp_path, node), ran(tmp_path, node + text)
    assert plain is not None and used is not None, said[-800:]
    assert not same(plain, used)
    assert WORDS[text[1 : text.index("\n")].split(",")[0]].source != COMPARED


@needs_ccx
def test_keywords_that_ccx_knows_are_compared(tmp_path):
    """What is harmless by a manual of Abaqus, or by none, is no keyword of CalculiX, whose matrices would tell."""
    judged = set(EFFECTS) - {"support", "load", "step", "section"}
    words = sorted(w for w in of_kind(*judged) if WORDS[w].source != COMPARED)
    known = {word for word in words if "cannot be inter" not in ran(tmp_path, f"*{word}\n")[1]}
    assert known == BEGIN_AS_OTHERS & set(words)


def test_each_class_has_its_effect_and_what_has_no_source_is_warned_of(deck_of):
    assert of_kind(*EFFECTS) == LEFT_OUT and not {"PRE-TENSION SECTION", "IMPERFECTION", "MODEL CHANGE"} & LEFT_OUT
    unsourced = sorted(word for word in LEFT_OUT if not WORDS[word].source)
    told = deck_of("".join(f"*{word}\n" for word in sorted(LEFT_OUT)))
    codes = [text for text in told.warnings if text.endswith("[keyword-unsourced]")]
    assert sorted(text.split(" was ")[0][1:] for text in codes) == unsourced
    assert any("HOURGLASS" in text and text.endswith("[keyword-effect]") for text in told.warnings)
    for kind, effect in EFFECTS.items():
        (note,) = [text for text in told.notes if effect in text]
        assert all(WORDS[word.strip(" *")].kind == kind for word in note.split(": ")[0].split(","))


@pytest.fixture
def deck_of(tmp_path):
    """Import a steel box with more lines."""

    def read(lines: str):
        path = tmp_path / "deck.inp"
        path.write_text(BODY + lines)
        return read_abaqus_deck(path).convert()

    return read


@pytest.mark.parametrize("where", ["model", "step"])
def test_supports_and_loads_are_named_with_what_the_model_loses(where, deck_of):
    lines = "*BOUNDARY\n1, 1, 3\n"
    steps = "*STEP\n*STATIC\n*BOUNDARY\n2, 1, 3\n*CLOAD\n3, 1, 5.\n*END STEP\n"
    told = deck_of(lines if where == "model" else steps)
    (support,) = [note for note in told.notes if note.startswith("*BOUNDARY: supports are not applied")]
    assert "the model is free" in support and "[[interface]]" in support and "--boundary keep" in support
    assert (where == "step") == any(note.startswith("*CLOAD: loads are not applied") for note in told.notes)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("*IMPERFECTION\n1, 0.1\n", ("unsupported", "IMPERFECTION")),
        ("*MODEL CHANGE, REMOVE\nBODY\n", ("unsupported", "MODEL CHANGE")),
        ("*FIXED MASS SCALING, FACTOR=2.\n", ("unsupported", "FIXED MASS SCALING")),
        ("*PRE-TENSION SECTION, SURFACE=LOW, NODE=1\n", ("unsupported", "PRE-TENSION SECTION", "--pretension")),
    ],
)
def test_keywords_that_change_the_model_are_refused_with_their_cure(lines, said, deck_of):
    with refusal(*said):
        deck_of(lines)


def test_mass_of_surfaces_and_hourglass_stiffness_are_warned_of(deck_of):
    lines = "*SURFACE SECTION, ELSET=BODY, DENSITY=3.\n*SECTION CONTROLS, NAME=C, HOURGLASS=ENHANCED\n"
    told = deck_of(lines + "*SECTION CONTROLS, NAME=D\n")
    assert [text for text in told.warnings if "DENSITY= is the mass" in text and "[keyword-effect]" in text]
    assert len([text for text in told.warnings if "[keyword-effect]" in text]) == 2
    assert not [text for text in deck_of("*SECTION CONTROLS, NAME=D\n").warnings if "keyword" in text]
