"""The compiled loop: one program for every step size, duration and parameter of a system's shape.

Two nested loops. The inner one takes `stride` steps and streams what must not be missed between two
samples: the extremes of energy and momentum, and the first step that was not finite any more. The
outer one stores the samples. Neither allocates per step, so memory does not grow with the steps.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from umbra_bench.integrators import INTEGRATORS, Integrator
from umbra_bench.precision import float64_allowed
from umbra_bench.state import State, angular_momentum, linear_momentum
from umbra_bench.system import System
from umbra_bench.umbra.bodies import Array, UmbraState
from umbra_bench.umbra.pipeline import apply_damping, step
from umbra_bench.umbra.repaired import primed, repaired_step

SMALL = 64
"""Up to this number of bodies the inner loop is compiled as one function, without the runtime's
overhead for each operation, which is ten times the arithmetic of a single body."""


class CompiledMethod(NamedTuple):
    """A method as two pure functions over its own state, which has a position and a velocity."""

    start: Callable[[System, State], Any]
    step: Callable[[System, Any, Array], Any]


def _textbook(integrator: Integrator) -> CompiledMethod:
    """A textbook integrator; damping, where a scenario has it, follows each step as in the devlog."""

    def damped_step(system: System, state: State, dt: Array) -> State:
        x, v = integrator(system, state, dt)
        return State(x, apply_damping(v, system.bodies.damping, dt))

    return CompiledMethod(lambda system, state: state, damped_step)


def _umbra_start(system: System, state: State) -> UmbraState:
    return UmbraState.at(state.position, state.velocity)


def _umbra_step(system: System, state: UmbraState, dt: Array) -> UmbraState:
    """What a game does: apply the forces of the state that it sees, then step."""
    force = state.force + system.force(state.position, state.velocity)
    return step(system.bodies, state._replace(force=force), dt)


def _repaired_start(system: System, state: State) -> UmbraState:
    return primed(system.bodies, _umbra_start(system, state), system.force)


def _repaired_step(system: System, state: UmbraState, dt: Array) -> UmbraState:
    return repaired_step(system.bodies, state, dt, system.force)


COMPILED_METHODS: dict[str, CompiledMethod] = {
    **{name: _textbook(integrator) for name, integrator in INTEGRATORS.items()},
    "umbra": CompiledMethod(_umbra_start, _umbra_step),
    "umbra-repaired": CompiledMethod(_repaired_start, _repaired_step),
}


class Observables(NamedTuple):
    """What is streamed over every step: scalars inside the loop, arrays of them outside.

    Energy in J, angular momentum about the origin in N m s, linear momentum in N s.
    """

    energy: Array
    angular_momentum: Array
    momentum_x: Array
    momentum_y: Array


def observe(system: System, position: Array, velocity: Array) -> Observables:
    """Measure one state, shape (3, N) each."""
    px, py = linear_momentum(system.bodies, velocity)
    return Observables(
        system.energy(position, velocity),
        angular_momentum(system.bodies, position, velocity),
        px,
        py,
    )


class Progress(NamedTuple):
    """Where a run stands: the method's state, and for how many steps its energy was within bounds."""

    state: Any
    intact: Array
    intact_steps: Array


class Recording(NamedTuple):
    """Samples of a run, one each `stride` steps, the first `stride` steps after the start.

    Attributes:
        position, velocity: shape (S, 3, N).
        at: the observables at the samples, shape (S,) each.
        low, high: their extremes over the steps from the sample before, inclusive, to this sample,
            exclusive, shape (S,) each.
    """

    position: Array
    velocity: Array
    at: Observables
    low: Observables
    high: Observables


@functools.partial(jax.jit, static_argnames="method")
def _start(method: CompiledMethod, system: System, state: State) -> Progress:
    return Progress(method.start(system, state), jnp.array(True), jnp.array(0))


@functools.partial(jax.jit, static_argnames=("method", "capacity"))
def _advance(
    method: CompiledMethod,
    capacity: int,
    system: System,
    progress: Progress,
    dt: Array,
    energy_limit: Array,
    stride: Array,
    samples: Array,
) -> tuple[Progress, Recording]:
    def one_step(_: Array, carry: Any) -> Any:
        (state, intact, intact_steps), low, high = carry
        # The state that is about to step is measured, so that the distances which energy and forces
        # share are computed once.
        seen = observe(system, state.position, state.velocity)
        low = jax.tree.map(jnp.minimum, low, seen)
        high = jax.tree.map(jnp.maximum, high, seen)
        intact = intact & (abs(seen.energy) <= energy_limit)  # false for NaN as well
        state = method.step(system, state, dt)
        return Progress(state, intact, intact_steps + intact), low, high

    def to_next_sample(progress: Progress) -> Any:
        infinity = jnp.array(jnp.inf, progress.state.position.dtype)
        low = Observables(infinity, infinity, infinity, infinity)
        high = jax.tree.map(jnp.negative, low)
        return jax.lax.fori_loop(0, stride, one_step, (progress, low, high))

    if progress.state.position.shape[1] <= SMALL:
        to_next_sample = _as_one_function(to_next_sample)

    def store(s: Array, carry: Any) -> Any:
        progress, recording = carry
        progress, low, high = to_next_sample(progress)
        position, velocity = progress.state.position, progress.state.velocity
        sample = Recording(position, velocity, observe(system, position, velocity), low, high)
        return progress, jax.tree.map(lambda all, one: all.at[s].set(one), recording, sample)

    x = progress.state.position
    scalars = Observables(*(jnp.zeros(capacity, x.dtype) for _ in Observables._fields))
    arrays = jnp.zeros((capacity, *x.shape), x.dtype)
    empty = Recording(arrays, arrays, scalars, scalars, scalars)
    return jax.lax.fori_loop(0, samples, store, (progress, empty))


def _as_one_function(loop: Callable[[Progress], Any]) -> Callable[[Progress], Any]:
    """Ask XLA to compile a loop as one function of its own, as it does unasked for the smallest.

    Without the request (an older or newer JAX without this door) the result is the same, slower.
    """
    try:
        from jax.experimental.scheduling_groups import xla_metadata_call
    except ImportError:
        return loop
    return xla_metadata_call(loop, xla_cpu_small_call="true", inlineable="false")


class CompiledRun:
    """A compiled method at work on one system.

    Args:
        method: a name in :data:`COMPILED_METHODS`.
        system: NumPy arrays of the precision in which the method shall run.
        initial: the initial state, of the same precision.
        dt: the step, s.
        energy_limit: J; a step whose energy is beyond it, or not finite, ends the intact part.
    """

    def __init__(
        self,
        method: str,
        system: System,
        initial: State,
        dt: float,
        energy_limit: float = float("inf"),
    ) -> None:
        dtype = initial.position.dtype.type
        self._method = COMPILED_METHODS[method]
        self._system = system
        self._dt = dtype(dt)
        self._limit = dtype(min(energy_limit, float(np.finfo(dtype).max)))
        with float64_allowed():
            self._progress = _start(self._method, system, initial)

    def compile(self, samples: int) -> None:
        """Compile what `advance` will need for this number of samples, without taking a step."""
        self._run(0, 0, _capacity(samples))

    def advance(self, stride: int, samples: int) -> Recording:
        """Take `stride` x `samples` steps and return the samples, as NumPy arrays."""
        self._progress, recording = self._run(stride, samples, _capacity(samples))
        return jax.tree.map(lambda all: np.asarray(all)[:samples], recording)

    @property
    def intact_steps(self) -> int:
        """For how many steps from the start the energy was finite and within its limit."""
        return int(self._progress.intact_steps)

    def _run(self, stride: int, samples: int, capacity: int) -> tuple[Progress, Recording]:
        with float64_allowed():
            return jax.block_until_ready(
                _advance(
                    self._method,
                    capacity,
                    self._system,
                    self._progress,
                    self._dt,
                    self._limit,
                    np.int64(stride),
                    np.int64(samples),
                )
            )


def _capacity(samples: int) -> int:
    """Room for samples, in powers of two: another number of them rarely needs another program."""
    return max(256, 1 << (samples - 1).bit_length())
