"""Long runs: interrupted or not, and the law of their energy error against theory."""

from __future__ import annotations

import io
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from umbra_bench import cli, drift
from umbra_bench.drift import print_drift, run_drift, sample_steps
from umbra_bench.drift_figures import draw_drift
from umbra_bench.drift_law import fit_drift_law
from umbra_bench.errors import UmbraBenchError
from umbra_bench.results import alone_at, load_table
from umbra_bench.scenario import load_scenario

SPRING = load_scenario("spring")
TIMES = np.geomspace(0.01, 1e5, 85)


# The law ------------------------------------------------------------------------------------------


def oscillating(rng: np.random.Generator, level: float) -> np.ndarray:
    """What a bounded oscillation adds to the extremes of an interval: most of its amplitude."""
    return level * (1.0 - 0.2 * rng.random(TIMES.size) * np.exp(-TIMES))


def random_walk(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The steps at which a walk is looked at, and its largest size since the look before."""
    walk = np.abs(np.cumsum(rng.normal(size=400_000)))
    looks = np.unique(np.geomspace(1, walk.size, 70).astype(int))
    return looks.astype(float), np.maximum.reduceat(walk, np.concatenate([[0], looks[:-1]]))


@pytest.mark.parametrize("seed", range(20))
def test_each_law_is_told_from_a_series_that_follows_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = 1.0 + 0.02 * rng.normal(size=TIMES.size)
    series = {
        "bounded": oscillating(rng, 1e-4),
        "linear": 1e-9 * TIMES * noise + oscillating(rng, 1e-9),
        "exponential": 1e-3 * np.expm1(2e-4 * TIMES) * noise,
    }
    for law, errors in series.items():
        assert fit_drift_law(TIMES, errors).law == law
    assert fit_drift_law(TIMES, series["linear"]).rate == pytest.approx(1e-9, rel=0.05)
    assert fit_drift_law(TIMES, series["exponential"]).rate == pytest.approx(2e-4, rel=0.05)


def test_the_envelope_of_random_walks_grows_with_the_root_of_time() -> None:
    # One walk wanders: its exponent is 0.5 in the mean over many, and no single walk is held to it.
    found = [fit_drift_law(*random_walk(np.random.default_rng(seed))) for seed in range(100)]
    exponents = np.array([law.exponent for law in found])
    error = exponents.std() / math.sqrt(len(exponents))
    assert exponents.mean() == pytest.approx(0.5, abs=max(0.05, 3 * error))
    laws = [law.law for law in found]
    assert max(set(laws), key=laws.count) == "random walk"
    assert "exponential" not in laws


def test_a_slow_climb_is_not_bounded() -> None:
    noise = 1.0 + 0.02 * np.random.default_rng(0).normal(size=TIMES.size)
    assert fit_drift_law(TIMES, 1e-6 * TIMES**0.13 * noise).law == "power"
    assert fit_drift_law(TIMES, 1e-6 * TIMES**0.001).law == "bounded"


@pytest.mark.parametrize("errors", [np.zeros(85), np.full(85, np.nan), np.ones(85)[:3]])
def test_nothing_to_follow_has_no_law(errors: np.ndarray) -> None:
    assert fit_drift_law(TIMES[: errors.size], errors).law == "none"


# Against theory -----------------------------------------------------------------------------------


def law_of(method: str, steps: int, results: Path, dt: float = 0.01) -> dict[str, object]:
    return run_drift(SPRING, [method], ["float64"], steps, dt, results).to_dicts()[0]


def test_explicit_euler_grows_by_one_plus_omega_dt_squared_a_step(tmp_path: Path) -> None:
    law = law_of("explicit-euler", 60_000, tmp_path)
    assert law["law"] == "exponential"
    # E_n = E_0 (1 + (omega dt)^2)^n, omega = 2 rad/s.
    assert law["rate"] == pytest.approx(math.log1p(0.02**2) / 0.01, rel=1e-4)
    assert law["diverged_at"] is None


def test_runge_kutta_loses_energy_in_a_line_at_the_rate_of_theory(tmp_path: Path) -> None:
    law = law_of("rk4", 300_000, tmp_path, dt=0.05)
    assert law["law"] == "linear"
    # |R(i z)|^2 = 1 - z^6/72 + z^8/576 with z = omega dt = 0.1, of an energy whose scale is E_0 or less.
    series = load_table("drift_series", tmp_path)
    lost = -math.log1p(-(0.1**6) / 72 + 0.1**8 / 576) / 0.05
    energy = float(series["energy_error"].abs()[-1] / -math.expm1(-lost * series["t"][-1]))
    assert law["rate"] == pytest.approx(lost * energy, rel=0.02)
    assert energy == pytest.approx(1.0, abs=0.6)


@pytest.mark.parametrize("method", ["umbra", "velocity-verlet", "semi-implicit-euler"])
def test_symplectic_methods_stay_within_bounds(method: str, tmp_path: Path) -> None:
    assert law_of(method, 300_000, tmp_path)["law"] == "bounded"


def test_a_run_beyond_stability_ends_and_says_when(tmp_path: Path) -> None:
    law = law_of("velocity-verlet", 10**9, tmp_path, dt=1.25)  # omega dt = 2.5
    assert law["diverged_at"] is not None
    assert law["steps"] < 10**6


# Interrupted or not -------------------------------------------------------------------------------


def same_tables(one: Path, other: Path) -> bool:
    names = ("drift.csv", "drift.parquet", "drift_series.parquet")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


def test_samples_do_not_depend_on_where_a_run_ends() -> None:
    assert sample_steps(10**6) == [step for step in sample_steps(10**9) if step <= 10**6]
    assert sample_steps(10**9)[-1] == 10**9


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_more_steps_go_on_from_the_end_as_if_there_had_been_none(
    tmp_path: Path, precision: str
) -> None:
    for steps in (700, 1234, 20_000):
        run_drift(SPRING, ["umbra", "umbra-repaired"], [precision], steps, None, tmp_path / "parts")
    run_drift(SPRING, ["umbra", "umbra-repaired"], [precision], 20_000, None, tmp_path / "whole")
    assert same_tables(tmp_path / "parts", tmp_path / "whole")


@pytest.mark.parametrize("completed", [True, False], ids=["after", "during"])
@pytest.mark.parametrize("advance", [0, 1, 7, 40, 41])
def test_an_interrupt_at_any_moment_loses_and_doubles_nothing(
    tmp_path: Path, advance: int, completed: bool
) -> None:
    taken, advances = drift._LongRun._advance, iter(range(1000))

    def interrupted(run: drift._LongRun, *args: Any) -> None:
        stop = next(advances) == advance
        if stop and not completed:
            run.run.advance(args[0], 1)  # the loop has run, and nobody has heard of it
            raise KeyboardInterrupt
        taken(run, *args)
        if stop:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drift._LongRun, "_advance", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_drift(SPRING, ["umbra"], ["float32"], 20_000, None, tmp_path / "parts")
    for name in ("parts", "whole"):
        run_drift(SPRING, ["umbra"], ["float32"], 20_000, None, tmp_path / name)
    assert same_tables(tmp_path / "parts", tmp_path / "whole")


def command(results: Path, steps: str) -> list[str]:
    folders = ["--results", str(results), "--output", str(results / "reports")]
    line = ["drift", "spring", "--method", "umbra", "--precision", "float64", "--steps", steps]
    often = "from umbra_bench import cli, drift; drift.KEEP_SECONDS = 1.0; cli.main()"
    return [sys.executable, "-c", often, *line, *folders]


def wait_for_another(kept: Path, seconds: float = 120.0) -> None:
    first, limit = kept.stat().st_mtime_ns, time.monotonic() + seconds
    while kept.stat().st_mtime_ns == first:
        assert time.monotonic() < limit
        time.sleep(0.05)


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_was_stopped_goes_on_bit_for_bit(tmp_path: Path, sign: signal.Signals) -> None:
    stopped = tmp_path / "stopped"
    run_drift(SPRING, ["umbra"], ["float64"], 1000, None, stopped)
    (kept,) = stopped.glob("drift/*.npz")
    process = subprocess.Popen(command(stopped, "1e12"), stderr=subprocess.PIPE, text=True)
    wait_for_another(kept)  # it begins
    if sign == signal.SIGKILL:
        wait_for_another(kept)
    else:
        time.sleep(0.5)
    process.send_signal(sign)
    _, errors = process.communicate(timeout=60)
    if sign == signal.SIGINT:
        assert process.returncode == 2
        assert errors.splitlines()[-1] == "umbra-bench: interrupted"
        assert "Traceback" not in errors
    with np.load(kept, allow_pickle=False) as state:
        taken = int(state["steps"])
    assert taken > 1000
    for folder in (stopped, tmp_path / "whole"):
        run_drift(SPRING, ["umbra"], ["float64"], taken + 12_345, None, folder)
    assert same_tables(stopped, tmp_path / "whole")


def test_a_finished_run_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    law_of("umbra", 5000, tmp_path)
    monkeypatch.setattr(drift._LongRun, "_advance", lambda *_: pytest.fail("it took a step"))
    assert law_of("umbra", 5000, tmp_path)["steps"] == 5000


def test_other_runs_keep_their_rows(tmp_path: Path) -> None:
    law_of("umbra", 2000, tmp_path)
    law_of("velocity-verlet", 2000, tmp_path)
    law_of("umbra", 3000, tmp_path)
    table = load_table("drift", tmp_path)
    assert dict(zip(table["method"], table["steps"], strict=True)) == {
        "umbra": 3000,
        "velocity-verlet": 2000,
    }


# Bad input ----------------------------------------------------------------------------------------


def test_what_was_kept_of_something_else_is_refused(tmp_path: Path) -> None:
    law_of("umbra", 2000, tmp_path)
    heavier = SPRING.model_copy(update={"duration": 10.0})
    with pytest.raises(UmbraBenchError, match=r"spring-umbra.*another.*--restart begins anew"):
        run_drift(heavier, ["umbra"], ["float64"], 3000, 0.01, tmp_path)
    again = run_drift(heavier, ["umbra"], ["float64"], 3000, 0.01, tmp_path, restart=True)
    assert again["steps"].to_list() == [3000]


def test_a_second_command_on_the_same_run_says_so_and_leavings_are_removed(tmp_path: Path) -> None:
    kept = tmp_path / "drift/spring-umbra-float64-0.01.npz"
    left = kept.with_name(f".{kept.name}.abcd1234")
    with alone_at(kept), pytest.raises(UmbraBenchError, match="another command is writing there"):
        law_of("umbra", 2000, tmp_path)
    left.touch()
    law_of("umbra", 2000, tmp_path)
    assert not left.exists()


def an_array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


def other_leaves() -> bytes:
    file = io.BytesIO()
    np.savez(file, key=np.array(["x"], dtype=object), steps=np.zeros(2))
    return file.getvalue()


@pytest.mark.parametrize("content", [b"", b"PK nonsense", b"\x93NUMPY", an_array(), other_leaves()])
def test_what_was_kept_and_is_damaged_is_one_line(tmp_path: Path, content: bytes) -> None:
    law_of("umbra", 2000, tmp_path)
    (kept,) = (tmp_path / "drift").glob("*.npz")
    kept.write_bytes(content)
    with pytest.raises(UmbraBenchError, match=r"npz: cannot be read .*--restart begins anew"):
        law_of("umbra", 3000, tmp_path)


def test_a_scenario_that_loses_energy_and_a_method_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(UmbraBenchError, match="spring_damped: its energy is not conserved"):
        run_drift(load_scenario("spring_damped"), [], ["float64"], 10, None, tmp_path)
    with pytest.raises(UmbraBenchError, match="--method 'pymunk'"):
        run_drift(SPRING, ["pymunk"], ["float64"], 10, None, tmp_path)


@pytest.mark.parametrize("steps", ["0", "1.5", "nan", "many", "1e300", "-3"])
def test_steps_are_a_whole_number(
    tmp_path: Path, steps: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["umbra-bench", *command(tmp_path, steps)[3:]])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    told = capsys.readouterr().err
    assert told.startswith("umbra-bench: Invalid value for '--steps'")
    assert told.count("\n") == 1


def test_the_figure_and_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_drift(SPRING, ["umbra", "explicit-euler"], ["float32", "float64"], 3000, None, tmp_path)
    drawn = draw_drift(tmp_path, tmp_path)
    assert [path.name for path in drawn] == ["spring-drift"]
    assert (tmp_path / "figures/spring-drift.svg").is_file()
    print_drift(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    assert sum("explicit-euler" in line for line in lines) == 2
    assert pl.read_csv(tmp_path / "drift.csv").height == 4
