"""Valid files and streams with a field or some bytes changed: read, or refused in one line, in bounded time and memory.

`python tests/fuzzing.py KIND --count 10000 --seed 1` tries more of them and shows what failed.
"""

import pytest
from fuzzing import MEMORY, Outcome, all_tried, tried

KINDS = ("mcap", "mat", "csv", "toml", "requests", "replies", "commands")


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others on the machine slow a case down."""
    monkeypatch.setenv("FUZZ_SECONDS", "60")


def stands(outcome: Outcome, seed: int) -> None:
    assert outcome.counts == {}, f"seed {seed}: " + "\n\n".join(outcome.failures)
    assert outcome.peak < MEMORY


@pytest.fixture(scope="module")
def some() -> dict[str, Outcome]:
    """What becomes of forty of each kind."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FUZZ_SECONDS", "60")
        return all_tried(KINDS, seed=0, count=40)


@pytest.mark.parametrize("kind", KINDS)
def test_some_mutations_are_read_or_refused(kind: str, some: dict[str, Outcome]) -> None:
    outcome = some[kind]
    stands(outcome, 0)
    assert outcome.cases > 20
    assert outcome.read > 0


@pytest.mark.parametrize("kind", KINDS)
def test_ten_seconds_of_mutations_are_read_or_refused(kind: str) -> None:
    """Always the same ones, as far as the time goes: others are tried by hand (docs/contributing.md)."""
    stands(tried(kind, 1, count=10**6, seconds=10), 1)


def test_the_harness_finds_tracebacks_hangs_warnings_ends_and_gluttony(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FUZZ_SECONDS", "0.2")
    outcome = tried("broken", seed=0, count=40)
    assert outcome.cases == 40
    assert (outcome.read > 0, outcome.refused > 0) == (True, True)
    found = " ".join(outcome.counts)
    for words in ("KeyError: 'a traceback'", "MemoryError", "took more than 0.2 s", "status 3", "on stderr", "says ''"):
        assert words in found, words
