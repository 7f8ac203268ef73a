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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from umbra_bench.errors import ScenarioError, UmbraBenchError, hint, one_line, short
from umbra_bench.methods import BROUGHT, PRECISIONS, find_method
from umbra_bench.scenario import (
    Number,
    Scenario,
    find_scenario,
    is_file,
    load_scenario,
    parse_scenario,
    read_toml,
)

STEP = "dt"
"""The key that varies the step size, s, in place of a number of the scenario."""

MOST_RUNS = 10**12
"""The most runs of a sweep."""

MOST_VALUES = 10**6
"""The most values of one key: they are held in memory."""

MOST_KEYS = 64

MOST_STEPS = 10**15
"""The most steps of a run: a year of them, and no whole number overflows."""

MOST_TRIED = 10**5
"""So many bodies are read, at most, to try all values of a key before anything runs: some seconds."""

_Count = Annotated[int, Field(strict=True, ge=1, le=10**9)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Range(_Table):
    """Numbers from start to stop, both included."""

    start: Number
    stop: Number
    count: Annotated[int, Field(strict=True, ge=1, le=MOST_VALUES)]
    spacing: Literal["linear", "log"] = "linear"

    @property
    def values(self) -> tuple[float, ...]:
        make = np.geomspace if self.spacing == "log" else np.linspace
        return tuple(float(value) for value in make(self.start, self.stop, self.count))


class Random(_Table):
    """Numbers drawn between low and high."""

    low: Number
    high: Number
    distribution: Literal["uniform", "log-uniform"] = "uniform"

    def at(self, u: float) -> float:
        """The number that belongs to u in [0, 1)."""
        if self.distribution == "log-uniform":
            return math.exp(math.log(self.low) + u * (math.log(self.high) - math.log(self.low)))
        return self.low + u * (self.high - self.low)


class Variation(_Table):
    """One number of the scenario and the values that it takes."""

    key: Annotated[str, Field(strict=True, min_length=1, max_length=200)]
    values: tuple[Number, ...] | None = Field(default=None, min_length=1, max_length=MOST_VALUES)
    range: Range | None = None
    random: Random | None = None

    @functools.cached_property
    def grid(self) -> tuple[float, ...]:
        """The values of a list or a range."""
        return self.range.values if self.range is not None else self.values or ()


class _File(_Table):
    scenario: Annotated[str, Field(strict=True, min_length=1)]
    methods: tuple[str, ...] = Field(min_length=1, max_length=1000)
    vary: tuple[Variation, ...] = Field(min_length=1, max_length=MOST_KEYS)
    precisions: tuple[Literal["float32", "float64"], ...] = Field(
        default=("float64",), min_length=1
    )
    dt: Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)] | None = None
    steps: Annotated[int, Field(strict=True, ge=1, le=MOST_STEPS)] | None = None
    draws: _Count = 1
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0


_TABLES: dict[int | str, type[_Table]] = {"vary": Variation, "range": Range, "random": Random}


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
        """The step of a run, s, and how many it takes: by default what fits in the duration.

        Raises:
            ScenarioError: no precision can take such a step, or so many.
        """
        given = dict(zip(self.keys, values, strict=True)).get(STEP, self.file.dt)
        dt = scenario.default_step if given is None else given
        if not _is_held(dt):
            raise ScenarioError(
                f"{scenario.name}: dt = {dt!r}: expected a step > 0 s that a float32 holds"
            )
        if scenario.duration / dt > MOST_STEPS and self.file.steps is None:
            raise ScenarioError(
                f"{scenario.name}: dt = {dt!r}: {scenario.duration / dt:.3g} steps in the duration of "
                f"{scenario.duration!r} s; at most {MOST_STEPS} are allowed"
            )
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

    Every value that a key can take is tried, one key at a time, before anything runs; of very many
    the extremes.

    Raises:
        UmbraBenchError: one line that names the file, the key and the value.
    """
    try:
        file = _File.model_validate(read_toml(path))
        complaint = next(_complaints(file), None)
    except ValidationError as error:
        complaint = _explain(error)
    if complaint is None:
        plan = Plan(path.stem, str(path), _scenario_document(file.scenario, path), file)
        complaint = next(_complaints_of_values(plan), None)
    if complaint is not None:
        raise UmbraBenchError(one_line(f"{path}: {complaint}"))
    return plan


def _explain(error: ValidationError) -> str:
    """The first fault of a file in one line: key, value, what is allowed."""
    faults = error.errors(include_url=False)
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    loc = fault["loc"]
    parts = (f"[{p}]" if isinstance(p, int) else f".{short(p)[1:-1]}" for p in loc)
    key = "".join(parts).removeprefix(".") or "''"
    if fault["type"] == "extra_forbidden":
        table = next((_TABLES[p] for p in reversed(loc[:-1]) if p in _TABLES), _File)
        return f"{key}: unknown key{hint(loc[-1], table.model_fields, 'allowed keys')}"
    given = "" if fault["type"] == "missing" else f" = {short(fault['input'])}"
    return f"{key}{given}: {fault['msg']}"


def _complaints(file: _File) -> Iterator[str]:
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
    try:
        found = beside if name.endswith(".toml") and is_file(beside) else name
        scenario = load_scenario(find_scenario(found))
    except ScenarioError as error:
        raise UmbraBenchError(one_line(f"{path}: scenario = {short(name)}: {error}")) from None
    document = scenario.model_dump(mode="json", exclude_none=True)
    # A varied scenario need not have the closed form nor keep the budgets of its model.
    return {k: v for k, v in document.items() if k not in ("closed_form", "budget")}


def _complaints_of_values(plan: Plan) -> Iterator[str]:
    if plan.runs > MOST_RUNS:
        yield f"vary: {short(plan.runs)} runs; at most {MOST_RUNS} are allowed"
    base = list(plan.values(0))
    for place, variation in enumerate(plan.file.vary):
        grid = variation.grid
        if variation.random:
            grid = (variation.random.low, variation.random.high)
        elif len(grid) * len(plan.document["bodies"]) > MOST_TRIED:
            grid = (min(grid), max(grid))
        for value in grid:
            values = (*base[:place], value, *base[place + 1 :])
            where = f"vary[{place}]: {short(variation.key)[1:-1]} = {value!r}"
            try:
                scenario = plan.scenario(values)
                if variation.key == STEP or STEP not in plan.keys:  # no fault of the other keys
                    plan.step(values, scenario)
            except KeyError as error:
                yield f"{where}: {error.args[0]}"
            except ScenarioError as error:
                reason = str(error).partition(": ")[2]
                yield f"{where}: {reason.removeprefix(f'{STEP} = {value!r}: ')}"


@functools.lru_cache(maxsize=1024)
def _is_held(dt: float) -> bool:
    """Whether every precision can take such a step."""
    with np.errstate(over="ignore", under="ignore"):
        return all(0.0 < float(np.dtype(p).type(dt)) < math.inf for p in PRECISIONS)


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
