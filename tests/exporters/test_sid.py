"""SID_FEM files: an independent parser, the equations of motion they stand for, and every known layout."""

import re
from dataclasses import replace

import numpy as np
import pytest

from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import Stiffening, floating_frame
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.exporters import export_body
from morembs.exporters.base import in_two_digits
from morembs.exporters.sid import SidFem, large_file_notes, normal_coordinates
from morembs.exporters.sid_reader import read_sid
from morembs.exporters.tolerances import TOL
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

OMEGA_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
SOUTHWELL = 1.193
J_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A lopsided block with three interfaces, its frame following the first; the body file."""

    def warp(x):
        return x + 0.05 * x[..., [1]] * np.array([1.0, 0.0, 2.0])

    model = steel(box("hex8", (4, 2, 2), (0.4, 0.1, 0.07), warp=warp))
    along, across = (np.argsort(model.nodes.xyz[:, axis]) for axis in (0, 1))
    chosen = (("hub", along[:6], "average"), ("tip", along[-6:], "rigid"), ("side", across[20:23], "direct"))
    faces = [make_interface(model, name=n, nodes=nodes, coupling=c) for n, nodes, c in chosen]
    path = tmp_path_factory.mktemp("sid") / "block.h5"
    with Problem(model, faces) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb30")
        floating = floating_frame(problem, reduced, kind="tangent", interfaces=("hub",), origin=(0.05, 0.02, 0.01))
        write_body(path, [elastic_body(problem, reduced, make_part(problem), floating=floating)])
    return path


def parsed(path):
    """Every number of the file as {(node or 0, section, 0 or 1): {indices: value}}, with a regular expression only."""
    entries, sizes, node, section = {}, {}, 0, ""
    for line in path.read_text().splitlines()[1:]:
        if match := re.fullmatch(r" {16}new node {24}= +(\d+)", line):
            node = int(match[1])
        elif re.fullmatch(r" {16}end node *", line):
            node = 0
        elif match := re.fullmatch(r" {11,21}(mdCM|J|Ct|Cr|Me|Gr|Ge|Oe|ksigma|Ke|De|origin|phi|psi|AP) +", line):
            section = match[1]
        elif match := re.fullmatch(r" {26}(order|nrow|ncol|nq|nqn|structure) +=  +(\d+)", line):
            sizes[node, section, match[1]] = int(match[2])
        elif match := re.fullmatch(r" {26}m(\d)\(([\d, ]+)\) +=([ -]\d\.\d{11}D[+-]\d\d)", line):
            indices = tuple(int(i) - 1 for i in match[2].split(","))
            entries.setdefault((node, section, int(match[1])), {})[indices] = float(match[3].replace("D", "E"))
        elif "=" in line:
            assert re.match(r" +(mass|nelastq|ielastq \( *\d+\)|rframe|new modal) +=", line), line
    return entries, sizes


def taylor(path, section, node=0):
    """(M0, M1) of the independent parser."""
    entries, sizes = parsed(path)
    rows, columns, q = (sizes[node, section, key] for key in ("nrow", "ncol", "nq"))
    M = np.zeros((rows, columns)), np.zeros((rows, q, columns))
    for order in (0, 1):
        for at, value in entries.get((node, section, order), {}).items():
            M[order][at] = value
    return M


def in_file(path, stiffening=None):
    """Body of the file in normal coordinates, as written."""
    body = read_body(path).bodies["cb30"]
    return normal_coordinates(replace(body.floating, stiffening=stiffening))[0]


def close(actual, expected, digits=11):
    """Equal entry by entry to the digits of the file."""
    scale = np.abs(expected)
    np.testing.assert_allclose(actual, expected, rtol=10.0**-digits, atol=1e-13 * scale.max(initial=0.0))


@pytest.mark.parametrize("dialect", ["fembs", "mode-major"])
def test_every_term_by_an_independent_parser(exported, tmp_path, dialect):
    path = export_body(exported, "sid", path=tmp_path / "a.SID_FEM", options={"dialect": dialect}).paths[0]
    frame = in_file(exported)
    integrals, n = frame.integrals, frame.count
    close(taylor(path, "Me")[0], np.eye(n))
    close(taylor(path, "Ke")[0], frame.Ke)
    for name in ("ksigma", "De"):
        assert not taylor(path, name)[0].any()
    close(taylor(path, "mdCM")[0][:, 0], integrals.first)
    close(taylor(path, "mdCM")[1][:, :, 0], integrals.Ct.T)
    close(taylor(path, "Ct")[0], integrals.Ct)
    close(taylor(path, "Cr")[0], integrals.Cr)
    close(taylor(path, "J")[0][:, 0], [integrals.inertia[a, b] for a, b in J_PAIRS])
    close(taylor(path, "J")[1][:, :, 0].T, np.array([[integrals.J1[k, a, b] for a, b in J_PAIRS] for k in range(n)]))
    close(taylor(path, "Oe")[0], integrals.Oe)
    close(taylor(path, "Oe")[1], integrals.Oe1.transpose(0, 2, 1))
    for name, blocks in (("Gr", integrals.Gr), ("Ge", integrals.Ge)):
        A = taylor(path, name)[0]
        for k in range(n):
            columns = slice(3 * k, 3 * k + 3) if dialect == "mode-major" else slice(k, None, n)
            close(A[:, columns], blocks[k])
    for number, name in enumerate(("hub", "tip"), start=1):
        marker = frame.markers[name]
        close(taylor(path, "origin", number)[0][:, 0], marker.point)
        close(taylor(path, "origin", number)[1][:, :, 0], marker.motion[:3])
        close(taylor(path, "phi", number)[0], marker.motion[:3])
        close(taylor(path, "psi", number)[0], marker.motion[3:])
        M0, M1 = taylor(path, "AP", number)
        close(M0, np.eye(3))
        for k in range(n):
            turn = marker.motion[3:, k]
            close(M1[:, k], np.array([np.cross(turn, e) for e in np.eye(3)]).T)


@pytest.mark.parametrize("dialect", ["fembs", "mode-major"])
def test_identities_of_the_file(exported, tmp_path, dialect):
    """J1 = sym(Gr), Ge = 2 Cr1, Oe from Gr, and the tangent frame rests."""
    path = export_body(exported, "sid", path=tmp_path / "a.SID_FEM", options={"dialect": dialect}).paths[0]
    sid = read_sid(path)
    assert sid.dialect == dialect
    for k in range(sid.count):
        sym = (sid.Gr[k] + sid.Gr[k].T) / 2
        close(sid.J.M1[:, k, 0], np.array([sym[a, b] for a, b in J_PAIRS]), digits=10)
        close(sid.Ge[k], 2 * sid.Cr.M1[:, k], digits=10)
        half = -sid.Gr[k] / 2
        oe = [half[a, b] if a == b else half[a, b] + half[b, a] for a, b in OMEGA_PAIRS]
        close(sid.Oe.M0[k], np.array(oe), digits=10)
    scale = np.abs(sid.nodes[2].phi.M0).max()
    assert np.abs(sid.nodes[1].phi.M0).max() < 1e-9 * scale and np.abs(sid.nodes[2].psi.M0).max() > 1e-3 * scale


def test_reader_gives_back_what_was_written(exported, tmp_path):
    path = export_body(exported, "sid", path=tmp_path / "a.SID_FEM").paths[0]
    sid, frame = read_sid(path), in_file(exported)
    integrals = frame.integrals
    assert sid.mass == pytest.approx(integrals.mass, rel=1e-11)
    assert sid.frequencies_hz == pytest.approx(np.sqrt(np.diag(frame.Ke)) / (2 * np.pi), rel=1e-5)
    for read, written in (
        (sid.Cr.M1, integrals.Cr1),
        (sid.Gr, integrals.Gr),
        (sid.Ge, integrals.Ge),
        (sid.Oe.M1, integrals.Oe1.transpose(0, 2, 1)),
        (sid.J.M0[:, 0], np.array([integrals.inertia[a, b] for a, b in J_PAIRS])),
        (sid.Ke.M0, frame.Ke),
    ):
        assert np.abs(read - written).max() <= 1e-11 * np.abs(written).max()


def test_energy_of_a_moving_body_from_the_file_is_that_of_its_mass_points(tmp_path):
    """Kinetic energy in any motion, from the file's terms and from M of the full model; a 6-coordinate body."""
    model = steel(box("hex8", (3, 2, 1), (0.3, 0.1, 0.05)))
    face = make_interface(model, name="hub", nodes=where(model, 0, 0.0), coupling="average")
    with Problem(model, [face]) as problem:
        reduced = CraigBampton(modes=6).reduce(problem, "cb")
        floating = floating_frame(problem, reduced, kind="tangent", interfaces=("hub",))
        write_body(tmp_path / "b.h5", [elastic_body(problem, reduced, make_part(problem), floating=floating)])
    sid = read_sid(export_body(tmp_path / "b.h5", "sid", options={"nodes": "all"}).paths[0])
    rng = np.random.default_rng(3)
    n = sid.count
    q, qd, v, w = 1e-3 * rng.normal(size=n), rng.normal(size=n), rng.normal(size=3), 5 * rng.normal(size=3)
    # Nodes in the file: origin(q) = x + phi q, after the interface.
    nodes = [sid.nodes[k] for k in range(2, 2 + len(model.nodes))]
    x = np.array([node.origin.M0[:, 0] + node.origin.M1[:, :, 0] @ q for node in nodes])
    u = v + np.cross(w, x) + np.array([node.phi.M0 @ qd for node in nodes])
    order = model.dofs.of_nodes(np.arange(len(model.nodes))).ravel()
    M = model.M.tocsr()[order][:, order]
    expected = 0.5 * u.ravel() @ (M @ u.ravel())
    J = np.zeros((3, 3))
    for (a, b), value in zip(J_PAIRS, sid.J.M0[:, 0] + sid.J.M1[:, :, 0] @ q, strict=True):
        J[a, b] = J[b, a] = value
    first = sid.mdCM.M0[:, 0] + sid.mdCM.M1[:, :, 0] @ q
    Cr = sid.Cr.M0 + np.einsum("ila,l->ia", sid.Cr.M1, q)
    energy = 0.5 * sid.mass * v @ v + v @ np.cross(w, first) + 0.5 * w @ J @ w
    energy += v @ (sid.Ct.M0.T @ qd) + w @ (Cr.T @ qd) + 0.5 * qd @ sid.Me.M0 @ qd
    # The file has no second order in J.
    second = (
        sum(
            0.5 * np.sum(np.cross(w, p - p0) ** 2)
            for p, p0 in zip(x, (node.origin.M0[:, 0] for node in nodes), strict=True)
        )
        * sid.mass
        / len(x)
    )
    assert energy == pytest.approx(expected, abs=2 * second + 1e-10 * expected)
    assert second < 1e-4 * expected


def test_normal_coordinates_are_the_same_body(exported):
    """Every integral is linear or quadratic in the shapes."""
    before = read_body(exported).bodies["cb30"].floating
    after, changed = normal_coordinates(before)
    T = np.linalg.lstsq(before.elastic, after.elastic, rcond=None)[0]
    old, new = before.integrals, after.integrals
    assert changed and not normal_coordinates(after)[1]
    for actual, expected in (
        (new.Me, np.eye(after.count)),
        (after.Ke, np.diag(np.diag(after.Ke))),
        (after.De, T.T @ before.De @ T),
        (new.Ct, T.T @ old.Ct),
        (new.Cr, T.T @ old.Cr),
        (new.C4, np.einsum("lk,lab->kab", T, old.C4)),
        (new.C6, np.einsum("ki,lj,klab->ijab", T, T, old.C6)),
        (after.markers["tip"].motion, before.markers["tip"].motion @ T),
    ):
        assert np.abs(actual - expected).max() <= 1e-9 * np.abs(actual).max()


def test_damping_moves_to_the_normal_coordinates(exported, tmp_path):
    """A damping that couples all coordinates: the response of the file is that of the body."""
    source = read_body(exported)
    body = source.bodies["cb30"]
    frame = body.floating
    A = np.random.default_rng(8).normal(size=frame.Ke.shape)
    size = np.sqrt(np.diag(frame.Ke))
    De = 1e-5 * np.outer(size, size) * (A @ A.T)
    written = SidFem().export(source, replace(body, floating=replace(frame, De=De)), tmp_path / "d.SID_FEM")
    sid = read_sid(written.paths[0])
    integrals, s = frame.integrals, 2j * np.pi * 900.0
    wanted = integrals.Ct.T @ np.linalg.solve(s * s * integrals.Me + s * De + frame.Ke, integrals.Ct)
    response = sid.Ct.M0.T @ np.linalg.solve(s * s * sid.Me.M0 + s * sid.De.M0 + sid.Ke.M0, sid.Ct.M0)
    assert np.abs(response - wanted).max() < 1e-7 * np.abs(wanted).max()
    light = integrals.Ct.T @ np.linalg.solve(s * s * integrals.Me + frame.Ke, integrals.Ct)
    assert np.abs(light - wanted).max() > 1e-2 * np.abs(wanted).max()


def test_frames_that_do_not_lie_along_the_body(exported, tmp_path):
    """AP takes components along the interface's axes to those of the body, and turns with the interface."""
    source = read_body(exported)
    # Rows are the axes: x along y of the body, y along z, z along x, then a turn about the new z.
    c, s = np.cos(0.4), np.sin(0.4)
    axes = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    turned = {**source.interfaces, "tip": replace(source.interfaces["tip"], axes=axes)}
    source = replace(source, interfaces=turned)
    body = source.bodies["cb30"]
    path = SidFem().export(source, body, tmp_path / "t.SID_FEM").paths[0]
    M0, M1 = taylor(path, "AP", 2)
    psi = in_file(exported).markers["tip"].motion[3:]
    x = np.array([1.0, 0.0, 0.0])
    close(M0 @ x, axes[0])
    for q in range(psi.shape[1]):
        # A vector fixed to the interface moves with psi cross vector.
        for at, axis in enumerate(axes):
            assert np.abs(M1[:, q, at] - np.cross(psi[:, q], axis)).max() < 1e-10 * max(1.0, np.abs(psi[:, q]).max())


def stiffened(n, names, seed=5):
    rng = np.random.default_rng(seed)

    def some(k):
        A = rng.normal(size=(k, n, n))
        return A + A.transpose(0, 2, 1)

    wrench = {name: some(6) for name in names}
    return Stiffening(acceleration=some(3), angular_acceleration=some(3), rotation=some(6), wrench=wrench)


def test_rotating_beam_stiffens_from_the_file(tmp_path):
    """Southwell coefficient of a clamped beam without hub, 1.193 in flap, by the Ke and Oe that the file holds."""
    model = steel(box("hex20", (10, 2, 2), (1.0, 0.04, 0.02)))
    face = make_interface(model, name="hub", nodes=where(model, 0, 0.0), coupling="rigid")
    with Problem(model, [face]) as problem:
        reduced = CraigBampton(modes=8).reduce(problem, "beam")
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=("hub",), origin=face.point)
        frame = replace(frame, stiffening=geometric_stiffening(problem, reduced, frame))
        write_body(tmp_path / "b.h5", [elastic_body(problem, reduced, make_part(problem), floating=frame)])
    sid = read_sid(export_body(tmp_path / "b.h5", "sid").paths[0])
    assert sid.dialect == "fembs"
    still = np.linalg.eigvalsh(sid.Ke.M0)[0]
    # The softest mode moves along z: in flap when the beam turns about z, in the plane of rotation about y.
    for axis, expected in ((2, SOUTHWELL), (1, SOUTHWELL - 1)):
        for speed in (10.0, 50.0):  # far below a crossing with the modes along y
            value = np.linalg.eigvalsh(sid.Ke.M0 + speed**2 * sid.Oe.M1[:, :, axis])[0]
            assert (value - still) / speed**2 == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("dialect", ["fembs", "mode-major"])
def test_stiffening_joins_the_terms_of_first_order(exported, tmp_path, dialect):
    source = read_body(exported)
    body = source.bodies["cb30"]
    stiff = stiffened(body.floating.count, ["hub", "tip"])
    body = replace(body, floating=replace(body.floating, stiffening=stiff))
    written = SidFem(dialect=dialect).export(source, body, tmp_path / "stiff.SID_FEM")
    assert not any("stiffening" in note for note in written.notes)
    sid = read_sid(written.paths[0])
    assert sid.dialect == dialect
    # Elastic force of each load in the coordinates of the file, against the same in those of the body.
    frame = in_file(exported)
    T = np.linalg.lstsq(body.floating.elastic, frame.elastic, rcond=None)[0]
    rng = np.random.default_rng(1)
    q, a, wd, f = rng.normal(size=frame.count), rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
    w = rng.normal(size=3)
    omega = np.array([w[i] * w[j] for i, j in OMEGA_PAIRS])
    integrals = frame.integrals
    terms = {
        "a": np.einsum("ila,l,a->i", sid.Ct.M1, q, a),
        "wd": np.einsum("ila,l,a->i", sid.Cr.M1 - integrals.Cr1, q, wd),
        "w": np.einsum("ila,l,a->i", sid.Oe.M1 - integrals.Oe1.transpose(0, 2, 1), q, omega),
        # phi' f stands on the other side of the equation.
        "f": -np.einsum("jli,l,j->i", np.vstack([sid.nodes[2].phi.M1, sid.nodes[2].psi.M1]), q, f),
    }
    wanted = {
        "a": np.tensordot(a, stiff.acceleration, 1),
        "wd": np.tensordot(wd, stiff.angular_acceleration, 1),
        "w": np.tensordot(omega, stiff.rotation, 1),
        "f": np.tensordot(f, stiff.wrench["tip"], 1),
    }
    for key, G in wanted.items():
        expected = T.T @ G @ (T @ q)
        assert np.abs(terms[key] - expected).max() < 1e-8 * np.abs(expected).max(), key


def test_layout_of_other_programs_is_detected(exported, tmp_path):
    """Gr mode by mode beside Ge axis by axis; then columns that fit nothing, and the other order of indices."""
    paths = {
        d: export_body(exported, "sid", path=tmp_path / f"{d}.SID_FEM", options={"dialect": d}).paths[0]
        for d in ("fembs", "mode-major")
    }
    plain, flat = (paths[d].read_text() for d in ("fembs", "mode-major"))
    pattern = re.compile(r"\n {11}Gr .*?end Gr", re.DOTALL)
    mixed = tmp_path / "mixed.SID_FEM"
    mixed.write_text(pattern.sub(lambda _: pattern.search(flat)[0], plain))
    without_title, original = read_sid(mixed), read_sid(paths["fembs"])
    assert without_title.dialect == "mixed"
    assert np.array_equal(without_title.Gr, original.Gr) and np.array_equal(without_title.Ge, original.Ge)
    strange = tmp_path / "strange.SID_FEM"
    strange.write_text(re.sub(r"(\n {11}Gr .*?=)( |-)(\d\.\d+D.00)", r"\1 9.0D+05", plain, count=1, flags=re.DOTALL))
    with refusal("file", "strange.SID_FEM"):
        read_sid(strange)
    swapped = tmp_path / "swapped.SID_FEM"
    swapped.write_text(re.sub(r"m1\(( *\d+),( *\d+),( *\d+)\)", r"m1(\1,\3,\2)", plain))
    with refusal("file", "swapped.SID_FEM", "m0", "m1"):
        read_sid(swapped)


def test_reader_wants_whole_files(exported, tmp_path):
    path = export_body(exported, "sid", path=tmp_path / "a.SID_FEM").paths[0]
    text = path.read_text()
    for cut, message in (
        (text[: len(text) // 2], ("file", "cut.SID_FEM")),
        (text.replace("           Ke ", "           Kx ", 1), ("file", "cut.SID_FEM")),
        (re.sub(r"(\n {11}Ct .*?ncol +=) +3", r"\1 2", text, count=1, flags=re.DOTALL), ("file", "cut.SID_FEM")),
        (re.sub(r"(\n {11}De .*?ncol +=) +\d+", r"\1 2", text, count=1, flags=re.DOTALL), ("file", "cut.SID_FEM")),
        (re.sub(r"=( |-)\d\.\d+D.\d\d", "= nothing", text, count=1), ("file", "cut.SID_FEM")),
        ("hello\n", ("file", "cut.SID_FEM")),
    ):
        (tmp_path / "cut.SID_FEM").write_text(cut)
        with refusal(*message):
            read_sid(tmp_path / "cut.SID_FEM")
    with refusal("file", "none.SID_FEM"):
        read_sid(tmp_path / "none.SID_FEM")


def test_one_coordinate(tmp_path):
    """Both layouts are the same then."""
    model = steel(box("hex8", (3, 1, 1), (0.3, 0.1, 0.05)))
    faces = [make_interface(model, name="hub", nodes=where(model, 0, 0.0), coupling="rigid")]
    with Problem(model, faces) as problem:
        reduced = CraigBampton(modes=1).reduce(problem, "one")
        write_body(tmp_path / "b.h5", [elastic_body(problem, reduced, make_part(problem))])
    files = [
        export_body(tmp_path / "b.h5", "sid", path=tmp_path / f"{d}.x", options={"dialect": d}).paths[0]
        for d in ("fembs", "mode-major")
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert read_sid(files[0]).Gr.shape == (1, 3, 3)


def test_default_name_and_notes(exported):
    written = export_body(exported, "sid")
    assert written.paths == (exported.with_name("block.SID_FEM"),)
    notes = " | ".join(written.notes)
    for words in ("nodes: 1 hub, 2 tip", "left out: side", "normal modes", "twelve digits", "(0.05, 0.02, 0.01) m"):
        assert words in notes
    written.paths[0].unlink()


def test_a_large_file_is_noted_with_what_makes_it_small(exported, tmp_path, monkeypatch):
    whole, few = {"nodes": "all"}, {"nodes": "interfaces"}
    sizes = [
        export_body(exported, "sid", path=tmp_path / f"{n}.SID_FEM", options=o).paths[0].stat().st_size
        for n, o in enumerate((whole, few))
    ]
    # No test can write a large file: as if all were larger.
    larger = TOL.large_file_bytes / (sizes[0] - 1)
    monkeypatch.setattr("morembs.exporters.sid.large_file_notes", lambda size: large_file_notes(larger * size))
    for number, options in enumerate((whole, few)):
        notes = " | ".join(export_body(exported, "sid", path=tmp_path / f"{number}.SID_FEM", options=options).notes)
        assert ("MB of text" in notes) == (options is whole)


def test_bad_input(exported, tmp_path):
    source = read_body(exported)
    body, path = source.bodies["cb30"], tmp_path / "a.SID_FEM"
    floating = body.floating
    cases = (
        (replace(body, floating=None), ("unsupported", "frame")),
        (replace(body, name="conrod frame"), ("value", "name")),
        (replace(body, name="frame_1"), ("value", "name", "frame")),
        (replace(body, floating=replace(floating, markers={})), ("unsupported", "coupling")),
        (replace(body, floating=replace(floating, Ke=floating.Ke * 1e95)), ("value", "units")),
        (
            replace(body, floating=replace(floating, Ke=np.diag(np.r_[0.0, np.diag(floating.Ke)[1:]]))),
            ("unsupported", "modes"),
        ),
        (replace(body, floating=replace(floating, elastic=floating.elastic[:, :0])), ("unsupported", "modes")),
        (replace(body, mass_matrix=np.full_like(body.mass_matrix, np.nan)), ("value", "mass_matrix")),
    )
    for wrong, message in cases:
        with refusal(*message):
            SidFem().export(source, wrong, path)
    assert not list(tmp_path.iterdir())
    with refusal("value", "units"):
        in_two_digits("Ct", np.array([1e-85, 1e-101]), "a SID file")
    assert in_two_digits("Ct", np.array([1.0, 1e-101]), "a SID file")[1] == 0
    with refusal("value", "dialect", "fembs", "mode-major"):
        export_body(exported, "sid", path=path, options={"dialect": "femb"})
