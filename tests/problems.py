"""Small mechanical problems as scenarios, and what the tests of laws do with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.scenario import Scenario, parse_scenario
from umbra_bench.state import State
from umbra_bench.system import System, build_system, initial_state

EPS = float(np.finfo(np.float64).eps)
EPS32 = float(np.finfo(np.float32).eps)

Table = dict[str, Any]


def problem(*bodies: Table, forces: list[Table] | None = None, **more: Any) -> Scenario:
    """A scenario of 5 s at 0.01 s; bodies are of 1 kg at the origin unless said."""
    defaults = {"mass": 1.0, "position": [0.0, 0.0]}
    document: Table = {
        "name": "problem",
        "title": "Problem",
        "family": "spring",
        "duration": 5.0,
        "dt": {"start": 0.01, "halvings": 0},
        "bodies": [{"name": f"body_{i}", **defaults, **body} for i, body in enumerate(bodies)],
        "forces": forces or [],
    }
    return parse_scenario(document | more, Path("problem.toml"))


def spring(position: tuple[float, float], velocity: tuple[float, float], **more: Any) -> Scenario:
    """2 kg on 8 N/m at the origin without rest length: omega = 2 rad/s."""
    weight = {"mass": 2.0, "position": list(position), "velocity": list(velocity)}
    pull = {"kind": "spring", "body": "body_0", "anchor": [0.0, 0.0], "stiffness": 8.0}
    return problem(weight, forces=[pull], **more)


def orbit(position: tuple[float, float], velocity: tuple[float, float], **more: Any) -> Scenario:
    """1 kg around the origin with mu = 1 m^3/s^2."""
    planet = {"position": list(position), "velocity": list(velocity)}
    pull = {"kind": "central_gravity", "body": "body_0", "mu": 1.0}
    return problem(planet, forces=[pull], **more)


def three_stars(**more: Any) -> Scenario:
    """The figure of eight, with unequal masses and a boost, so that no momentum is zero."""
    stars = [
        {"mass": 1.0, "position": [0.97, -0.243], "velocity": [0.57, 0.43]},
        {"mass": 1.3, "position": [-0.97, 0.243], "velocity": [0.47, 0.33]},
        {"mass": 0.8, "position": [0.1, 0.0], "velocity": [-0.83, -0.76]},
    ]
    pull = {
        "kind": "mutual_gravity",
        "bodies": ["body_0", "body_1", "body_2"],
        "gravitational_constant": 1.0,
    }
    return problem(*stars, forces=[pull], **more)


def in_numpy(scenario: Scenario, precision: str = "float64") -> tuple[System, State]:
    """The bodies and laws of a scenario and its initial state."""
    return build_system(scenario, precision), initial_state(scenario, precision)


def states(method: str, system: System, state: State, dt: float, steps: int) -> Iterator[Any]:
    """The states of a method after 0, 1, ... `steps` steps, computed with NumPy."""
    start, step = COMPILED_METHODS[method]
    dt = state.position.dtype.type(dt)
    moving = start(system, state)
    yield moving
    for _ in range(steps):
        moving = step(system, moving, dt)
        yield moving


def trace(method: str, scenario: Scenario, dt: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities after 0, 1, ... `steps` steps, shape (steps + 1, 3, N) each."""
    seen = list(states(method, *in_numpy(scenario), dt, steps))
    return np.stack([s.position for s in seen]), np.stack([s.velocity for s in seen])


def angles_apart(angle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The difference of two angles, whatever the turns between them, rad."""
    return np.remainder(angle - other + np.pi, 2 * np.pi) - np.pi
