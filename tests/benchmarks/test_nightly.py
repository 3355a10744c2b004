"""Campaigns of a night: failures keep their seeds, and seeds that once failed pass."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "benchmarks"))

from published import larger_errors  # noqa: E402

from benchmarks import nightly  # noqa: E402
from benchmarks.decks import RESULTS  # noqa: E402
from benchmarks.nightly import SEEDS, Campaign, nights_of, stored_seeds  # noqa: E402

# Fails for odd seeds.
ODD = Campaign(
    name="odd",
    words="odd <seeds>",
    arguments=("-c", "import sys; print('of <seed>', SEED); sys.exit(SEED % 2)"),
    trials=3,
    share=1,
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(nightly, "CAMPAIGNS", (ODD,))
    monkeypatch.setattr(nightly, "SEEDS", tmp_path / "seeds.toml")
    monkeypatch.setattr(nightly.store_seeds, "__defaults__", (tmp_path / "seeds.toml",))
    return tmp_path


def test_failures_keep_their_seeds_and_the_page_shows_them(folder: Path) -> None:
    run = ["--hours", "0", "--folder", str(folder)]
    assert nightly.main([*run, "--seed", "4"]) == 0
    assert nightly.main([*run, "--seed", "7"]) == 1
    assert nightly.main([*run, "--seed", "7"]) == 1
    assert [(each["campaign"], each["seed"]) for each in stored_seeds(folder / "seeds.toml")] == [("odd", 7)]
    nights = nights_of(folder / "history.jsonl")
    assert [(night.trials, night.chunks, night.failed_seeds) for night in nights] == [
        (3, 1, ()),
        (3, 1, (7,)),
        (3, 1, (7,)),
    ]
    page = (folder / "index.html").read_text()
    assert "--repeat odd 7" in page and "of &lt;seed&gt; 7" in page and "<seed" not in page and "<svg" in page


def test_a_chunk_is_repeated_by_its_seed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert nightly.main(["--repeat", "odd", "9"]) == 1
    assert capsys.readouterr().out == "of <seed> 9\n"
    assert nightly.main(["--repeat", "odd", "8"]) == 0


def test_seeds_that_failed_once_pass() -> None:
    failed = [(each["campaign"], each["seed"]) for each in stored_seeds()]
    assert [each for each in failed if nightly.campaign_of(each[0]).run(each[1]).code] == []


def test_every_campaign_draws_by_its_seed() -> None:
    for campaign in nightly.CAMPAIGNS:
        assert campaign.name == "published" or "SEED" in campaign.arguments
    assert RESULTS.exists() and SEEDS.exists()


def test_larger_errors_of_published_models_are_found() -> None:
    recorded = {"chain": {"h2_error": 1e-3, "hinf_error": None}}
    assert larger_errors({"chain": {"h2_error": 1e-3, "hinf_error": 0.1}}, recorded) == []
    assert larger_errors({"chain": {"h2_error": 1.1e-3}}, recorded) == ["chain: h2_error is 0.0011, 0.001 is on record"]
    assert larger_errors({"chain": {"h2_error": None}}, recorded) == ["chain: h2_error is None, 0.001 is on record"]
