"""The same study gives the same numbers, whatever runs beside it, before it or after it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from problems import orbit, spring

from umbra_bench.results import load_table, save_study
from umbra_bench.scenario import Scenario
from umbra_bench.study import Study, run_study

TABLES = ("runs", "orders", "references", "motion", "energy")
ROOT = Path(__file__).resolve().parent.parent


def two() -> list[Scenario]:
    more = {"duration": 1.28, "dt": {"start": 0.08, "halvings": 3}}
    return [
        spring((1.1, 0.3), (-0.4, 0.9), **more).model_copy(update={"name": "swing"}),
        orbit((1.0, 0.1), (0.1, 1.0), **more).model_copy(update={"name": "ring"}),
    ]


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study(two(), ["umbra", "rk4"])


def of(study: Study, scenario: str) -> dict[str, pl.DataFrame]:
    """The tables of one scenario, without its timings."""
    return {
        name: getattr(study, name)
        .filter(pl.col("scenario") == scenario)
        .drop("wall_time", strict=False)
        for name in TABLES
    }


@pytest.mark.parametrize("chosen", [slice(None, None, -1), slice(0, 1), slice(1, 2)])
def test_neither_order_nor_company_changes_a_number(study: Study, chosen: slice) -> None:
    scenarios = two()[chosen]
    again = run_study(scenarios, ["umbra", "rk4"])
    for scenario in scenarios:
        expected, found = of(study, scenario.name), of(again, scenario.name)
        for name in TABLES:
            assert_frame_equal(found[name], expected[name], check_exact=True)


def test_the_order_of_methods_changes_no_number(study: Study) -> None:
    again = run_study(two(), ["rk4", "umbra"])
    key = ["scenario", "method", "precision", "dt"]
    one, other = (s.runs.drop("wall_time").sort(key) for s in (study, again))
    assert_frame_equal(one, other, check_exact=True)


def test_the_same_study_is_the_same_bytes_on_disk_apart_from_timings(
    study: Study, tmp_path: Path
) -> None:
    for name in ("first", "second"):
        save_study(run_study(two(), ["umbra", "rk4"]), tmp_path / name)
    for path in sorted((tmp_path / "first").iterdir()):
        if path.name not in ("study.csv", "study.parquet", "study.sha256"):
            assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes(), path.name
    one, other = (
        load_table("study", tmp_path / name).drop("wall_time").write_csv()
        for name in ("first", "second")
    )
    assert one == other


def test_kills_and_limits_leave_whole_results() -> None:
    """A few of what `make trust` does by the fifty."""
    words = [sys.executable, "trust/kills.py", "--kills", "1", "--commands", "0", "--resumed", "0"]
    done = subprocess.run(
        words,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "kills survived: 2 of 2" in done.stdout
