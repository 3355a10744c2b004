"""Short forms of the attacks, with fixed seeds: killed runs and damaged inputs, and that the attacks see faults.

What is asserted holds for every instant at which a run may be killed, however fast the machine is.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.attack import damage, forked, kill, mutations, scenarios  # noqa: E402
from benchmarks.attack.__main__ import main  # noqa: E402
from benchmarks.attack.fingerprint import differences, fingerprint  # noqa: E402
from tests.support.processes import load  # noqa: E402

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="this system cannot fork processes")
KINDS = ("import", "export", "simulate", "batch", "out-of-core", "gmp")
# One of each sort of reader: decks, meshes, matrices as text and binary, arrays, jobs, bodies.
FORMATS = ("nastran", "mesh", "matrix-market", "op4", "npz", "native", "job", "body")


@pytest.fixture(scope="module", autouse=True)
def _loaded() -> None:
    load()


@pytest.mark.parametrize("kind", KINDS)
def test_killed_runs_leave_nothing_half_done(tmp_path: Path, kind: str) -> None:
    # Each is a whole run, one that is killed and one that follows; make attack draws thousands.
    count = 2 if kind == "import" else 1
    outcomes = list(kill.attacks(tmp_path, count=count, seed=1, kinds=[kind]))
    assert len(outcomes) == count
    assert [(outcome.trial, outcome.failures) for outcome in outcomes if outcome.failures] == []


def test_a_whole_process_is_killed_as_a_forked_one(tmp_path: Path) -> None:
    target = kill.Target("import", tmp_path)
    trial = next(drawn for i in range(99) if (drawn := kill.draw("import", i, 1, whole=1.0)).signal == signal.SIGTERM)
    assert trial.whole
    # Any time does; its own need not be found out by another run.
    target.alone = 2.0
    assert target.attack(trial).failures == []


def test_damaged_inputs_are_refused_or_the_differ_knows_why(tmp_path: Path) -> None:
    outcomes = list(damage.attacks(tmp_path, count=2 * len(FORMATS), seed=1, kinds=FORMATS))
    assert len(outcomes) == 2 * len(FORMATS)
    bad = [outcome for outcome in outcomes if outcome.result in damage.FAILURES]
    silent = [outcome for outcome in outcomes if outcome.result == "silent"]
    bad += [outcome for outcome in silent if mutations.reason(outcome.kind, outcome.format) is None]
    assert [(outcome.format, outcome.number, outcome.result, outcome.words, outcome.detail) for outcome in bad] == []
    assert sum(outcome.result == "refused" for outcome in outcomes) > len(FORMATS) / 2


# The attacks themselves: a program that does what it must not do is found out.


def half(path: str) -> None:
    """Writes where it should not yet, and stops there."""
    with open(path, "wb") as file:
        file.write(b"\x89HDF half")
        file.flush()
        signal.pause()


def faulty(work: object, monkeypatch: pytest.MonkeyPatch, folder: Path) -> kill.Target:
    """A target whose whole run writes "out", and whose killed one does ``work``."""
    scenario = scenarios.Scenario(lambda folder: None, lambda: Path("out").write_bytes(b"all"), ("out",))
    monkeypatch.setitem(kill.SCENARIOS, "faulty", scenario)
    target = kill.Target("faulty", folder)
    target.scenario = scenarios.Scenario(scenario.inputs, work, ("out",))  # type: ignore[arg-type]
    return target


def test_a_half_file_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> None:
        half("out") if not Path("out").exists() else Path("out").write_bytes(b"all")

    target = faulty(work, monkeypatch, tmp_path)

    def until_half(_: float) -> None:
        while not (path := target.folder / "trial-0" / "out").exists() or not path.stat().st_size:
            os.sched_yield()

    monkeypatch.setattr(kill, "time", SimpleNamespace(sleep=until_half, monotonic=time.monotonic))
    trial = kill.Trial("faulty", 0, signal.SIGKILL, 1.0, group=True, twice=False, old=False, whole=False)
    assert [kind for kind, _ in target.attack(trial).failures] == ["half file"]


def test_a_stray_file_a_lost_file_and_a_false_code_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> None:
        Path("stray").write_bytes(b"")
        Path("out").unlink()

    def until_its_end(_: float) -> None:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)

    target = faulty(work, monkeypatch, tmp_path)
    monkeypatch.setattr(kill, "time", SimpleNamespace(sleep=until_its_end, monotonic=time.monotonic))
    trial = kill.Trial("faulty", 0, signal.SIGTERM, 1.0, group=False, twice=False, old=True, whole=False)
    kinds = {kind for kind, _ in target.attack(trial).failures}
    assert kinds == {"lost file", "exit code", "stray at once", "restart", "other result", "stray"}


def _spin() -> None:
    while True:
        pass


@pytest.mark.parametrize(
    ("work", "result"),
    [
        (lambda: 1 / 0, "traceback"),
        (lambda: signal.pause(), "hang"),
        (_spin, "hang"),
        (lambda: np.ones(10**8).sum(), "memory"),
        (lambda: sys.exit(3), "exit code"),
        (lambda: sys.stderr.write("Warn: x"), "noise"),
        (lambda: Path("more").write_bytes(b""), "half output"),
        (lambda: sys.exit(2), "messages"),
    ],
)
def test_what_a_damaged_input_does_is_seen(tmp_path: Path, work: object, result: str) -> None:
    def whole() -> None:
        if Path("in").read_bytes() != b"1 2 3\n":
            work()  # type: ignore[operator]
        Path("out").write_bytes(b"all")

    seed = damage.Seed({"in": b"1 2 3\n"}, ("in",), whole, "out")
    target = damage.Target("own", seed, tmp_path / "own")
    # Whatever is damaged hangs for ever; only that run may be cut short.
    if work is _spin:
        target.processor = 1
    elif result == "hang":
        target.patience = 1
    assert target.attack(0, 1).result == result


def test_the_differ_sees_another_mass_and_no_other_order(tmp_path: Path) -> None:
    for name, values in (("a", [1.0, 2.0]), ("b", [2.0, 1.0]), ("c", [1.0, 2.1])):
        with h5py.File(tmp_path / name, "w") as file:
            file["x"] = values
    original, same, other = (fingerprint(tmp_path / name) for name in "abc")
    assert differences(original, same) == [] and differences(original, other) == ["x: 2.23607 -> 2.32594"]


def test_trials_are_drawn_from_seed_kind_and_number_alone(tmp_path: Path) -> None:
    assert kill.draw("import", 7, 3) == kill.draw("import", 7, 3) != kill.draw("import", 7, 4)
    for table in (mutations.TEXT, mutations.BINARY):
        for name, change in table.items():
            first, second = (change(b"*NODE\n1, 2.5, -3e2\n2, 4., 5.\n", random.Random(5)) for _ in range(2))
            assert first == second, name
    assert sum(kill.counts(1000, list(scenarios.SCENARIOS)).values()) == 1000


def test_a_program_that_stops_its_alarm_clock_is_ended_nevertheless(tmp_path: Path) -> None:
    def work() -> None:
        signal.alarm(0)
        while True:
            signal.pause()

    ended = forked.run(work, tmp_path, tmp_path / "logs", seconds=1)
    assert ended.hung and ended.code == -signal.SIGKILL


def test_a_forked_child_takes_nothing_from_its_parent(tmp_path: Path) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        ended = forked.run(lambda: sys.stdout.write(tempfile.gettempdir()), tmp_path, tmp_path / "logs")
        assert ended.code == 0 and ended.output.strip() == str(tmp_path / "logs" / forked.TEMPORARY)
        assert Path(folder).is_dir()


def test_the_command_line_prints_how_to_repeat(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["damage", "--kind", "npz", "--only", "3", "--seed", "2"]) == 0
    assert "seed 2" in capfd.readouterr().out
