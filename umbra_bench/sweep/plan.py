"""A sweep as its file states it, and the values of any of its runs by the run's number.

No list of runs is ever made: the numbers of a grid are read off the run's number digit by digit, and
a random draw is found at its place in a counter-based stream, so that a worker needs the file and two
numbers to know what to do, and a thousand million runs cost no memory.
"""

from __future__ import annotations

import functools
import hashlib
import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from umbra_bench.errors import ScenarioError, UmbraBenchError, short
from umbra_bench.methods import BROUGHT, PRECISIONS, find_method
from umbra_bench.scenario import Scenario, find_scenario, load_scenario, parse_scenario

STEP = "dt"
"""The key that varies the step size, s, in place of a number of the scenario."""

MOST_RUNS = 10**12
"""The most runs of a sweep."""

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=1, le=10**9)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Range(_Table):
    """Numbers from start to stop, both included."""

    start: _Finite
    stop: _Finite
    count: _Count
    spacing: Literal["linear", "log"] = "linear"

    @property
    def values(self) -> tuple[float, ...]:
        make = np.geomspace if self.spacing == "log" else np.linspace
        return tuple(float(value) for value in make(self.start, self.stop, self.count))


class Random(_Table):
    """Numbers drawn between low and high."""

    low: _Finite
    high: _Finite
    distribution: Literal["uniform", "log-uniform"] = "uniform"

    def at(self, u: float) -> float:
        """The number that belongs to u in [0, 1)."""
        if self.distribution == "log-uniform":
            return math.exp(math.log(self.low) + u * (math.log(self.high) - math.log(self.low)))
        return self.low + u * (self.high - self.low)


class Variation(_Table):
    """One number of the scenario and the values that it takes."""

    key: Annotated[str, Field(strict=True, min_length=1)]
    values: tuple[_Finite, ...] | None = Field(default=None, min_length=1)
    range: Range | None = None
    random: Random | None = None

    @functools.cached_property
    def grid(self) -> tuple[float, ...]:
        """The values of a list or a range."""
        return self.range.values if self.range is not None else self.values or ()


class _File(_Table):
    scenario: Annotated[str, Field(strict=True, min_length=1)]
    methods: tuple[str, ...] = Field(min_length=1)
    vary: tuple[Variation, ...] = Field(min_length=1)
    precisions: tuple[Literal["float32", "float64"], ...] = Field(
        default=("float64",), min_length=1
    )
    dt: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None
    steps: Annotated[int, Field(strict=True, ge=1, le=2**62)] | None = None
    draws: _Count = 1
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0


@dataclass(frozen=True)
class Task:
    """Runs `first` to `last`, exclusive, of one method and precision: one part of the results."""

    number: int
    method: str
    precision: str
    first: int
    last: int


TASK_STEPS = 2 * 10**7
"""Steps of bodies in a task: half a second, several hundred times what a scheduler needs for it."""

TASK_RUNS = 4096
"""The most runs in such a task: each costs a tenth of a millisecond before its first step."""

MOST_TASKS = 20_000
"""A sweep of more work than this many tasks has longer ones: a scheduler answers a thousand workers that
ask every half minute, not every half second, and a folder holds so many files gladly."""


@dataclass(frozen=True)
class Plan:
    """A sweep: everything that its results depend on, and nothing of where they are computed.

    Attributes:
        name: of the sweep: its file's stem.
        document: the scenario as a table of plain values, which each run changes.
        file: what the sweep file states.
    """

    name: str
    path: str
    document: dict[str, Any]
    file: _File

    @property
    def keys(self) -> tuple[str, ...]:
        """What varies, in the order of the file."""
        return tuple(variation.key for variation in self.file.vary)

    @property
    def points(self) -> int:
        """The runs of one method and precision."""
        grid = math.prod(len(variation.grid) or 1 for variation in self.file.vary)
        return grid * (self.file.draws if self.is_random else 1)

    @property
    def is_random(self) -> bool:
        return any(variation.random for variation in self.file.vary)

    @property
    def lines(self) -> list[tuple[str, str]]:
        """The methods, each with the precisions in which it runs; an engine has its own."""
        lines: dict[tuple[str, str], None] = {}
        for method in self.file.methods:
            for precision in self.file.precisions:
                lines[method, find_method(method).precision or precision] = None
        return list(lines)

    @property
    def runs(self) -> int:
        return self.points * len(self.lines)

    def values(self, point: int) -> tuple[float, ...]:
        """What each key is in run `point` of any method; the last key of the file varies fastest."""
        grid, draw = divmod(point, self.file.draws) if self.is_random else (point, 0)
        values = []
        for place, variation in reversed(list(enumerate(self.file.vary))):
            if variation.random is not None:
                values.append(variation.random.at(_uniform(self.file.seed, place, draw)))
            else:
                grid, digit = divmod(grid, len(variation.grid))
                values.append(variation.grid[digit])
        return tuple(reversed(values))

    def scenario(self, values: tuple[float, ...]) -> Scenario:
        """The scenario of a run.

        Raises:
            ScenarioError: it is none that can be simulated.
        """
        document = self.document
        for key, value in zip(self.keys, values, strict=True):
            if key != STEP:
                document = _replaced(document, _parts(key), value)
        return parse_scenario(document, self._file_name)

    @functools.cached_property
    def _file_name(self) -> Path:
        return Path(f"{self.document['name']}.toml")

    def step(self, values: tuple[float, ...], scenario: Scenario) -> tuple[float, int]:
        """The step of a run, s, and how many it takes: by default what fits in the duration."""
        given = dict(zip(self.keys, values, strict=True)).get(STEP, self.file.dt)
        dt = scenario.default_step if given is None else given
        return dt, self.file.steps or max(1, round(scenario.duration / dt))

    @functools.cached_property
    def tasks(self) -> list[Task]:
        """The parts of the work, which depend on the sweep alone and on no number of workers."""
        values = self.values(0)
        scenario = self.scenario(values)
        _, steps = self.step(values, scenario)
        size = max(1, min(self.points, TASK_RUNS, TASK_STEPS // (steps * len(scenario.bodies))))
        size = max(size, math.ceil(self.runs / MOST_TASKS))
        parts = [
            (*line, first, min(first + size, self.points))
            for line in self.lines
            for first in range(0, self.points, size)
        ]
        return [Task(number, *part) for number, part in enumerate(parts)]

    @property
    def fingerprint(self) -> str:
        """The SHA-256 of all that the rows depend on, versions apart."""
        stated = f"{self.document!r} {self.file.model_dump_json()}"
        return hashlib.sha256(stated.encode()).hexdigest()


def load_plan(path: Path) -> Plan:
    """Read and check a sweep file.

    Every value that a key can take is tried, one key at a time, before anything runs.

    Raises:
        UmbraBenchError: one line that names the file, the key and the value.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UmbraBenchError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UmbraBenchError(f"{path}: is not a text file in UTF-8, as TOML must be") from None
    except (ValueError, RecursionError) as error:
        raise UmbraBenchError(f"{path}: is not valid TOML: {error}") from None
    try:
        file = _File.model_validate(document)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in fault["loc"]).lstrip(".")
        raise UmbraBenchError(f"{path}: {key} = {short(fault['input'])}: {fault['msg']}") from None
    for complaint in _complaints(file):
        raise UmbraBenchError(f"{path}: {complaint}")
    plan = Plan(path.stem, str(path), _scenario_document(file.scenario, path), file)
    if plan.runs > MOST_RUNS:
        raise UmbraBenchError(f"{path}: {plan.runs} runs; at most {MOST_RUNS} are allowed")
    _try_values(plan, path)
    return plan


def _complaints(file: _File) -> Any:
    keys = [variation.key for variation in file.vary]
    for i, v in enumerate(file.vary):
        where = f"vary[{i}]"
        if sum(given is not None for given in (v.values, v.range, v.random)) != 1:
            yield f"{where}: needs one of values = [...], range = {{...}} and random = {{...}}"
        if keys.index(v.key) < i:
            yield f"{where}.key = {v.key!r}: varies already"
        if v.range and v.range.spacing == "log" and not min(v.range.start, v.range.stop) > 0.0:
            yield f"{where}.range: a log spacing needs start and stop > 0"
        if v.random and not v.random.low < v.random.high:
            yield f"{where}.random: low = {v.random.low!r} must be less than high = {v.random.high!r}"
        if v.random and v.random.distribution == "log-uniform" and not v.random.low > 0.0:
            yield f"{where}.random.low = {v.random.low!r}: log-uniform needs a number > 0"
    if file.draws > 1 and not any(v.random for v in file.vary):
        yield f"draws = {file.draws}: nothing is drawn; give a key random = {{ low = .., high = .. }}"
    for i, method in enumerate(file.methods):
        if method.startswith(BROUGHT):
            yield f"methods[{i}] = {method!r}: a file starts no program; allowed: installed methods"
            return
        try:
            found = find_method(method)
        except UmbraBenchError as error:
            yield f"methods[{i}]: {str(error).removeprefix('--method ')}"
            return
        if found.kind == "reference":
            yield f"methods[{i}] = {method!r}: it takes no steps; allowed: all other methods"
        elif not found.installed:
            yield f"methods[{i}] = {method!r}: {found.missing}"


def _scenario_document(name: str, path: Path) -> dict[str, Any]:
    """The scenario that a sweep names: beside the sweep's file, else in the project's scenarios."""
    beside = path.parent / name
    found = beside if name.endswith(".toml") and beside.is_file() else name
    document = load_scenario(find_scenario(found)).model_dump(mode="json", exclude_none=True)
    # A varied scenario need not have the closed form nor keep the budgets of its model.
    return {k: v for k, v in document.items() if k not in ("closed_form", "budget")}


def _try_values(plan: Plan, path: Path) -> None:
    base = list(plan.values(0))
    for place, variation in enumerate(plan.file.vary):
        ends = (variation.random.low, variation.random.high) if variation.random else variation.grid
        for value in ends:
            values = (*base[:place], value, *base[place + 1 :])
            where = f"{path}: vary[{place}]: {variation.key} = {value!r}"
            try:
                dt, _ = plan.step(values, plan.scenario(values))
            except KeyError as error:
                raise UmbraBenchError(f"{where}: {error.args[0]}") from None
            except ScenarioError as error:
                raise UmbraBenchError(f"{where}: {str(error).partition(': ')[2]}") from None
            if variation.key == STEP and not all(
                0.0 < np.dtype(p).type(dt) < math.inf for p in PRECISIONS
            ):
                raise UmbraBenchError(f"{where}: expected a step > 0 s that a float32 holds")


def _uniform(seed: int, place: int, draw: int) -> float:
    """Draw number `draw` of the key at `place`, in [0, 1), found without the draws before it."""
    block, rest = divmod(draw, 4)  # the generator makes four numbers at a time
    stream = np.random.Philox(key=[seed, place]).advance(block)
    return float(np.random.Generator(stream).random(rest + 1)[-1])


_PART = re.compile(r"\.?([A-Za-z_][A-Za-z_0-9]*)|\[(\d{1,9})\]|\.?\"([^\"]+)\"")


@functools.lru_cache(maxsize=64)
def _parts(key: str) -> tuple[str | int, ...]:
    """`bodies[0].velocity[1]` as ["bodies", 0, "velocity", 1]; a body's name may stand for its place."""
    parts: list[str | int] = []
    end = 0
    while end < len(key):
        match = _PART.match(key, end)
        if match is None:
            raise KeyError(
                "is not a key; expected one like bodies[0].mass, forces[0].stiffness or dt"
            )
        name, place, quoted = match.groups()
        parts.append(int(place) if place else name or quoted)
        end = match.end()
    return tuple(parts)


def _replaced(node: Any, parts: Sequence[str | int], value: float) -> Any:
    """A copy of a document in which one number has another value."""
    if not parts:
        if isinstance(node, bool) or not isinstance(node, int | float):
            raise KeyError(f"is {short(node)} in the scenario; only a number can vary")
        return int(value) if isinstance(node, int) and value.is_integer() else value
    part, *rest = parts
    if isinstance(node, list):
        if isinstance(part, str):
            places = [i for i, each in enumerate(node) if _name(each) == part]
            part = places[0] if places else len(node)
        if part < len(node):
            return [*node[:part], _replaced(node[part], rest, value), *node[part + 1 :]]
    elif isinstance(node, dict) and part in node:
        return {**node, part: _replaced(node[part], rest, value)}
    elif isinstance(node, dict) and not rest and isinstance(part, str):
        return {**node, part: value}  # a key that the scenario leaves at its default, or none
    raise KeyError("the scenario has no such number")


def _name(table: Any) -> Any:
    return table.get("name") if isinstance(table, dict) else None
