"""What is simulated: a mechanical problem, read from TOML and checked.

The models below are the file format; the description of a field is what an error message quotes as
the allowed value. :func:`load_scenario` is the only door.
"""

from __future__ import annotations

import functools
import hashlib
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, ValidationError

from umbra_bench.errors import ScenarioError, hint, one_line, short
from umbra_bench.methods import METHODS

DEFAULT_STEP = 0.01
"""UMBRA's default step, s: where budgets are enforced and time series are drawn."""

MINIMUM_SAMPLES = 256
"""The least number of instants at which a trajectory is compared with the reference."""

MAXIMUM_STEPS = 10**9
"""The most steps that one run of a sweep may take."""

MAXIMUM_COARSE_STEPS = 10**6
"""The most steps at the coarsest step, which are all kept as samples."""

MAXIMUM_BYTES = 4 * 2**20
"""The largest scenario file: some 50,000 bodies, read in seconds."""

MAXIMUM_KEY_PARTS = 64
"""The most parts of a dotted key: the format has four, and a parser needs their square of memory."""

MAXIMUM_STATES = 10**7
"""The most states (samples times bodies) that one run keeps: half a gigabyte."""

MAXIMUM_ATTRACTING = 1000
"""The most bodies under one mutual gravity: every two of them are a pair."""

LARGEST = 1e60
"""The largest size of a number in a scenario: products of five of them are still finite."""

SMALLEST = 1e-60
"""The smallest size of a mass, a length, a duration: its inverse is still finite."""

_Finite = Annotated[float, Field(strict=True, allow_inf_nan=False, le=LARGEST)]
Number = Annotated[_Finite, Field(ge=-LARGEST)]
NotNegative = Annotated[_Finite, Field(ge=0.0)]
Positive = Annotated[_Finite, Field(ge=SMALLEST)]
Vector = tuple[Number, Number]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True, min_length=1)]
Damping = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1.0)]

_NUMBER = "a finite number (1e60 at most)"
_NOT_NEGATIVE = "a finite number >= 0 (1e60 at most)"
_POSITIVE = "a finite number > 0 (1e-60 to 1e60)"
_VECTOR = "two finite numbers [x, y] (1e60 at most)"
_DAMPING = "the fraction of velocity kept per second, in (0, 1]; 1 = none"
_BODY = "the name of one of the bodies"


class _Table(BaseModel):
    """A table of a scenario file: unknown keys are errors, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Box(_Table):
    """A rectangle of uniform density."""

    kind: Literal["box"]
    width: Positive = Field(description=_POSITIVE + ", in m")
    height: Positive = Field(description=_POSITIVE + ", in m")


class Circle(_Table):
    """A solid disk of uniform density."""

    kind: Literal["circle"]
    radius: Positive = Field(description=_POSITIVE + ", in m")


Shape = Annotated[Box | Circle, Discriminator("kind")]


class Body(_Table):
    """A body as the file states it: kg, m, m/s, rad, rad/s."""

    name: Text = Field(description="a name, not empty and different from every other body's")
    mass: NotNegative = Field(description=_NOT_NEGATIVE + ", in kg; 0 = static")
    shape: Shape | None = Field(
        default=None,
        description='{ kind = "box", width = W, height = H } or { kind = "circle", radius = R }',
    )
    inertia: NotNegative | None = Field(
        default=None, description=_NOT_NEGATIVE + ", in kg m^2; 0 = no torque turns it"
    )
    position: Vector = Field(description=_VECTOR + ", in m")
    angle: Number = Field(default=0.0, description=_NUMBER + ", in rad")
    velocity: Vector = Field(default=(0.0, 0.0), description=_VECTOR + ", in m/s")
    angular_velocity: Number = Field(default=0.0, description=_NUMBER + ", in rad/s")
    affected_by_gravity: Flag = Field(default=True, description="true or false")
    kind: Literal["dynamic", "static", "kinematic"] = Field(
        default="dynamic", description='"dynamic", "static" or "kinematic"'
    )
    linear_damping: Damping | None = Field(default=None, description=_DAMPING)
    angular_damping: Damping | None = Field(default=None, description=_DAMPING)

    @property
    def is_static(self) -> bool:
        return self.kind == "static" or (self.kind == "dynamic" and self.mass == 0.0)


class Spring(_Table):
    """A spring from a body to an anchor in the world or to another body's centre of mass."""

    kind: Literal["spring"]
    body: Text = Field(description=_BODY)
    anchor: Vector | None = Field(default=None, description=_VECTOR + ", in m")
    other: Text | None = Field(default=None, description=_BODY)
    point: Vector = Field(default=(0.0, 0.0), description=_VECTOR + ", in body coordinates, m")
    stiffness: NotNegative = Field(description=_NOT_NEGATIVE + ", in N/m")
    rest_length: NotNegative = Field(default=0.0, description=_NOT_NEGATIVE + ", in m")
    damping: NotNegative = Field(default=0.0, description=_NOT_NEGATIVE + ", in N s/m")


class TorsionSpring(_Table):
    """A torque that returns a body to an angle; the difference is taken in (-pi, pi]."""

    kind: Literal["torsion_spring"]
    body: Text = Field(description=_BODY)
    stiffness: NotNegative = Field(description=_NOT_NEGATIVE + ", in N m/rad")
    rest_angle: Number = Field(default=0.0, description=_NUMBER + ", in rad")
    damping: NotNegative = Field(default=0.0, description=_NOT_NEGATIVE + ", in N m s/rad")


class CentralGravity(_Table):
    """The attraction of a fixed centre, mu/r^2 per unit of mass."""

    kind: Literal["central_gravity"]
    body: Text = Field(description=_BODY)
    centre: Vector = Field(default=(0.0, 0.0), description=_VECTOR + ", in m")
    mu: Positive = Field(description=_POSITIVE + ", in m^3/s^2")


class MutualGravity(_Table):
    """Newton's attraction between every two of the bodies."""

    kind: Literal["mutual_gravity"]
    bodies: Annotated[tuple[Text, ...], Field(min_length=2, max_length=MAXIMUM_ATTRACTING)] = Field(
        description=f"the names of two or more bodies, {MAXIMUM_ATTRACTING} at most"
    )
    gravitational_constant: Positive = Field(description=_POSITIVE + ", in m^3/(kg s^2)")


class ConstantForce(_Table):
    """A constant force at a point of a body, fixed in the world or turning with the body."""

    kind: Literal["constant_force"]
    body: Text = Field(description=_BODY)
    force: Vector = Field(description=_VECTOR + ", in N")
    point: Vector = Field(default=(0.0, 0.0), description=_VECTOR + ", in body coordinates, m")
    frame: Literal["world", "body"] = Field(default="world", description='"world" or "body"')


class ConstantTorque(_Table):
    """A constant torque on a body."""

    kind: Literal["constant_torque"]
    body: Text = Field(description=_BODY)
    torque: Number = Field(description=_NUMBER + ", in N m")


class Drag(_Table):
    """A force against the velocity of a body, proportional to it."""

    kind: Literal["drag"]
    body: Text = Field(description=_BODY)
    coefficient: NotNegative = Field(description=_NOT_NEGATIVE + ", in N s/m")


ForceTable = (
    Spring | TorsionSpring | CentralGravity | MutualGravity | ConstantForce | ConstantTorque | Drag
)
Force = Annotated[ForceTable, Discriminator("kind")]

FORCE_KINDS: dict[str, type[BaseModel]] = {
    "spring": Spring,
    "torsion_spring": TorsionSpring,
    "central_gravity": CentralGravity,
    "mutual_gravity": MutualGravity,
    "constant_force": ConstantForce,
    "constant_torque": ConstantTorque,
    "drag": Drag,
}


class Sweep(_Table):
    """The steps of the error-versus-dt report: start, start/2, ... start/2^halvings."""

    start: Positive = Field(description=_POSITIVE + ", in s, and no longer than the duration")
    halvings: Annotated[int, Field(strict=True)] = Field(
        ge=0, le=24, description="a whole number from 0 to 24"
    )


class Budget(_Table):
    """Absolute limits for one method at the default step."""

    energy_error_max: Positive | None = Field(default=None, description=_POSITIVE)
    energy_drift_rate: Positive | None = Field(default=None, description=_POSITIVE + ", per s")
    position_error_max: Positive | None = Field(default=None, description=_POSITIVE + ", in m")
    velocity_error_max: Positive | None = Field(default=None, description=_POSITIVE + ", in m/s")
    angular_momentum_error_max: Positive | None = Field(default=None, description=_POSITIVE)


class Scenario(_Table):
    """A mechanical problem: bodies, forces, initial state, duration and step sizes. SI units."""

    name: Text = Field(description="the stem of the file's name")
    title: Text = Field(description="a title, not empty")
    family: Literal["spring", "orbit", "free_fall", "rotation"] = Field(
        description='"spring", "orbit", "free_fall" or "rotation"'
    )
    description: Annotated[str, Field(strict=True)] = Field(default="", description="a text")
    duration: Positive = Field(description=_POSITIVE + ", in s")
    gravity: Vector = Field(default=(0.0, 0.0), description=_VECTOR + ", in m/s^2")
    linear_damping: Damping = Field(default=1.0, description=_DAMPING)
    angular_damping: Damping = Field(default=1.0, description=_DAMPING)
    closed_form: Text | None = Field(default=None, description="the name of an exact solution")
    dt: Sweep = Field(description="a table [dt] with start and halvings")
    bodies: Annotated[tuple[Body, ...], Field(min_length=1)] = Field(
        description="one table [[bodies]] or more"
    )
    forces: tuple[Force, ...] = Field(default=(), description="tables [[forces]]")
    budget: dict[str, Budget] = Field(default_factory=dict, description="tables [budget.METHOD]")

    @property
    def steps(self) -> tuple[float, ...]:
        """The steps of the sweep, s, longest first."""
        return tuple(self.dt.start / 2**k for k in range(self.dt.halvings + 1))

    @property
    def coarse_steps(self) -> int:
        """How many of the longest steps make the duration."""
        return round(self.duration / self.dt.start)

    @property
    def samples(self) -> int:
        """The number of sample intervals: the coarsest grid, halved until there are enough."""
        samples = self.coarse_steps
        while samples < MINIMUM_SAMPLES:
            samples *= 2
        return samples

    @property
    def default_step(self) -> float:
        """The step of the sweep nearest (by ratio) to UMBRA's default of 0.01 s."""
        return _nearest_to_default(self.steps)

    def with_sweep(self, start: float, halvings: int) -> Self:
        """The same problem with another sweep of steps."""
        return self.model_copy(update={"dt": Sweep(start=start, halvings=halvings)})


@functools.lru_cache(maxsize=64)
def _nearest_to_default(steps: tuple[float, ...]) -> float:
    return min(steps, key=lambda dt: abs(math.log(dt / DEFAULT_STEP)))


def load_scenario(name_or_path: str | Path, folder: Path | None = None) -> Scenario:
    """Read and check a scenario.

    Args:
        name_or_path: the name of a file in `folder` (without its ending), or a path to a file.
        folder: where names are looked up; by default `scenarios/` here, else the project's.

    Raises:
        ScenarioError: the file is missing, is not TOML or states something that is not allowed.
    """
    path = find_scenario(name_or_path, folder)
    document = read_toml(path)
    try:
        return parse_scenario(document, path)
    except ValueError as error:
        raise ScenarioError(one_line(f"{path}: {error}")) from None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, of a scenario or a sweep, of a size and a depth that a parser can bear.

    Raises:
        ScenarioError: it cannot be read or is not such a file.
    """
    try:
        with path.open("rb") as file:
            return _toml(file.read(MAXIMUM_BYTES + 1))
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ScenarioError(one_line(f"{path}: {error}")) from None


_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DOT = r"[ \t]*+\.[ \t]*+"
# Begins where a word begins and never goes back, so that no text takes more than a few passes.
_LONG_KEY = re.compile(rf"(?<![\w.-]){_PART}(?:{_DOT}{_PART}){{{MAXIMUM_KEY_PARTS}}}")


def _toml(content: bytes) -> dict[str, Any]:
    """Read TOML of a size and a depth that a parser can bear.

    Raises:
        ValueError: it is too large, not in UTF-8 or not TOML, with the line where there is one.
    """
    if len(content) > MAXIMUM_BYTES:
        raise ValueError(f"is larger than {MAXIMUM_BYTES} bytes, the most that is allowed")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise ValueError(f"is not text in UTF-8, as TOML must be (at line {line})") from None
    long = _LONG_KEY.search(text)
    if long is not None:
        line = text.count("\n", 0, long.start()) + 1
        raise ValueError(
            f"is not allowed: more than {MAXIMUM_KEY_PARTS} parts joined by dots (at line {line})"
        )
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("is not valid TOML: tables or arrays are nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"is not valid TOML: {error}") from None


def parse_scenario(document: dict[str, Any], path: Path) -> Scenario:
    """Check the content of a scenario file; `path` names it in messages.

    Raises:
        ScenarioError: as :func:`load_scenario`.
    """
    try:
        scenario = Scenario.model_validate(document)
        complaint = next(_complaints(scenario, path.stem), None)
    except ValidationError as error:
        complaint = _explain(error)
    if complaint is not None:
        raise ScenarioError(one_line(f"{path}: {complaint}"))
    return scenario


def scenario_folders() -> list[Path]:
    """Where scenarios are looked up by name: here first, then beside the package."""
    folders = [Path("scenarios"), Path(__file__).resolve().parent.parent / "scenarios"]
    return [folder for folder in folders if folder.is_dir()]


def list_scenarios() -> list[str]:
    """The names of the scenarios of a study, sorted; those of `gate/` serve the gate alone."""
    for folder in scenario_folders():
        names = sorted(path.stem for path in folder.glob("*.toml"))
        if names:
            return names
    return []


def find_scenario(name_or_path: str | Path, folder: Path | None = None) -> Path:
    """The file that a name or a path means.

    Raises:
        ScenarioError: there is no such file.
    """
    given = Path(name_or_path)
    is_path = given.suffix == ".toml" or len(given.parts) > 1
    named = [] if is_path else [folder] if folder else scenario_folders()
    named += [directory / "gate" for directory in named]
    for path in (*(directory / f"{given}.toml" for directory in named), given):
        if is_file(path):
            return path
    if is_path:
        raise ScenarioError(f"{given}: there is no such scenario file")
    known = list_scenarios()
    raise ScenarioError(
        f"SCENARIO {str(name_or_path)!r} is neither a file nor a name in scenarios/"
        f"{hint(name_or_path, known)}"
    )


def is_file(path: Path) -> bool:
    """Whether a path, however odd, is that of a file."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def scenario_hash(scenario: Scenario) -> str:
    """The SHA-256 of what the scenario states (not of its file's layout or comments)."""
    return hashlib.sha256(scenario.model_dump_json().encode()).hexdigest()


# Messages -----------------------------------------------------------------------------------------

_CHILDREN: dict[str, type[BaseModel]] = {"bodies": Body, "dt": Sweep, "budget": Budget}
_TAGGED: dict[str, dict[str, type[BaseModel]]] = {
    "forces": FORCE_KINDS,
    "shape": {"box": Box, "circle": Circle},
}


def _explain(error: ValidationError) -> str:
    """The first fault of a file in one line: key, value, what is allowed."""
    faults = error.errors(include_url=False)
    # A misspelt key is also a missing one: the spelling is what helps.
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    key, allowed, table = _locate(fault["loc"])
    value = short(fault["input"])
    if fault["type"] == "extra_forbidden":
        known = list(table.model_fields)
        return f"{key}: unknown key{hint(fault['loc'][-1], known, 'allowed keys')}"
    if fault["type"] == "missing":
        return f"{key}: missing; expected {allowed}"
    if fault["type"] in ("union_tag_invalid", "union_tag_not_found"):
        tags = _TAGGED[str(next(part for part in reversed(fault["loc"]) if isinstance(part, str)))]
        kind = fault["input"].get("kind") if isinstance(fault["input"], dict) else fault["input"]
        given = f"{key}.kind = {short(kind)}" if kind is not None else f"{key}.kind: missing"
        return f"{given}{hint(kind, tags)}"
    return f"{key} = {value}: not allowed; expected {allowed}"


def _locate(loc: Sequence[int | str]) -> tuple[str, str, type[BaseModel]]:
    """The dotted key of a pydantic location, what its field allows, and the table that holds it."""
    key, allowed = "", "a value of another form"
    table: type[BaseModel] = Scenario
    tags: dict[str, type[BaseModel]] = {}
    for part in loc:
        if isinstance(part, int):
            key += f"[{part}]"
        elif part in tags:
            table, tags = tags[part], {}
        else:
            shown = part if re.fullmatch(r"[\w-]{1,80}", part) else short(part, 80)
            key += f".{shown}" if key else shown
            field = table.model_fields.get(part)
            if field is not None and field.description:
                allowed = field.description
            tags = _TAGGED.get(part, {})
            table = _CHILDREN.get(part, table)
    return key, allowed, table


def _complaints(scenario: Scenario, stem: str) -> Iterator[str]:
    """What is wrong between keys, each as one line; the first one is reported."""
    if scenario.name != stem:
        yield f"name = {scenario.name!r}: must equal the file's stem, {stem!r}"
    yield from _body_complaints(scenario)
    bodies = {body.name: body for body in scenario.bodies}
    for i, force in enumerate(scenario.forces):
        yield from _force_complaints(bodies, force, f"forces[{i}]")
    yield from _step_complaints(scenario)
    for method in scenario.budget:
        if method not in METHODS and not method.startswith("native:"):
            yield f"budget.{method}: not a method{hint(method, METHODS)}"
    if scenario.closed_form is not None:
        from umbra_bench.closed_form import CLOSED_FORMS, fitting_closed_forms

        fitting = fitting_closed_forms(scenario)
        given = f"closed_form = {scenario.closed_form!r}"
        if scenario.closed_form not in CLOSED_FORMS:
            yield f"{given}: not known{hint(scenario.closed_form, CLOSED_FORMS)}"
        elif scenario.closed_form not in fitting:
            allowed = ", ".join(fitting) or "none, so leave the key out"
            yield f"{given}: does not solve this scenario; allowed here: {allowed}"


def _step_complaints(scenario: Scenario) -> Iterator[str]:
    start, duration = scenario.dt.start, scenario.duration
    if start > duration:
        yield f"dt.start = {start!r}: longer than the duration of {duration!r} s"
        return
    ratio = duration / start
    if ratio > MAXIMUM_COARSE_STEPS:
        yield (
            f"dt.start = {start!r}: too short, {ratio:.3g} steps in {duration!r} s; "
            f"at most {MAXIMUM_COARSE_STEPS} are allowed at the longest step"
        )
        return
    if abs(ratio - round(ratio)) > 1e-9 * ratio:
        yield (
            f"duration = {duration!r}: not a whole number of steps of dt.start = {start!r} s "
            f"({ratio:.6g}); every step of the sweep must divide it"
        )
    if scenario.samples * len(scenario.bodies) > MAXIMUM_STATES:
        yield (
            f"bodies: {len(scenario.bodies)} of them at {scenario.samples} samples are too many states "
            f"to keep; at most {MAXIMUM_STATES} are allowed"
        )
    if round(ratio) * 2**scenario.dt.halvings > MAXIMUM_STEPS:
        yield (
            f"dt.halvings = {scenario.dt.halvings}: the shortest step would need "
            f"{round(ratio) * 2**scenario.dt.halvings} steps; at most {MAXIMUM_STEPS} are allowed"
        )


def _body_complaints(scenario: Scenario) -> Iterator[str]:
    names = [body.name for body in scenario.bodies]
    for name, count in Counter(names).items():
        if count > 1:
            second = len(names) - 1 - names[::-1].index(name)
            yield f"bodies[{second}].name = {name!r}: already the name of another body"
    for i, body in enumerate(scenario.bodies):
        for key in ("mass", "inertia"):
            value = getattr(body, key)
            if value is not None and 0.0 < value < SMALLEST:
                yield f"bodies[{i}].{key} = {value!r}: expected 0 or a number of at least {SMALLEST}"
        if body.is_static and (any(body.velocity) or body.angular_velocity):
            key = "velocity" if any(body.velocity) else "angular_velocity"
            still = list(body.velocity) if any(body.velocity) else body.angular_velocity
            yield (
                f"bodies[{i}].{key} = {still}: a static body does not move; "
                'expected 0, or kind = "kinematic"'
            )


def _force_complaints(bodies: dict[str, Body], force: ForceTable, key: str) -> Iterator[str]:
    named = force.bodies if isinstance(force, MutualGravity) else (force.body,)
    for name in named:
        if name not in bodies:
            where = "bodies" if isinstance(force, MutualGravity) else "body"
            yield f"{key}.{where}: {_no_such_body(name, bodies)}"
            return
    match force:
        case Spring():
            if (force.anchor is None) == (force.other is None):
                yield f"{key}: a spring needs either anchor = [x, y] or other = BODY, and not both"
            elif force.other is not None and force.other not in bodies:
                yield f"{key}.other: {_no_such_body(force.other, bodies)}"
            elif force.other == force.body:
                yield f"{key}.other = {force.other!r}: must be another body than body"
        case CentralGravity() if bodies[force.body].position == force.centre:
            yield (
                f"{key}.centre = {list(force.centre)}: body {force.body!r} stands in it, "
                "where gravity has no value; expected another place"
            )
        case MutualGravity():
            places: dict[Vector, str] = {}
            if len(set(named)) < len(named):
                yield f"{key}.bodies = {list(named)}: names a body twice"
            for name in named:
                first = places.setdefault(bodies[name].position, name)
                if first != name:
                    place = list(bodies).index(name)
                    yield (
                        f"bodies[{place}].position = {list(bodies[name].position)}: bodies {first!r} and "
                        f"{name!r} stand in one place under mutual_gravity; expected two places"
                    )
        case _:
            pass


def _no_such_body(name: str, bodies: dict[str, Body]) -> str:
    return f"there is no body {name!r}{hint(name, bodies)}"
