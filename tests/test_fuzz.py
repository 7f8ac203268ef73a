"""Odd files: a hundred of the search of `trust/`, and every file that once broke a reader."""

from __future__ import annotations

import random
import time
from pathlib import Path

import inputs
import polars as pl
import pytest
from test_results import small_study, tiny_study

from umbra_bench.drift import run_drift
from umbra_bench.drift_figures import load_long_runs
from umbra_bench.errors import ScenarioError, UmbraBenchError
from umbra_bench.report import load_scenario_tables
from umbra_bench.results import load_json, load_table, save_study, save_table
from umbra_bench.scenario import MAXIMUM_BYTES, load_scenario
from umbra_bench.schemas import ENGINES_SCHEMA
from umbra_bench.sweep.plan import load_plan
from umbra_bench.sweep.work import run_sweep
from umbra_bench.system import build_system

HEAD = """name = "odd"
title = "Odd"
family = "spring"
duration = 1.0
dt = { start = 0.1, halvings = 1 }
"""
BODY = 'bodies = [{ name = "a", mass = 1.0, position = [0.0, 1.0] }]\n'


@pytest.fixture(scope="session")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study on disk with a table of engines."""
    folder = tmp_path_factory.mktemp("study")
    save_study(small_study(), folder)
    run_drift(load_scenario("spring"), ["umbra"], ["float64"], 300, 0.01, folder)
    run_drift(load_scenario("spring"), ["rk4"], ["float32"], 300, 9.0, folder)  # diverges
    row = {"method": "umbra", "version": "", "precision": "either", "integrator": "x"}
    row |= {"velocity": "y", "position_order": 1.0, "energy_error_100": 0.1, "energy_error_60": 0.2}
    save_table(pl.DataFrame([row], ENGINES_SCHEMA), "engines", folder)
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "scenarios",
        "sweeps",
        "baselines",
        "claims.json",
        "engines",
        "kept",
        "stamps",
        *inputs.RESULTS,
    ],
)
def test_odd_files_are_sound_or_refused_in_one_line(name: str, study: Path, tmp_path: Path) -> None:
    match name:
        case "scenarios":
            kind, count = inputs.scenarios(), 30
        case "sweeps":
            kind, count = inputs.sweeps(), 20
        case "kept":
            kind, count = inputs.long_runs(study), 8
        case "stamps":
            kind, count = inputs.stamps(), 5
        case "baselines":
            kind, count = inputs.baselines(), 10
        case "claims.json":
            kind, count = inputs.claims(), 10
        case "engines":
            kind, count = inputs.engines(study), 5
        case _:
            kind, count = inputs.results(study, name), 6
    here = inputs.unsealed_copy(study, tmp_path / "here")
    chance = random.Random(f"suite {name}")
    assert inputs.examined(kind, _put(here / kind.file, kind.seeds[0]), chance) == "accepted"
    for _ in range(count):
        content = kind.mutate(chance, chance.choice(kind.seeds), chance.choice(kind.seeds))
        inputs.examined(kind, _put(here / kind.file, content), chance)


def _put(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


ONCE_WRONG = {
    # what it did: the content, and what is said now
    "all memory: a key of many parts": (
        HEAD + BODY + ".".join(["a"] * 100_000) + " = 1\n",
        "more than 64 parts joined by dots (at line 7)",
    ),
    "minutes: a key of many quoted parts": (
        HEAD + BODY + " . ".join(['"a"'] * 100_000) + " = 1\n",
        "more than 64 parts joined by dots (at line 7)",
    ),
    "minutes: one long word": (HEAD + BODY + "x" * 2_000_000, "not valid TOML"),
    "minutes: a million bodies": (
        HEAD + '[[bodies]]\nname = "a"\nmass = 1.0\nposition = [0.0, 1.0]\n' * 100_000,
        f"is larger than {MAXIMUM_BYTES} bytes",
    ),
    "gigabytes: all pairs of many bodies": (
        HEAD
        + "bodies = ["
        + ",".join(f'{{name="b{i}", mass=1, position=[{i}, 0]}}' for i in range(1500))
        + ']\nforces = [{ kind = "mutual_gravity", gravitational_constant = 1.0, bodies = ['
        + ",".join(f'"b{i}"' for i in range(1500))
        + "] }]\n",
        "1000 at most",
    ),
    "gigabytes: too many samples of too many bodies": (
        HEAD.replace("0.1", "0.00001")
        + "bodies = ["
        + ",".join(f'{{name="b{i}", mass=1, position=[{i}, 0]}}' for i in range(200))
        + "]\n",
        "bodies: 200 of them at 100000 samples are too many states to keep",
    ),
    "a message of 20,000 characters: a long key": (
        HEAD + BODY + "x" * 20_000 + " = 1\n",
        "unknown key",
    ),
    "a message that names no key: an empty one": (HEAD + BODY + '"" = 1\n', "'': unknown key"),
    "colours on the terminal: an escape in a key": (
        HEAD + BODY + '"\\u001b[31m" = 1\n',
        r"'\x1b[31m': unknown key",
    ),
    "a message of megabytes: all names of many bodies": (
        HEAD
        + "bodies = ["
        + ",".join(f'{{name="b{i}", mass=1, position=[{i}, 0]}}' for i in range(5000))
        + ']\nforces = [{ kind = "drag", body = "c", coefficient = 1.0 }]\n',
        "and 4960 more",
    ),
    "no line: not UTF-8": ((HEAD + BODY).encode() + b"# \xff\n", "(at line 7)"),
}


@pytest.mark.parametrize("did", ONCE_WRONG)
def test_a_scenario_file_that_once_broke_the_reader(did: str, tmp_path: Path) -> None:
    content, said = ONCE_WRONG[did]
    path = tmp_path / "odd.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    began = time.process_time()
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert time.process_time() - began < 60.0, "bounded, however slow the machine"
    message = str(caught.value)
    inputs.check_message(message.replace("is larger", "the whole: is larger"), path)
    assert said in message


def test_a_thousand_bodies_are_read_and_built(tmp_path: Path) -> None:
    bodies = ",".join(f'{{name="b{i}", mass=1, position=[{i}, 0]}}' for i in range(1000))
    path = _put(tmp_path / "odd.toml", f"{HEAD}bodies = [{bodies}]\n".encode())
    assert build_system(load_scenario(path)).bodies.mass.shape == (3, 1000)


# Results ------------------------------------------------------------------------------------------


def test_a_damaged_table_is_told_by_its_seal(tmp_path: Path) -> None:
    """Of 400 tables with one to ten bytes changed the Parquet reader took 166 without a word."""
    save_study(tiny_study(), tmp_path)
    path = tmp_path / "study.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(UmbraBenchError, match="is not what was written"):
        load_table("study", tmp_path)
    (tmp_path / "study.sha256").unlink()
    with pytest.raises(UmbraBenchError, match="has no seal"):
        load_table("study", tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (pl.lit(-1.0).alias("dt"), "row 1: dt = -1.0: expected a finite number > 0"),
        (pl.lit(float("nan")).alias("position_error_max"), "row 1: position_error_max = nan"),
        (pl.lit(-1.0).alias("energy_error_max"), "row 1: energy_error_max = -1.0"),
        (pl.lit("../../x").alias("scenario"), "row 1: scenario = '../../x'"),
        (pl.lit("float16").alias("precision"), "row 1: precision = 'float16'"),
        (pl.lit(None, pl.String).alias("method"), "row 1: method = None: expected a value"),
        (pl.lit("1").alias("steps"), "column 'steps': holds String; expected Int64"),
    ],
)
def test_a_table_that_holds_nonsense_is_refused(change: pl.Expr, said: str, tmp_path: Path) -> None:
    save_table(tiny_study().runs.with_columns(change), "study", tmp_path)
    with pytest.raises(UmbraBenchError) as caught:
        load_table("study", tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}/study.parquet: {said}")


def test_a_table_that_states_a_run_twice_or_lacks_a_column_is_refused(tmp_path: Path) -> None:
    runs = tiny_study().runs
    for table, said in (
        (pl.concat([runs, runs]), "row 2: the same scenario, method, precision, dt"),
        (runs.drop("dt"), "column 'dt': missing"),
    ):
        save_table(table, "study", tmp_path)
        with pytest.raises(UmbraBenchError, match=said):
            load_table("study", tmp_path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'{"a": 1, "a": 2}', "the key 'a' is stated twice"),
        (b"[" * 100_000, "is not valid JSON"),
        (b"\xff", "is not valid JSON"),
        (b"1" * 10_000, "is not valid JSON"),
    ],
)
def test_a_document_that_is_not_sound_json(content: bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(UmbraBenchError, match=said) as caught:
        load_json(_put(tmp_path / "a.json", content))
    assert len(str(caught.value).splitlines()) == 1


def test_a_scenario_without_its_reference_is_refused(study: Path, tmp_path: Path) -> None:
    here = inputs.unsealed_copy(study, tmp_path / "here")
    save_table(load_table("references", here).clear(), "references", here)
    with pytest.raises(UmbraBenchError, match=r"references\.parquet: holds no reference of"):
        load_scenario_tables(here)


# Sweeps and long runs -----------------------------------------------------------------------------

SWEEP = """scenario = "spring"
methods = ["umbra"]
vary = [{ key = "dt", values = [0.01] }]
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[0.01]", "[0.0]", "vary[0]: dt = 0.0: expected a step > 0 s"),  # divided by zero
        ("[0.01]", "[1e-30]", "vary[0]: dt = 1e-30: 2e+31 steps in the duration"),  # overflowed
        ("[0.01]", '["0.01"]', "vary[0].values[0] = '0.01'"),  # was taken for a number
        ("[0.01]", "[true]", "vary[0].values[0] = True"),
        ("values = [0.01]", "range = { start = 1, stop = 2, count = 1000000000 }", "count"),  # 8 GB
        ('"spring"', '"../x.toml"', "scenario = '../x.toml': ../x.toml: there is no such"),
        ('"spring"', '"\\u0000.toml"', r"scenario = '\x00.toml'"),
        ("vary", f"{'.'.join(['a'] * 100_000)} = 1\nvary", "more than 64 parts"),  # all memory
        ("key", "kay = 1, key", "vary[0].kay: unknown key; did you mean 'key'?"),
        ("scenario", "scenarios", "scenarios: unknown key; did you mean 'scenario'?"),
    ],
)
def test_a_sweep_file_that_once_broke_the_reader(
    old: str, new: str, said: str, tmp_path: Path
) -> None:
    path = _put(tmp_path / "odd.toml", SWEEP.replace(old, new, 1).encode())
    with pytest.raises(UmbraBenchError) as caught:
        load_plan(path)
    inputs.check_message(str(caught.value), path)
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize("content", [b"[]", b"{}", b'{"fingerprint": 1}'])
def test_a_stamp_that_is_none_is_of_another_sweep(content: bytes, tmp_path: Path) -> None:
    plan = load_plan(_put(tmp_path / "odd.toml", SWEEP.encode()))
    (tmp_path / "sweeps").mkdir()
    _put(tmp_path / "sweeps/odd.json", content)
    with pytest.raises(UmbraBenchError, match=r"odd\.json: holds another sweep .* --restart"):
        run_sweep(plan, tmp_path)


def test_a_law_without_its_samples_is_refused(study: Path, tmp_path: Path) -> None:
    for name in ("drift", "drift_series"):
        table = load_table(name, study, {})
        if name == "drift":
            table = table.with_columns(scenario=pl.lit("other"))
        save_table(table, name, tmp_path)
    with pytest.raises(UmbraBenchError, match=r"row other/.*: has no samples"):
        load_long_runs(tmp_path)
