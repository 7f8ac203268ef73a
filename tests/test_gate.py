"""The gate: green on what is, red on what got worse, and never green on what it cannot judge."""

from __future__ import annotations

import copy
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from umbra_bench import cli, gate
from umbra_bench.errors import UmbraBenchError
from umbra_bench.gate import Judgement, Line, Measurement
from umbra_bench.gate_output import write_outputs

ROOT = Path(__file__).resolve().parent.parent
LINES = [Line("spring", "umbra", "float64"), Line("spring", "umbra", "float32")]
CELL = "spring/umbra/float64/0.01"


@pytest.fixture(scope="session")
def measured() -> Measurement:
    return gate.measure_lines(LINES)


@pytest.fixture
def baseline(measured: Measurement) -> dict[str, Any]:
    return copy.deepcopy(gate.as_baseline(measured))


def verdicts(judgements: list[Judgement]) -> set[str]:
    return {j.verdict for j in judgements}


def test_nothing_changed_is_a_pass(measured: Measurement, baseline: dict[str, Any]) -> None:
    judgements = gate.judge(measured, baseline)
    assert verdicts(judgements) == {"pass"}
    assert gate.exit_code(judgements) == 0
    assert len(judgements) > 50


def test_the_committed_baseline_is_what_this_code_measures(measured: Measurement) -> None:
    committed = gate.load_baseline(ROOT / gate.BASELINE)
    assert gate.exit_code(gate.judge(measured, committed)) == 0


def test_the_committed_baseline_covers_the_whole_plan() -> None:
    committed = gate.load_baseline(ROOT / gate.BASELINE)
    for line in gate.planned_lines():
        assert str(line) in committed["orders"]
        assert any(cell.startswith(f"{line}/") for cell in committed["cells"])


def test_a_cell_that_is_no_longer_measured_is_not_a_pass(
    measured: Measurement, baseline: dict[str, Any]
) -> None:
    baseline["cells"]["spring/gone/float64/0.01"] = baseline["cells"][CELL]
    assert gate.exit_code(gate.judge(measured, baseline)) == 0
    judgements = [j for j in gate.judge(measured, baseline, whole=True) if j.verdict != "pass"]
    assert [(j.cell, j.verdict) for j in judgements] == [("spring/gone/float64/0.01", "unjudged")]
    assert gate.exit_code(judgements) == 2


@pytest.mark.parametrize("metric", gate.METRICS)
def test_an_error_beyond_the_tolerance_fails(
    measured: Measurement, baseline: dict[str, Any], metric: str
) -> None:
    baseline["cells"][CELL][metric] /= 1.05
    judgements = [j for j in gate.judge(measured, baseline) if j.verdict != "pass"]
    assert [(j.cell, j.metric, j.verdict) for j in judgements] == [(CELL, metric, "fail")]
    assert judgements[0].factor == pytest.approx(1.05, rel=1e-3)
    assert gate.exit_code(judgements) == 1


def test_an_error_within_the_tolerance_passes(
    measured: Measurement, baseline: dict[str, Any]
) -> None:
    baseline["cells"][CELL]["position_error_max"] /= 1.005
    assert gate.exit_code(gate.judge(measured, baseline)) == 0


def test_better_is_a_notice_and_a_pass(measured: Measurement, baseline: dict[str, Any]) -> None:
    baseline["cells"][CELL]["position_error_max"] *= 1.05
    judgements = gate.judge(measured, baseline)
    assert verdicts(judgements) == {"pass", "better"}
    assert gate.exit_code(judgements) == 0


def test_an_order_that_drops_fails(measured: Measurement, baseline: dict[str, Any]) -> None:
    baseline["orders"]["spring/umbra/float64"]["position"] += 0.15
    failed = [j for j in gate.judge(measured, baseline) if j.verdict == "fail"]
    assert [j.metric for j in failed] == ["position order"]


def test_a_truth_that_moved_fails_in_either_direction(
    measured: Measurement, baseline: dict[str, Any]
) -> None:
    key = next(iter(baseline["truths"]["spring"]))
    for factor in (1 - 1e-6, 1 + 1e-6):
        changed = copy.deepcopy(baseline)
        changed["truths"]["spring"][key] *= factor
        failed = [j for j in gate.judge(measured, changed) if j.verdict == "fail"]
        assert [j.metric for j in failed] == [key]


def test_not_a_number_and_divergence_fail(measured: Measurement, baseline: dict[str, Any]) -> None:
    broken = copy.deepcopy(measured)
    broken.cells[CELL]["energy_error_max"] = float("inf")
    broken.cells[CELL]["velocity_error_max"] = float("nan")
    broken.cells[CELL]["diverged_at"] = 0.5
    failed = {j.metric for j in gate.judge(broken, baseline) if j.verdict == "fail"}
    assert {"energy_error_max", "velocity_error_max", "diverged_at"} <= failed


def test_an_error_at_the_floor_is_judged_against_the_floor(
    measured: Measurement, baseline: dict[str, Any]
) -> None:
    floor = measured.floors[CELL]["position_error_max"]
    noisy = copy.deepcopy(measured)
    noisy.cells[CELL]["position_error_max"] = 0.9 * floor
    baseline["cells"][CELL]["position_error_max"] = 1e-3 * floor
    assert gate.exit_code(gate.judge(noisy, baseline)) == 0
    noisy.cells[CELL]["position_error_max"] = 2.0 * floor
    assert gate.exit_code(gate.judge(noisy, baseline)) == 1


def test_a_budget_is_an_absolute_limit(measured: Measurement, baseline: dict[str, Any]) -> None:
    assert "energy_error_max" in measured.budgets[CELL]
    tight = copy.deepcopy(measured)
    tight.budgets[CELL]["energy_error_max"] = 1e-3
    failed = [j for j in gate.judge(tight, baseline) if j.verdict == "fail"]
    assert [j.metric for j in failed] == ["budget energy_error_max"]


def test_a_missing_cell_a_missing_line_and_a_changed_scenario_are_not_judged(
    measured: Measurement, baseline: dict[str, Any]
) -> None:
    for damage in (
        lambda b: b["cells"].pop(CELL),
        lambda b: b["cells"][CELL].pop("energy_error_max"),
        lambda b: b["cells"][CELL].pop("diverged_at"),
        lambda b: b["orders"].pop("spring/umbra/float64"),
        lambda b: b["scenarios"].update(spring="0" * 64),
        lambda b: b["scenarios"].pop("spring"),
        lambda b: b["truths"].pop("spring"),
    ):
        damaged = copy.deepcopy(baseline)
        damage(damaged)
        assert gate.exit_code(gate.judge(measured, damaged)) == 2


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda text: text[: len(text) // 2], "not valid JSON"),
        (lambda text: "", "not valid JSON"),
        (lambda text: "[]", "not a baseline"),
        (lambda text: "{}", "not a baseline"),
        (lambda text: text.replace(gate.FORMAT, "another"), "not a baseline"),
        (lambda text: text.replace('"cells"', '"sells"'), "cells: missing"),
        (
            lambda text: text.replace('"energy_error_max": ', '"energy_error_max": NaN, "x": ', 1),
            "nan",
        ),
        (
            lambda text: text.replace(
                '"energy_error_max": ', '"energy_error_max": 1e999, "x": ', 1
            ),
            "inf",
        ),
        (
            lambda text: text.replace('"energy_error_max": ', '"energy_error_max": "1", "x": ', 1),
            "'1'",
        ),
    ],
)
def test_a_damaged_baseline_is_one_clear_line_and_exit_code_2(
    damage: Any, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(damage((ROOT / gate.BASELINE).read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(UmbraBenchError, match=r"baseline\.json"):
        gate.load_baseline(path)
    monkeypatch.setattr("sys.argv", ["umbra-bench", "gate", "--baseline", str(path)])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert exit_.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


def test_a_missing_baseline_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(UmbraBenchError, match="gate --update"):
        gate.load_baseline(tmp_path / "baseline.json")


def test_a_baseline_reads_back_as_it_was_written(measured: Measurement, tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    gate.save_baseline(measured, path)
    text = path.read_text(encoding="utf-8")
    gate.save_baseline(measured, path)
    assert path.read_text(encoding="utf-8") == text
    assert gate.load_baseline(path) == gate.as_baseline(measured)


def test_the_outputs_name_cell_metric_both_numbers_and_factor(
    measured: Measurement,
    baseline: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
) -> None:
    before = baseline["cells"][CELL]["energy_error_max"] / 2
    baseline["cells"][CELL]["energy_error_max"] = before
    judgements = gate.judge(measured, baseline)
    summary = tmp_path / "summary.md"
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    write_outputs(judgements, tmp_path)

    found = json.loads((tmp_path / "gate.json").read_text(encoding="utf-8"))
    assert found["exit_code"] == 1
    failed = [j for j in found["judgements"] if j["verdict"] == "fail"]
    assert [(j["cell"], j["metric"]) for j in failed] == [(CELL, "energy_error_max")]
    assert failed[0]["factor"] == pytest.approx(2.0, rel=1e-3)

    failures = ET.parse(tmp_path / "gate.xml").getroot().findall(".//testcase[failure]")
    assert [(case.get("classname"), case.get("name")) for case in failures] == [
        (CELL, "energy_error_max")
    ]
    now = measured.cells[CELL]["energy_error_max"]
    written = summary.read_text(encoding="utf-8")
    for text in (capsys.readouterr().out, written):
        for part in (
            CELL,
            "energy_error_max",
            f"{before:.4g}",
            f"{now:.4g}",
            "factor 2" if text != written else "| 2 |",
        ):
            assert part in text
