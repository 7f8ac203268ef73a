"""The tables of a study: what they hold, and that they are on disk whole or not at all."""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import json
import math
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import umbra_bench
from umbra_bench import cli, results
from umbra_bench.errors import UmbraBenchError
from umbra_bench.methods import METHODS
from umbra_bench.results import (
    fingerprint,
    holds,
    load_table,
    replacing,
    save_json,
    save_study,
    save_table,
)
from umbra_bench.scenario import Scenario, parse_scenario, scenario_hash
from umbra_bench.schemas import ENGINES_SCHEMA
from umbra_bench.study import ENGINE_STEPS, Study, run_study

STUDY_COLUMNS = (
    "scenario,method,precision,dt,steps,position_error_max,velocity_error_max,position_error_final,"
    "energy_error_max,energy_drift_rate,angular_momentum_error_max,reference_error,diverged_at,wall_time"
)
ORDERS_COLUMNS = "scenario,method,precision,quantity,order,standard_error,points"

MARKUP = "<script>alert(1)</script> | **x** `y` [z](http://example.org) &lt; \\\\| # 1. d_e_f"
"""A text that no page may take for markup."""

METHODS_RUN = ("velocity-verlet", "umbra", "pymunk", "pymunk-spring")


def spring(
    name: str, stiffness: float, duration: float, halvings: int = 5, **more: Any
) -> Scenario:
    """1 kg on a spring, from 0.08 s down.

    All have laws of the same kinds and 256 samples, so that they share compiled code.
    """
    document: dict[str, Any] = {
        "name": name,
        "title": name.capitalize(),
        "family": "spring",
        "description": "A weight on a spring.",
        "duration": duration,
        "gravity": [0.0, -2.0],
        "dt": {"start": 0.08, "halvings": halvings},
        "bodies": [
            {"name": "weight", "mass": 1.0, "position": [1.1, 0.3], "velocity": [-0.4, 0.9]}
        ],
        "forces": [
            {"kind": "spring", "body": "weight", "anchor": [0.1, -0.2], "stiffness": stiffness}
        ],
    }
    return parse_scenario(document | more, Path(f"{name}.toml"))


def spared() -> Scenario:
    """A weight that gravity spares: more than an engine's own gravity can do."""
    weight = {"name": "weight", "mass": 1.0, "position": [1.1, 0.3], "affected_by_gravity": False}
    return spring("spared", 4.0, 0.64, halvings=1, bodies=[weight])


def scenarios() -> list[Scenario]:
    """A spring that all methods can follow, one too stiff for long steps, and an odd one."""
    return [
        spring("soft", 4.0, 1.28, title=MARKUP, description=MARKUP),
        spring("stiff", 1e4, 10.24, halvings=4, closed_form="normal_modes"),
        spared(),
    ]


@functools.cache
def small_study() -> Study:
    """One study for all tests: every kind of row that there is. Nobody changes it."""
    return run_study(scenarios(), METHODS_RUN)


@pytest.fixture(scope="session")
def study() -> Study:
    return small_study()


@pytest.fixture(scope="session")
def folder(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study on disk. Nobody changes it."""
    path = tmp_path_factory.mktemp("results")
    save_study(study, path)
    return path


@functools.cache
def tiny_study() -> Study:
    """One row, for tests that write."""
    return run_study([spring("tiny", 4.0, 0.16, halvings=0)], ["umbra"], ["float64"])


def runs(study: Study, scenario: str, method: str, precision: str = "float64") -> pl.DataFrame:
    """The rows of one line of a sweep, longest step first."""
    line = {"scenario": scenario, "method": method, "precision": precision}
    rows = study.runs.filter(*(pl.col(key) == value for key, value in line.items()))
    return rows.sort("dt", descending=True)


def without_times(table: pl.DataFrame) -> pl.DataFrame:
    return table.drop("wall_time") if "wall_time" in table.columns else table


# The contract -------------------------------------------------------------------------------------


def test_the_columns_are_those_of_the_contract(folder: Path) -> None:
    for name, columns in (("study", STUDY_COLUMNS), ("orders", ORDERS_COLUMNS)):
        header = (folder / f"{name}.csv").read_text(encoding="utf-8").splitlines()[0]
        assert header == columns
        assert ",".join(load_table(name, folder).columns) == columns


def test_every_table_is_on_disk(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.{ending}" for name in results.TABLES for ending in ("csv", "parquet")),
        *("motion.parquet", "energy.parquet", "scenarios.json", "environment.json"),
        "study.sha256",
    }


@pytest.mark.parametrize("name", ["study", "orders", "references", "skips"])
def test_csv_and_parquet_hold_the_same(study: Study, folder: Path, name: str) -> None:
    memory = {"study": study.runs, "orders": study.orders, "references": study.references}.get(
        name, study.skips
    )
    parquet = load_table(name, folder)
    assert_frame_equal(parquet, memory, check_exact=True)
    kinds = {key: kind for key, kind in parquet.schema.items() if kind != pl.Null}
    text = pl.read_csv(folder / f"{name}.csv", schema_overrides=kinds)
    assert_frame_equal(text.cast(dict(parquet.schema)), parquet, check_exact=True)
    assert parquet.height > 0


def test_motion_and_energy_are_kept_at_the_default_step(study: Study, folder: Path) -> None:
    for name, table in (("motion", study.motion), ("energy", study.energy)):
        assert_frame_equal(load_table(name, folder), table, check_exact=True)
        for scenario in study.scenarios:
            of_one = table.filter(pl.col("scenario") == scenario.name)
            assert set(of_one["dt"]) == {scenario.default_step}
            methods = set(runs_at_default(study, scenario)["method"])
            extra = {"reference"} if name == "motion" else set()
            assert set(of_one["method"]) == methods | extra


def runs_at_default(study: Study, scenario: Scenario) -> pl.DataFrame:
    return study.runs.filter(
        (pl.col("scenario") == scenario.name) & (pl.col("dt") == scenario.default_step)
    )


def test_a_row_per_scenario_method_precision_and_step(study: Study) -> None:
    expected = set()
    for scenario in study.scenarios:
        for name in METHODS_RUN:
            own = METHODS[name].precision
            if (scenario.name, name) == ("spared", "pymunk-spring"):
                continue
            for dt in scenario.steps:
                if own and round(scenario.duration / dt) > ENGINE_STEPS:
                    continue
                for precision in [own] if own else ["float32", "float64"]:
                    expected.add((scenario.name, name, precision, dt))
    keys = study.runs.select("scenario", "method", "precision", "dt").rows()
    assert len(keys) == len(set(keys))
    assert set(keys) == expected
    for name, dt, steps in study.runs.select("scenario", "dt", "steps").rows():
        duration = next(s.duration for s in study.scenarios if s.name == name)
        assert steps == round(duration / dt)


def test_an_order_per_scenario_method_precision_and_quantity(study: Study) -> None:
    lines = set(study.runs.select("scenario", "method", "precision").rows())
    keys = study.orders.select("scenario", "method", "precision", "quantity").rows()
    assert len(keys) == len(set(keys))
    assert set(keys) == {(*line, q) for line in lines for q in ("position", "velocity", "energy")}
    first = study.orders.row(
        by_predicate=(pl.col("scenario") == "soft")
        & (pl.col("method") == "velocity-verlet")
        & (pl.col("precision") == "float64")
        & (pl.col("quantity") == "position"),
        named=True,
    )
    assert first["order"] == pytest.approx(2.0, abs=0.05)
    assert first["points"] >= 3
    assert 0.0 <= first["standard_error"] < 0.05


@pytest.mark.parametrize("asked", [["float32"], ["float64"], ["float32", "float64"]], ids=" ".join)
def test_an_engine_keeps_its_own_precision(asked: list[str]) -> None:
    found = run_study([spared()], ["velocity-verlet", "pymunk"], asked)
    of = {
        name: found.runs.filter(pl.col("method") == name)["precision"].to_list()
        for name in ("velocity-verlet", "pymunk")
    }
    assert of["pymunk"] == ["float64"] * 2
    assert sorted(of["velocity-verlet"]) == sorted(asked * 2)
    engine = found.motion.filter(pl.col("method") == "pymunk")
    assert set(engine["precision"]) == {"float64"}


def test_errors_are_measured_against_the_reference(study: Study) -> None:
    """The columns of a row follow from the motion that was kept, where every step was kept."""
    row = runs(study, "soft", "umbra").filter(pl.col("dt") == 0.01).row(0, named=True)
    tables = [
        study.motion.filter((pl.col("scenario") == "soft") & (pl.col("method") == method))
        .filter(pl.col("precision") == "float64")
        .sort("t")
        for method in ("umbra", "reference")
    ]
    method, truth = (
        table.filter((pl.col("t") / 0.01 - (pl.col("t") / 0.01).round()).abs() < 1e-6)
        for table in tables
    )
    assert method.height == truth.height == 129
    far = ((method["x"] - truth["x"]) ** 2 + (method["y"] - truth["y"]) ** 2).sqrt()
    assert row["position_error_max"] == pytest.approx(far.max(), rel=1e-9)
    assert row["position_error_final"] == pytest.approx(far[-1], rel=1e-9)
    fast = ((method["vx"] - truth["vx"]) ** 2 + (method["vy"] - truth["vy"]) ** 2).sqrt()
    assert row["velocity_error_max"] == pytest.approx(fast.max(), rel=1e-9)
    assert row["reference_error"] < 1e-3 * row["position_error_max"]
    assert row["energy_error_max"] > 0.0
    assert row["wall_time"] > 0.0
    assert row["diverged_at"] is None


def test_a_method_that_blows_up_is_a_row_like_others(study: Study) -> None:
    """The stiff spring has omega = 100 rad/s: velocity Verlet holds below dt = 0.02 s."""
    rows = runs(study, "stiff", "velocity-verlet")
    assert rows["dt"].to_list() == [0.08, 0.04, 0.02, 0.01, 0.005]
    assert rows["diverged_at"].is_null().to_list() == [False, False, True, True, True]
    for precision in ("float64", "float32"):
        worst = runs(study, "stiff", "velocity-verlet", precision).row(0, named=True)
        assert 0.0 < worst["diverged_at"] < 4.0
        assert worst["energy_error_max"] == worst["angular_momentum_error_max"] == math.inf
        assert math.isnan(worst["energy_drift_rate"])
        for column in ("position_error_max", "velocity_error_max", "position_error_final"):
            assert worst[column] > 1e200
    assert worst["position_error_max"] == math.inf, "float32 holds no such number"
    # Errors are infinite, not missing.
    errors = study.runs.select(pl.col("^.*_error_.*$"))
    assert errors.null_count().sum_horizontal().item() == 0
    assert not any(errors.select(pl.all().is_nan().any()).row(0))
    # pymunk, which is explicit Euler, holds nowhere: no order, and nobody else is disturbed.
    assert runs(study, "stiff", "pymunk")["diverged_at"].null_count() == 0
    order = study.orders.filter(pl.col("scenario") == "stiff", pl.col("method") == "pymunk")
    assert order["order"].is_nan().all()
    assert (order["points"] == 0).all()
    assert runs(study, "soft", "pymunk")["diverged_at"].null_count() == 6


def test_what_was_not_run_is_recorded_with_the_reason(study: Study, folder: Path) -> None:
    (skip,) = load_table("skips", folder).rows(named=True)
    assert (skip["scenario"], skip["method"]) == ("spared", "pymunk-spring")
    assert "gravity" in skip["reason"]
    assert runs(study, "spared", "pymunk-spring").is_empty()


def test_the_same_study_twice_gives_the_same_tables(study: Study) -> None:
    again = run_study(scenarios(), METHODS_RUN)
    for name in ("runs", "orders", "references", "skips", "motion", "energy"):
        first, second = (without_times(getattr(s, name)) for s in (study, again))
        assert_frame_equal(first, second, check_exact=True)


def test_a_quick_study_is_the_longest_steps_of_the_full_one(study: Study) -> None:
    quick = run_study(scenarios()[:1], ["umbra", "pymunk"], ["float64"], quick=True)
    for method in ("umbra", "pymunk"):
        short, full = runs(quick, "soft", method), runs(study, "soft", method)
        assert 1 < short.height < full.height
        assert_frame_equal(
            without_times(short), without_times(full.head(short.height)), check_exact=True
        )


def test_progress_is_told() -> None:
    told: list[tuple[str, int, int]] = []
    run_study(
        [spared()],
        ["velocity-verlet", "pymunk"],
        ["float64"],
        listener=lambda what, done, total: told.append((what, done, total)),
    )
    assert told == [("spared", 1, 1)]


SOFT = """
name = "soft"
title = "Soft"
family = "spring"
duration = 1.28
gravity = [0.0, -2.0]
dt = { start = 0.08, halvings = 5 }
bodies = [{ name = "weight", mass = 1.0, position = [1.1, 0.3], velocity = [-0.4, 0.9] }]
forces = [{ kind = "spring", body = "weight", anchor = [0.1, -0.2], stiffness = 4.0 }]
"""


def test_the_command_writes_the_tables_and_says_where(
    study: Study,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("soft.toml").write_text(SOFT, encoding="utf-8")
    words = [
        "soft.toml",
        "--method",
        "umbra",
        "--precision",
        "float64",
        "--quick",
        "--results",
        "t",
    ]
    monkeypatch.setattr(sys, "argv", ["umbra-bench", "study", *words])
    with pytest.raises(SystemExit) as ending:
        cli.main()
    stdout, stderr = capfd.readouterr()
    assert ending.value.code == 0
    assert stdout == "4 runs in t/study.csv, orders in t/orders.csv\n"
    assert stderr.splitlines() == ["[1/1] soft"]
    written = load_table("study", Path("t"))
    expected = runs(study, "soft", "umbra").head(4)
    assert_frame_equal(without_times(written), without_times(expected), check_exact=True)


# Studies of unusual form --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("methods", "said"), [(["umbre"], "did you mean 'umbra'?"), (["reference"], "'reference'")]
)
def test_a_study_of_no_such_method(methods: list[str], said: str) -> None:
    with pytest.raises(UmbraBenchError, match=re.escape(said)):
        run_study([spared()], methods)


def test_an_engine_that_no_step_is_long_enough_for_is_skipped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A scenario of many steps (100 s at 0.04 s): an engine takes none, and the study goes on."""
    monkeypatch.setattr("umbra_bench.study.ENGINE_STEPS", 1)
    found = run_study([spared()], ["umbra", "pymunk"], ["float64"])
    assert set(found.runs["method"]) == set(found.orders["method"]) == {"umbra"}
    (skip,) = found.skips.rows(named=True)
    assert (skip["scenario"], skip["method"]) == ("spared", "pymunk")
    assert skip["reason"]


def test_a_study_of_nothing(tmp_path: Path) -> None:
    with contextlib.suppress(UmbraBenchError):
        empty = run_study([], ["umbra"])
        assert empty.runs.height == 0
        save_study(empty, tmp_path)


def test_what_is_named_twice_is_run_once() -> None:
    """A row per scenario, method, precision and dt."""
    soft = spring("soft", 4.0, 0.16, halvings=0)
    found = run_study([soft, soft], ["umbra", "umbra"], ["float64", "float64"])
    keys = found.runs.select("scenario", "method", "precision", "dt").rows()
    assert keys == [("soft", "umbra", "float64", 0.08)]
    assert found.references.height == 1


def test_two_scenarios_of_one_name_are_not_confused() -> None:
    """Tables know scenarios by name: none of two different ones may go without a word."""
    two = [spring("soft", stiffness, 0.16, halvings=0) for stiffness in (4.0, 9.0)]
    with pytest.raises(UmbraBenchError, match="soft"):
        run_study(two, ["umbra"], ["float64"])


def test_the_names_of_the_package_are_always_the_same_things() -> None:
    """`ub.simulate` is a function the first time and every time, whatever was imported before."""
    for name in umbra_bench.__all__:
        assert callable(getattr(umbra_bench, name)), name
        assert getattr(umbra_bench, name) is getattr(umbra_bench, name)


# On disk ------------------------------------------------------------------------------------------


def test_missing_results_are_named_with_what_to_run(tmp_path: Path) -> None:
    for results_folder in (tmp_path / "nowhere", tmp_path):
        for name in ("study", "orders", "motion"):
            with pytest.raises(UmbraBenchError) as caught:
                load_table(name, results_folder)
            message = str(caught.value)
            assert message.splitlines() == [message]
            assert message.startswith(f"{results_folder / name}.parquet: missing")
            assert "umbra-bench study" in message


@pytest.mark.parametrize(
    "content", [b"", b"not Parquet", b"PAR1" * 10], ids=["empty", "text", "cut"]
)
def test_results_that_cannot_be_read(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "study.parquet").write_bytes(content)
    with pytest.raises(UmbraBenchError) as caught:
        load_table("study", tmp_path)
    message = str(caught.value)
    assert message.splitlines() == [message]
    assert message.startswith(f"{tmp_path}/study.parquet: has no seal")


def test_a_folder_may_have_any_name(tmp_path: Path) -> None:
    for name in ("a folder", "2024-05-17 [quick]", "Übung*", "{}"):
        save_study(tiny_study(), tmp_path / name)
        assert_frame_equal(load_table("study", tmp_path / name), tiny_study().runs)


FAILURES = {
    "full disk": (OSError(28, "No space left on device"), UmbraBenchError),
    "interrupt": (KeyboardInterrupt(), KeyboardInterrupt),
    "bug": (ZeroDivisionError(), ZeroDivisionError),
}


@pytest.mark.parametrize("writer", ["write_csv", "write_parquet"])
@pytest.mark.parametrize("failure", FAILURES)
def test_a_study_that_dies_while_it_is_written_leaves_the_old_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: str, failure: str
) -> None:
    save_study(tiny_study(), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    error, seen = FAILURES[failure]
    touched = []

    def dies(table: pl.DataFrame, file: Path) -> None:
        Path(file).write_text("half of a ta", encoding="utf-8")
        touched.append(Path(file))
        raise error

    monkeypatch.setattr(pl.DataFrame, writer, dies)
    with pytest.raises(seen):
        save_study(tiny_study(), tmp_path)
    assert touched
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "value.json"
    save_json({"b": [1, 2.5], "a": None}, path)
    first = path.read_text(encoding="utf-8")
    assert json.loads(first) == {"a": None, "b": [1, 2.5]}
    assert first.endswith("}\n")
    assert path.stat().st_mode & 0o777 == 0o644
    with pytest.raises(ValueError, match="JSON"):
        save_json(math.nan, path)
    with replacing(path) as temporary:
        temporary.write_text("[]", encoding="utf-8")
        assert temporary.parent == path.parent, "on one disk, so that the replacement is atomic"
        assert path.read_text(encoding="utf-8") == first
    assert path.read_text(encoding="utf-8") == "[]"
    assert list(path.parent.iterdir()) == [path]


def test_results_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(UmbraBenchError) as caught:
        save_study(tiny_study(), tmp_path / "file" / "results")
    message = str(caught.value)
    assert message.splitlines() == [message]
    assert message.startswith(f"{tmp_path}/file/results: cannot be written: ")
    assert (tmp_path / "file").read_text(encoding="utf-8") == "in the way"


def test_the_environment_is_recorded(study: Study, folder: Path) -> None:
    text = (folder / "environment.json").read_text(encoding="utf-8")
    environment = json.loads(text)
    assert environment["python"] == ".".join(map(str, sys.version_info[:3]))
    assert environment["processor"]
    assert environment["cores"] == os.cpu_count()
    for name in ("umbra-bench", "numpy", "jax", "diffrax", "pymunk", "polars"):
        assert environment["packages"][name] == importlib.metadata.version(name)
    assert environment["scenarios"] == {s.name: scenario_hash(s) for s in study.scenarios}
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in environment["scenarios"].values())


def test_nothing_on_disk_tells_where_it_was_made(folder: Path) -> None:
    places = {
        str(Path.cwd()),
        str(Path.home()),
        sys.prefix,
        str(Path(__file__).parent),
        str(folder),
    }
    for path in folder.iterdir():
        content = path.read_bytes()
        for place in places - {"/"}:
            assert place.encode() not in content, f"{path.name} names {place}"
    text = (folder / "environment.json").read_text(encoding="utf-8")
    assert not re.search(r'"/[^"]*"', text)


def test_a_study_is_known_again_by_all_that_it_depends_on(study: Study, tmp_path: Path) -> None:
    soft = study.scenarios
    asked = fingerprint(soft, ["umbra"], ["float64"], False)
    save_table(pl.DataFrame(schema=ENGINES_SCHEMA), "engines", tmp_path)
    save_study(study, tmp_path, asked)
    assert holds(tmp_path, asked)
    stiffer = [soft[0].model_copy(update={"duration": 2.0 * soft[0].duration}), *soft[1:]]
    others = [
        fingerprint(stiffer, ["umbra"], ["float64"], False),
        fingerprint(soft, ["umbra", "rk4"], ["float64"], False),
        fingerprint(soft, ["umbra"], ["float64", "float32"], False),
        fingerprint(soft, ["umbra"], ["float64"], True),
    ]
    assert not any(holds(tmp_path, other) for other in others)
    assert len({asked, *others}) == 5
    assert not holds(tmp_path, fingerprint(soft, ["native:engine.so"], ["float64"], False))
    (tmp_path / "energy.parquet").write_bytes(b"damaged")
    assert not holds(tmp_path, asked)


def test_changed_code_is_measured_anew(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = fingerprint(study.scenarios, ["umbra"], ["float64"], False)
    package = tmp_path / "umbra_bench"
    shutil.copytree(Path(results.__file__).parent, package)
    monkeypatch.setattr(results, "__file__", str(package / "results.py"))
    assert fingerprint(study.scenarios, ["umbra"], ["float64"], False) == before
    with (package / "umbra" / "pipeline.py").open("a") as file:
        file.write("# another line\n")
    assert fingerprint(study.scenarios, ["umbra"], ["float64"], False) != before
