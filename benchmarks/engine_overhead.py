"""What the harness costs an engine per step: the whole step minus the engine's own, one body, in us.

The whole step evaluates the force (a compiled function called from NumPy), hands it over, steps, reads
the state and measures it. `make bench` runs this.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from umbra_bench.engines.protocol import open_engine
from umbra_bench.jax_settings import float64_allowed, keep_compiled_code
from umbra_bench.methods import METHODS
from umbra_bench.scenario import load_scenario
from umbra_bench.simulation import simulate
from umbra_bench.system import compiled_force, initial_state

STEPS = 5000
DT = 0.001


def own_step(method: str, engine: Any) -> Callable[[], Any]:
    """The engine's own step, and nothing around it."""
    if method.startswith("pymunk"):
        return lambda: engine.space.step(DT)
    if method == "box2d":
        return lambda: engine._world.Step(DT, 1, 1)
    if method == "bullet":
        import pybullet

        return lambda: pybullet.stepSimulation(physicsClientId=engine._client)
    if method == "physx":
        return engine._system.step
    import mujoco

    return lambda: mujoco.mj_step(engine._model, engine._data)


def microseconds(call: Callable[[], Any], count: int) -> float:
    """The fastest of three rounds, per call."""
    rounds = []
    for _ in range(3):
        begin = time.perf_counter()
        for _ in range(count):
            call()
        rounds.append(time.perf_counter() - begin)
    return 1e6 * min(rounds) / count


def main() -> None:
    """Print a row for each installed engine."""
    keep_compiled_code()
    scenario = load_scenario("spring")
    force, start = compiled_force(scenario), initial_state(scenario)
    with float64_allowed():
        force(*start)
        print(f"one evaluation of the force: {microseconds(lambda: force(*start), STEPS):.1f} us")
        print(f"{'engine':22} {'whole step':>10} {'own step':>10} {'overhead':>10}")
        for method in (m.name for m in METHODS.values() if m.package and m.installed):
            engine = open_engine(method, scenario)
            engine.step(DT, *start)
            own = microseconds(own_step(method, engine), STEPS)
            runs = (simulate(scenario, method, DT, steps=STEPS, every=STEPS) for _ in range(3))
            whole = 1e6 * min(run.wall_time for run in runs) / STEPS
            print(f"{method:22} {whole:10.1f} {own:10.1f} {whole - own:10.1f}")


if __name__ == "__main__":
    main()
