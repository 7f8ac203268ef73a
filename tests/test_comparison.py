"""Two runs against each other: what a reviewer wants to see, and nothing else."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from umbra_bench.comparison import beside, differences
from umbra_bench.findings import energy_fate
from umbra_bench.overview import overview, print_overview
from umbra_bench.report import tables_of, write_report
from umbra_bench.results import save_study
from umbra_bench.scenario import load_scenario
from umbra_bench.study import Study, run_study


@pytest.fixture(scope="module")
def study() -> Study:
    spring = load_scenario("spring").with_sweep(0.04, 3)
    return run_study([spring], ["explicit-euler", "umbra", "velocity-verlet"])


def spoilt(study: Study, factor: float) -> Study:
    """The same study with larger errors of one method in float64."""
    hit = (pl.col("method") == "umbra") & (pl.col("precision") == "float64")
    column = "position_error_max"
    runs = study.runs.with_columns(
        pl.when(hit).then(pl.col(column) * factor).otherwise(pl.col(column)).alias(column)
    )
    orders = study.orders.with_columns(
        pl.when(hit).then(pl.col("order") - 0.5).otherwise(pl.col("order")).alias("order")
    )
    return Study(**{**vars(study), "runs": runs, "orders": orders})


def test_a_run_against_itself_shows_nothing(study: Study) -> None:
    assert differences(beside(tables_of(study), tables_of(study))) == []


def test_what_is_within_the_tolerance_is_not_shown(study: Study) -> None:
    found = differences(beside(tables_of(spoilt(study, 1.005)), tables_of(study)))
    assert {d.metric for d in found} == {"order"}


def test_what_got_worse_is_named_with_its_factor(study: Study) -> None:
    found = differences(beside(tables_of(spoilt(study, 2.0)), tables_of(study)))
    errors = [d for d in found if d.metric == "position_error_max"]
    assert {(d.scenario, d.method, d.precision) for d in found} == {("spring", "umbra", "float64")}
    assert len(errors) == 4
    assert all(d.factor == pytest.approx(2.0) and d.worse for d in errors)


def test_what_got_better_is_not_worse(study: Study) -> None:
    found = differences(beside(tables_of(study), tables_of(spoilt(study, 2.0))))
    assert found
    assert not any(d.worse for d in found)


def test_a_line_that_is_gone_is_worse(study: Study) -> None:
    less = Study(**{**vars(study), "runs": study.runs.filter(pl.col("method") != "umbra")})
    found = differences(beside(tables_of(less), tables_of(study)))
    assert {(d.method, d.now) for d in found if d.metric != "order"} == {("umbra", None)}
    assert all(d.worse for d in found)


def test_both_pages_tell(study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_study(study, tmp_path / "before")
    save_study(spoilt(study, 2.0), tmp_path / "now")
    monkeypatch.setattr("umbra_bench.parallel.os.cpu_count", lambda: 1)
    page = write_report(tmp_path / "now", tmp_path / "out", against=tmp_path / "before")
    for path in (page, page.with_suffix(".md")):
        text = path.read_text(encoding="utf-8")
        assert "What changed" in text
        assert "5 numbers, 5 of them worse" in text
    again = write_report(tmp_path / "now", tmp_path / "out")
    assert "What changed" not in again.read_text(encoding="utf-8")


# The overview ----------------------------------------------------------------------------------------


def test_the_overview_fits_a_hundred_columns(
    study: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    print_overview(tables_of(study))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    assert any(line.startswith("UMBRA, as published") for line in lines)


def test_energy_has_the_fate_that_theory_says(study: Study) -> None:
    (tables,) = tables_of(study)
    fates = {row.method: (row.gains, row.diverged) for row in overview([tables])}
    assert fates == {"explicit-euler": (1, 0), "umbra": (0, 0), "velocity-verlet": (0, 0)}
    run = tables.runs.to_dicts()[0]
    assert energy_fate({**run, "diverged_at": 3.0}, tables) == "diverged"
