"""Growth per step against omega dt: the eigenvalues of the step that is run, on a unit spring."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.scenario import Body, Scenario, Spring, Sweep
from umbra_bench.state import State
from umbra_bench.system import build_system, initial_state

_KEPT = ("position", "velocity", "acceleration")
"""What a method carries from one step to the next; a pipeline's accumulators are empty between."""


def unit_spring(kept: float = 1.0) -> Scenario:
    """A body of 1 kg on a spring of 1 N/m; `kept` is the part of its velocity kept per second."""
    return Scenario(
        name="unit_spring",
        title="Unit spring",
        family="spring",
        description="omega = 1/s",
        duration=1.0,
        linear_damping=kept,
        angular_damping=kept,
        dt=Sweep(start=0.5, halvings=0),
        bodies=(Body(name="weight", mass=1.0, position=(1.0, 0.0), velocity=(0.0, 0.0)),),
        forces=(Spring(kind="spring", body="weight", anchor=(0.0, 0.0), stiffness=1.0),),
    )


def measured_growth(method: str, steps: np.ndarray, kept: float = 1.0) -> np.ndarray:
    """The spectral radius of one step at each dt (s, shape (K,)) on the unit spring, shape (K,).

    The Jacobian of the compiled step by automatic differentiation, along x: the map is linear there.
    """
    compiled = COMPILED_METHODS[method]
    system, start = build_system(unit_spring(kept)), initial_state(unit_spring(kept))
    names = [name for name in _KEPT if hasattr(compiled.start(system, start), name)]

    def step(x_row: Any, dt: Any) -> Any:
        state = compiled.start(system, State(*map(jnp.asarray, start)))
        parts = {
            name: getattr(state, name).at[0, 0].set(value)
            for name, value in zip(names, x_row, strict=True)
        }
        after = compiled.step(system, state._replace(**parts), dt)
        return jnp.stack([getattr(after, name)[0, 0] for name in names])

    with float64_allowed():
        at = jnp.array([1.0, 0.0, -1.0][: len(names)])
        jacobians = jax.jit(jax.vmap(jax.jacfwd(step), in_axes=(None, 0)))(at, jnp.asarray(steps))
        return np.abs(np.linalg.eigvals(np.asarray(jacobians))).max(axis=1)


def largest_stable_step(method: str, kept: float = 1.0) -> float:
    """The largest omega dt, of 0.01, 0.02 to 4, up to which no motion grows by 1e-6 a step."""
    steps = np.linspace(0.01, 4.0, 400)
    growing = measured_growth(method, steps, kept) > 1.0 + 1e-6
    if growing[0]:
        return 0.0
    first = int(np.argmax(growing)) if growing.any() else len(steps)
    return float(steps[first - 1])
