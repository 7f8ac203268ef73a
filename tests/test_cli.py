"""The command line's contract: what it writes, what it refuses, and with which exit code."""

from __future__ import annotations

import csv
import json
import math
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from umbra_bench import cli
from umbra_bench.methods import METHODS
from umbra_bench.scenario import FORCE_KINDS, Scenario, load_scenario

ROOT = Path(__file__).resolve().parent.parent
COMMAND = Path(sys.executable).with_name("umbra-bench")

HEADER = "t,body,x,y,angle,vx,vy,omega,energy"

SWING = """
name = "swing"
title = "Swing"
family = "spring"
duration = 1.0
dt = { start = 0.05, halvings = 4 }
forces = [
    { kind = "spring", body = "left", anchor = [0.1, -0.2], stiffness = 8.0 },
    { kind = "spring", body = "left", other = "right, the other", stiffness = 3.0 },
]

[[bodies]]
name = "left"
mass = 2.0
position = [1.1, 0.3]
velocity = [-0.4, 0.9]

[[bodies]]
name = "right, the other"
mass = 0.7
position = [0.3, 1.7]
angle = 0.3
angular_velocity = -1.1
"""

ORBIT = """
name = "orbit"
title = "Orbit"
family = "orbit"
duration = 1.0
dt = { start = 0.05, halvings = 1 }
bodies = [{ name = "planet", mass = 1.0, position = [1.0, 0.0], velocity = [0.0, 1.0] }]
forces = [{ kind = "central_gravity", body = "planet", mu = 1.0 }]
"""


class Outcome(NamedTuple):
    """How a command ended."""

    code: int
    stdout: str
    stderr: str


Run = Callable[..., Outcome]


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache folder that the tests share, in the place of the user's."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def _cache_of_the_tests(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    """The processes that a test starts write no compiled code into the user's cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process."""

    def run_main(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["umbra-bench", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ending:
            cli.main()
        code = ending.value.code
        assert isinstance(code, int)
        return Outcome(code, *capfd.readouterr())

    return run_main


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    """A scenario file outside scenarios/: two bodies on two springs, 1 s."""
    path = tmp_path / "elsewhere" / "swing.toml"
    path.parent.mkdir()
    path.write_text(SWING, encoding="utf-8")
    return path


@pytest.fixture
def orbit(tmp_path: Path) -> Path:
    path = tmp_path / "orbit.toml"
    path.write_text(ORBIT, encoding="utf-8")
    return path


def installed(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    """Run the installed command in a process of its own."""
    words = [str(COMMAND), *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=120, **options)  # type: ignore[call-overload]


def rows_of(text: str) -> list[dict[str, str]]:
    header, *_ = text.splitlines()
    assert header == HEADER
    return list(csv.DictReader(text.splitlines(), strict=True))


def refused(outcome: Outcome) -> str:
    """The one line of a command that could not do it."""
    assert outcome.code == 2
    assert outcome.stdout == ""
    assert outcome.stderr.endswith("\n")
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("umbra-bench: ")
    assert "Traceback" not in line
    return line.removeprefix("umbra-bench: ")


# simulate -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("steps", "every", "counts"),
    [
        (6, 1, [0, 1, 2, 3, 4, 5, 6]),
        (6, 3, [0, 3, 6]),
        (7, 3, [0, 3, 6, 7]),
        (2, 3, [0, 2]),
        (1, 1, [0, 1]),
        (20, 100, [0, 20]),
    ],
)
def test_a_row_per_body_every_so_many_steps(
    run: Run, swing: Path, steps: int, every: int, counts: list[int]
) -> None:
    words = ("--method", "umbra", "--dt", 0.05, "--steps", steps, "--every", every)
    outcome = run("simulate", swing, *words)
    assert (outcome.code, outcome.stderr) == (0, "")
    rows = rows_of(outcome.stdout)
    bodies = ["left", "right, the other"]
    assert [(float(row["t"]), row["body"]) for row in rows] == [
        (count * 0.05, body) for count in counts for body in bodies
    ]


def test_the_start_is_as_the_scenario_states_it(run: Run, swing: Path) -> None:
    rows = rows_of(run("simulate", swing, "--method", "umbra", "--dt", 0.05).stdout)
    left, right = ({k: float(v) for k, v in row.items() if k != "body"} for row in rows[:2])
    assert [left[key] for key in ("t", "x", "y", "angle")] == [0.0, 1.1, 0.3, 0.0]
    assert [left[key] for key in ("vx", "vy", "omega")] == [-0.4, 0.9, 0.0]
    assert [right[key] for key in ("x", "y", "angle", "omega")] == [0.3, 1.7, 0.3, -1.1]
    # T + V by hand; the whole system's energy stands in the row of every body.
    kinetic = 0.5 * 2.0 * (0.4**2 + 0.9**2) + 0.5 * 0.7 * 1.1**2
    potential = 0.5 * 8.0 * (1.0**2 + 0.5**2) + 0.5 * 3.0 * (0.8**2 + 1.4**2)
    assert left["energy"] == right["energy"] == pytest.approx(kinetic + potential, rel=1e-14)


def test_by_default_as_many_steps_as_fit_in_the_duration(run: Run, swing: Path) -> None:
    for dt, steps in ((0.05, 20), (0.1, 10), (0.3, 3), (1.0, 1)):
        outcome = run("simulate", swing, "--method", "umbra", "--dt", dt, "--every", 1000)
        rows = rows_of(outcome.stdout)
        assert [float(row["t"]) for row in rows] == [0.0, 0.0, steps * dt, steps * dt]


@pytest.mark.parametrize(
    ("method", "precision"),
    [("umbra", "float64"), ("umbra", "float32"), ("pymunk", "float64"), ("pymunk", "float32")],
)
def test_numbers_read_back_exactly(run: Run, swing: Path, method: str, precision: str) -> None:
    from umbra_bench.study import simulate

    words = ("--method", method, "--dt", 0.05, "--precision", precision)
    outcome = run("simulate", swing, *words)
    assert (outcome.code, outcome.stderr) == (0, "")
    rows = rows_of(outcome.stdout)
    trajectory = simulate(load_scenario(swing), method, 0.05, precision=precision)
    kept = "float64" if method == "pymunk" else precision  # an engine keeps its own
    assert trajectory.position.dtype == np.dtype(kept)
    states = np.concatenate([trajectory.position, trajectory.velocity], axis=1)  # (T, 6, N)
    for column, name in enumerate(("x", "y", "angle", "vx", "vy", "omega")):
        written = np.array([row[name] for row in rows]).astype(kept).reshape(-1, 2)
        np.testing.assert_array_equal(written, states[:, column])
    energy = np.array([row["energy"] for row in rows[::2]]).astype(kept)
    np.testing.assert_array_equal(energy, trajectory.at.energy)
    np.testing.assert_array_equal([float(row["t"]) for row in rows[::2]], trajectory.times)
    # As many digits as it takes in the precision of the run, and no more.
    digits = {len(row["x"].lstrip("-0.").replace(".", "")) for row in rows[2:]}
    assert max(digits) <= (9 if kept == "float32" else 17)
    assert max(digits) >= (7 if kept == "float32" else 15)


def test_the_precision_of_a_run_is_that_asked_for(run: Run, swing: Path) -> None:
    words = ("simulate", swing, "--method", "umbra", "--dt", 0.05, "--precision")
    in32, in64 = (rows_of(run(*words, p).stdout) for p in ("float32", "float64"))
    x32 = np.array([float(row["x"]) for row in in32])
    x64 = np.array([float(row["x"]) for row in in64])
    assert 0 < abs(x32 - x64).max() < 1e-5
    for row in in32[2:]:
        assert str(np.float32(row["x"])) == row["x"], "the shortest text of a float32"


def test_what_is_written_does_not_depend_on_how_much_is_kept(
    run: Run, swing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("simulate", swing, "--method", "umbra", "--dt", 0.05, "--every", 2, "--steps", 19)
    at_once = run(*words).stdout
    monkeypatch.setattr("umbra_bench.trajectory_csv.CHUNK", 2)
    assert run(*words).stdout == at_once
    assert len(rows_of(at_once)) == 2 * 11


def test_the_reference_can_be_written_too(run: Run, swing: Path) -> None:
    words = ("--method", "reference", "--dt", 0.05, "--every", 10)
    rows = rows_of(run("simulate", swing, *words).stdout)
    assert [float(row["t"]) for row in rows[::2]] == [0.0, 0.5, 1.0]
    energies = [float(row["energy"]) for row in rows]
    assert energies == pytest.approx([energies[0]] * len(rows), rel=1e-12)


def test_a_run_that_diverges_is_written_and_said(run: Run, swing: Path) -> None:
    words = ("--method", "umbra", "--dt", 1e6, "--steps", 80)
    outcome = run("simulate", swing, *words)
    assert outcome.code == 0
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("umbra-bench: umbra diverged at t = ")
    rows = rows_of(outcome.stdout)
    assert len(rows) == 2 * 81
    assert not math.isfinite(float(rows[-1]["energy"]))


# --output -----------------------------------------------------------------------------------------


def test_output_is_what_would_have_been_printed(run: Run, swing: Path, tmp_path: Path) -> None:
    words = ("simulate", swing, "--method", "umbra", "--dt", 0.05)
    printed = run(*words)
    target = tmp_path / "new" / "folder" / "run.csv"
    written = run(*words, "--output", target)
    assert written == Outcome(0, "", "")
    assert target.read_bytes() == printed.stdout.encode()
    assert [path.name for path in target.parent.iterdir()] == ["run.csv"]
    assert run(*words, "--output", "-") == printed


@pytest.mark.parametrize(
    "words",
    [
        ("--method", "umbre", "--dt", 0.05),
        ("--method", "umbra", "--dt", -0.05),
        ("--method", "umbra", "--dt", 0.05, "--steps", 0),
    ],
    ids=["method", "dt", "steps"],
)
def test_a_bad_request_leaves_the_old_file(
    run: Run, swing: Path, tmp_path: Path, words: tuple[object, ...]
) -> None:
    target = tmp_path / "out" / "run.csv"
    target.parent.mkdir()
    target.write_text("old", encoding="utf-8")
    refused(run("simulate", swing, *words, "--output", target))
    assert target.read_text(encoding="utf-8") == "old"
    assert list(target.parent.iterdir()) == [target]


def test_a_run_that_is_interrupted_leaves_the_old_file(
    run: Run, swing: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from umbra_bench.engines import EngineRun

    advance, seen = EngineRun.advance, []

    def interrupted(self: EngineRun, stride: int, samples: int) -> object:
        seen.append(sorted(path.name for path in target.parent.iterdir()))
        if len(seen) == 3:
            raise KeyboardInterrupt
        return advance(self, stride, samples)

    monkeypatch.setattr(EngineRun, "advance", interrupted)
    monkeypatch.setattr("umbra_bench.trajectory_csv.CHUNK", 2)
    target = tmp_path / "out" / "run.csv"
    target.parent.mkdir()
    target.write_text("old", encoding="utf-8")
    words = ("--method", "pymunk", "--dt", 0.05, "--output", target)
    outcome = run("simulate", swing, *words)
    assert (outcome.code, outcome.stdout) == (2, "")
    assert (
        outcome.stderr.strip() == "umbra-bench: interrupted"
    )  # below what the terminal shows of ^C
    assert len(seen) == 3
    assert len(seen[-1]) == 2, "what is written stands in a file of its own until it is whole"
    assert target.read_text(encoding="utf-8") == "old"
    assert list(target.parent.iterdir()) == [target]


def test_output_that_cannot_be_written(run: Run, swing: Path, tmp_path: Path) -> None:
    words = ("simulate", swing, "--method", "umbra", "--dt", 0.05, "--steps", 2, "--output")
    for target in (swing / "run.csv", swing / "more" / "run.csv", tmp_path, tmp_path / ("a" * 300)):
        line = refused(run(*words, target))
        assert line.startswith(f"{target}: cannot be written: ")
    assert swing.read_text(encoding="utf-8") == SWING


def test_a_pipe_is_written_to_and_not_replaced(run: Run, swing: Path, tmp_path: Path) -> None:
    """As for any program: --output /dev/null must not put a file in the place of the device."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        words = ("--method", "umbra", "--dt", 0.05, "--steps", 2, "--output", pipe)
        outcome = run("simulate", swing, *words)
        assert stat.S_ISFIFO(pipe.stat().st_mode)
        if outcome.code == 0:
            assert len(rows_of(os.read(reader, 65536).decode())) == 6
        else:
            refused(outcome)
    finally:
        os.close(reader)


# What is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--method", "umbre", "--dt", 0.05), ["'umbre'", "did you mean 'umbra'?", "rk4"]),
        (("--method", "", "--dt", 0.05), ["--method ''", "rk4"]),
        (("--method", "umbra", "--dt", 0), ["--dt 0.0", "> 0"]),
        (("--method", "umbra", "--dt", -0.05), ["--dt -0.05", "> 0"]),
        (("--method", "umbra", "--dt", "nan"), ["--dt nan", "finite"]),
        (("--method", "umbra", "--dt", "inf"), ["--dt inf", "finite"]),
        (("--method", "umbra", "--dt", "-inf", "--steps", 3), ["--dt -inf", "finite"]),
        (("--method", "umbra", "--dt", "fast"), ["--dt", "'fast'"]),
        (("--method", "umbra", "--dt", 1.5), ["--dt 1.5", "longer", "1.0 s", "swing"]),
        (("--method", "umbra", "--dt", 1e300), ["--dt 1e+300", "longer"]),
        (("--method", "umbra"), ["--dt"]),
        (("--dt", 0.05), ["--method"]),
        (("--method", "umbra", "--dt", 0.05, "--steps", 0), ["--steps", "0", "1<=x"]),
        (("--method", "umbra", "--dt", 0.05, "--steps", -3), ["--steps", "-3"]),
        (("--method", "umbra", "--dt", 0.05, "--steps", 2.5), ["--steps", "2.5"]),
        (("--method", "umbra", "--dt", 0.05, "--every", 0), ["--every", "0", "1<=x"]),
        (("--method", "umbra", "--dt", 0.05, "--every", "x"), ["--every", "'x'"]),
        (
            ("--method", "umbra", "--dt", 0.05, "--precision", "float16"),
            ["--precision", "'float16'", "float32", "float64"],
        ),
        (("--method", "umbra", "--dt", 0.05, "--colour", "red"), ["--colour"]),
        (("another", "--method", "umbra", "--dt", 0.05), ["another"]),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)
def test_simulate_refuses(
    run: Run, swing: Path, words: tuple[object, ...], said: list[str]
) -> None:
    line = refused(run("simulate", swing, *words))
    assert all(part in line for part in said)


@pytest.mark.parametrize(
    "words",
    [
        ("--dt", 1e-310),
        ("--dt", 0.05, "--steps", 10**30, "--every", 10**30),
        ("--dt", 0.05, "--steps", 10**19, "--every", 10**19),
    ],
    ids=["dt", "steps", "steps-64-bit"],
)
def test_simulate_refuses_more_steps_than_can_be_counted(
    run: Run, swing: Path, words: tuple[object, ...]
) -> None:
    line = refused(run("simulate", swing, "--method", "umbra", *words))
    assert "--dt" in line or "--steps" in line


def test_a_step_that_is_nothing_in_the_precision_of_the_run_is_refused(
    run: Run, swing: Path
) -> None:
    """In float32 it would be rounded to 0 or to infinity, and nothing or nonsense would move."""
    words = ("--method", "umbra", "--steps", 2, "--precision", "float32")
    for dt in (1e-50, 1e50):
        assert "--dt" in refused(run("simulate", swing, *words, "--dt", dt))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sprng", ["'sprng'", "did you mean 'spring'?", "free_fall"]),
        ("", ["''"]),
        ("none.toml", ["none.toml"]),
        ("none/spring", ["none/spring"]),
        ("/", ["'/'"]),
        ("a" * 300, ["aaa"]),
    ],
    ids=lambda value: value[:12] if isinstance(value, str) else "",
)
def test_a_scenario_that_is_not_there(run: Run, name: str, said: list[str]) -> None:
    for words in (("simulate", name, "--method", "umbra", "--dt", 0.05), ("study", name)):
        line = refused(run(*words))
        assert all(part in line for part in said)


@pytest.mark.parametrize(
    ("written", "wrong", "said"),
    [
        ("mass = 2.0", "mass = -2.0", "bodies[0].mass = -2.0"),
        ("angle = 0.3", "angel = 0.3", "bodies[1].angel: unknown key; did you mean 'angle'?"),
        ("duration = 1.0", "duration = nan", "duration = nan"),
        ("angle = 0.3", 'shape = { kind = "circle", radius = 1e200 }', "bodies[1]"),
        ('"swing"', '"swang"', "name = 'swang'"),
        ('"Swing"', '"Swing', "TOML"),
    ],
    ids=["value", "key", "nan", "overflow", "name", "toml"],
)
def test_a_scenario_file_that_is_wrong(
    run: Run, swing: Path, written: str, wrong: str, said: str
) -> None:
    assert written in SWING
    swing.write_text(SWING.replace(written, wrong, 1), encoding="utf-8")
    line = refused(run("simulate", swing, "--method", "umbra", "--dt", 0.05))
    assert str(swing) in line
    assert said in line


@pytest.mark.parametrize(
    ("written", "wrong"),
    [("mass = 2.0", "mass = 1e50"), ("mass = 2.0", "mass = 1e-50"), ("[1.1, 0.3]", "[1e50, 0.3]")],
)
def test_numbers_that_float32_does_not_hold_make_no_warnings(
    run: Run, swing: Path, written: str, wrong: str
) -> None:
    """Refused in one line, or run and said to have diverged: a warning is neither."""
    swing.write_text(SWING.replace(written, wrong, 1), encoding="utf-8")
    words = ("--method", "umbra", "--dt", 0.05, "--precision", "float32")
    outcome = run("simulate", swing, *words)
    assert outcome.code in (0, 2)
    assert len(outcome.stderr.splitlines()) <= 1
    assert outcome.stderr == "" or outcome.stderr.startswith("umbra-bench: ")


def test_an_engine_that_cannot_do_a_scenario_says_why(run: Run, orbit: Path) -> None:
    line = refused(run("simulate", orbit, "--method", "pymunk-spring", "--dt", 0.05))
    assert "pymunk" in line
    assert "central_gravity" in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("frobnicate",), "frobnicate"),
        (("--frobnicate",), "--frobnicate"),
        (("simulate",), "SCENARIO"),
        (("list",), "scenarios"),
        (("list", "planets"), "planets"),
        (("study", "spring", "--method", "umbre"), "did you mean 'umbra'?"),
        (("study", "spring", "--method", "reference"), "'reference'"),
        (("study", "spring", "--precision", "float16"), "float16"),
        (("study", "spring", "sprong"), "'sprong'"),
        (("report", "--results", "nowhere"), "nowhere"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_other_commands_refuse(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused(run(*words))
    assert list(tmp_path.iterdir()) == []


# list ---------------------------------------------------------------------------------------------


def test_list_scenarios(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    names = sorted(path.stem for path in (ROOT / "scenarios").glob("*.toml"))
    outcome = run("list", "scenarios")
    assert (outcome.code, outcome.stderr) == (0, "")
    assert [line.split()[0] for line in outcome.stdout.splitlines()] == names
    rows = json.loads(run("list", "scenarios", "--json").stdout)
    assert [row["name"] for row in rows] == names
    for row in rows:
        scenario: Scenario = load_scenario(row["name"])
        assert (row["title"], row["family"]) == (scenario.title, scenario.family)
        assert row["duration"] == scenario.duration
        assert row["steps"] == list(scenario.steps)


def test_list_methods(run: Run) -> None:
    outcome = run("list", "methods")
    assert (outcome.code, outcome.stderr) == (0, "")
    assert [line.split()[0] for line in outcome.stdout.splitlines()] == list(METHODS)
    rows = json.loads(run("list", "methods", "--json").stdout)
    assert {row["name"]: row["title"] for row in rows} == {
        m.name: m.title for m in METHODS.values()
    }
    promised = {
        *("explicit-euler", "semi-implicit-euler", "velocity-verlet", "rk4", "yoshida4", "umbra"),
        *("umbra-repaired", "reference", "pymunk", "pymunk-velocity-func", "pymunk-spring"),
    }
    assert promised <= set(METHODS)


def test_list_forces(run: Run) -> None:
    outcome = run("list", "forces")
    assert (outcome.code, outcome.stderr) == (0, "")
    assert [line.split()[0] for line in outcome.stdout.splitlines()] == list(FORCE_KINDS)
    rows = json.loads(run("list", "forces", "--json").stdout)
    assert {row["name"] for row in rows} == {
        *("spring", "torsion_spring", "central_gravity", "mutual_gravity"),
        *("constant_force", "constant_torque", "drag"),
    }
    for row in rows:
        assert row["title"]
        assert row["keys"]
        for key, description in row["keys"].items():
            assert description, f"{row['name']}.{key} is described"


def test_list_says_which_scenario_file_is_wrong(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "broken.toml").write_text("name = 3", encoding="utf-8")
    assert "broken.toml" in refused(run("list", "scenarios"))


# The installed command ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["-h"],
        ["--version"],
        *([c, "--help"] for c in ("simulate", "study", "report", "list")),
    ],
    ids=" ".join,
)
def test_help_and_version(run: Run, words: list[str]) -> None:
    outcome = run(*words)
    assert (outcome.code, outcome.stderr) == (0, "")
    assert outcome.stdout.strip()
    if words == ["--help"]:
        assert all(command in outcome.stdout for command in ("simulate", "study", "report", "list"))


def test_the_command_starts_without_numerical_libraries() -> None:
    code = (
        "import sys; import umbra_bench, umbra_bench.cli; "
        "heavy = {'jax', 'numpy', 'scipy', 'diffrax', 'polars', 'matplotlib', 'pydantic', 'pymunk'}; "
        "sys.exit(repr(sorted(heavy & set(sys.modules))) if heavy & set(sys.modules) else 0)"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60
    )
    assert (outcome.returncode, outcome.stderr) == (0, "")
    helped = installed("--help")
    assert (helped.returncode, helped.stderr) == (0, "")
    assert helped.stdout.startswith("Usage: umbra-bench")


def test_the_installed_command_simulates_a_file_from_anywhere(swing: Path, cache: Path) -> None:
    words = ("--method", "semi-implicit-euler", "--dt", 0.1, "--steps", 3)
    outcome = installed("simulate", "swing.toml", *words, cwd=swing.parent)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert len(rows_of(outcome.stdout)) == 2 * 4
    assert any((cache / "umbra-bench").iterdir()), "compiled code is kept in the user's cache"


def test_the_installed_command_refuses_in_one_line() -> None:
    outcome = installed("list", "planets")
    assert "'planets'" in refused(Outcome(outcome.returncode, outcome.stdout, outcome.stderr))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_standard_output_that_cannot_be_written() -> None:
    with Path("/dev/full").open("w") as full:
        outcome = subprocess.run(
            [str(COMMAND), "list", "methods"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
    assert outcome.returncode == 2
    assert len(outcome.stderr.splitlines()) == 1


def test_a_reader_that_had_enough_ends_the_command_well() -> None:
    """`umbra-bench list methods | true`: nothing is wrong, and nothing was judged to be bad."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed:
        outcome = subprocess.run(
            [str(COMMAND), "list", "methods"],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
    assert outcome.returncode == 0
    assert outcome.stderr == ""
