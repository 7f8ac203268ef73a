"""Foreign engines: the numbers that are known of them, what each is, and what happens without one."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from umbra_bench import methods
from umbra_bench.engine_table import examine_engines
from umbra_bench.errors import UmbraBenchError, UnsupportedScenario
from umbra_bench.identify import identify
from umbra_bench.methods import METHODS, methods_of_study
from umbra_bench.scenario import Body, Scenario, Spring, Sweep, load_scenario
from umbra_bench.schemas import ENGINES_SCHEMA
from umbra_bench.simulation import simulate
from umbra_bench.study import run_study

SPATIAL = ("bullet", "physx", "mujoco-euler", "mujoco-rk4")
OPTIONAL = ("box2d", *SPATIAL)


def installed(*names: str) -> list[object]:
    """The engines as parameters; one that is missing is skipped with the reason."""
    return [
        pytest.param(
            name,
            marks=pytest.mark.skipif(not METHODS[name].installed, reason=METHODS[name].missing),
        )
        for name in names
    ]


def page_spring(**body: object) -> Scenario:
    """The spring of the physics page: omega = 2 rad/s, released at rest from 1 m."""
    return Scenario(
        name="page_spring",
        title="Spring",
        family="spring",
        description="omega = 2 rad/s",
        duration=5.0,
        dt=Sweep(start=0.05, halvings=2),
        bodies=(Body(name="weight", mass=1.0, position=(1.0, 0.0), **body),),
        forces=(Spring(kind="spring", body="weight", anchor=(0.0, 0.0), stiffness=4.0),),
    )


@pytest.mark.parametrize(
    "method", [*installed("box2d", "bullet", "physx", "mujoco-euler"), "umbra"]
)
def test_the_position_error_of_semi_implicit_euler(method: str) -> None:
    run = simulate(page_spring(), method, 5 / 400, steps=400)
    assert abs(run.position[-1, 0, 0] - math.cos(10.0)) == pytest.approx(6.95e-3, rel=0.01)


def test_pymunk_before_the_step_and_inside_it() -> None:
    errors = {
        method: abs(
            simulate(page_spring(), method, 5 / 400, steps=400).position[-1, 0, 0] - math.cos(10.0)
        )
        for method in ("pymunk", "pymunk-velocity-func", "pymunk-spring")
    }
    assert errors["pymunk"] == pytest.approx(1.13e-1, rel=0.01)
    assert errors["pymunk-velocity-func"] == pytest.approx(6.66e-3, rel=0.01)
    assert errors["pymunk-spring"] == pytest.approx(6.66e-3, rel=0.01)


@pytest.mark.parametrize("method", installed("mujoco-rk4"))
def test_mujocos_runge_kutta_is_of_fourth_order(method: str) -> None:
    orders = run_study([load_scenario("spring").with_sweep(0.16, 4)], [method]).orders
    found = orders.filter(orders["quantity"] == "position")["order"][0]
    assert found > 3.8


@pytest.mark.parametrize("method", installed(*OPTIONAL))
def test_nothing_is_damped_and_rotation_is_kept(method: str) -> None:
    scenario = page_spring(angular_velocity=3.0, inertia=0.2)
    run = simulate(scenario, method, 0.005, steps=2000)
    np.testing.assert_allclose(run.velocity[:, 2, 0], 3.0, rtol=2e-3)
    assert run.at.energy[-400:].max() > 0.97 * run.at.energy[0]


@pytest.mark.parametrize("method", installed(*OPTIONAL))
@pytest.mark.parametrize("name", ["elastic_pendulum", "torsion_spring"])
def test_forces_push_and_torques_turn(method: str, name: str) -> None:
    scenario, own = load_scenario(name), "semi-implicit-euler"
    run = simulate(scenario, method, 0.01, steps=100)
    other = simulate(scenario, "rk4" if method == "mujoco-rk4" else own, 0.01, steps=100)
    assert np.ptp(other.position, axis=0).max() > 0.1
    gap = run.position - other.position
    gap[:, 2] = np.remainder(gap[:, 2] + math.pi, 2 * math.pi) - math.pi
    np.testing.assert_allclose(gap, 0.0, atol=1e-4)
    np.testing.assert_allclose(run.velocity, other.velocity, atol=5e-4)


@pytest.mark.parametrize("method", installed(*SPATIAL))
def test_a_kinematic_body_is_a_stated_skip(method: str) -> None:
    crane = load_scenario("scenarios/gate/crane.toml")
    with pytest.raises(UnsupportedScenario, match="'trolley' is kinematic"):
        simulate(crane, method, 0.01, steps=1)


@pytest.mark.parametrize("method", installed("box2d"))
def test_box2d_carries_kinematic_and_static_bodies(method: str) -> None:
    crane = load_scenario("scenarios/gate/crane.toml")
    run = simulate(crane, method, 0.01, steps=100)
    names = [body.name for body in crane.bodies]
    trolley, mast = names.index("trolley"), names.index("mast")
    np.testing.assert_allclose(run.position[-1, :2, trolley], [0.5, 4.1], atol=1e-4)
    np.testing.assert_array_equal(run.position[-1, :2, mast], [3.0, 4.0])


@pytest.mark.parametrize("method", installed("mujoco-euler", "bullet", "box2d", "physx"))
def test_divergence_is_a_result(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    spring = page_spring()
    stiff = spring.model_copy(
        update={"forces": (spring.forces[0].model_copy(update={"stiffness": 4e6}),)}
    )
    run = simulate(stiff, method, 0.01, steps=500, energy_limit=1e12)
    if method == "box2d":  # it limits every step to 2 m
        assert np.abs(np.diff(run.position[:, :2], axis=0)).max() < 2.01
    else:
        assert run.diverged_at is not None
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().out == ""


# Which integrator is it? ------------------------------------------------------------------------------

KNOWN = {
    "explicit-euler": "explicit Euler",
    "semi-implicit-euler": "semi-implicit Euler, velocity first",
    "velocity-verlet": "velocity Verlet",
    "rk4": "Runge-Kutta 4",
    "yoshida4": "Yoshida 4",
    "umbra": "semi-implicit Euler, velocity first",
    "umbra-repaired": "velocity Verlet",
    "umbra-service": "semi-implicit Euler, velocity first",
    "pymunk": "explicit Euler",
    "pymunk-velocity-func": "semi-implicit Euler, position first",
    "pymunk-spring": "semi-implicit Euler, position first",
    "box2d": "semi-implicit Euler, velocity first",
    "bullet": "semi-implicit Euler, velocity first",
    "physx": "semi-implicit Euler, velocity first",
    "mujoco-euler": "semi-implicit Euler, velocity first",
    "mujoco-rk4": "Runge-Kutta 4",
}
LAGGING = ("umbra", "umbra-service")


@pytest.mark.parametrize("method", installed(*KNOWN))
def test_every_method_is_named_by_its_trajectories(method: str) -> None:
    found = identify(method)
    assert found.integrator == KNOWN[method]
    assert ("half a kick earlier" in found.velocity) == (method in LAGGING)
    assert ("the same time" in found.velocity) == (method not in LAGGING)


TEN = [
    "elastic_pendulum",
    "figure_eight",
    "free_fall",
    "orbit_circular",
    "orbit_extreme",
    "spinning_box",
    "spring_chain",
    "spring_stiff",
    "thruster",
    "torsion_spring",
]


@pytest.mark.parametrize("method", installed("umbra", "rk4", "physx"))
@pytest.mark.parametrize("scenario", TEN)
def test_no_scenario_gives_a_wrong_answer(method: str, scenario: str) -> None:
    found = identify(method, [load_scenario(scenario)])
    assert found.matches, "what is right is among what cannot be told apart"
    if found.match is not None:
        assert found.integrator == KNOWN[method]


def test_no_match_is_an_answer() -> None:
    found = identify("umbra-primed")
    assert found.match is None
    assert found.integrator == "none of the known integrators"


def test_what_takes_no_steps_is_refused() -> None:
    with pytest.raises(UmbraBenchError, match="takes no steps"):
        identify("reference")


def test_a_damped_scenario_tells_nothing() -> None:
    with pytest.raises(UmbraBenchError, match="none of the scenarios: they are damped"):
        identify("umbra", [load_scenario("spring_damped")])


def test_engines_side_by_side() -> None:
    table = examine_engines(["umbra", "pymunk-velocity-func", "velocity-verlet"])
    assert dict(table.schema) == ENGINES_SCHEMA
    assert table["method"].to_list() == ["umbra", "pymunk-velocity-func"]
    assert table["energy_error_100"][0] > 1.5 * table["energy_error_100"][1]
    assert (table["energy_error_60"] > table["energy_error_100"]).all()


def test_without_an_engine_there_is_nothing_to_compare() -> None:
    assert examine_engines(["umbra", "rk4"]).is_empty()


# Without the engines ---------------------------------------------------------------------------------


@pytest.fixture
def none_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def find_spec(name: str) -> object:
        return None if name in {METHODS[m].package for m in OPTIONAL} else true_find_spec(name)

    true_find_spec = importlib.util.find_spec
    monkeypatch.setattr(methods.importlib.util, "find_spec", find_spec)


@pytest.mark.usefixtures("none_installed")
def test_an_absent_engine_is_a_line_that_says_how_to_install_it() -> None:
    assert not set(OPTIONAL) & set(methods_of_study())
    quick = load_scenario("spring").with_sweep(0.04, 2)
    skips = run_study([quick], [], ["float64"], quick=True).skips
    absent = skips.filter(skips["scenario"] == "all")
    assert set(absent["method"]) == set(OPTIONAL)
    assert all("make engines" in reason for reason in absent["reason"])


@pytest.mark.usefixtures("none_installed")
@pytest.mark.parametrize("method", OPTIONAL)
def test_an_absent_engine_that_is_asked_for_is_one_clear_line(method: str) -> None:
    with pytest.raises(UmbraBenchError, match=f"'{method}': the engine needs .* not installed"):
        simulate(page_spring(), method, 0.01, steps=1)
    with pytest.raises(UmbraBenchError, match="not installed"):
        run_study([page_spring()], [method])
