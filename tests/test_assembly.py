"""Bodies made of bodies: against models that were never cut, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs.app.cli.commands import app
from morembs.body.file import StoredBodies, read_body, write_body
from morembs.dynamics.assembly import Couple, Substructure, assemble_bodies
from morembs.fem import FEModel, rigid_motion
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

LENGTH, SECTION = 0.3, (0.05, 0.04)
Make = Callable[..., Path]


def bar(pieces: int) -> FEModel:
    return steel(box("hex8", (3 * pieces, 2, 2), (LENGTH * pieces, *SECTION)))


def ends(model: FEModel, **places: float) -> list[morembs.Interface]:
    return [morembs.make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in places.items()]


@pytest.fixture(scope="module")
def make_piece(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Path of the body of a piece, with all its modes unless a reducer is given."""
    folder = tmp_path_factory.mktemp("pieces")

    def make(name: str, reducer: object = None, **damping: float) -> Path:
        path, model = folder / f"{name}.h5", bar(1)
        with morembs.Problem(model, ends(model, L=0.0, R=LENGTH), damping=morembs.Damping(**damping)) as problem:
            chosen = reducer or morembs.CraigBampton(modes=problem.K.shape[0] - 12)
            body = morembs.elastic_body(problem, chosen.reduce(problem), morembs.make_part(problem))
            return write_body(path, [body])

    return make


@pytest.fixture(scope="module")
def piece(make_piece: Make) -> StoredBodies:
    return read_body(make_piece("whole"))


def row(piece: StoredBodies, count: int, turn: np.ndarray | None = None, **options: object) -> FEModel:
    """Pieces one behind the other, all turned in space."""
    R = np.eye(3) if turn is None else turn
    parts = [
        Substructure(name=f"p{k}", bodies=piece, position=R @ [LENGTH * k, 0, 0], rotation=R) for k in range(count)
    ]
    couples = [Couple(between=(f"p{k}:R", f"p{k + 1}:L"), **options) for k in range(count - 1)]
    return assemble_bodies(parts, couples)


def lowest(model: FEModel, count: int = 12, **sets: str) -> tuple[np.ndarray, morembs.Problem]:
    interfaces = [morembs.make_interface(model, name=name, nodes=model.nodes.sets[of]) for name, of in sets.items()]
    with morembs.Problem(model, interfaces) as problem:
        return problem.elastic_modes(count=count).frequencies_hz, problem


@pytest.mark.parametrize("count", [2, 3])
def test_pieces_with_all_their_modes_are_the_uncut_bar(count: int, piece: StoredBodies) -> None:
    model = bar(count)
    cuts = {f"cut{k}": LENGTH * k for k in range(count + 1)}
    with morembs.Problem(model, ends(model, **cuts)) as uncut:
        expected = uncut.elastic_modes(count=12).frequencies_hz
        mass, center, inertia = uncut.mass_properties
        loads = slice(0, 6), slice(6 * count, 6 * count + 6)
        H = morembs.full_response(uncut, 2 * np.pi * np.array([150.0, 900.0]))[:, loads[0], loads[1]]
    model = row(piece, count)
    frequencies, problem = lowest(model, first="p0:L", last=f"p{count - 1}:R")
    assert frequencies == pytest.approx(expected, rel=1e-9)
    assert problem.mass_properties[0] == pytest.approx(mass, rel=1e-12)
    assert problem.mass_properties[1] == pytest.approx(center, rel=1e-12)
    assert problem.mass_properties[2] == pytest.approx(inertia, rel=1e-10, abs=1e-12)
    with morembs.Problem(model, problem.interfaces) as again:
        ours = morembs.full_response(again, 2 * np.pi * np.array([150.0, 900.0]))[:, :6, 6:]
    assert np.abs(ours - H).max() < 1e-8 * np.abs(H).max()


def test_frequencies_do_not_know_where_the_assembly_is_nor_the_order_of_its_parts(piece: StoredBodies) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    turn *= np.linalg.det(turn)
    straight, _ = lowest(row(piece, 2), first="p0:L", last="p1:R")
    turned, _ = lowest(row(piece, 2, turn), first="p0:L", last="p1:R")
    assert turned == pytest.approx(straight, rel=1e-10)
    second = Substructure(name="b", bodies=piece, position=(LENGTH, 0, 0))
    swapped = assemble_bodies([second, Substructure(name="a", bodies=piece)], [Couple(between=("b:L", "a:R"))])
    assert lowest(swapped, first="a:L", last="b:R")[0] == pytest.approx(straight, rel=1e-11)


def test_a_hinge_is_a_motion_more_and_a_stiff_spring_nearly_none(piece: StoredBodies) -> None:
    fixed, problem = lowest(row(piece, 2), first="p0:L", last="p1:R")
    hinged = row(piece, 2, components=(0, 1, 2, 3, 5))
    with morembs.Problem(hinged, [morembs.make_interface(hinged, name="e", nodes=hinged.nodes.sets["p0:L"])]) as loose:
        K, M = (A.toarray() for A in (loose.K, loose.M))
    values = np.sort(np.linalg.eigvals(np.linalg.solve(K + 1e3 * M, M)).real)[::-1]
    assert problem.rigid.shape[1] == 6
    # Seven motions without stiffness.
    assert values[:7] == pytest.approx(np.full(7, 1e-3), rel=1e-6) and values[7] < 1e-5
    errors = []
    for factor in (1.0, 10.0):
        stiffness = (factor * 1e12,) * 3 + (factor * 1e9,) * 3
        springs, _ = lowest(row(piece, 2, stiffness=stiffness), first="p0:L", last="p1:R")
        errors.append(np.abs(springs / fixed - 1).max())
    assert errors[0] < 2e-2 and errors[1] == pytest.approx(errors[0] / 10, rel=0.1)


def test_any_free_body_with_its_interface_motions_is_a_part(make_piece: Make) -> None:
    """Twenty modes, or moments: the assembly of small bodies has the low frequencies of the uncut one."""
    exact, _ = lowest(row(read_body(make_piece("all")), 2), count=3, first="p0:L", last="p1:R")
    for name, reducer in (("cb", morembs.CraigBampton(modes=20)), ("free", morembs.FreeInterface(modes=20))):
        small, _ = lowest(row(read_body(make_piece(name, reducer)), 2), count=3, first="p0:L", last="p1:R")
        assert (small >= exact * (1 - 1e-9)).all() and small == pytest.approx(exact, rel=2e-3)


JOB = """
[[substructure]]
name = "upper"
body = "BODY"

[[substructure]]
name = "lower"
body = "BODY"
position = [300.0, 0.0, 0.0]
rotation = { axis = [1, 0, 0], degrees = 0 }

[[couple]]
between = ["upper:R", "lower:L"]

[model]
units = "mm-t-s"

[[interface]]
name = "base"
nodes = "set:upper:L"

[[interface]]
name = "tip"
nodes = "set:lower:R"

[[reduce]]
method = "craig-bampton"
modes = 12

[certify]
band_hz = [0, 2000]

[output]
path = "arm.h5"
picture = "arm.png"
"""


def test_a_job_reduces_an_assembly_and_keeps_its_shapes(make_piece: Make, tmp_path: Path) -> None:
    job = tmp_path / "arm.toml"
    body = make_piece("part", morembs.CraigBampton(modes=20))
    job.write_text(JOB.replace("BODY", str(body)))
    checked = CliRunner().invoke(app, ["check", str(job)])
    assert checked.exit_code == 0, checked.output
    done = CliRunner().invoke(app, ["reduce", str(job)])
    assert done.exit_code == 0, done.output
    arm = read_body(tmp_path / "arm.h5")
    assert any("own errors are not in them" in warning for warning in arm.warnings)
    (small,) = arm.bodies.values()
    exact, _ = lowest(row(read_body(make_piece("all again")), 2), count=4, first="p0:L", last="p1:R")
    assert small.frequencies_hz[6:10] == pytest.approx(exact, rel=5e-3)
    # The nodes of both parts move with the shapes: those of both sides of the joint as one.
    joint = np.flatnonzero(np.abs(arm.coordinates[:, 0] - LENGTH) < 1e-9)
    place, group = np.unique(arm.coordinates[joint].round(9), axis=0, return_inverse=True)
    moved = small.view(4).motion[:, joint]
    assert len(place) == 9 and len(joint) > 2 * len(place)
    for k in range(len(place)):
        same = moved[:, group.ravel() == k]
        assert np.ptp(same, axis=1).max() < 1e-5 * np.abs(moved).max()
    again = CliRunner().invoke(app, ["reduce", str(job), "--set", 'couple.between=["upper:R", "lower:X"]'])
    assert again.exit_code == 2 and "there is no 'lower:X'; did you mean 'lower:R'" in again.stderr
    hinged = CliRunner().invoke(app, ["check", str(job), "--set", "couple.components=[0, 1, 2, 3, 5]"])
    assert hinged.exit_code == 2 and "rotation y of lower:L against upper:R" in hinged.stderr
    beside = CliRunner().invoke(app, ["reduce", str(job), "--set", "output.path=" + str(body)])
    assert beside.exit_code == 2 and body.exists()


def test_parts_that_do_not_fit_are_refused(make_piece: Make, piece: StoredBodies) -> None:
    a, b = Substructure(name="a", bodies=piece), Substructure(name="b", bodies=piece, position=(LENGTH, 0, 1e-5))
    joint = Couple(between=("a:R", "b:L"))
    with refusal("value", "", "1e-05"):
        assemble_bodies([a, b], [joint])
    near = replace(b, position=(LENGTH, 0, 0))
    with refusal("conflict", "", "b:L", "a:R"):
        assemble_bodies([a, near], [joint, Couple(between=("b:L", "a:R"))])
    with refusal("value", "parts"):
        assemble_bodies([a, replace(near, name="a")], [])
    with refusal("value", "rotation"):
        assemble_bodies([replace(a, rotation=2 * np.eye(3))], [])
    with refusal("value", "components", "7"):
        assemble_bodies([a, near], [replace(joint, components=(7,))])
    with refusal("value", "stiffness"):
        assemble_bodies([a, near], [replace(joint, stiffness=(1.0,))])
    with refusal("value", "damping"):
        assemble_bodies([a, near], [replace(joint, damping=(1.0,) * 6)])
    structural = read_body(make_piece("structural", morembs.CraigBampton(modes=4), structural=0.02))
    with refusal("unsupported", "damping"):
        assemble_bodies([replace(a, bodies=structural)], [])
    modal = read_body(make_piece("modal", morembs.Modal(modes=4)))
    with refusal("model", "modes"):
        assemble_bodies([replace(a, bodies=modal)], [])


def test_a_part_with_one_interface_hangs_at_another(make_piece: Make, piece: StoredBodies) -> None:
    """A leaf: against the bar that was never cut, with an interface at the cut and at one end."""
    model = bar(2)
    with morembs.Problem(model, ends(model, cut=LENGTH, left=0.0)) as uncut:
        expected = uncut.elastic_modes(count=8).frequencies_hz
    short = bar(1)
    with morembs.Problem(short, ends(short, L=0.0)) as problem:
        reduced = morembs.CraigBampton(modes=problem.K.shape[0] - 6).reduce(problem)
        path = make_piece("x").parent / "leaf.h5"
        leaf = read_body(write_body(path, [morembs.elastic_body(problem, reduced, morembs.make_part(problem))]))
    for between in (("a:R", "b:L"), ("b:L", "a:R")):
        parts = [Substructure(name="a", bodies=piece), Substructure(name="b", bodies=leaf, position=(LENGTH, 0, 0))]
        joined = assemble_bodies(parts, [Couple(between=between)])
        frequencies, problem = lowest(joined, count=8, cut="b:L", left="a:L")
        assert frequencies == pytest.approx(expected, rel=1e-8) and problem.rigid.shape[1] == 6
        # The interface that follows the other is the other.
        assert lowest(joined, count=8, cut="a:R")[0] == pytest.approx(lowest(joined, count=8, cut="b:L")[0], rel=1e-12)


@pytest.mark.parametrize(
    "joint",
    [
        [{}],
        [{"stiffness": (1e9,) * 3 + (1e5,) * 3}],
        [{"stiffness": (5e11,) * 3 + (5e9,) * 3}],
        [{"components": (0, 1, 2)}, {"components": (3, 4, 5), "stiffness": (1e5,) * 6}],
    ],
)
def test_places_of_few_digits_strain_nothing_as_the_assembly_turns(piece: StoredBodies, joint: list[dict]) -> None:
    """Frames up to 1e-7 m apart, far from the origin: a chain whose middle part follows by way of another."""
    rng = np.random.default_rng(11)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    places = [turn @ [LENGTH * k, 0, 0] + [9.0, -20.0, 4.0] for k in range(3)]
    pairs = ("p0:R", "p1:L"), ("p2:L", "p1:R")
    couples = [Couple(between=pair, **options) for pair in pairs for options in joint]

    def model(digits: int) -> FEModel:
        return assemble_bodies(
            [
                Substructure(name=f"p{k}", bodies=piece, position=np.round(place, digits), rotation=turn)
                for k, place in enumerate(places)
            ],
            couples,
        )

    exact, rounded = model(16), model(7)
    assert np.linalg.norm(rounded.nodes.xyz - exact.nodes.xyz, axis=1).max() > 3e-8
    assert not any("apart" in warning for warning in rounded.warnings)
    (expected, _), (found, problem) = lowest(exact), lowest(rounded)
    assert problem.rigid.shape[1] == 6
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-5 * expected[-1])


def test_places_of_few_digits_of_parts_that_follow_another_together(piece: StoredBodies) -> None:
    """Three parts at one frame, in both orders: the offsets along the chain add up."""
    turns = [np.eye(3), np.eye(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])]
    right, left = (piece.interfaces[name].point for name in "RL")
    places = [np.zeros(3), right - left + [0, 4e-8, -3e-8], right - turns[2] @ left + [0, -2e-8, 1e-8]]
    parts = [
        Substructure(name=f"p{k}", bodies=piece, position=place, rotation=turn)
        for k, (place, turn) in enumerate(zip(places, turns, strict=True))
    ]
    for pairs in ((("p0:R", "p1:L"), ("p1:L", "p2:L")), (("p2:L", "p1:L"), ("p2:L", "p0:R"))):
        model = assemble_bodies(parts, [Couple(between=pair) for pair in pairs])
        S, R = model.dependent.S, rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
        # Sums of up to six products along a chain of three frames.
        assert np.abs(S @ R - R).max() < 18 * np.finfo(float).eps and lowest(model)[1].rigid.shape[1] == 6


def test_nodes_without_rotations_that_are_apart_are_told_and_hold_nothing(make_piece: Make) -> None:
    model = bar(1)
    faces = [
        morembs.make_interface(model, name=name, nodes=where(model, 0, x)[[0, 2, 6]], coupling="direct")
        for name, x in (("L", 0.0), ("R", LENGTH))
    ]
    with morembs.Problem(model, faces) as problem:
        body = morembs.elastic_body(problem, morembs.CraigBampton(modes=5).reduce(problem), morembs.make_part(problem))
        stored = read_body(write_body(make_piece("x").parent / "direct.h5", [body]))
    a, b = (Substructure(name=name, bodies=stored, position=(x, 0, 0)) for name, x in (("a", 0.0), ("b", LENGTH)))
    joint = Couple(between=("a:R", "b:L"))
    assert not any("apart" in warning for warning in assemble_bodies([a, b], [joint]).warnings)
    for apart in (3e-11, 1e-9, 3e-8):
        away = assemble_bodies([a, replace(b, position=(LENGTH - 0.8 * apart, 0.3 * apart, 0.6 * apart))], [joint])
        assert any("a:R and b:L are" in warning and "apart and coupled as one" in warning for warning in away.warnings)
        assert lowest(away)[1].rigid.shape[1] == 6


def test_couplings_that_say_nothing_or_too_much_are_refused(piece: StoredBodies) -> None:
    part = Substructure(name="a", bodies=piece)
    with refusal("conflict", "", "'a:R'"):
        assemble_bodies([part], [Couple(between=("a:R", "a:R"))])
    with refusal("value", "position"):
        assemble_bodies([replace(part, position=(0.0, np.nan, 0.0))], [])


def test_what_couplings_leave_free_is_named(piece: StoredBodies) -> None:
    """Three pieces: what one coupling leaves, a chain cannot hold, a second one at the same place can."""
    hinge = (0, 1, 2, 3, 5)
    assert row(piece, 3).free_motions == ()
    assert row(piece, 2, components=hinge).free_motions == ("rotation y of p1:L against p0:R",)
    names = row(piece, 3, components=(0, 1, 2)).free_motions
    assert [name.split(" of ")[0] for name in names] == ["rotation x, rotation y, rotation z"] * 2
    parts = row(piece, 2).parts
    ends = ("p0:R", "p1:L")
    soft = Couple(between=ends, components=(4,), stiffness=(0, 0, 0, 0, 1e-3, 0), damping=(0, 0, 0, 0, 1.0, 0))
    assert assemble_bodies(parts, [Couple(between=ends, components=hinge), soft]).free_motions == ()
    nothing = replace(soft, stiffness=(1.0, 0, 0, 0, 0, 0))
    assert len(assemble_bodies(parts, [Couple(between=ends, components=hinge), nothing]).free_motions) == 2
