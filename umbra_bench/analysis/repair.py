"""The repair of the published pipeline: its two halves, each alone and both, and what they cost."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import simulate
from umbra_bench.state import State
from umbra_bench.system import System, build_system, initial_state

VARIANTS: dict[str, str] = {
    "umbra": "as published",
    "umbra-primed": "first acceleration primed, phases as published",
    "umbra-swapped": "phases swapped, first acceleration zero",
    "umbra-repaired": "both",
}
"""The methods that the repair consists of, and what each changes."""


class Cost(NamedTuple):
    """What a method costs.

    Attributes:
        force_evaluations: per step.
        numbers_per_body: kept from one step to the next, accumulators included.
        step_ratio: time per step over the time of the first variant, in one run.
    """

    force_evaluations: int
    numbers_per_body: int
    step_ratio: float


def costs(scenario: Scenario, steps: int = 400_000, rounds: int = 12) -> dict[str, Cost]:
    """Count and time the variants on a scenario, in turns; the fastest round of each counts."""
    best = dict.fromkeys(VARIANTS, np.inf)
    for _ in range(rounds):
        for method in VARIANTS:
            run = simulate(scenario, method, 0.001, steps=steps, every=steps)
            best[method] = min(best[method], run.wall_time)
    first = next(iter(best.values()))
    return {
        method: Cost(
            _force_evaluations(scenario, method), _numbers(scenario, method), best[method] / first
        )
        for method in VARIANTS
    }


class _Counting:
    """A force law that counts how often it is asked."""

    conservative: ClassVar[bool] = True
    velocity_dependent: ClassVar[bool] = False

    def __init__(self) -> None:
        self.calls = 0

    def force(self, position: Any, velocity: Any) -> Any:
        self.calls += 1
        return -position

    def potential(self, position: Any) -> Any:
        return 0.5 * (position**2).sum()


def _force_evaluations(scenario: Scenario, method: str) -> int:
    counting = _Counting()
    system = System(build_system(scenario).bodies, (counting,))
    compiled = COMPILED_METHODS[method]
    state = compiled.start(system, initial_state(scenario))
    counting.calls = 0
    compiled.step(system, state, np.float64(0.01))
    return counting.calls


def _numbers(scenario: Scenario, method: str) -> int:
    system, start = build_system(scenario), initial_state(scenario)
    state = COMPILED_METHODS[method].start(system, State(*start))
    return int(sum(part.size for part in state) // start.position.shape[1])
