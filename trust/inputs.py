"""Odd files by the thousand, and what must be true of each: accepted and sound, or refused in one line.

A kind of file is a set of good ones (seeds), a way to read one as the project does, and an oracle that
tells nonsense without the project's code. Mutations are of bytes, of lines and of the tree that a file
states. Everything follows from a seed of the random numbers, so that each file can be made again.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import io
import json
import math
import random
import re
import shutil
import tomllib
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from umbra_bench import findings, gate
from umbra_bench.claims.record import load_claims
from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.drift import _DAMAGED, _arrays, _LongRun
from umbra_bench.drift_figures import draw_long_runs, load_long_runs
from umbra_bench.errors import ScenarioError, UmbraBenchError, UnsupportedScenario
from umbra_bench.html_report import _long_runs_data, explorer_data
from umbra_bench.overview import overview
from umbra_bench.reference import certified_reference
from umbra_bench.report import load_scenario_tables, render_page
from umbra_bench.results import load_environment, load_table
from umbra_bench.scenario import MAXIMUM_BYTES, Scenario, load_scenario
from umbra_bench.schemas import ENGINES_SCHEMA
from umbra_bench.simulation import simulate
from umbra_bench.sweep.plan import MOST_RUNS, load_plan
from umbra_bench.sweep.work import _claim
from umbra_bench.system import build_system, initial_state

ROOT = Path(__file__).resolve().parent.parent

Random = random.Random
Tree = Any


class Wrong(AssertionError):
    """What may not happen to any file."""


# Numbers, words and trees that nobody expects -------------------------------------------------------

NUMBERS: tuple[Any, ...] = (
    *(0, -1, 1, 2**31, 2**63, 2**64, -(2**63), 10**30, 10**308, 10**309, 10**400),
    *(0.0, -0.0, -1.0, 0.5, 1e-3, 1e60, 1.0000001e60, 1e-60, 1e-61, 1e308, -1e308),
    *(5e-324, 2.2250738585072014e-308, math.nan, -math.nan, math.inf, -math.inf, math.pi, 1e6),
)
WORDS: tuple[Any, ...] = (
    *("", " ", "nan", "umbra", "bob", "spring", "../../etc/passwd", "..", "/", "C:\\x", "a/b"),
    *(
        "\x00",
        "\x1b[31mred",
        "\n",
        "\u202e",
        "\ud7ff",
        "é" * 300,
        "x" * 20_000,
        "${HOME}",
        "{{7*7}}",
    ),
    *("<script>", "$(id)", "%s", "__class__", "kind", "name", "native:x.so", "process:id"),
)
OTHERS: tuple[Any, ...] = (True, False, [], {}, [[]], [0.0], [1.0, 2.0, 3.0], {"kind": "spring"})


def nasty(random: Random) -> Tree:
    """A value of some kind."""
    value = random.choice(random.choice((NUMBERS, NUMBERS, WORDS, OTHERS)))
    if random.random() < 0.03:
        for _ in range(random.choice((3, 40, 400))):
            value = [value] if random.random() < 0.5 else {"a": value}
    return copy.deepcopy(value)


def nodes(tree: Tree) -> Iterator[tuple[Any, Any]]:
    """Every (container, key) of a tree."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, (dict, list)):
            yield from nodes(value)


def mutate_tree(random: Random, tree: Tree) -> Tree:
    """A copy with one thing changed; a few times several."""
    tree = copy.deepcopy(tree)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        found = list(nodes(tree)) if isinstance(tree, (dict, list)) else []
        if not found:
            return nasty(random)
        _mutate_node(random, *random.choice(found), random.choice(found))
    return tree


def _mutate_node(random: Random, container: Any, key: Any, other: tuple[Any, Any]) -> None:
    value = container[key]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    match random.randrange(9):
        case 0:
            del container[key]
        case 1 if isinstance(container, dict):  # misspelt, or one too many
            word = str(key)
            spelt = random.choice(
                (word[:-1], word + "s", word.upper(), word * 2, "", "a.b", "\x1b[")
            )
            container[spelt] = value if random.random() < 0.5 else container.pop(key)
        case 1 | 2 if isinstance(container, list):
            container.insert(key, copy.deepcopy(value))
        case 3 if isinstance(value, list) and value:
            container[key] = (value * random.choice((2, 30, 2000)))[:4000]
        case 4:
            container[key] = (
                copy.deepcopy(other[0].get(other[1])) if isinstance(other[0], dict) else 0
            )
        case 5 | 6 if number:
            with np.errstate(all="ignore"):
                try:
                    container[key] = value * random.choice(
                        (-1.0, 10.0, 1e-20, 1e20, 1e40, 1.1, 0.0)
                    )
                except OverflowError:
                    container[key] = 0
        case 7:
            container[key] = random.choice((str(value)[:99], [value], {"value": value}, None))
        case _:
            container[key] = nasty(random)


TOKENS = (
    *(
        b"=",
        b"[",
        b"]",
        b"[[",
        b"]]",
        b"{",
        b"}",
        b'"',
        b"'''",
        b'"""',
        b"\\",
        b"#",
        b".",
        b",",
        b"\n",
    ),
    *(b"\r", b"\0", b"\xff", b"\xc3", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"nan", b"inf", b"1e999"),
    *(b"-", b"_", b"0x", b"true", b"null", b"2024-01-01", b"bodies", b"[[bodies]]", b"name"),
)


def mutate_bytes(random: Random, content: bytes, other: bytes = b"") -> bytes:
    """A few bytes, words or lines changed; a piece lost, doubled, or from another file."""
    data = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 5))):
        at = random.randrange(len(data) + 1)
        size = random.choice((1, 4, 40, 400))
        match random.randrange(9):
            case 0:
                del data[at:]
            case 1:
                del data[at : at + size]
            case 2 if data:
                data[min(at, len(data) - 1)] = random.randrange(256)
            case 3 | 4:
                data[at:at] = random.choice(TOKENS)
            case 5:
                data[at:at] = data[at : at + size] * random.choice((1, 1, 50))
            case 6:
                start = random.randrange(len(other) + 1)
                data[at : at + size] = other[start : start + size]
            case 7:
                lines = bytes(data).split(b"\n")
                line = random.choice(lines)
                lines.insert(random.randrange(len(lines) + 1), line)
                data = bytearray(b"\n".join(lines))
            case _:
                data[at:at] = random.choice((b"[", b"{a=", b"a.", b'"', b"9")) * random.choice(
                    (5, 3000)
                )
    return bytes(data[: 2 * MAXIMUM_BYTES])


def toml(tree: Tree, *, top: bool = True) -> str:
    """A tree as TOML, tables within tables in one line; null becomes a word."""
    if top:
        return "".join(
            f"{toml(str(k), top=False)} = {toml(v, top=False)}\n" for k, v in tree.items()
        )
    match tree:
        case bool():
            return "true" if tree else "false"
        case int():
            return hex(tree) if tree > 10**300 else str(tree)
        case float():
            return "nan" if math.isnan(tree) else repr(tree)
        case dict():
            pairs = (f"{toml(str(k), top=False)} = {toml(v, top=False)}" for k, v in tree.items())
            return "{" + ", ".join(pairs) + "}"
        case list():
            return "[" + ", ".join(toml(value, top=False) for value in tree) + "]"
        case _:
            return json.dumps(str(tree), ensure_ascii=False).replace("\x7f", "")


# What everything that is refused must say -----------------------------------------------------------

_PLACE = re.compile(
    r"at line \d+|at end of document|^[^ ]{1,900}( = |: |\b)|column '|row \d+|line \d+ column"
)

_BESIDE = re.compile(r"[a-z]+\.(json|parquet): .* of the tables beside it")


def check_message(message: str, path: Path) -> None:
    """One printable line that names the file and a place in it."""
    if not message.isprintable():
        raise Wrong(f"not one printable line: {message!r}")
    if len(message) > 1200:
        raise Wrong(f"{len(message)} characters long: {message[:200]!r}")
    beside = _BESIDE.match(message)  # two files that do not belong together: the other one is named
    if path.name not in message and not beside:
        raise Wrong(f"does not name {path.name}: {message!r}")
    if not (beside or _PLACE.search(message.partition(f"{path.name}: ")[2])):
        raise Wrong(f"names no key and no line: {message!r}")


# Scenarios ------------------------------------------------------------------------------------------

_FORCE_KEYS = {
    "spring": "body anchor other point stiffness rest_length damping",
    "torsion_spring": "body stiffness rest_angle damping",
    "central_gravity": "body centre mu",
    "mutual_gravity": "bodies gravitational_constant",
    "constant_force": "body force point frame",
    "constant_torque": "body torque",
    "drag": "body coefficient",
}
_KEYS = {
    "scenario": "name title family description duration gravity linear_damping angular_damping "
    "closed_form dt bodies forces budget",
    "body": "name mass shape inertia position angle velocity angular_velocity affected_by_gravity "
    "kind linear_damping angular_damping",
}
_NOT_NEGATIVE = ["mass", "inertia", "stiffness", "damping", "rest_length", "coefficient"]
_POSITIVE = ["duration", "start", "mu", "gravitational_constant", "width", "height", "radius"]
_FRACTION = ("linear_damping", "angular_damping")
_TEXT = ["name", "title", "family", "description", "closed_form", "kind", "body", "other", "frame"]


def nonsense_in_scenario(document: dict[str, Any], stem: str) -> str | None:
    """What no reader of the format would accept; written from the format's page, not from the code."""
    if unknown := set(document) - set(_KEYS["scenario"].split()):
        return f"unknown keys {unknown}"
    if document["name"] != stem:
        return "a name that is not the file's"
    names = [body["name"] for body in document["bodies"]]
    if len(set(names)) < len(names):
        return "two bodies of one name"
    for body in document["bodies"]:
        if unknown := set(body) - set(_KEYS["body"].split()):
            return f"unknown keys {unknown} of a body"
    for force in document.get("forces", []):
        if unknown := set(force) - {"kind", *_FORCE_KEYS[force["kind"]].split()}:
            return f"unknown keys {unknown} of a {force['kind']}"
        for name in (
            *force.get("bodies", ()),
            *(force[k] for k in ("body", "other") if k in force),
        ):
            if name not in names:
                return f"a force on {name!r}, which is none of the bodies"
    for container, key in nodes(document):
        value = container[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if number and not abs(value) <= 1e60:
            return f"{key} = {value}"
        if key in (*_NOT_NEGATIVE, *_POSITIVE, *_FRACTION) and not number:
            return f"{key} = {value!r}, no number"
        if key in _NOT_NEGATIVE and value < 0:
            return f"{key} = {value}, negative"
        if key in _POSITIVE and value <= 0:
            return f"{key} = {value}, not positive"
        if key in _FRACTION and not 0 < value <= 1:
            return f"{key} = {value}, no fraction"
        if key in _TEXT and not isinstance(value, str):
            return f"{key} = {value!r}, no text"
        if key in ("position", "velocity", "gravity", "anchor", "centre", "point", "force") and (
            len(value) != 2 or not all(type(v) in (int, float) for v in value)
        ):
            return f"{key} = {value!r}, not two numbers"
    steps = document["duration"] / document["dt"]["start"]
    if abs(steps - round(steps)) > 1e-6 * steps or round(steps) < 1:
        return f"{steps} steps in the duration"
    return None


def follow(scenario: Scenario, random: Random, *, through_the_door: bool = False) -> None:
    """What follows from a scenario that was accepted: a state that is finite, or told to be not."""
    for precision in ("float64", "float32"):
        try:
            system, state = build_system(scenario, precision), initial_state(scenario, precision)
        except UnsupportedScenario as error:
            check_message(str(error).replace(f"scenario {scenario.name}", "f"), Path("f"))
            continue
        start, step = COMPILED_METHODS["umbra"]
        moving = start(system, state)
        dt = state.position.dtype.type(scenario.default_step)
        finite = True
        with np.errstate(all="ignore"):
            for _ in range(4):
                moving = step(system, moving, dt)
            finite = bool(np.isfinite(moving.position).all() and np.isfinite(moving.velocity).all())
        if not finite or through_the_door:
            if len(scenario.bodies) > 64:
                continue
            run = simulate(scenario, "umbra", float(dt), steps=4, precision=precision)
            sound = np.isfinite(run.position).all() and np.isfinite(run.velocity).all()
            if (run.diverged_at is None) and not sound:
                raise Wrong(f"not finite in {precision}, and not told")


# Kinds of files -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: what it is called in the figures.
        file: the name under which it is read.
        seeds: good ones.
        parse, write: bytes to a tree and back.
        examine: reads the file at a path and follows it; raises UmbraBenchError where it is refused,
            and :class:`Wrong` where what was accepted is not sound.
    """

    name: str
    file: str
    seeds: list[bytes]
    parse: Callable[[bytes], Tree]
    write: Callable[[Tree], bytes]
    examine: Callable[[Path, Random], None]

    def mutate(self, random: Random, content: bytes, other: bytes) -> bytes:
        """Another file that is nearly `content`."""
        if random.random() < 0.6:
            with contextlib.suppress(ValueError, RecursionError):  # no tree, or too deep a one
                return self.write(mutate_tree(random, self.parse(content)))
        return mutate_bytes(random, content, other)


def examined(kind: Kind, path: Path, random: Random) -> str:
    """Examine a file: "accepted", or the message with which it was refused.

    Raises:
        Wrong: and every other exception is a failure as well.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            kind.examine(path, random)
        except UmbraBenchError as error:
            check_message(str(error), path)
            return str(error).replace(str(path), kind.file)
    return "accepted"


def _examine_scenario(path: Path, random: Random) -> None:
    scenario = load_scenario(path)
    nonsense = nonsense_in_scenario(tomllib.loads(path.read_text(encoding="utf-8")), path.stem)
    if nonsense is not None:
        raise Wrong(f"accepted: {nonsense}")
    follow(scenario, random, through_the_door=random.random() < 0.002)


def scenarios() -> Kind:
    """The scenario files of the project, under one name."""
    seeds = []
    for path in sorted(ROOT.glob("scenarios/**/*.toml")):
        text = path.read_text(encoding="utf-8")
        seeds.append(re.sub(r'^name = ".*"', 'name = "odd"', text, count=1, flags=re.M).encode())
    return Kind(
        "scenarios",
        "odd.toml",
        seeds,
        lambda content: tomllib.loads(content.decode("utf-8")),
        lambda tree: toml(tree if isinstance(tree, dict) else {"a": tree}).encode(
            "utf-8", "replace"
        ),
        _examine_scenario,
    )


def _json_kind(
    name: str, file: str, seeds: list[Tree], examine: Callable[[Path, Random], None]
) -> Kind:
    return Kind(
        name,
        file,
        [json.dumps(seed, indent=1).encode() for seed in seeds],
        lambda content: json.loads(content.decode("utf-8")),
        lambda tree: json.dumps(tree).encode(),
        examine,
    )


def _tree_of(path: Path) -> Tree:
    return json.loads(path.read_text(encoding="utf-8"))


def baselines() -> Kind:
    """The baseline of the gate, of one scenario."""
    whole = _tree_of(ROOT / "results" / "baseline.json")
    small = {
        key: {
            name: entry for name, entry in table.items() if name.split("/")[0] == "spring_dashpot"
        }
        if isinstance(table, dict)
        else table
        for key, table in whole.items()
    }
    measured = gate.measure_lines([gate.Line("spring_dashpot", "umbra", "float64")])

    def examine(path: Path, random: Random) -> None:
        baseline = gate.load_baseline(path)
        tree = _tree_of(path)
        if set(tree) != set(whole):
            raise Wrong(f"accepted: keys {sorted(tree)}")
        for table in ("truths", "cells", "orders"):
            for container, key in nodes(tree[table]):
                value = container[key]
                if isinstance(value, dict):
                    continue
                if isinstance(value, bool) or not (value is None or abs(value) < math.inf):
                    raise Wrong(f"accepted: {key} = {value!r}")
                if table == "cells" and value is not None and value < 0:
                    raise Wrong(f"accepted: {key} = {value!r}")
        judgements = gate.judge(measured, baseline, whole=random.random() < 0.5)
        if gate.exit_code(judgements) not in (0, 1, 2) or not judgements:
            raise Wrong("judged by nothing")

    return _json_kind("baselines", "baseline.json", [small], examine)


def sweeps() -> Kind:
    """Sweep files: the project's own, and one of each way to vary a number."""
    seeds = [path.read_bytes() for path in sorted(ROOT.glob("examples/sweeps/*.toml"))]
    seeds += [text.encode() for text in _SWEEPS]

    def examine(path: Path, random: Random) -> None:
        planned = load_plan(path)
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        if nonsense := nonsense_in_sweep(document):
            raise Wrong(f"accepted: {nonsense}")
        if (
            not 0 < planned.runs <= MOST_RUNS
            or sum(t.last - t.first for t in planned.tasks) != planned.runs
        ):
            raise Wrong("tasks that are not the runs")
        for point in {0, planned.points - 1, random.randrange(planned.points)}:
            with contextlib.suppress(ScenarioError):  # a run that cannot be is a row that says why
                values = planned.values(point)
                planned.step(values, planned.scenario(values))

    return Kind(
        "sweeps",
        "odd.toml",
        seeds,
        lambda content: tomllib.loads(content.decode("utf-8")),
        lambda tree: toml(tree if isinstance(tree, dict) else {"a": tree}).encode(
            "utf-8", "replace"
        ),
        examine,
    )


_SWEEPS = (
    """scenario = "spring"
methods = ["umbra", "pymunk"]
precisions = ["float32", "float64"]
dt = 0.01
draws = 5
seed = 7
vary = [
  { key = "forces[0].stiffness", random = { low = 1.0, high = 9.0, distribution = "log-uniform" } },
  { key = "bodies[0].velocity[1]", values = [-1.0, 0.5, 2] },
]
""",
    """scenario = "figure_eight"
methods = ["rk4"]
vary = [
  { key = "dt", range = { start = 0.001, stop = 0.1, count = 5, spacing = "log" } },
  { key = "bodies[0].mass", range = { start = 1, stop = 2, count = 3 } },
]
""",
)
_SWEEP_KEYS = {"scenario", "methods", "vary", "precisions", "dt", "steps", "draws", "seed"}
_WAYS = {
    "values": None,
    "range": {"start", "stop", "count", "spacing"},
    "random": {"low", "high", "distribution"},
}


def nonsense_in_sweep(document: dict[str, Any]) -> str | None:
    """What no reader of sweep files would accept; written from the format, not from the code."""
    if unknown := set(document) - _SWEEP_KEYS:
        return f"unknown keys {unknown}"
    for method in document["methods"]:
        if not isinstance(method, str) or ":" in method:
            return f"the method {method!r}"
    keys = [variation["key"] for variation in document["vary"]]
    if len(set(keys)) < len(keys):
        return "a key that varies twice"
    for variation in document["vary"]:
        ways = set(variation) - {"key"}
        if len(ways) != 1 or not ways <= set(_WAYS):
            return f"a key with {ways}"
        (way,) = ways
        if isinstance(variation[way], dict) and set(variation[way]) - (_WAYS[way] or set()):
            return f"unknown keys in {variation[way]}"
    for container, key in nodes(document):
        value = container[key]
        if isinstance(value, bool):
            return f"{key} = {value}"
        if isinstance(value, (int, float)) and key != "seed" and not abs(value) <= 1e60:
            return f"{key} = {value}"
        if key in ("start", "stop", "low", "high", "dt") and not isinstance(value, (int, float)):
            return f"{key} = {value!r}, no number"
        if key in ("count", "steps", "draws", "seed") and not (
            type(value) is int and value >= (key != "seed")
        ):
            return f"{key} = {value!r}, no count"
    return None


def long_runs(folder: Path) -> Kind:
    """What a long run keeps of where it stands; `folder` holds one."""
    (kept,) = (folder / "drift").glob("*umbra*.npz")
    scenario, reference = load_scenario("spring"), certified_reference(load_scenario("spring"))

    def parse(content: bytes) -> Tree:
        try:
            return {name: array.tolist() for name, array in _arrays(content).items()}
        except (*_DAMAGED, KeyError) as error:
            raise ValueError("damaged") from error

    def write(tree: Tree) -> bytes:
        file = io.BytesIO()
        try:
            np.savez(file, **{str(key): np.array(value) for key, value in tree.items()})
        except (ValueError, TypeError, AttributeError, OverflowError):
            return b""
        return file.getvalue()

    def examine(path: Path, random: Random) -> None:
        run = _LongRun(scenario, reference, "umbra", "float64", 0.01, path.parent)
        run.take_up(restart=False)
        steps = run.standing.steps
        if not 0 <= steps <= 2**53 or run.run.intact_steps > steps:
            raise Wrong(f"{steps} steps, {run.run.intact_steps} of them intact")
        if len(run.standing.seen) and random.random() < 0.2:
            run.go_on(steps + 1, lambda *_: None)
            run.tables()

    return Kind("drift/*.npz", kept.name, [kept.read_bytes()], parse, write, examine)


def stamps() -> Kind:
    """What tells which sweep lies in a place."""
    planned = load_plan(ROOT / "examples" / "sweeps" / "spring_stability.toml")
    seed = {"sweep": planned.name, "fingerprint": planned.fingerprint, "reproduce": "x"}

    def examine(path: Path, random: Random) -> None:
        _claim(planned, path.with_suffix(".parquet"), restart=False)
        if _tree_of(path).get("fingerprint") != planned.fingerprint:
            raise Wrong("accepted: the stamp of another sweep")

    return _json_kind("sweeps/*.json", "spring_stability.json", [seed], examine)


RESULTS = (
    *("scenarios.json", "environment.json", "study.parquet", "orders.parquet"),
    *("references.parquet", "skips.parquet", "motion.parquet", "energy.parquet"),
    *("drift.parquet", "drift_series.parquet"),
)
"""The files of a study and of long runs that a report reads."""


def unsealed_copy(study: Path, folder: Path) -> Path:
    """A copy of a study whose documents may be changed at will: only its tables stay sealed."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(study, folder)
    seals = sorted(folder.glob("*.sha256"))
    lines = [line for seal in seals for line in seal.read_text().splitlines()]
    for seal in seals:
        seal.unlink()
    tables = (f"{line}\n" for line in lines if line.endswith(".parquet"))
    (folder / "study.sha256").write_text("".join(tables))
    return folder


def results(folder: Path, file: str) -> Kind:
    """A file of a study: a document, or a table cell by cell; `folder` holds a good study.

    A table that was written whole is sealed and read; one that was damaged must be refused by its seal.
    """

    def pages(path: Path, random: Random) -> None:
        if path.suffix == ".parquet":
            _seal(path)
        tables = load_scenario_tables(path.parent)
        load_environment(path.parent)
        load_table("skips", path.parent)
        overview(tables)
        findings.paragraph(tables)
        findings.drift_table(tables)
        long_runs = load_long_runs(path.parent)
        for runs in long_runs:
            findings.long_runs_caption(runs.laws.to_dicts())
            _long_runs_data(runs)
            if "drift" in path.name and random.random() < 0.1:
                draw_long_runs(runs)
        text = json.dumps(explorer_data(tables), allow_nan=False)
        if random.random() < 0.1:
            text += render_page(tables, path.parent)
        if "passwd" in text and "figures/.." in text:
            raise Wrong("a path that escapes")

    def documents(path: Path, random: Random) -> None:
        pages(path, random)
        if path.name == "scenarios.json":
            for name, document in _tree_of(path).items():
                if nonsense := nonsense_in_scenario(document, name):
                    raise Wrong(f"accepted: {nonsense}")

    if file.endswith(".json"):
        return _json_kind(file, file, [_tree_of(folder / file)], documents)
    return Kind(file, file, [_whole((folder / file).read_bytes())], _columns, _parquet, pages)


_WHOLE: set[str] = set()
"""SHA-256 of the tables that were written whole: damaged ones are read by no one, the search included."""


def _whole(content: bytes) -> bytes:
    _WHOLE.add(hashlib.sha256(content).hexdigest())
    return content


def _columns(content: bytes) -> Tree:
    if hashlib.sha256(content).hexdigest() not in _WHOLE:
        raise ValueError("damaged")
    table = pl.read_parquet(io.BytesIO(content))
    return table.gather_every(1 + table.height // 40).to_dict(as_series=False)


def _seal(path: Path) -> None:
    """Seal a table that was written whole; one that was damaged keeps the seal of the good one."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest not in _WHOLE:
        digest = "0" * 64
    seal = path.parent / "study.sha256"
    lines = seal.read_text().splitlines() if seal.is_file() else []
    kept = [line for line in lines if not line.endswith(f"  {path.name}")]
    seal.write_text("\n".join([*kept, f"{digest}  {path.name}"]) + "\n")


def _parquet(tree: Tree) -> bytes:
    """Columns as a table; what no table can hold is left out."""
    columns = []
    for name, values in tree.items() if isinstance(tree, dict) else ():
        try:
            column = pl.Series(str(name), values, strict=False)
        except (TypeError, ValueError, OverflowError, pl.exceptions.PolarsError):
            continue
        if column.dtype == pl.Null:  # a column of numbers none of which is there
            column = column.cast(pl.Float64)
        if (
            not str(column.dtype).count("(") > 8
        ):  # polars writes deeper ones and dies of reading them
            columns.append(column)
    file = io.BytesIO()
    shortest = min(map(len, columns), default=0)
    try:
        pl.DataFrame([c.head(shortest) for c in columns]).write_parquet(file)
    except pl.exceptions.PolarsError:
        return b""
    return _whole(file.getvalue())


def claims() -> Kind:
    """What the claims' command writes; a small document of its form."""
    machine = {
        "python": "3",
        "platform": "x",
        "processor": "y",
        "cores": 2,
        "packages": {"numpy": "2"},
    }
    criterion = {
        "what": "a ratio",
        "value": 2.0,
        "relation": "<=",
        "threshold": 1.0,
        "unit": "",
        "met": False,
        "otherwise": "is larger",
    }
    statement = {
        "name": "order",
        "place": "here",
        "statement": "It is second order.",
        "verdict": "fails",
        "why": "it is first",
        "examines": True,
        "criteria": [criterion, {**criterion, "value": None}],
    }
    seed = {
        "format": "umbra-bench claims 1",
        "subject": "umbra",
        "environment": machine,
        "statements": [statement],
        "proofs": {"identity": [{"scenario": "s", "ulps": 1.0}]},
    }

    def examine(path: Path, random: Random) -> None:
        document = load_claims(path.parent)
        list(findings.claims_sentence(document))

    return _json_kind("claims.json", "claims.json", [seed], examine)


def engines(folder: Path) -> Kind:
    """The table of the engines side by side."""

    def examine(path: Path, random: Random) -> None:
        _seal(path)
        load_table("engines", path.parent, ENGINES_SCHEMA).to_dicts()

    return Kind(
        "engines.parquet",
        "engines.parquet",
        [_whole((folder / "engines.parquet").read_bytes())],
        _columns,
        _parquet,
        examine,
    )
