"""Sweeps: the same rows wherever they are computed, and what theory says of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import psutil
import pytest

from umbra_bench.errors import UmbraBenchError
from umbra_bench.results import alone_at
from umbra_bench.scenario import load_scenario
from umbra_bench.simulation import simulate
from umbra_bench.sweep.figures import draw_sweep
from umbra_bench.sweep.plan import Plan, load_plan
from umbra_bench.sweep.work import run_sweep, run_task, write_part

SPRING = """
scenario = "spring"
methods = ["umbra", "velocity-verlet"]
steps = 400
[[vary]]
key = "forces[0].stiffness"
range = { start = 1.0, stop = 1000.0, count = 12, spacing = "log" }
[[vary]]
key = "dt"
values = [0.005, 0.05, 0.2, 0.4]
"""

LONG = """
scenario = "spring_chain"
methods = ["umbra"]
steps = 5000
draws = 240
seed = 3
[[vary]]
key = "forces[1].stiffness"
random = { low = 1.0, high = 100.0, distribution = "log-uniform" }
[[vary]]
key = "bodies[0].velocity[1]"
random = { low = -1.0, high = 1.0 }
"""


SMALL_TASKS = "from umbra_bench.sweep import plan; plan.TASK_STEPS = 5 * 10**6; "
"""So that a sweep of seconds has tasks enough for a worker to die between them."""


@pytest.fixture(autouse=True)
def _small_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("umbra_bench.sweep.plan.TASK_STEPS", 5 * 10**6)


def planned(folder: Path, text: str, name: str = "sweep") -> Plan:
    path = folder / f"{name}.toml"
    path.write_text(text)
    return load_plan(path)


def rows_of(plan: Plan) -> pl.DataFrame:
    return pl.concat([run_task(plan, task) for task in plan.tasks])


# What the rows say --------------------------------------------------------------------------------


def test_a_spring_diverges_where_omega_dt_exceeds_two(tmp_path: Path) -> None:
    rows = rows_of(planned(tmp_path, SPRING)).with_columns(
        turn=(pl.col("forces[0].stiffness") / 2.0).sqrt() * pl.col("dt")
    )
    assert rows.height == 2 * 12 * 4
    assert rows.filter(pl.col("turn") < 1.98)["diverged_at"].is_null().all()
    beyond = rows.filter(pl.col("turn") > 2.2)
    assert beyond.height > 5
    assert beyond["diverged_at"].is_not_null().all()


@pytest.mark.parametrize(
    ("scenario", "precision"), [("spring_chain", "float32"), ("figure_eight", "float64")]
)
def test_runs_side_by_side_are_the_runs_one_by_one(
    tmp_path: Path, scenario: str, precision: str
) -> None:
    plan = planned(
        tmp_path,
        f'scenario = "{scenario}"\nmethods = ["umbra", "rk4"]\nprecisions = ["{precision}"]\nsteps = 50\n'
        '[[vary]]\nkey = "bodies[0].mass"\nvalues = [1.0, 1.5]\n',
    )
    rounding = float(np.finfo(precision).eps)
    for row in rows_of(plan).to_dicts():
        varied = plan.scenario((row["bodies[0].mass"],))
        run = simulate(varied, row["method"], row["dt"], steps=50, precision=precision)
        scale = max(row["energy_scale"], abs(row["energy_high"]))
        for column, extreme in (
            ("energy_low", min(run.low.energy.min(), run.at.energy.min())),
            ("energy_high", max(run.high.energy.max(), run.at.energy.max())),
        ):
            # Two programs of one formula: 50 steps of rounding.
            assert row[column] == pytest.approx(float(extreme), abs=200 * rounding * scale)
        assert row["steps"] == 50
        assert row["refused"] is None


def test_an_engine_is_swept_too_and_a_refusal_is_a_row(tmp_path: Path) -> None:
    plan = planned(
        tmp_path,
        'scenario = "spring"\nmethods = ["pymunk"]\nsteps = 20\n'
        '[[vary]]\nkey = "bodies[0].mass"\nvalues = [2.0]\n',
    )
    (row,) = rows_of(plan).to_dicts()
    run = simulate(load_scenario("spring"), "pymunk", row["dt"], steps=20)
    assert row["energy_high"] == pytest.approx(float(run.at.energy.max()), rel=1e-12)


def test_a_value_that_only_some_runs_refuse_is_a_row_with_the_reason(tmp_path: Path) -> None:
    plan = planned(
        tmp_path,
        'scenario = "spring"\nmethods = ["umbra"]\nprecisions = ["float32"]\nsteps = 3\n'
        '[[vary]]\nkey = "bodies[0].mass"\nvalues = [1.0, 1e50]\n',
    )
    good, bad = rows_of(plan).to_dicts()
    assert good["refused"] is None
    assert "float32 does not hold" in bad["refused"]


# Which runs there are -----------------------------------------------------------------------------


def test_the_last_key_varies_fastest_and_every_point_comes_once(tmp_path: Path) -> None:
    plan = planned(tmp_path, SPRING)
    values = [plan.values(point) for point in range(plan.points)]
    assert [dt for _, dt in values[:5]] == [0.005, 0.05, 0.2, 0.4, 0.005]
    assert len(set(values)) == plan.points == 48


def test_a_draw_depends_on_its_number_and_the_seed_alone(tmp_path: Path) -> None:
    plan = planned(tmp_path, LONG)
    other = planned(tmp_path, LONG.replace("seed = 3", "seed = 4"), "other")
    fewer = planned(tmp_path, LONG.replace("draws = 240", "draws = 20"), "fewer")
    assert [fewer.values(i) for i in range(20)] == [plan.values(i) for i in range(20)]
    assert plan.values(0) != other.values(0)
    stiffness, speed = np.array([plan.values(i) for i in range(plan.points)]).T
    assert len(set(stiffness)) == len(set(speed)) == 240
    assert 1.0 <= stiffness.min() < 2.0
    assert 50.0 < stiffness.max() <= 100.0
    # The median of 240 log-uniform draws: a tenth of the decades' span is over two deviations.
    assert np.median(np.log10(stiffness)) == pytest.approx(1.0, abs=0.3)
    assert np.median(speed) == pytest.approx(0.0, abs=0.3)


def test_a_thousand_million_runs_are_planned_without_a_list_of_them(tmp_path: Path) -> None:
    plan = planned(tmp_path, LONG.replace("draws = 240", "draws = 1000000000"))
    assert plan.points == 10**9
    assert len(plan.values(10**9 - 1)) == 2
    assert len(plan.tasks) <= 20_000
    assert plan.tasks[-1].last == 10**9


def test_a_long_task_has_the_rows_of_short_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = planned(tmp_path, SPRING)
    whole = rows_of(plan)
    monkeypatch.setattr("umbra_bench.sweep.work.TASK_RUNS", 7)
    assert rows_of(plan).equals(whole)


# Where they are computed --------------------------------------------------------------------------


def sweep_command(plan: Plan, results: Path, *more: str) -> list[str]:
    folders = ["--results", str(results), "--output", str(results / "figures")]
    run = SMALL_TASKS + "from umbra_bench.cli import main; main()"
    return [sys.executable, "-c", run, "sweep", plan.path, *folders, *more]


def parts_in(results: Path) -> list[Path]:
    return list(results.glob("sweeps/*/*.parquet"))


def wait_for_a_part(results: Path, process: subprocess.Popen[str]) -> None:
    limit = time.monotonic() + 120
    while not parts_in(results):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < limit
        time.sleep(0.02)


def test_two_workers_one_of_them_killed_give_the_bytes_of_one_process(tmp_path: Path) -> None:
    plan = planned(tmp_path, LONG)
    assert len(plan.tasks) > 6
    here = run_sweep(plan, tmp_path / "here").read_bytes()

    process = subprocess.Popen(
        sweep_command(plan, tmp_path / "killed", "--workers", "2"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for_a_part(tmp_path / "killed", process)
    children = psutil.Process(process.pid).children(recursive=True)
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    assert workers
    before = len(parts_in(tmp_path / "killed"))
    workers[-1].send_signal(signal.SIGKILL)
    assert before < len(plan.tasks)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert (tmp_path / "killed/sweeps/sweep.parquet").read_bytes() == here


def test_a_sweep_that_was_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    plan = planned(tmp_path, LONG)
    here = run_sweep(plan, tmp_path / "here").read_bytes()
    process = subprocess.Popen(
        sweep_command(plan, tmp_path / "killed"), stderr=subprocess.PIPE, text=True
    )
    wait_for_a_part(tmp_path / "killed", process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    kept = {part.name: part.stat().st_mtime_ns for part in parts_in(tmp_path / "killed")}
    assert 0 < len(kept) < len(plan.tasks)

    told: list[str] = []
    table = run_sweep(plan, tmp_path / "killed", listener=lambda what, *_: told.append(what))
    assert table.read_bytes() == here
    assert told[0] == "found from before"
    assert len(told) == 1 + len(plan.tasks) - len(kept)


def test_what_a_killed_sweep_left_half_written_or_damaged_is_made_again(tmp_path: Path) -> None:
    plan = planned(tmp_path, SPRING)
    here = run_sweep(plan, tmp_path / "here").read_bytes()
    parts = tmp_path / "killed/sweeps/sweep"
    for task in plan.tasks:
        write_part(plan, task, parts)
    first, *_ = sorted(parts.iterdir())
    first.write_bytes(first.read_bytes()[:-9])
    (parts / f".{first.name}.abcd1234").touch()
    told: list[str] = []
    table = run_sweep(plan, tmp_path / "killed", listener=lambda what, *_: told.append(what))
    assert table.read_bytes() == here
    assert len(told) == (2 if len(plan.tasks) > 1 else 1)
    assert not parts.exists()


def test_a_second_sweep_in_the_same_place_says_so(tmp_path: Path) -> None:
    plan = planned(tmp_path, SPRING)
    table = tmp_path / "sweeps/sweep.parquet"
    with alone_at(table), pytest.raises(UmbraBenchError, match="another command is writing there"):
        run_sweep(plan, tmp_path)
    assert run_sweep(plan, tmp_path) == table


def test_a_damaged_table_of_a_sweep_is_refused(tmp_path: Path) -> None:
    plan = planned(tmp_path, SPRING)
    table = run_sweep(plan, tmp_path)
    table.write_bytes(table.read_bytes()[:-1])
    for read in (run_sweep, lambda plan, folder: draw_sweep(plan, table, folder)):
        with pytest.raises(UmbraBenchError, match=r"sweep\.parquet: is not what was written"):
            read(plan, tmp_path)


def test_another_sweep_in_the_same_place_is_refused_until_told(tmp_path: Path) -> None:
    run_sweep(planned(tmp_path, SPRING), tmp_path)
    changed = planned(tmp_path, SPRING.replace("steps = 400", "steps = 300"))
    with pytest.raises(UmbraBenchError, match=r"sweep\.json: holds another sweep .*--restart"):
        run_sweep(changed, tmp_path)
    table = run_sweep(changed, tmp_path, restart=True)
    assert set(pl.read_parquet(table)["steps"]) == {300}


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    plan = planned(tmp_path, SPRING)
    found = subprocess.run(
        sweep_command(plan, tmp_path, "--scheduler", "nonsense://1:2"),
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "100"},
    )
    assert found.returncode == 2
    assert found.stderr.startswith("umbra-bench: --scheduler nonsense://1:2: cannot be reached")
    assert found.stderr.count("\n") == 1


# What it draws, and what it refuses ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "figures"), [(SPRING, 2), (SPRING.split('[[vary]]\nkey = "dt"')[0], 1)]
)
def test_a_map_for_two_keys_and_curves_for_one(tmp_path: Path, text: str, figures: int) -> None:
    plan = planned(tmp_path, text)
    drawn = draw_sweep(plan, run_sweep(plan, tmp_path), tmp_path)
    assert len(drawn) == figures
    assert all(Path(f"{path}.png").read_bytes().startswith(b"\x89PNG") for path in drawn)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ('"forces[0].stiffness"', '"forces[1].stiffness"'),
            "vary[0]: forces[1].stiffness = 1.0: the",
        ),
        (('"forces[0].stiffness"', '"forces[0].stifness"'), "unknown key"),
        (('"forces[0].stiffness"', '"name"'), "only a number can vary"),
        (('"forces[0].stiffness"', '"!"'), "is not a key"),
        (("start = 1.0", "start = -1.0"), "vary[0].range: a log spacing needs start and stop > 0"),
        (("steps = 400", "steps = 0"), "steps = 0"),
        (("steps = 400", "stepz = 400"), "stepz"),
        (("0.005, ", "-0.005, "), "vary[1]: dt = -0.005: expected a step > 0 s"),
        (('"umbra", ', '"umbar", '), "methods[0]: 'umbar' is not a method; did you mean 'umbra'?"),
        (('"umbra", ', '"reference", '), "it takes no steps"),
        (('"umbra", ', '"process:rm"  , '), "a file starts no program"),
        (('"dt"', '"forces[0].stiffness"'), "vary[1].key = 'forces[0].stiffness': varies already"),
        (("steps = 400", "draws = 3"), "draws = 3: nothing is drawn"),
        (("values = [0.005, 0.05, 0.2, 0.4]", ""), "vary[1]: needs one of values"),
    ],
)
def test_a_wrong_sweep_is_one_line_that_names_file_key_and_value(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    assert change[0] in SPRING
    with pytest.raises(UmbraBenchError) as refused:
        planned(tmp_path, SPRING.replace(*change))
    assert str(refused.value).startswith(str(tmp_path / "sweep.toml"))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
