"""What the tests share: scenarios of the project, the golden recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from umbra_bench.scenario import Scenario, load_scenario

TESTS = Path(__file__).resolve().parent
SCENARIOS = TESTS.parent / "scenarios"

# A shared machine has no deadline.
settings.register_profile("laws", deadline=None, max_examples=60)
settings.load_profile("laws")


@pytest.fixture(scope="session")
def load() -> Callable[[str], Scenario]:
    """Load a scenario of the project by its name, from whatever folder the tests are run."""
    return lambda name: load_scenario(name, SCENARIOS)


@pytest.fixture(scope="session", autouse=True)
def _no_cache_of_the_user() -> Iterator[None]:
    """A command that is run in this process neither reads nor writes the user's compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("umbra_bench.jax_settings.keep_compiled_code", lambda: None)
        yield


@pytest.fixture(scope="session")
def golden() -> Path:
    """The folder of the recordings of the published pipeline in C++ (a copy: see its README)."""
    return TESTS / "golden"
