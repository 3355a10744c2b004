"""Options of an import are declared once, and mean the same on the command line, in jobs and in Python."""

from __future__ import annotations

import pickle
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import morembs
from morembs import import_model, read_model
from morembs.app.cli.models import import_command
from morembs.app.jobs.tables import ModelTable
from morembs.importers.advice import JOB as JOB_FORM
from morembs.importers.advice import PYTHON
from morembs.importers.decks.problems import DeckError
from morembs.importers.options import ImportOptions, read_import_options
from tests.support import commands
from tests.support.decks import BEAM, MATERIAL, deck, folder
from tests.support.refusals import refusal

# Steel without density, and contact, which a linear model does not carry.
INCOMPLETE = deck(BEAM) + MATERIAL.replace("*DENSITY\n7.85e-9\n", "") + "*CONTACT PAIR, INTERACTION=NONE\nA, B\n"
OPTIONS = {"units": "mm-t-s", "density": 7.85e-9, "skip": ["CONTACT PAIR"]}
JOB = 'file = "part.inp"\nunits = "mm-t-s"\n'


def same(a, b) -> bool:
    return all((abs(getattr(a, name) - getattr(b, name))).max() == 0 for name in "KM") and a.warnings == b.warnings


def blocks(language: str, word: str) -> list[str]:
    text = (Path(__file__).parents[2] / "docs/reference/formats.md").read_text()
    return [block for block in re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL) if word in block]


def test_each_option_is_a_flag_and_a_key():
    names = {entry.name for entry in fields(ImportOptions)}
    flags = {option.name for option in import_command().params}
    assert names - {"file"} <= flags and "material" in flags
    assert names < {entry.name for entry in fields(ModelTable)}


def test_the_command_and_python_make_the_same_model(tmp_path):
    (tmp_path / "part.inp").write_text(INCOMPLETE)
    out = tmp_path / "part.model.h5"
    given = ("--units", "mm-t-s", "--density", "7.85e-9,set=EVERY", "--skip", "CONTACT PAIR")
    commands.run("import", tmp_path / "part.inp", *given, "-o", out)
    model = import_model(tmp_path / "part.inp", **OPTIONS)
    assert same(read_model(out), model) and "density-given" in " ".join(model.warnings)
    # 24 cubes of 10 mm of steel.
    np.testing.assert_allclose(model.M[0::3, 0::3].sum(), 24 * 7.85e-9 * 1e3 * 1e3)


def test_a_job_reads_a_deck_by_itself(tmp_path):
    """The bodies of a deck and of the model file that the import makes of it are the same."""
    texts = [JOB + 'density = { EVERY = 7.85e-9 }\nskip = ["CONTACT PAIR"]', 'file = "part.model.h5"\nunits = "mm-t-s"']
    bodies = []
    for number, text in enumerate(texts):
        path = tmp_path / str(number)
        path.mkdir()
        job = folder(path, {"model": text, "material": None}, INCOMPLETE)
        morembs.write_model(path / "part.model.h5", import_model(path / "part.inp", **OPTIONS))
        commands.run("reduce", job)
        bodies.append(morembs.read_body(path / "part.h5").bodies["cb"])
    assert all(np.array_equal(getattr(bodies[0].reduced, name), getattr(bodies[1].reduced, name)) for name in "KM")


def test_materials_of_a_job_go_to_its_deck(tmp_path):
    job = folder(tmp_path, {"model": JOB}, deck(BEAM))
    assert "cb" in commands.run("reduce", job)
    job = folder(tmp_path, {"model": JOB}, deck(BEAM) + MATERIAL)
    assert "where nothing lacks a material" in commands.refused(job)


def test_a_job_reads_matrices_by_themselves(tmp_path):
    from scipy.io import mmwrite

    model = import_model_of_steel(tmp_path)
    for name in "KM":
        mmwrite(tmp_path / f"{name}.mtx", getattr(model, name).tocoo())
    text = 'stiffness = "K.mtx"\nmass = "M.mtx"\nnodes = "part.inp"\n'
    job = folder(tmp_path, {"model": text, "material": None}, scaled_deck())
    commands.run("reduce", job)
    whole = folder(tmp_path, {"model": JOB, "output": 'path = "deck.h5"'}, deck(BEAM))
    commands.run("reduce", whole)
    mine, other = (morembs.read_body(tmp_path / name).bodies["cb"].frequencies_hz for name in ("part.h5", "deck.h5"))
    np.testing.assert_allclose(mine[6:], other[6:], rtol=1e-9)


def import_model_of_steel(path: Path) -> morembs.FEModel:
    (path / "steel.inp").write_text(deck(BEAM) + MATERIAL)
    return import_model(path / "steel.inp", units="mm-t-s")


def scaled_deck() -> str:
    return deck(BEAM, size=0.01)


def test_messages_name_options_as_the_user_has_them(tmp_path):
    """On the command line, in a job and in Python; a job and Python say nothing of the command line."""
    job = folder(tmp_path, {"model": JOB, "material": None}, INCOMPLETE)
    deck = tmp_path / "part.inp"
    told = commands.refused(job)
    assert 'contact = "skip" in [model] leaves it out; contact = "tie" glues it' in told
    assert "density = { EVERY = X } in [model]" in told and " --" not in told
    assert told.endswith('cure of all problems: contact = "skip", density = X in [model]\n')
    with pytest.raises(DeckError) as python:
        import_model(deck)
    with refusal("unsupported", "CONTACT PAIR", 'contact="skip"', 'contact="tie"', by=DeckError):
        morembs.read_deck(deck).to_model()
    assert 'density={"EVERY": X}' in str(python.value) and " --" not in str(python.value)
    assert python.value.answer == 'contact="skip", density=X'
    assert str(pickle.loads(pickle.dumps(python.value))) == str(python.value)
    typed = commands.run("import", deck, "-o", tmp_path / "x.model.h5", code=2)
    assert "--contact skip leaves it out" in typed and typed.rstrip().endswith("--contact skip --density X")


def test_a_mesh_of_a_job_is_refused_with_keys_of_the_job(tmp_path):
    """``read_mesh`` names arguments of Python, and a job that reads by it names keys."""
    (tmp_path / "outer.inp").write_text("*INCLUDE, INPUT=../other.inp\n")
    (tmp_path.parent / "other.inp").write_text(deck(BEAM))
    job = folder(tmp_path, {"model": 'mesh = "outer.inp"\nunits = "mm-t-s"'})
    assert "allow_includes_outside = true in [model]" in commands.refused(job)
    with refusal("unsupported", "INCLUDE", "allow_includes_outside"):
        morembs.read_mesh(tmp_path / "outer.inp")
    assert "--allow-includes-outside" in commands.run("init", tmp_path / "outer.inp", code=2)


@pytest.mark.parametrize(
    ("typed", "key", "argument"),
    [
        ("--skip 'CONTACT PAIR' if", 'skip = ["CONTACT PAIR"] in [model] if', 'skip=["CONTACT PAIR"] if'),
        ("--skip CE,CP leaves", 'skip = ["CE", "CP"] in [model] leaves', 'skip=["CE", "CP"] leaves'),
        ("--density 'X,set=A B'", 'density = { "A B" = X } in [model]', 'density={"A B": X}'),
        ("--density X,set=B, or", "density = { B = X } in [model], or", 'density={"B": X}, or'),
        ("--density was given", "density in [model] was given", "density was given"),
        ("--boundary keep --preload N", 'boundary = "keep" in [model] preload = N', 'boundary="keep" preload=N'),
        ("name it: --set K=NAME", 'name it: set = { K = "NAME" } in [model]', 'name it: set={"K": "NAME"}'),
        ("--engine calculix takes", 'engine = "calculix" in [model] takes', 'engine="calculix" takes'),
        ("--engine-timeout, or", "engine_timeout in [model], or", "engine_timeout, or"),
        ("--format nastran", 'format = "nastran" in [model]', 'format="nastran"'),
        ("leave --material out", "leave [[material]] out", "leave materials out"),
        ("--nodes FILE --dofs", 'nodes = "FILE" in [model] dofs', 'nodes="FILE" dofs'),
        (
            "--material young=..,set=A",
            '[[material]] with set = "A", young = ..',
            'materials=[isotropic(set="A", young=..)]',
        ),
        ("morembs import --list, part--contact", "morembs import --list, part--contact", None),
    ],
)
def test_every_kind_of_option_has_the_form_of_a_key_and_of_an_argument(typed, key, argument):
    assert JOB_FORM.phrase(typed) == key and PYTHON.phrase(typed) == (argument or typed)


def test_every_option_of_an_import_has_both_forms():
    for name in {field.name for field in fields(ImportOptions)} - {"allow_includes_outside"}:
        typed = f"leave --{name.replace('_', '-')} out"
        assert PYTHON.phrase(typed) == f"leave {name} out" and JOB_FORM.phrase(typed) == f"leave {name} in [model] out"


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"contact": "glue"}, ("value", "contact")),
        ({"density": -1.0}, ("value", "density")),
        ({"densty": 1.0}, ("unknown", "densty", "density")),
        ({"material": []}, ("unknown", "material", "materials")),
        ({"keep_files": 5}, ("value", "keep_files")),
        ({"set": "K=Kfull"}, ("value", "set", "Kfull")),
        ({"engine_timeout": 0}, ("value", "engine_timeout")),
        ({"units": "mm"}, ("value", "units")),
        ({"boundary": "keep"}, ("conflict", "boundary")),
        ({"engine": "calculix", "mass_integration": "exact"}, ("value", "mass_integration", "calculix")),
    ],
)
def test_options_of_python_are_checked(given, named, tmp_path):
    (tmp_path / "part.inp").write_text(deck(BEAM) + MATERIAL)
    with refusal(*named):
        import_model(tmp_path / "part.inp", **given)


def test_a_rule_for_masses_is_refused_where_matrices_are_ready(tmp_path):
    morembs.write_model(tmp_path / "steel.model.h5", import_model_of_steel(tmp_path))
    with refusal("value", "mass_integration"):
        import_model(tmp_path / "steel.model.h5", mass_integration="exact")


def test_a_material_is_whole_where_a_density_is_given_for_all_others(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(re.sub(r"\*DENSITY\n.*\n", "", deck(BEAM) + MATERIAL))
    soft = morembs.isotropic(set="EVERY", young=1e3, poisson=0.1, density=1.0)
    alone, both = (import_model(path, materials=[soft], **given) for given in ({}, {"density": 7850.0}))
    assert abs(alone.K - both.K).max() == 0 and abs(alone.M - both.M).max() == 0
    for engine in (None, "auto", "calculix", "mystran"):
        with refusal("conflict", "density", "EVERY"):
            import_model(path, materials=[soft], density={"every": 7850.0}, engine=engine)


def test_keys_of_whole_models_are_refused_beside_a_mesh(tmp_path):
    job = folder(tmp_path, {"model": 'mesh = "part.inp"\nunits = "mm-t-s"\ncontact = "skip"'})
    assert "contact was given beside mesh" in commands.refused(job)


def test_paths_of_a_job_are_seen_from_its_folder(tmp_path):
    options = read_import_options(file="a.inp", nodes="b.msh").with_paths(lambda path: tmp_path / path)
    assert options.files == (tmp_path / "a.inp", tmp_path / "b.msh")


def test_a_body_file_is_no_model(tmp_path):
    job = folder(tmp_path)
    commands.run("reduce", job)
    assert "is a body file" in commands.run("import", tmp_path / "part.h5", "-o", tmp_path / "x.model.h5", code=2)


def test_the_examples_of_the_documents(tmp_path, monkeypatch):
    (toml,), (python,) = blocks("toml", "bracket.inp"), blocks("python", "import_model")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bracket.inp").write_text(INCOMPLETE.replace("EVERY", "BODY"))
    job = folder(tmp_path, {"model": toml.replace("[model]\n", ""), "material": None})
    commands.run("reduce", job)
    exec(python, {})
    assert same(read_model("bracket.model.h5"), import_model("bracket.inp", **OPTIONS))


def test_init_keeps_the_materials_of_a_deck(tmp_path):
    """A deck with materials is proposed as a whole; of another one the job says what its mesh leaves out."""
    (tmp_path / "part.inp").write_text(deck(BEAM) + MATERIAL)
    commands.run("init", tmp_path / "part.inp", "--units", "mm-t-s", "-o", tmp_path / "job.toml")
    text = (tmp_path / "job.toml").read_text()
    assert 'file = "part.inp"' in text and "[[material]]" not in text
    commands.run("check", tmp_path / "job.toml")
    (tmp_path / "other.inp").write_text(deck(BEAM))
    commands.run("init", tmp_path / "other.inp", "-o", tmp_path / "other.toml")
    text = (tmp_path / "other.toml").read_text()
    assert 'mesh = "other.inp"' in text and "reads all that the deck holds" in text and "[[material]]" in text


STEEL = morembs.isotropic(set="all", young=210e3, poisson=0.3, density=7.85e-9)


@pytest.mark.parametrize("given", [STEEL, [{"young": 1.0}], "steel"])
def test_other_things_than_materials_are_refused_in_one_message(given, tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM))
    for call in (
        lambda: import_model(path, materials=given),
        lambda: morembs.read_deck(path).to_model(materials=given),
        lambda: morembs.assemble(morembs.read_mesh(path), given),
    ):
        with refusal("value", "materials"):
            call()


def test_a_word_to_skip_that_is_nowhere_is_told(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(INCOMPLETE)
    given = {**OPTIONS, "skip": ["CONTACT PAIR", "FOO"]}
    told = [text for text in import_model(path, **given).warnings if "skip-unused" in text]
    assert told == ['skip=["FOO"] leaves nothing out [skip-unused]']
    assert told[0] in morembs.read_deck(path, density=7.85e-9, skip="FOO,CONTACT PAIR").warnings
    with refusal("unsupported", "CONTACT PAIR", "CONTACTPAIR", "CONTACT", "PAIR"):
        import_model(path, **{**OPTIONS, "skip": ["CONTACTPAIR"]})
    assert "skip-unused" not in " ".join(import_model(path, **OPTIONS).warnings)


def test_elements_are_not_to_be_skipped_where_nothing_would_be_left(tmp_path):
    path = tmp_path / "part.inp"
    shells = "*ELEMENT, TYPE=M3D4\n101, 1, 2, 3, 4\n"
    for text, is_offered in (
        (deck(BEAM) + shells, True),
        ("*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n" + shells, False),
    ):
        path.write_text(text)
        with refusal("unsupported", "ELEMENT", "M3D4") as caught:
            import_model(path, units="mm-t-s", materials=[STEEL])
        assert ('skip=["M3D4"]' in str(caught.value)) is is_offered


def test_a_deck_that_is_given_materials_is_not_told_to_be_given_them(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM))
    notes = import_model(path, units="mm-t-s", materials=[STEEL]).notes
    assert "The deck has no materials of its own." in notes and "give them" not in " ".join(notes)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"density": {"NOPE": 1.0}}, ("unknown", "density", "NOPE", "EVERY")),
        ({"density": {"FIRST": 1.0}}, ("unknown", "density", "FIRST")),
        (
            {"materials": [morembs.isotropic(set="FOO", young=1.0, poisson=0.3, density=1.0)]},
            ("unknown", "", "FOO", "part.inp"),
        ),
    ],
)
def test_sets_that_the_deck_does_not_have_are_named(given, message, tmp_path):
    (tmp_path / "part.inp").write_text(INCOMPLETE)
    with refusal(*message):
        import_model(tmp_path / "part.inp", units="mm-t-s", skip=["CONTACT PAIR"], **given)


def test_units_of_a_deck_are_given_to_its_model(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(INCOMPLETE)
    with refusal("value", "", "to_model"):
        morembs.read_deck(path, units="mm-t-s")


def test_a_material_without_density_is_told_what_is_missing(tmp_path):
    (tmp_path / "part.inp").write_text(deck(BEAM))
    given = ("--material", "young=1,poisson=0.3", "-o", tmp_path / "x.model.h5")
    assert "density is missing: add density=NUMBER" in commands.run("import", tmp_path / "part.inp", *given, code=2)


def test_a_mesh_does_not_lose_shells_beside_solids(tmp_path):
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM) + "*ELEMENT, TYPE=S4, ELSET=SKIN\n9001, 1, 2, 3, 4\n")
    with refusal("unsupported", "ELEMENT", "S4"):
        morembs.read_mesh(path)
