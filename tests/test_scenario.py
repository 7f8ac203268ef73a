"""Scenario files: what is right is read as it was written, what is wrong is said in one line."""

from __future__ import annotations

import copy
import math
import tomllib
import warnings
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from umbra_bench.closed_form import fitting_closed_forms
from umbra_bench.errors import ScenarioError, UmbraBenchError
from umbra_bench.scenario import (
    MINIMUM_SAMPLES,
    Scenario,
    list_scenarios,
    load_scenario,
    parse_scenario,
    scenario_hash,
)
from umbra_bench.system import body_definition, build_system, initial_state

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"

Document = dict[str, Any]
Key = tuple[str | int, ...]

EXAMPLE = """
name = "elastic_pendulum"            # equals the file's stem
title = "Elastic pendulum"
family = "spring"                    # spring | orbit | free_fall | rotation
description = "A mass on a spring that also swings: no closed form, so the reference alone judges."
duration = 10.0                      # s
gravity = [0.0, -9.81]               # m/s^2, default [0, 0]
linear_damping = 1.0                 # fraction of velocity kept per second, (0, 1], default 1 = none
angular_damping = 1.0

[dt]                                 # the sweep of the error-versus-dt report
start = 0.04                         # s
halvings = 7

[[bodies]]
name = "bob"
mass = 1.5                           # kg; 0 = static
shape = { kind = "box", width = 1.0, height = 0.5 }
inertia = 0.2                        # kg m^2; optional, computed from the shape when absent
position = [1.3, 0.2]
angle = 0.0                          # rad
velocity = [-0.4, 0.9]
angular_velocity = 0.0
affected_by_gravity = true
kind = "dynamic"                     # dynamic | static | kinematic
linear_damping = 0.5                 # optional: overrides the scenario's
angular_damping = 0.5

[[forces]]
kind = "spring"                      # from an anchor in the world, or from another body
body = "bob"
anchor = [0.1, -0.2]                 # or: other = "weight"
point = [0.0, 0.0]                   # where it holds the body, in body coordinates
stiffness = 30.0                     # N/m
rest_length = 1.0                    # m, default 0
damping = 0.0                        # N s/m, along the spring, default 0

[budget.umbra]                       # optional, per method
energy_error_max = 0.05
"""
"""The scenario file of the design page."""

RIG = """
name = "rig"
title = "Rig"
family = "orbit"
description = "Every table and every key of the format."
duration = 10.0
gravity = [0.25, -9.81]
linear_damping = 0.9
angular_damping = 0.8

[dt]
start = 0.04
halvings = 7

[[bodies]]
name = "bob"
mass = 1.5
shape = { kind = "box", width = 1.0, height = 0.5 }
inertia = 0.2
position = [1.3, 0.2]
angle = 0.1
velocity = [-0.4, 0.9]
angular_velocity = 0.3
affected_by_gravity = true
kind = "dynamic"
linear_damping = 0.5
angular_damping = 0.6

[[bodies]]
name = "weight"
mass = 2.5
shape = { kind = "circle", radius = 0.5 }
position = [-1.3, 0.4]

[[bodies]]
name = "post"
mass = 0.0
position = [5.0, 5.0]

[[forces]]
kind = "spring"
body = "bob"
anchor = [0.1, -0.2]
point = [0.15, 0.05]
stiffness = 30.0
rest_length = 1.25
damping = 0.35

[[forces]]
kind = "spring"
body = "bob"
other = "weight"
stiffness = 20.0

[[forces]]
kind = "torsion_spring"
body = "bob"
stiffness = 3.0
rest_angle = 0.45
damping = 0.55

[[forces]]
kind = "central_gravity"
body = "bob"
centre = [7.0, 7.5]
mu = 1.75

[[forces]]
kind = "mutual_gravity"
bodies = ["bob", "weight"]
gravitational_constant = 1.85

[[forces]]
kind = "constant_force"
body = "bob"
force = [0.65, 0.75]
point = [0.11, 0.12]
frame = "body"

[[forces]]
kind = "constant_torque"
body = "bob"
torque = 0.95

[[forces]]
kind = "drag"
body = "weight"
coefficient = 0.13

[budget.umbra]
energy_error_max = 0.05
energy_drift_rate = 0.06
position_error_max = 0.07
velocity_error_max = 0.08
angular_momentum_error_max = 0.09
"""

KEPLER = """
name = "rig"
title = "Orbit"
family = "orbit"
duration = 1.0
closed_form = "kepler"
dt = { start = 0.04, halvings = 2 }
bodies = [{ name = "planet", mass = 1.0, position = [1.0, 0.0], velocity = [0.0, 1.0] }]
forces = [{ kind = "central_gravity", body = "planet", mu = 1.0 }]
"""

TWISTED = """
name = "rig"
title = "Twisted"
family = "rotation"
duration = 1.0
closed_form = "normal_modes"
dt = { start = 0.04, halvings = 2 }
forces = [
    { kind = "torsion_spring", body = "rod", stiffness = 2.0 },
    { kind = "spring", body = "rod", anchor = [0.0, 0.0], stiffness = 2.0 },
]

[[bodies]]
name = "rod"
mass = 1.0
position = [1.0, 0.0]
angle = 0.5
shape = { kind = "circle", radius = 0.5 }
"""

FALLING = """
name = "rig"
title = "Falling"
family = "free_fall"
duration = 1.0
gravity = [0.0, -9.81]
closed_form = "free_motion"
dt = { start = 0.04, halvings = 2 }
bodies = [{ name = "stone", mass = 1.0, position = [1.0, 0.0] }]
"""


@pytest.fixture
def rig() -> Document:
    """A document that uses every table and every key; a test's own copy."""
    return tomllib.loads(RIG)


def only_fault(error: BaseException, file: object = "rig.toml") -> str:
    """The message of a ScenarioError without the file's name; one line that begins with it."""
    assert type(error) is ScenarioError
    message = str(error)
    assert message.splitlines() == [message]
    assert message.startswith(f"{file}: ")
    return message.removeprefix(f"{file}: ")


def refusal(document: Document) -> str:
    """What is said of a document that is wrong, without the file's name."""
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(document, Path("rig.toml"))
    return only_fault(caught.value)


def refusal_of_file(path: Path, content: str | bytes) -> str:
    """What is said of a file that is wrong, without the file's name."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    return only_fault(caught.value, path)


def at(document: Any, key: Key) -> Any:
    """The value at a key such as ("bodies", 0, "mass")."""
    for part in key:
        document = document[part]
    return document


def changed(document: Document, key: Key, value: Any) -> Document:
    """A copy with another value at a key; the key itself may be new."""
    document = copy.deepcopy(document)
    at(document, key[:-1])[key[-1]] = value
    return document


def without(document: Document, key: Key) -> Document:
    """A copy without a key."""
    document = copy.deepcopy(document)
    del at(document, key[:-1])[key[-1]]
    return document


def spelt(key: Key) -> str:
    """A key as messages spell it: bodies[0].mass."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def leaves(value: Any, key: Key = ()) -> Iterator[tuple[Key, Any]]:
    """Every value of a document that is neither a table nor a list, with its key."""
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else None
    )
    if items is None:
        yield key, value
        return
    for part, inner in items:
        yield from leaves(inner, (*key, part))


def keys_of(kind: type | tuple[type, ...]) -> list[Any]:
    """Parameters: the keys of RIG whose value is of one kind."""
    document = tomllib.loads(RIG)
    return [
        pytest.param(key, id=spelt(key))
        for key, value in leaves(document)
        if isinstance(value, kind) and not (isinstance(value, bool) and kind is not bool)
    ]


# What is right ------------------------------------------------------------------------------------


def test_the_example_of_the_design_page_loads(tmp_path: Path) -> None:
    path = tmp_path / "elastic_pendulum.toml"
    path.write_text(EXAMPLE, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.name == "elastic_pendulum"
    assert (scenario.duration, scenario.gravity) == (10.0, (0.0, -9.81))
    assert scenario.steps == tuple(0.04 / 2**k for k in range(8))
    assert scenario.default_step == 0.01
    (bob,) = scenario.bodies
    assert (bob.mass, bob.position, bob.velocity) == (1.5, (1.3, 0.2), (-0.4, 0.9))
    (spring,) = scenario.forces
    assert (spring.kind, spring.anchor, spring.rest_length) == ("spring", (0.1, -0.2), 1.0)
    assert scenario.budget["umbra"].energy_error_max == 0.05


def test_every_key_of_the_format_is_read(rig: Document) -> None:
    scenario = parse_scenario(rig, Path("rig.toml"))
    stated = scenario.model_dump(mode="json")
    for key, value in leaves(rig):
        assert at(stated, key) == value, spelt(key)
    assert [force.kind for force in scenario.forces] == [f["kind"] for f in rig["forces"]]


def test_defaults() -> None:
    document = {
        "name": "rig",
        "title": "Rig",
        "family": "spring",
        "duration": 1,  # a whole number is a number
        "dt": {"start": 0.5, "halvings": 0},
        "bodies": [{"name": "bob", "mass": 1, "position": [1, 2]}],
    }
    scenario = parse_scenario(document, Path("rig.toml"))
    (bob,) = scenario.bodies
    assert (scenario.gravity, scenario.linear_damping, scenario.angular_damping) == ((0, 0), 1, 1)
    assert (scenario.closed_form, scenario.forces, scenario.budget) == (None, (), {})
    assert (bob.velocity, bob.angle, bob.angular_velocity) == ((0, 0), 0, 0)
    assert (bob.affected_by_gravity, bob.kind, bob.shape, bob.inertia) == (
        True,
        "dynamic",
        None,
        None,
    )


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_of_the_project_loads(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    assert scenario.title
    assert scenario.description
    assert scenario.closed_form is None or scenario.closed_form in fitting_closed_forms(scenario)


def test_a_scenario_is_found_by_name_and_by_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    by_name = load_scenario("rig", tmp_path)
    by_path = load_scenario(tmp_path / "rig.toml")
    assert by_name == by_path
    monkeypatch.chdir(tmp_path)  # no scenarios/ here: the project's are found
    assert load_scenario("rig.toml") == by_path
    assert load_scenario("./rig.toml") == by_path
    assert load_scenario("spring").name == "spring"
    assert list_scenarios() == sorted(p.stem for p in SCENARIOS.glob("*.toml"))
    (tmp_path / "scenarios").mkdir()  # a user's own folder goes first
    (tmp_path / "scenarios" / "rig.toml").write_text(RIG, encoding="utf-8")
    assert list_scenarios() == ["rig"]
    assert load_scenario("rig") == by_path


def test_a_file_needs_no_ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rig").write_text(RIG, encoding="utf-8")
    assert load_scenario(tmp_path / "rig").name == "rig"
    monkeypatch.chdir(tmp_path)
    assert load_scenario("rig").name == "rig"


@given(
    coarse=st.integers(1, 3000),
    start=st.sampled_from([0.1, 0.04, 1 / 60, 0.01, 1e-3, 7.0]),
    halvings=st.integers(0, 10),
)
def test_the_grid_of_a_sweep(coarse: int, start: float, halvings: int) -> None:
    document = tomllib.loads(EXAMPLE) | {
        "duration": coarse * start,
        "dt": {"start": start, "halvings": halvings},
    }
    scenario = parse_scenario(document, Path("elastic_pendulum.toml"))
    assert scenario.coarse_steps == coarse
    assert len(scenario.steps) == halvings + 1
    assert scenario.steps[0] == start
    for longer, shorter in zip(scenario.steps, scenario.steps[1:], strict=False):
        assert shorter == longer / 2
    assert scenario.samples >= MINIMUM_SAMPLES == 256
    assert scenario.samples % coarse == 0
    ratio = scenario.samples // coarse
    assert ratio & (ratio - 1) == 0, "the samples are the coarsest grid, halved"
    assert ratio == 1 or scenario.samples < 2 * MINIMUM_SAMPLES, "and no finer than it takes"
    distance = {dt: abs(math.log(dt / 0.01)) for dt in scenario.steps}
    assert distance[scenario.default_step] == min(distance.values())


@pytest.mark.parametrize(
    ("start", "halvings", "expected"),
    [(0.04, 7, 0.01), (0.04, 1, 0.02), (0.1, 4, 0.0125), (0.005, 3, 0.005), (1 / 60, 3, 1 / 120)],
)
def test_the_default_step_is_the_nearest_to_that_of_umbra(
    start: float, halvings: int, expected: float
) -> None:
    sweep = {"start": start, "halvings": halvings}
    document = tomllib.loads(FALLING) | {"duration": 600 * start, "dt": sweep}
    scenario = parse_scenario(document, Path("rig.toml"))
    assert scenario.default_step == expected


@pytest.mark.parametrize(
    ("given_values", "expected"),
    [
        ({}, 3.0),
        ({"shape": {"kind": "circle", "radius": 0.5}}, 3.0 * 0.5**2 / 2),
        ({"shape": {"kind": "box", "width": 2.0, "height": 0.5}}, 3.0 * (2.0**2 + 0.5**2) / 12),
        ({"inertia": 0.7}, 0.7),
        ({"inertia": 0.7, "shape": {"kind": "circle", "radius": 0.5}}, 0.7),
        ({"inertia": 0.0, "shape": {"kind": "circle", "radius": 0.5}}, 0.0),
    ],
    ids=["nothing", "circle", "box", "given", "given-and-shape", "zero-and-shape"],
)
def test_inertia_is_as_given_else_of_the_shape_else_of_the_mass(
    given_values: Document, expected: float
) -> None:
    document = tomllib.loads(FALLING)
    document["bodies"][0] |= {"mass": 3.0, **given_values}
    scenario = parse_scenario(document, Path("rig.toml"))
    definition = body_definition(scenario.bodies[0], scenario)
    assert definition.moment_of_inertia == pytest.approx(expected, rel=1e-15)
    inverse = build_system(scenario).bodies.inverse_mass[2, 0]
    assert inverse == pytest.approx(1 / expected if expected else 0.0, rel=1e-15)


def test_the_damping_of_a_body_overrides_that_of_the_scenario(rig: Document) -> None:
    scenario = parse_scenario(rig, Path("rig.toml"))
    bob, weight, _ = (body_definition(body, scenario) for body in scenario.bodies)
    assert (bob.linear_damping, bob.angular_damping) == (0.5, 0.6)
    assert (weight.linear_damping, weight.angular_damping) == (0.9, 0.8)


def test_the_hash_is_of_what_is_stated_not_of_the_layout(tmp_path: Path, rig: Document) -> None:
    first = parse_scenario(rig, Path("rig.toml"))
    shuffled = dict(reversed(rig.items()))
    assert scenario_hash(parse_scenario(shuffled, Path("rig.toml"))) == scenario_hash(first)
    other = changed(rig, ("bodies", 0, "mass"), 1.6)
    assert scenario_hash(parse_scenario(other, Path("rig.toml"))) != scenario_hash(first)


# What is wrong with a key -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "wrong", "meant"),
    [
        ((), "durration", "duration"),
        ((), "linear_dampening", "linear_damping"),
        (("bodies", 0), "possition", "position"),
        (("bodies", 1), "affected_by_gravty", "affected_by_gravity"),
        (("bodies", 0, "shape"), "widht", "width"),
        (("bodies", 1, "shape"), "radus", "radius"),
        (("dt",), "halving", "halvings"),
        (("budget", "umbra"), "energy_eror_max", "energy_error_max"),
        (("forces", 0), "stifness", "stiffness"),
        (("forces", 2), "rest_angel", "rest_angle"),
        (("forces", 3), "center", "centre"),
        (("forces", 4), "gravitation_constant", "gravitational_constant"),
        (("forces", 5), "frames", "frame"),
        (("forces", 6), "torqe", "torque"),
        (("forces", 7), "coeficient", "coefficient"),
    ],
    ids=lambda value: spelt(value) or "top" if isinstance(value, tuple) else None,
)
def test_an_unknown_key_is_named_with_the_nearest_known_one(
    rig: Document, table: Key, wrong: str, meant: str
) -> None:
    message = refusal(changed(rig, (*table, wrong), 1.0))
    assert message.startswith(f"{spelt((*table, wrong))}: unknown key; did you mean {meant!r}?")
    assert meant in message.partition("llowed keys:")[2]


def test_an_unknown_key_like_no_other_is_named_with_all_known_ones(rig: Document) -> None:
    message = refusal(changed(rig, ("dt", "zzz"), 1.0))
    assert message == "dt.zzz: unknown key; allowed keys: start, halvings"


REQUIRED: list[Key] = [
    *[(key,) for key in ("name", "title", "family", "duration", "dt", "bodies")],
    *[("dt", key) for key in ("start", "halvings")],
    *[("bodies", 1, key) for key in ("name", "mass", "position")],
    *[("bodies", 0, "shape", key) for key in ("width", "height")],
    ("bodies", 1, "shape", "radius"),
    *[("forces", 0, key) for key in ("body", "stiffness")],
    *[("forces", 2, key) for key in ("body", "stiffness")],
    *[("forces", 3, key) for key in ("body", "mu")],
    *[("forces", 4, key) for key in ("bodies", "gravitational_constant")],
    *[("forces", 5, key) for key in ("body", "force")],
    *[("forces", 6, key) for key in ("body", "torque")],
    *[("forces", 7, key) for key in ("body", "coefficient")],
]


@pytest.mark.parametrize("key", REQUIRED, ids=spelt)
def test_a_missing_key_is_named_with_what_it_holds(rig: Document, key: Key) -> None:
    message = refusal(without(rig, key))
    assert message.startswith(f"{spelt(key)}: missing; expected ")
    assert message.partition("expected ")[2]


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        (("duration",), "durration"),
        (("bodies", 0, "mass"), "mas"),
        (("forces", 0, "stiffness"), "stifness"),
        (("dt", "halvings"), "halving"),
    ],
    ids=lambda value: spelt(value) if isinstance(value, tuple) else None,
)
def test_a_key_that_is_needed_and_misspelt_is_not_just_missing(
    rig: Document, key: Key, wrong: str
) -> None:
    misspelt = changed(without(rig, key), (*key[:-1], wrong), at(rig, key))
    message = refusal(misspelt)
    assert message.startswith(
        f"{spelt((*key[:-1], wrong))}: unknown key; did you mean {key[-1]!r}?"
    )


@pytest.mark.parametrize("key", [("forces", 0), ("bodies", 0, "shape")], ids=spelt)
@pytest.mark.parametrize("given_kind", [None, "sprong", 3, ["spring"], False], ids=repr)
def test_a_kind_that_is_missing_or_unknown_is_named_with_all_kinds(
    rig: Document, key: Key, given_kind: Any
) -> None:
    if given_kind is None:
        message = refusal(without(rig, (*key, "kind")))
        assert message.startswith(f"{spelt(key)}.kind: missing; allowed: ")
    else:
        message = refusal(changed(rig, (*key, "kind"), given_kind))
        assert message.startswith(f"{spelt(key)}.kind = {given_kind!r}; ")
    kinds = ["box", "circle"] if "shape" in key else ["spring", "torsion_spring", "drag"]
    assert all(kind in message for kind in kinds)
    if given_kind == "sprong" and "forces" in key:
        assert "did you mean 'spring'?" in message


@pytest.mark.parametrize("key", keys_of((int, float)))
def test_every_number_is_a_finite_number_and_nothing_else(rig: Document, key: Key) -> None:
    numbers = (math.nan, math.inf, -math.inf, 1e200, -1e200)
    for value in (*numbers, True, "1.0", [1.0], {"value": 1.0}):
        message = refusal(changed(rig, key, value))
        assert message.startswith(f"{spelt(key)} = {value!r}: not allowed; expected ")


@pytest.mark.parametrize("key", keys_of(str))
def test_every_text_is_a_text_and_nothing_else(rig: Document, key: Key) -> None:
    for value in (3, 1.5, True, ["bob"], {}, date(2024, 5, 17)):
        message = refusal(changed(rig, key, value))
        assert message.startswith(f"{spelt(key)} = {value!r}")


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        (("duration",), 0.0, "> 0"),
        (("duration",), -1.0, "> 0"),
        (("duration",), 10**400, "a finite number > 0"),
        (("gravity",), [0.0, 0.0, -9.81], "two finite numbers"),
        (("gravity",), 9.81, "two finite numbers"),
        (("gravity",), "down", "two finite numbers"),
        (("linear_damping",), 0.0, "(0, 1]"),
        (("linear_damping",), 1.5, "(0, 1]"),
        (("angular_damping",), -0.5, "(0, 1]"),
        (("family",), "fluid", '"spring", "orbit", "free_fall" or "rotation"'),
        (("name",), "", "stem"),
        (("title",), "", "not empty"),
        (("dt",), 0.04, "start and halvings"),
        (("dt", "start"), 0.0, "> 0"),
        (("dt", "start"), -0.04, "> 0"),
        (("dt", "halvings"), -1, "a whole number from 0 to 24"),
        (("dt", "halvings"), 25, "a whole number from 0 to 24"),
        (("dt", "halvings"), 7.0, "a whole number from 0 to 24"),
        (("dt", "halvings"), 10**400, "a whole number from 0 to 24"),
        (("bodies",), [], "one table [[bodies]] or more"),
        (("bodies",), {"name": "bob"}, "one table [[bodies]] or more"),
        (("bodies",), "bob", "one table [[bodies]] or more"),
        (("bodies", 0), 3, "one table [[bodies]] or more"),
        (("bodies", 0, "name"), "", "not empty"),
        (("bodies", 0, "mass"), -1.5, ">= 0"),
        (("bodies", 0, "inertia"), -0.2, ">= 0"),
        (("bodies", 0, "kind"), "flying", '"dynamic", "static" or "kinematic"'),
        (("bodies", 0, "affected_by_gravity"), 1, "true or false"),
        (("bodies", 0, "affected_by_gravity"), "yes", "true or false"),
        (("bodies", 0, "linear_damping"), 0.0, "(0, 1]"),
        (("bodies", 0, "shape"), "box", "kind = "),
        (("bodies", 0, "shape", "width"), 0.0, "> 0"),
        (("bodies", 0, "shape", "height"), -0.5, "> 0"),
        (("bodies", 1, "shape", "radius"), 0.0, "> 0"),
        (("forces",), {"kind": "spring"}, "tables [[forces]]"),
        (("forces", 0), 3, "tables [[forces]]"),
        (("forces", 0, "stiffness"), -30.0, ">= 0"),
        (("forces", 0, "rest_length"), -1.0, ">= 0"),
        (("forces", 0, "damping"), -0.1, ">= 0"),
        (("forces", 0, "anchor"), [0.0, 0.0, 0.0], "two finite numbers"),
        (("forces", 3, "mu"), 0.0, "> 0"),
        (("forces", 4, "gravitational_constant"), -1.0, "> 0"),
        (("forces", 4, "bodies"), ["bob"], "two or more bodies"),
        (("forces", 5, "frame"), "moon", '"world" or "body"'),
        (("forces", 7, "coefficient"), -0.1, ">= 0"),
        (("budget",), 3, "[budget.METHOD]"),
        (("budget", "umbra"), 0.05, "[budget.METHOD]"),
        (("budget", "umbra", "energy_error_max"), 0.0, "> 0"),
        (("budget", "umbra", "position_error_max"), -1.0, "> 0"),
    ],
    ids=lambda value: spelt(value) if isinstance(value, tuple) else None,
)
def test_a_value_that_is_not_allowed_is_named_with_what_is(
    rig: Document, key: Key, value: Any, allowed: str
) -> None:
    message = refusal(changed(rig, key, value))
    start = f"{spelt(key)} = {repr(value)[:57]}"
    assert message.startswith(start)
    stated, _, expected = message.partition("not allowed; expected ")
    assert len(stated) < 120, "a long value is cut short"
    assert allowed in expected


def test_a_vector_of_one_number_lacks_the_other(rig: Document) -> None:
    message = refusal(changed(rig, ("gravity",), [0.0]))
    assert message.startswith("gravity[1]: missing; expected two finite numbers")


# What is wrong between keys -----------------------------------------------------------------------


def test_the_name_is_the_stem_of_the_file(rig: Document) -> None:
    message = refusal(rig | {"name": "rag"})
    assert message == "name = 'rag': must equal the file's stem, 'rig'"


def test_two_bodies_have_two_names(rig: Document) -> None:
    message = refusal(changed(rig, ("bodies", 2, "name"), "bob"))
    assert message.startswith("bodies[2].name = 'bob': ")
    assert "another body" in message


@pytest.mark.parametrize("force", [0, 2, 3, 5, 6, 7])
def test_a_force_acts_on_a_body_that_there_is(rig: Document, force: int) -> None:
    message = refusal(changed(rig, ("forces", force, "body"), "bobb"))
    assert message == (
        f"forces[{force}].body: there is no body 'bobb'; "
        "did you mean 'bob'? Allowed: bob, weight, post"
    )


def test_a_force_names_other_bodies_that_there_are(rig: Document) -> None:
    message = refusal(changed(rig, ("forces", 1, "other"), "wait"))
    assert message.startswith("forces[1].other: there is no body 'wait'")
    message = refusal(changed(rig, ("forces", 4, "bodies", 1), "moon"))
    assert message.startswith("forces[4].bodies: there is no body 'moon'")
    assert message.endswith("bob, weight, post")


def test_a_spring_has_one_other_end(rig: Document) -> None:
    both = refusal(changed(rig, ("forces", 0, "other"), "weight"))
    neither = refusal(without(rig, ("forces", 0, "anchor")))
    assert both == neither
    assert both.startswith("forces[0]: ")
    assert "anchor" in both
    assert "other" in both
    itself = refusal(changed(rig, ("forces", 1, "other"), "bob"))
    assert itself.startswith("forces[1].other = 'bob': must be another body")


def test_no_body_stands_in_the_centre_of_gravity(rig: Document) -> None:
    message = refusal(changed(rig, ("forces", 3, "centre"), [1.3, 0.2]))
    assert message.startswith("forces[3].centre = [1.3, 0.2]: body 'bob' stands in it")
    assert "expected another place" in message


def test_two_bodies_stand_in_two_places_under_mutual_gravity(rig: Document) -> None:
    together = changed(rig, ("bodies", 1, "position"), [1.3, 0.2])
    message = refusal(together)
    assert message.startswith("bodies[1].position = [1.3, 0.2]: ")
    assert "'bob'" in message
    assert "'weight'" in message
    assert "expected two places" in message
    apart = without(together, ("forces", 4))  # without the attraction they may
    parse_scenario(apart, Path("rig.toml"))


def test_mutual_gravity_names_a_body_once(rig: Document) -> None:
    message = refusal(changed(rig, ("forces", 4, "bodies"), ["bob", "weight", "bob"]))
    assert message.startswith("forces[4].bodies = ['bob', 'weight', 'bob']: ")


@pytest.mark.parametrize(
    ("key", "value"), [("velocity", [0.0, 1.0]), ("angular_velocity", -2.0)], ids=["linear", "turn"]
)
def test_a_static_body_has_no_velocity(rig: Document, key: str, value: Any) -> None:
    for static in ({"mass": 0.0}, {"mass": 1.0, "kind": "static"}):
        body = rig["bodies"][2] | static | {key: value}
        message = refusal(changed(rig, ("bodies", 2), body))
        assert message.startswith(f"bodies[2].{key} = {value}: a static body does not move; ")
    moving = rig["bodies"][2] | {"kind": "kinematic", key: value}
    parse_scenario(changed(rig, ("bodies", 2), moving), Path("rig.toml"))


@pytest.mark.parametrize("duration", [0.05, 0.06, 9.99, 10.01])
def test_the_steps_of_a_sweep_divide_its_duration(rig: Document, duration: float) -> None:
    message = refusal(rig | {"duration": duration})
    assert message.startswith(f"duration = {duration}: not a whole number of steps")
    assert "dt.start = 0.04" in message


def test_the_longest_step_is_no_longer_than_the_duration(rig: Document) -> None:
    message = refusal(changed(rig, ("dt", "start"), 20.0))
    assert message == "dt.start = 20.0: longer than the duration of 10.0 s"
    once = rig | {"dt": {"start": 10.0, "halvings": 3}}
    assert parse_scenario(once, Path("rig.toml")).coarse_steps == 1


def test_a_sweep_that_would_never_end_is_refused(rig: Document) -> None:
    message = refusal(changed(rig, ("dt", "start"), 1e-9))
    assert message.startswith("dt.start = 1e-09: too short")
    message = refusal(changed(rig, ("dt", "start"), 5e-324))
    assert message.startswith("dt.start = 5e-324: not allowed; expected a finite number > 0")
    message = refusal(rig | {"dt": {"start": 0.001, "halvings": 24}})
    assert message.startswith("dt.halvings = 24: ")


def test_a_budget_is_of_a_method(rig: Document) -> None:
    rig["budget"]["umbre"] = {"energy_error_max": 0.05}
    message = refusal(rig)
    assert message.startswith("budget.umbre: not a method; did you mean 'umbra'?")


def test_a_closed_form_is_one_that_there_is_and_that_fits() -> None:
    orbit = tomllib.loads(KEPLER)
    message = refusal(orbit | {"closed_form": "keppler"})
    assert message.startswith("closed_form = 'keppler': not known; did you mean 'kepler'?")
    message = refusal(orbit | {"closed_form": "free_motion"})
    assert message == (
        "closed_form = 'free_motion': does not solve this scenario; allowed here: kepler"
    )
    pushed = changed(orbit, ("gravity",), [0.0, 0.1])
    message = refusal(pushed)
    assert message.startswith("closed_form = 'kepler': does not solve this scenario")
    assert message.endswith("none, so leave the key out")


# What is wrong with a file ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("written", "wrong", "stated"),
    [
        ("duration = 10.0", "duration = nan", "duration = nan: "),
        ("mass = 1.5", "mass = -1.5", "bodies[0].mass = -1.5: "),
        ("angle = 0.1", "angle = inf", "bodies[0].angle = inf: "),
        ("position = [1.3, 0.2]", "position = [-inf, 0.2]", "bodies[0].position[0] = -inf: "),
        ("mu = 1.75", "mu = +nan", "forces[3].mu = nan: "),
        ("mass = 1.5", 'mass = "1.5"', "bodies[0].mass = '1.5': "),
        ("halvings = 7", "halvings = 0x7_000", "dt.halvings = 28672: "),
        ("duration = 10.0", "duration = 2024-05-17", "duration = datetime.date(2024, 5, 17): "),
        ('title = "Rig"', 'title = """\n"""', "title = ''"),
        ('kind = "drag"', 'kind = "dr\\nag"', "forces[7].kind = 'dr\\nag'; "),
    ],
)
def test_what_toml_allows_and_a_scenario_does_not(
    tmp_path: Path, written: str, wrong: str, stated: str
) -> None:
    assert RIG.count(written) == 1
    message = refusal_of_file(tmp_path / "rig.toml", RIG.replace(written, wrong))
    assert message.startswith(stated)


@pytest.mark.parametrize(
    "content",
    [
        "name = ",
        "name: rig\ntitle: Rig\n",
        "{}",
        RIG + "\n[dt]\nstart = 0.04\n",
        RIG.replace("[dt]", "[dt"),
        '\ufeff"',
        "\0",
        "a = " + "[" * 100_000,
        "a = " + "{ a = " * 100_000,
        "a = 1" + "0" * 10_000,
        "a = 99-99-99",
    ],
    ids=lambda content: repr(content[:12]),
)
def test_a_file_that_is_not_toml(tmp_path: Path, content: str) -> None:
    assert refusal_of_file(tmp_path / "rig.toml", content).startswith("is not valid TOML: ")


@pytest.mark.parametrize(
    "content",
    [RIG.encode("utf-16"), b"\xff\xfe\x00", b'name = "\xe9"'],
    ids=["utf-16", "bytes", "latin-1"],
)
def test_a_file_that_is_not_utf_8(tmp_path: Path, content: bytes) -> None:
    message = refusal_of_file(tmp_path / "rig.toml", content)
    assert "UTF-8" in message


@pytest.mark.parametrize("content", ["", "# nothing but a comment\n"], ids=["empty", "comment"])
def test_an_empty_file(tmp_path: Path, content: str) -> None:
    message = refusal_of_file(tmp_path / "rig.toml", content)
    assert message == "name: missing; expected the stem of the file's name"


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "file.toml").write_text(RIG, encoding="utf-8")
    for path in (
        "none.toml",
        "folder.toml",
        "none/rig.toml",
        "file.toml/rig.toml",
        "folder.toml/.",
    ):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(tmp_path / path)
        only_fault(caught.value, tmp_path / path)


@pytest.mark.parametrize("name", ["sprung", "", ".", "..", "/", "a\nb", "a\0b", "*"])
def test_a_name_that_is_no_scenario(name: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name)
    message = str(caught.value)
    assert message.splitlines() == [message]
    assert repr(name) in message
    if name == "sprung":
        assert "did you mean 'spring'?" in message
        assert "elastic_pendulum, " in message


@pytest.mark.parametrize("name", ["a" * 300, "a" * 300 + ".toml", "folder/" + "a" * 300])
def test_a_name_longer_than_the_system_allows(name: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name)
    assert name[:50] in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        RIG.replace("duration = 10.0", "duration = 0x" + "f" * 5000),
        RIG.replace("halvings = 7", "halvings = 0x" + "f" * 5000),
        RIG.replace("[dt]", ".".join(["gravity_"] * 3000) + " = 1\n[dt]", 1),
        RIG.replace("gravity = [0.25, -9.81]", ".".join(["gravity"] * 3000) + " = 1"),
        RIG.replace("[0.25, -9.81]", "[" * 150 + "]" * 150),
    ],
    ids=["huge-number", "huge-whole-number", "deep-unknown", "deep-known", "deep-list"],
)
def test_a_value_too_large_to_print(tmp_path: Path, content: str) -> None:
    message = refusal_of_file(tmp_path / "rig.toml", content)
    assert len(message) < 500


@pytest.mark.parametrize("place", ["top", "body", "budget"])
def test_a_key_with_a_line_break_makes_no_second_line(rig: Document, place: str) -> None:
    table: Key = {"top": (), "body": ("bodies", 0), "budget": ("budget",)}[place]
    value = {"energy_error_max": 0.1} if place == "budget" else 1.0
    message = refusal(changed(rig, (*table, "one\ntwo"), value))
    assert "one" in message


EXTREMES: dict[str, tuple[str, dict[Key, Any]]] = {
    "angle": (TWISTED, {("bodies", 0, "angle"): 1e200}),
    "spin": (TWISTED, {("bodies", 0, "angular_velocity"): -1e200}),
    "radius": (TWISTED, {("bodies", 0, "shape", "radius"): 1e200}),
    "radius-without-closed-form": (TWISTED, {("bodies", 0, "shape", "radius"): 1e200}),
    "box": (RIG, {("bodies", 0, "shape", "width"): 1e200, ("bodies", 0, "inertia"): 0.1}),
    "box-without-inertia": (RIG, {("bodies", 0, "shape", "width"): 1e200}),
    "orbit": (KEPLER, {("bodies", 0, "velocity"): [1e200, 1.0]}),
    "far-orbit": (KEPLER, {("bodies", 0, "position"): [1e200, 1.0]}),
    "mass": (FALLING, {("bodies", 0, "mass"): 1e308}),
    "brief": (FALLING, {("duration",): 5e-324, ("dt", "start"): 5e-324}),
    "long": (FALLING, {("duration",): 1e308, ("dt", "start"): 1e308}),
}


@pytest.mark.parametrize("case", EXTREMES)
def test_numbers_at_the_edge_of_what_a_computer_holds(case: str) -> None:
    """They are refused in one line, or every derived number is finite: never a traceback."""
    text, values = EXTREMES[case]
    document = tomllib.loads(text)
    if case.endswith("without-inertia"):
        del document["bodies"][0]["inertia"]
    if case.endswith("without-closed-form"):
        del document["closed_form"]
    for key, value in values.items():
        document = changed(document, key, value)
    try:
        scenario = parse_scenario(document, Path("rig.toml"))
    except ScenarioError as error:
        only_fault(error)
        return
    assert scenario.default_step in scenario.steps
    assert min(scenario.steps) > 0.0
    system, start = build_system(scenario), initial_state(scenario)
    for constants in (system.bodies.mass, system.bodies.inverse_mass, *start):
        assert np.isfinite(constants).all()


# Anything else ------------------------------------------------------------------------------------

JUNK: list[Any] = [
    *(math.nan, math.inf, -math.inf, 0, 0.0, -0.0, 1, -1, 2.5, 1e-9, 1e200, -1e308, 5e-324),
    *(10**400, -(10**30), True, False, "", "x", "bob", "spring", "normal_modes", "a\nb", "\0"),
    *([], [1.0], [0.0, 0.0], [1.0, 2.0, 3.0], [[[[]]]], {}, {"kind": "spring"}, {"": {}}),
    date(2024, 5, 17),
]


def nodes(value: Any, key: Key = ()) -> Iterator[Key]:
    """The keys of everything in a document, tables and lists included."""
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for part, inner in items:
        yield (*key, part)
        yield from nodes(inner, (*key, part))


@st.composite
def mutated(draw: Callable[[st.SearchStrategy[Any]], Any]) -> Document:
    """A valid document with a few keys removed, replaced by junk or added."""
    document = tomllib.loads(draw(st.sampled_from([RIG, KEPLER, TWISTED, FALLING])))
    for _ in range(draw(st.integers(1, 3))):
        places = list(nodes(document))
        if not places:
            break
        *above, key = draw(st.sampled_from(places))
        parent = at(document, tuple(above))
        junk = copy.deepcopy(draw(st.sampled_from(JUNK)))
        match draw(st.sampled_from(["replace", "delete", "add"])):
            case "delete":
                del parent[key]
            case "add" if isinstance(parent, dict):
                parent[draw(st.sampled_from(["mass", "kind", "x", "a\nb", "body", "dt"]))] = junk
            case _:
                parent[key] = junk
    return document


@settings(max_examples=200)
@given(document=mutated())
def test_any_document_is_a_scenario_or_wrong_in_one_line(document: Document) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning on a terminal is a second line
        try:
            scenario = parse_scenario(document, Path("rig.toml"))
        except UmbraBenchError as error:
            only_fault(error)
            return
    assert isinstance(scenario, Scenario)
    assert scenario.default_step in scenario.steps
    assert scenario.samples % scenario.coarse_steps == 0


@settings(max_examples=60)
@given(content=st.text(max_size=200) | st.binary(max_size=200))
def test_any_file_is_wrong_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, content: str | bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "rig.toml"
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    assert refusal_of_file(path, content)
