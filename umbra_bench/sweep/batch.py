"""Runs of one shape as one compiled, vectorised call.

The runs stand last: every array has shape (..., B), so that the same step that a single run takes
is taken by B of them side by side, each with its own parameters, step size and limit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from umbra_bench.compiled import (
    COMPILED_METHODS,
    NEVER,
    CompiledMethod,
    Observables,
    Streamed,
    as_one_function,
    by_component,
    observe,
    options_for,
    streamed_step,
)
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.metrics import DIVERGENCE
from umbra_bench.state import State, kinetic_energy
from umbra_bench.system import System
from umbra_bench.umbra.bodies import Array

AT_ONCE = 128
"""So many bodies, of all runs of a batch together, are stepped side by side: their rows stay in the
cache nearest to the processor, and the loop is one compiled function without calls between."""


def batch_size(bodies: int) -> int:
    """How many runs of a system of `bodies` bodies make a batch."""
    return max(1, AT_ONCE // bodies)


class Problem(NamedTuple):
    """One run: a system, its start and its step, s. In a batch every array has a last axis of runs."""

    system: System
    initial: State
    dt: Array


class Outcome(NamedTuple):
    """What runs of some steps showed, shape (B,) each.

    Attributes:
        start: the observables of the initial state.
        energy_scale: J, as :func:`energy_scale`.
        low, high: the extremes of the observables over all states, first and last included.
        intact_steps: for how many steps the energy was finite and within its limit.
    """

    start: Observables
    energy_scale: Array
    low: Observables
    high: Observables
    intact_steps: Array


def energy_scale(start: Array, kinetic: Array) -> Array:
    """What energies of a run are measured in, J: the larger of T and |E| at its start; 1 J if both are 0.

    A run of a sweep has no reference whose motion could tell more.
    """
    xp = start.__array_namespace__()
    scale = xp.maximum(abs(start), kinetic)
    return xp.where(scale > 0.0, scale, 1.0)


def side_by_side(problems: Sequence[Problem]) -> Problem:
    """Problems of one shape (one tree of arrays), at most :func:`batch_size`, as one.

    The last one fills the batch up, so that every batch of a sweep is one program.
    """
    size = batch_size(problems[0].initial.position.shape[1])
    filled = [*problems, *[problems[-1]] * (size - len(problems))]
    return jax.tree.map(lambda *each: np.stack(each, axis=-1), *filled)


def run_batch(method: str, batch: Problem, steps: int) -> Outcome:
    """Take steps of all problems of a batch.

    Args:
        method: a name in :data:`umbra_bench.compiled.COMPILED_METHODS`.
        batch: from :func:`side_by_side`.
        steps: of each run.
    """
    with float64_allowed():
        outcome = jax.block_until_ready(  # type: ignore[no-untyped-call]
            _compiled_run()(COMPILED_METHODS[method], batch, np.int64(steps))
        )
    return jax.tree.map(np.asarray, outcome)


@functools.cache
def _compiled_run() -> Callable[..., Outcome]:
    return jax.jit(_run, static_argnames="method", compiler_options=options_for(AT_ONCE))


def _run(method: CompiledMethod, batch: Problem, steps: Array) -> Outcome:
    each = functools.partial(jax.vmap, in_axes=-1, out_axes=-1)
    start = each(lambda p: observe(p.system, *p.initial))(batch)
    kinetic = each(lambda p: kinetic_energy(p.system.bodies, p.initial.velocity).sum())(batch)
    scale = energy_scale(start.energy, kinetic)
    limit = jnp.minimum(DIVERGENCE * scale, np.finfo(scale.dtype).max)
    none = jnp.full_like(scale, jnp.inf)
    streamed = Streamed(
        jnp.full(none.shape, NEVER), Observables(none, none), Observables(-none, -none)
    )
    state = each(lambda p: method.start(p.system, p.initial))(batch)
    apart, together = by_component(state)

    def one_step(n: Array, carry: tuple[Any, Streamed]) -> tuple[Any, Streamed]:
        def of_one(
            p: Problem, limit: Array, state: Any, streamed: Streamed
        ) -> tuple[Any, Streamed]:
            return streamed_step(method, p.system, p.dt, limit, n, state, streamed)

        parts, streamed = carry
        state, streamed = each(of_one)(batch, limit, together(parts), streamed)
        return apart(state), streamed

    def loop(carry: tuple[Any, Streamed]) -> tuple[Any, Streamed]:
        return jax.lax.fori_loop(0, steps, one_step, carry)

    small = state.position[0].size <= AT_ONCE
    parts, streamed = (as_one_function(loop) if small else loop)((apart(state), streamed))
    state = together(parts)
    end = each(lambda p, s: observe(p.system, s.position, s.velocity))(batch, state)
    within = abs(end.energy) <= limit
    broken = jnp.minimum(streamed.broken, jnp.where(within, NEVER, steps))
    return Outcome(
        start,
        scale,
        jax.tree.map(jnp.minimum, streamed.low, end),
        jax.tree.map(jnp.maximum, streamed.high, end),
        jnp.minimum(broken, steps),
    )
