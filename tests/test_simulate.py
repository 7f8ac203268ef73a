"""A run: what is sampled, streamed and continued is one motion, in the precision asked for."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import EPS, EPS32, angles_apart, in_numpy, orbit, states

from umbra_bench.compiled import COMPILED_METHODS, Observables
from umbra_bench.errors import UmbraBenchError
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.reference import observe_all
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import Trajectory, open_run, simulate, whole_steps

Load = Callable[[str], Scenario]

KEPLER = orbit((0.5, 0.1), (-0.2, 1.5))
EXACT = orbit((0.5, 0.125), (-0.25, 1.5))
"""Nearly the same, in numbers that both precisions hold exactly."""
BOTH = pytest.mark.parametrize("precision", ["float32", "float64"])
# One of UMBRA, one textbook method and one engine: three loops or states of different shapes.
SOME = pytest.mark.parametrize("method", ["umbra", "yoshida4", "pymunk"])


# Sampling -----------------------------------------------------------------------------------------


@SOME
def test_samples_do_not_depend_on_how_often_they_are_taken(method: str) -> None:
    often = simulate(KEPLER, method, 0.01, steps=500, every=1)
    seldom = simulate(KEPLER, method, 0.01, steps=500, every=50)
    np.testing.assert_array_equal(often.position[::50], seldom.position)
    np.testing.assert_array_equal(often.velocity[::50], seldom.velocity)
    np.testing.assert_allclose(often.times[::50], seldom.times, rtol=2 * EPS)


@pytest.mark.parametrize("method", [*COMPILED_METHODS, "pymunk", "reference"])
def test_a_trajectory_has_its_start_and_its_end(method: str) -> None:
    run = simulate(KEPLER, method, 0.01, every=100)
    _, start = in_numpy(KEPLER)
    assert run.steps == 500
    assert run.position.shape == run.velocity.shape == (6, 3, 1)
    assert run.times[0] == 0.0
    assert run.times[-1] == pytest.approx(5.0, rel=2 * EPS)
    np.testing.assert_array_equal(run.position[0], start.position)
    np.testing.assert_array_equal(run.velocity[0], start.velocity)
    assert run.diverged_at is None
    # All turn by more than a radian and stay near the orbit, whose distances are 0.4 to 0.6 m.
    assert 0.1 < np.hypot(*run.position[-1, :2, 0]) < 5.0


def test_as_many_steps_as_fit_in_the_duration(load: Load) -> None:
    scenario = load("spring")  # 20 s
    # 20 / 0.1 and the like are whole up to rounding; 20 / 0.3 = 66.7 is not.
    expected = {0.1: 200, 0.01: 2000, 1 / 3: 60, 0.3: 66, 0.7: 28, 20.0: 1, 21.0: 0}
    assert {dt: whole_steps(scenario, dt) for dt in expected} == expected


def test_steps_that_do_not_fit_between_samples_are_refused() -> None:
    with pytest.raises(UmbraBenchError, match="every = 7"):
        simulate(KEPLER, "umbra", 0.01, steps=500, every=7)


# Streaming ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "precision", "rounding"),
    [("umbra", "float64", EPS), ("umbra", "float32", EPS32), ("pymunk", "float64", EPS)],
    ids=["umbra-float64", "umbra-float32", "pymunk"],
)
def test_streamed_extremes_are_those_of_every_step(
    method: str, precision: str, rounding: float
) -> None:
    every, samples = 50, 10
    steps = every * samples
    run = simulate(KEPLER, method, 0.01, steps=steps, every=every, precision=precision)
    each = simulate(KEPLER, method, 0.01, steps=steps, every=1, precision=precision)
    for name in Observables._fields:
        # Each interval has its first state and not its last.
        seen = getattr(each.at, name)[:-1].reshape(samples, every)
        # Two programs evaluate one formula: a few roundings of terms of order 1 to 4.
        atol = 16 * rounding
        np.testing.assert_allclose(getattr(run.low, name), seen.min(1), rtol=0, atol=atol)
        np.testing.assert_allclose(getattr(run.high, name), seen.max(1), rtol=0, atol=atol)
        if name != "angular_momentum":
            assert np.ptp(seen) > 1000 * atol  # there was something to see between the samples


def test_what_is_measured_at_the_samples_is_measured_on_the_samples() -> None:
    run = simulate(KEPLER, "umbra", 0.01, steps=500, every=50)
    x, y, vx, vy = *run.position[:, :2, 0].T, *run.velocity[:, :2, 0].T
    energy = (vx**2 + vy**2) / 2 - 1 / np.hypot(x, y)
    np.testing.assert_allclose(run.at.energy, energy, rtol=0, atol=16 * EPS)
    np.testing.assert_allclose(run.at.angular_momentum, x * vy - y * vx, rtol=0, atol=16 * EPS)


# Continuing ---------------------------------------------------------------------------------------


@SOME
@BOTH
def test_a_run_in_two_parts_is_the_run_in_one_part_bit_for_bit(method: str, precision: str) -> None:
    whole, parts = (open_run(KEPLER, method, 0.01, precision) for _ in range(2))
    one = whole.advance(50, 10)
    two = [parts.advance(50, 3), parts.advance(50, 7)]
    joined = jax.tree.map(lambda *pieces: np.concatenate(pieces), *two)
    jax.tree.map(np.testing.assert_array_equal, joined, one)
    assert whole.intact_steps == parts.intact_steps == 500


def test_strides_may_change_on_the_way() -> None:
    steady, changing = (open_run(KEPLER, "umbra", 0.01) for _ in range(2))
    end = steady.advance(50, 10)
    changing.advance(7, 30)
    changing.advance(1, 90)
    last = changing.advance(200, 1)
    np.testing.assert_array_equal(last.position[-1], end.position[-1])
    np.testing.assert_array_equal(last.velocity[-1], end.velocity[-1])


def test_a_run_repeats_itself_bit_for_bit() -> None:
    one, two = (simulate(KEPLER, "umbra", 0.01, every=50) for _ in range(2))
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.at.energy, two.at.energy)


def test_the_reference_goes_on_where_it_stopped() -> None:
    whole, parts = (open_run(KEPLER, "reference", 0.01) for _ in range(2))
    one = whole.advance(100, 5)
    parts.advance(50, 5)
    two = parts.advance(50, 5)
    # At 3, 4 and 5 s: two solutions at a tolerance of 1e-14 in each of some hundred steps.
    np.testing.assert_allclose(two.position[::2], one.position[2:], rtol=0, atol=1e-11)


# Divergence ---------------------------------------------------------------------------------------


def overflow_of_explicit_euler(load: Load, dt: float, precision: str) -> int:
    """The step at which E_n = E_0 (1 + omega^2 dt^2)^n of spring_stiff leaves the floats."""
    scenario = load("spring_stiff")
    start = simulate(scenario, "explicit-euler", dt, steps=1).at.energy[0]
    growth = 1 + (100.0 * dt) ** 2
    largest = np.finfo(precision).max
    return int(np.ceil((np.log(largest) - np.log(start)) / np.log(growth)))


@pytest.mark.parametrize("every", [1, 16])
@BOTH
def test_an_unstable_run_says_when_it_diverged(load: Load, precision: str, every: int) -> None:
    dt, steps = 0.4, 256
    run = simulate(
        load("spring_stiff"), "explicit-euler", dt, steps=steps, every=every, precision=precision
    )
    assert run.diverged_at is not None
    diverged = round(run.diverged_at / dt)
    # A sum of squares overflows before the energy itself does by at most a factor 2 of the energy
    # (k l^2 before it is halved), less than the growth of 1601 in a step.
    expected = overflow_of_explicit_euler(load, dt, precision)
    assert expected - 1 <= diverged <= expected
    assert run.diverged_at == pytest.approx(diverged * dt, rel=2 * EPS)
    # The rows keep what became of it.
    assert len(run.position) == steps // every + 1
    assert np.all(np.isfinite(run.at.energy[: (diverged - 1) // every + 1]))
    assert not np.any(np.isfinite(run.at.energy[-(-diverged // every) :]))
    assert not np.any(np.isfinite(run.position[-1, :2]))
    assert not np.any(np.isfinite(run.velocity[-1, :2]))
    assert run.position.dtype == precision


@pytest.mark.parametrize("every", [1, 50])
def test_beyond_its_energy_limit_a_run_has_diverged(load: Load, every: int) -> None:
    dt, steps = 0.01, 200
    scenario = load("spring_stiff")
    energy = simulate(scenario, "explicit-euler", dt, steps=steps).at.energy
    limit = 1e6 * energy[0]
    run = simulate(scenario, "explicit-euler", dt, steps=steps, every=every, energy_limit=limit)
    first = int(np.argmax(energy > limit))
    assert run.diverged_at == pytest.approx(first * dt, rel=2 * EPS)
    # omega dt = 1 doubles the energy at each step: 2^20 is the first power beyond 10^6.
    assert first == 20


def test_an_engine_diverges_at_the_same_step(load: Load) -> None:
    scenario = load("spring_stiff")
    limit = 1e6 * simulate(scenario, "explicit-euler", 0.01, steps=1).at.energy[0]
    run = simulate(scenario, "pymunk", 0.01, steps=200, every=50, energy_limit=limit)
    assert run.diverged_at == pytest.approx(20 * 0.01, rel=2 * EPS)  # it is explicit Euler


STABLE_TO_2 = pytest.mark.parametrize("method", ["semi-implicit-euler", "velocity-verlet", "umbra"])


@STABLE_TO_2
def test_the_symplectic_methods_are_stable_below_omega_dt_2(load: Load, method: str) -> None:
    scenario, omega = load("spring_stiff"), 100.0
    for dt in (0.01, 0.0199):
        run = simulate(scenario, method, dt, steps=2000, every=10)
        assert run.diverged_at is None
        # They conserve v^2 + omega^2 d^2 - omega^2 dt d v (Verlet: v^2 + omega^2 (1 - z^2/4) d^2)
        # with z = omega dt, so that omega d never exceeds this; a few roundings a step.
        z = omega * dt
        away, velocity = run.position[:, :2, 0] - (0.1, -0.2), run.velocity[0, :2, 0]
        first = np.hypot(np.hypot(*velocity), omega * np.hypot(*away[0]))
        bound = np.sqrt((1 + z / 2) / (1 - z / 2)) * first
        assert omega * np.hypot(*away.T).max() <= bound * (1 + 4 * 2000 * EPS)


@STABLE_TO_2
def test_and_not_above(load: Load, method: str) -> None:
    # |lambda| = e^0.2 at omega dt = 2.01: 5000 steps are beyond any float.
    run = simulate(load("spring_stiff"), method, 0.0201, steps=5000, every=500)
    assert run.diverged_at is not None


# Precision ----------------------------------------------------------------------------------------


def assert_all_of(run: Trajectory, dtype: type) -> None:
    arrays = [run.position, run.velocity, *run.at, *run.low, *run.high]
    assert {array.dtype for array in arrays} == {np.dtype(dtype)}


@pytest.mark.parametrize("method", COMPILED_METHODS)
def test_float32_is_float32_in_every_operation(method: str) -> None:
    system, state = in_numpy(EXACT, "float32")
    start, step = COMPILED_METHODS[method]
    with float64_allowed():
        program = jax.make_jaxpr(lambda s: step(system, start(system, s), np.float32(0.01)))(state)
    # A literal of the source may be a scalar on its way to float32; no array of the state may.
    assert "f32[3" in str(program)
    assert not re.search(r"f64\[\d", str(program))


@pytest.mark.parametrize("method", COMPILED_METHODS)
def test_float32_keeps_float32_between_steps(method: str) -> None:
    dt, steps = 1 / 128, 512
    run = simulate(EXACT, method, dt, steps=steps, every=4, precision="float32")
    assert run.precision == "float32"
    assert_all_of(run, np.float32)
    # NumPy rounds alike, up to fused multiply-adds: n roundings that grow with n on an orbit.
    by_numpy = [s.position for s in states(method, *in_numpy(EXACT, "float32"), dt, steps)]
    np.testing.assert_allclose(run.position, by_numpy[::4], rtol=0, atol=steps**2 / 4 * EPS32)
    # Start and step are exact in both precisions: were the state kept in double between steps, only
    # one rounding of the samples would be seen, EPS32/2 of places below 1 m.
    in_double = simulate(EXACT, method, dt, steps=steps, every=4).position
    assert np.abs(run.position - in_double)[:, :2].max() > 8 * EPS32


@pytest.mark.parametrize("method", [*COMPILED_METHODS, "pymunk", "reference"])
def test_float64_is_float64(method: str) -> None:
    run = simulate(KEPLER, method, 0.01, steps=100, every=20)
    assert run.precision == "float64"
    assert_all_of(run, np.float64)


def test_an_engine_keeps_its_own_precision() -> None:
    asked, unasked = (
        simulate(KEPLER, "pymunk", 0.01, steps=100, precision=precision)
        for precision in ("float32", "float64")
    )
    assert asked.precision == "float64"
    assert_all_of(asked, np.float64)
    np.testing.assert_array_equal(asked.position, unasked.position)


def test_angles_of_umbra_are_wrapped_and_those_of_the_textbook_are_not(load: Load) -> None:
    scenario = load("spinning_box")
    umbra, textbook = (
        simulate(scenario, method, 0.01, steps=500).position[:, 2]
        for method in ("umbra", "semi-implicit-euler")
    )
    assert umbra[1:].min() >= 0.0
    assert umbra.max() < 2 * np.pi
    assert np.abs(textbook).max() > 2 * np.pi
    # Each of 500 steps rounds an angle of up to 63 rad.
    assert np.abs(angles_apart(umbra, textbook)).max() <= 500 * 64 * EPS


# JAX's settings are the caller's ------------------------------------------------------------------

IMPORT_ALL = """
import importlib, pkgutil
import jax
settings = dict(jax.config.values)
import umbra_bench
for module in pkgutil.walk_packages(umbra_bench.__path__, "umbra_bench."):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as missing:  # an engine that this machine does not have
            assert module.name.startswith("umbra_bench.engines."), module.name
            assert missing.name in ("Box2D", "pybullet", "sapien", "mujoco"), missing.name
changed = {key for key, value in jax.config.values.items() if settings.get(key, value) != value}
assert not changed, changed
assert jax.config.jax_enable_x64 is False
"""


def test_importing_the_package_changes_no_setting_of_jax() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("setting", [False, True])
def test_running_a_simulation_changes_no_setting_of_jax(setting: bool) -> None:
    with jax.enable_x64(setting):
        settings = dict(jax.config.values)
        for method in ("umbra", "pymunk", "reference"):
            for precision in ("float32", "float64"):
                simulate(KEPLER, method, 0.01, steps=10, every=2, precision=precision)
        assert jax.config.jax_enable_x64 is setting
        assert dict(jax.config.values) == settings
        assert jnp.ones(1).dtype == (np.float64 if setting else np.float32)


def test_a_simulation_is_the_same_whatever_the_callers_setting() -> None:
    runs = []
    for setting in (False, True):
        with jax.enable_x64(setting):
            runs.append(simulate(KEPLER, "umbra", 0.01, steps=500, every=50))
    np.testing.assert_array_equal(runs[0].position, runs[1].position)


def test_energy_of_many_states_is_measured_in_their_own_precision() -> None:
    for precision in ("float32", "float64"):
        system, start = in_numpy(KEPLER, precision)
        seen = observe_all(system, start.position[None], start.velocity[None])
        assert {values.dtype for values in seen} == {np.dtype(precision)}
