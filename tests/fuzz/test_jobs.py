"""A slice of the random jobs, and every defect that was found once: nothing is wrong in silence, no input is lost."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

pytest.importorskip("flint", reason="truths in extended arithmetic need python-flint")
pytestmark = [
    pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="this system cannot fork processes"),
    pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="this machine has no arithmetic of 80 bits"),
]
sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.attack.jobs import main, table  # noqa: E402
from tests.fuzz import cases, stage  # noqa: E402
from tests.fuzz.judge import judge  # noqa: E402
from tests.fuzz.models import draw_model  # noqa: E402
from tests.fuzz.trials import FAULTS, Folder, Outcome, trial  # noqa: E402
from tests.fuzz.truth import Damping, Port, Truth  # noqa: E402
from tests.support.processes import load  # noqa: E402

SEED, COUNT, PARTS = 33, 16, 4


@pytest.fixture(scope="module", autouse=True)
def _loaded() -> None:
    load()


@pytest.mark.parametrize("name", list(cases.CASES))
def test_a_defect_that_was_found_stays_mended(tmp_path: Path, name: str) -> None:
    outcome = cases.run(name, tmp_path)
    assert (outcome.result, outcome.words) == ("good", "")


@pytest.mark.parametrize("part", range(PARTS))
def test_random_jobs_are_right_or_refused(tmp_path: Path, part: int) -> None:
    outcomes = [trial(number, SEED, tmp_path) for number in range(part, COUNT, PARTS)]
    faults = [(o.command, o.result, o.words) for o in outcomes if o.result in FAULTS]
    assert faults == []
    assert sum(o.result == "good" for o in outcomes) >= len(outcomes) / 3
    assert "valid by construction" in table(outcomes)


def test_sums_over_modes_are_the_eliminated_balls() -> None:
    for seed in range(6):
        model = draw_model(np.random.default_rng([1, seed]))
        node = int(model.node[-1])
        own = tuple(model.component[model.node == node].tolist())
        port = Port(name="end", nodes=np.array([node]), coupling="direct", point=model.xyz[node], components=own)
        truth = Truth(model, (port,), Damping(steps=() if model.D is not None else ((0.0, 0.01),)))
        omega = 2 * np.pi * np.array([0.3, 0.999, 1.7]) * truth.hz[0]
        H, e = truth.H(omega, 0.02), truth.envelope(omega, 0.02)
        for k, w in enumerate(omega):
            assert np.abs(truth.exact(float(w), 0.02) - H[k]).max() < 1e-14 * e[k]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda body: scaled(body["stiffness_matrix"], 1 + 1e-5), "mode 1 of modal is off"),
        (lambda body: scaled(body["stiffness_matrix"], 1 - 1e-5), "lies below that of the model"),
        (lambda body: scaled(body["certificate/cell_limit"], 0.5), "proven limit"),
        (lambda body: scaled(body["certificate/mode_enclosure_hz"], 1.001), "is enclosed"),
        (lambda body: scaled(body["certificate/band_hz"], 0.5), "modes are said to lie"),
        (lambda body: scaled(body["full_frequencies_hz"], 1.001), "full frequency"),
    ],
)
def test_the_judge_sees_what_is_wrong_with_a_body(tmp_path: Path, change: Callable[..., None], words: str) -> None:
    n = 9
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    truth = stage.abstract(K, np.eye(n), (n - 1,))
    place = Folder(tmp_path / "body", Outcome("body"))
    stage.write_model(place, K, np.eye(n))
    job = [stage.MODEL, stage.END.format(labels=n) + 'coupling = "direct"', stage.MODAL, stage.OUTPUT]
    (place.place / "job.toml").write_text("\n".join([*job, "[certify]", f"band_hz = [0.0, {truth.hz[2] * 1.2}]"]))
    assert place.run(["reduce", "job.toml"]).code == 0
    file = place.place / "body.h5"
    given = {"exact": set(), "tolerances": {}, "promised": {"modal": "modal"}}
    assert judge(file, truth, np.random.default_rng(1), **given).wrong == []
    with h5py.File(file, "r+") as stored:
        change(stored["bodies/modal"])
    assert words in "; ".join(judge(file, truth, np.random.default_rng(1), **given).wrong)


def scaled(dataset: h5py.Dataset, factor: float) -> None:
    """Multiply what is stored."""
    dataset[...] = dataset[...] * factor


def test_the_trial_sees_what_commands_do_to_inputs(tmp_path: Path) -> None:
    outcome = Outcome("seen")
    place = Folder(tmp_path / "inputs", outcome)
    (place.place / "part.msh").write_text("one")
    place.seal()
    (place.place / "part.msh").write_text("two")
    (place.place / ".morembs.tmp-1").write_text("")
    place.check()
    assert (outcome.result, outcome.words) == ("input changed", "part.msh was written over")


def test_the_command_line_repeats_a_trial(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["jobs", "--seed", str(SEED), "--only", "0", "--keep", str(tmp_path)])
    main()
    assert f"jobs --seed {SEED} --only 0" in capsys.readouterr().out
    assert (tmp_path / f"job-{SEED}-0" / "job.toml").is_file()
