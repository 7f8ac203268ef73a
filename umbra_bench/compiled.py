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
from umbra_bench.jax_settings import (
    FEWER_COPIES,
    WIDE_VECTORS,
    CompilerOption,
    compiler_options,
    float64_allowed,
)
from umbra_bench.state import State, angular_momentum
from umbra_bench.system import System
from umbra_bench.umbra.bodies import Array, UmbraState
from umbra_bench.umbra.pipeline import apply_damping, step
from umbra_bench.umbra.repaired import primed, repaired_step
from umbra_bench.umbra.uncorrected import uncorrected_step

SMALL = 16
"""Up to this number of bodies a state is carried row by row."""

SERIAL = 10**5
"""Up to this number of elements in the largest array of a step, the inner loop is compiled as one
function, without the runtime's overhead for each operation, which is ten times the arithmetic of a single
body. Beyond it the threads that the runtime has are worth more."""

MANY = 64
STEPS_A_TURN = 4
"""So many steps of more than `MANY` bodies are a turn of the loop, at whose end the state is copied."""


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
    return step(system.bodies, _with_forces(system, state), dt)


def _uncorrected_step(system: System, state: UmbraState, dt: Array) -> UmbraState:
    return uncorrected_step(system.bodies, _with_forces(system, state), dt)


def _with_forces(system: System, state: UmbraState) -> UmbraState:
    return state._replace(force=state.force + system.force(state.position, state.velocity))


def _repaired_start(system: System, state: State) -> UmbraState:
    return primed(system.bodies, _umbra_start(system, state), system.force)


def _repaired_step(system: System, state: UmbraState, dt: Array) -> UmbraState:
    return repaired_step(system.bodies, state, dt, system.force)


COMPILED_METHODS: dict[str, CompiledMethod] = {
    **{name: _textbook(integrator) for name, integrator in INTEGRATORS.items()},
    "umbra": CompiledMethod(_umbra_start, _umbra_step),
    "umbra-repaired": CompiledMethod(_repaired_start, _repaired_step),
    "umbra-primed": CompiledMethod(_repaired_start, _umbra_step),
    "umbra-swapped": CompiledMethod(_umbra_start, _repaired_step),
    "umbra-uncorrected": CompiledMethod(_umbra_start, _uncorrected_step),
}


class Observables(NamedTuple):
    """What is streamed over every step: scalars inside the loop, arrays of them outside.

    Energy in J, angular momentum about the origin in N m s.
    """

    energy: Array
    angular_momentum: Array


def observe(system: System, position: Array, velocity: Array) -> Observables:
    """Measure one state, shape (3, N) each."""
    momenta = angular_momentum(system.bodies, position, velocity)
    return Observables(system.energy(position, velocity), momenta.sum())


class Progress(NamedTuple):
    """Where a run stands.

    Attributes:
        state: the method's own.
        steps: how many were taken.
        broken: the first step whose energy was not within its limit; `NEVER` if there was none.
    """

    state: Any
    steps: Array
    broken: Array


NEVER = np.int64(2**62)


class Recording(NamedTuple):
    """Samples of a run, one each `stride` steps, the first `stride` steps after the start.

    Attributes:
        position, velocity: shape (S, 3, N).
        low, high: extremes of the observables over the steps from the sample before, inclusive, to
            this sample, exclusive; shape (S,) each.
    """

    position: Array
    velocity: Array
    low: Observables
    high: Observables


class Streamed(NamedTuple):
    """What a loop must not miss between two samples.

    Attributes:
        broken: as in :class:`Progress`.
        low, high: the extremes of the observables so far.
    """

    broken: Array
    low: Observables
    high: Observables


def streamed_step(
    method: CompiledMethod,
    system: System,
    dt: Array,
    energy_limit: Array,
    n: Array,
    state: Any,
    streamed: Streamed,
) -> tuple[Any, Streamed]:
    """Take step `n`, and stream what is to be seen of the state before it."""
    # The state that is about to step is measured, so that the distances which energy and forces
    # share are computed once.
    seen = observe(system, state.position, state.velocity)
    within = abs(seen.energy) <= energy_limit  # false for NaN as well
    streamed = Streamed(
        jnp.minimum(streamed.broken, jnp.where(within, NEVER, n)),
        jax.tree.map(jnp.minimum, streamed.low, seen),
        jax.tree.map(jnp.maximum, streamed.high, seen),
    )
    return method.step(system, state, dt), streamed


def options_for(elements: int) -> dict[str, CompilerOption]:
    """What to ask of the compiler for a loop over rows of so many elements; each was measured to pay."""
    if elements == 1:
        return {}
    return compiler_options(FEWER_COPIES if elements <= SMALL else FEWER_COPIES | WIDE_VECTORS)


@functools.cache
def _compiled_advance(bodies: int) -> Callable[..., tuple[Progress, Recording]]:
    names = ("method", "capacity")
    return jax.jit(_advance, static_argnames=names, compiler_options=options_for(bodies))


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
    bodies = progress.state.position.shape[1]
    a_turn = STEPS_A_TURN if bodies > MANY else 1

    def to_next_sample(progress: Progress) -> tuple[Progress, Observables, Observables]:
        state, steps, broken = progress
        dtype = state.position.dtype
        low, high = (Observables(*[dtype.type(end)] * 2) for end in (jnp.inf, -jnp.inf))
        apart, together = carried(state)

        def one_step(n: Array, carry: tuple[Any, Streamed]) -> tuple[Any, Streamed]:
            parts, streamed = carry
            state, streamed = streamed_step(
                method, system, dt, energy_limit, n, together(parts), streamed
            )
            return apart(state), streamed

        parts, (broken, low, high) = take_steps(
            one_step, steps, stride, (apart(state), Streamed(broken, low, high)), a_turn
        )
        return Progress(together(parts), steps + stride, broken), low, high

    serial = _largest(system, progress.state.position) <= SERIAL
    advance = as_one_function(to_next_sample) if serial else to_next_sample

    def store(s: Array, carry: Any) -> Any:
        progress, recording = carry
        progress, low, high = advance(progress)
        sample = Recording(progress.state.position, progress.state.velocity, low, high)
        return progress, jax.tree.map(lambda all, one: all.at[s].set(one), recording, sample)

    x = progress.state.position
    states, scalars = jnp.zeros((capacity, *x.shape), x.dtype), jnp.zeros(capacity, x.dtype)
    extremes = Observables(scalars, scalars)
    recording = Recording(states, states, extremes, extremes)
    return jax.lax.fori_loop(0, samples, store, (progress, recording))


def take_steps(
    one_step: Callable[[Array, Any], Any], first: Array, count: Array, carry: Any, a_turn: int
) -> Any:
    """Take steps `first` to `first + count`, exclusive, `a_turn` of them in a turn of the loop."""

    def several(turn: Array, carry: Any) -> Any:
        for i in range(a_turn):
            carry = one_step(first + turn * a_turn + i, carry)
        return carry

    if a_turn > 1:
        turns = count // a_turn
        carry = jax.lax.fori_loop(0, turns, several, carry)
        first, count = first + turns * a_turn, count - turns * a_turn
    return jax.lax.fori_loop(first, first + count, one_step, carry)


def _largest(system: System, position: Array) -> int:
    """The number of elements of the largest array of a step: of pairs, under mutual gravity."""
    potentials = [jax.eval_shape(law.potential, position) for law in system.laws]
    return max(array.size for array in (position, *potentials))


def by_component(like: Any) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """How a loop carries a small state: row by row, so that no row waits for the others.

    A third of the time of a single body is saved; thousands of bodies are better off whole.
    """
    _, shape = jax.tree.flatten(like)

    def apart(state: Any) -> Any:
        return [jnp.unstack(array) for array in jax.tree.leaves(state)]

    def together(parts: Any) -> Any:
        return jax.tree.unflatten(shape, [jnp.stack(rows) for rows in parts])

    return apart, together


def carried(like: UmbraState | State) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """How a loop carries a state: a small one row by row, a larger one whole."""
    if like.position.shape[1] <= SMALL:
        return by_component(like)
    return (lambda state: state), (lambda state: state)


def as_one_function(loop: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Ask XLA to compile a loop as one function of its own, as it does unasked for the smallest.

    Without the request (an older or newer JAX without this door) the result is the same, slower.
    """
    try:
        from jax.experimental.scheduling_groups import xla_metadata_call
    except ImportError:
        return loop
    return xla_metadata_call(  # type: ignore[no-untyped-call]
        loop, xla_cpu_small_call="true", inlineable="false"
    )


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
        self._progress = Progress(
            self._method.start(system, initial), np.array(0, np.int64), np.array(NEVER)
        )

    def compile(self, samples: int) -> None:
        """Compile what `advance` will need for this number of samples, without taking a step."""
        self._run(0, 0, room_for=samples)

    def advance(self, stride: int, samples: int) -> Recording:
        """Take `stride` x `samples` steps and return the samples, as NumPy arrays."""
        self._progress, recording = self._run(stride, samples)
        return jax.tree.map(lambda all: np.asarray(all)[:samples], recording)

    @property
    def intact_steps(self) -> int:
        """For how many steps from the start the energy was finite and within its limit."""
        return int(min(self._progress.steps, self._progress.broken))

    @property
    def position_and_velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """The state as it stands, shape (3, N) each."""
        state = self._progress.state
        return np.asarray(state.position), np.asarray(state.velocity)

    def kept(self) -> list[np.ndarray]:
        """All that a run knows of where it stands: what `resume` takes to go on bit for bit."""
        return [np.asarray(leaf) for leaf in jax.tree.leaves(self._progress)]

    def resume(self, kept: list[np.ndarray]) -> None:
        """Stand where another run of the same method, system and step stood."""
        self._progress = jax.tree.unflatten(jax.tree.structure(self._progress), kept)

    def _run(self, stride: int, samples: int, room_for: int | None = None) -> Any:
        bodies = self._progress.state.position.shape[1]
        capacity = _capacity(room_for or samples, bodies)
        with float64_allowed():
            return jax.block_until_ready(  # type: ignore[no-untyped-call]
                _compiled_advance(bodies)(
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


def _capacity(samples: int, bodies: int) -> int:
    """Room for samples, in powers of two: another number of them rarely needs another program."""
    least = 256 if bodies <= SMALL else 1
    return max(least, 1 << (samples - 1).bit_length())
