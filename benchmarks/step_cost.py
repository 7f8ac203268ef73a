"""What does a step cost? One orbiting body in float64, measured side by side in one run.

- this harness: `umbra`, wrapping of angles, energy and momenta streamed over every step;
- Diffrax: `SemiImplicitEuler` at constant step, no metrics, the same force.

Machines are shared and their speed varies, so rounds alternate and the ratio of the best counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from umbra_bench.compiled import CompiledRun
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.scenario import load_scenario
from umbra_bench.system import build_system, initial_state

STEPS = 1_000_000
SAMPLES = 250
ROUNDS = 7
DT = 1e-3


def main() -> None:
    """Print nanoseconds per step and their ratio."""
    contenders: dict[str, Callable[[], Any]] = {
        "umbra-bench, umbra, streaming metrics": harness(),
        "Diffrax SemiImplicitEuler, no metrics": diffrax_constant_step(),
    }
    best = dict.fromkeys(contenders, float("inf"))
    for _ in range(ROUNDS):
        for name, run in contenders.items():
            began = time.perf_counter()
            run()
            best[name] = min(best[name], time.perf_counter() - began)
    (_, ours), (_, theirs) = best.items()
    for name, seconds in best.items():
        print(f"{name:40} {seconds / STEPS * 1e9:7.1f} ns a step")
    print(f"{'ratio':40} {ours / theirs:7.2f}")


def harness() -> Callable[[], Any]:
    """This project's compiled loop, with all that a study asks of it."""
    scenario = load_scenario("orbit_circular")
    run = CompiledRun("umbra", build_system(scenario), initial_state(scenario), DT)
    run.compile(SAMPLES)
    return lambda: run.advance(STEPS // SAMPLES, SAMPLES)


def diffrax_constant_step() -> Callable[[], Any]:
    """Diffrax's own symplectic Euler over the same force law."""
    scenario = load_scenario("orbit_circular")
    system, start = build_system(scenario), initial_state(scenario)
    terms = (
        diffrax.ODETerm(lambda t, v, args: v),
        diffrax.ODETerm(lambda t, x, args: system.acceleration(x, jnp.zeros_like(x))),
    )

    @jax.jit
    def solve(position: Any, velocity: Any) -> Any:
        return diffrax.diffeqsolve(
            terms,
            diffrax.SemiImplicitEuler(),
            t0=0.0,
            t1=STEPS * DT,
            dt0=DT,
            y0=(position, velocity),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.ConstantStepSize(),
            max_steps=None,
        ).ys

    def run() -> Any:
        with float64_allowed():
            return jax.block_until_ready(solve(*start))

    assert np.isfinite(run()[0]).all()
    return run


if __name__ == "__main__":
    main()
