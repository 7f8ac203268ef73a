"""A number's history, told from results alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_results import small_study

from umbra_bench import cli
from umbra_bench.drift import run_drift, sample_steps
from umbra_bench.errors import UmbraBenchError
from umbra_bench.explain import WIDTH, explain, reproduce
from umbra_bench.results import save_study
from umbra_bench.scenario import load_scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("results")
    save_study(small_study(), path)
    return path


def test_an_order_is_told_with_its_points_and_why_others_are_none(folder: Path) -> None:
    lines = explain("soft/velocity-verlet/float64/position/order", folder)
    text = "\n".join(lines)
    (row,) = (
        small_study()
        .orders.filter(
            scenario="soft", method="velocity-verlet", precision="float64", quantity="position"
        )
        .rows(named=True)
    )
    assert sum(line.endswith("in the fit") for line in lines) == row["points"]
    assert f"order: {row['order']:.6g} ± {row['standard_error']:.2g}" in text
    assert "reproduce: umbra-bench study soft --method velocity-verlet --precision float64" in text


def test_a_run_is_told_with_every_step_and_its_command(folder: Path) -> None:
    runs = small_study().runs.filter(scenario="soft", method="umbra", precision="float32")
    step, error = runs.select("dt", "energy_error_max").row(1)
    lines = explain(f"soft/umbra/float32/{step:g}/energy_error_max", folder)
    assert f"  dt = {step:<12g} {error!r} <- this cell" in lines
    assert sum(line.startswith("  dt = ") for line in lines) == runs.height
    assert any("umbra-bench simulate soft --method umbra" in line for line in lines)


def test_a_divergence_is_told(folder: Path) -> None:
    text = "\n".join(explain("stiff/umbra/float64/position/order", folder))
    assert "diverged at" in text


def test_every_cell_fits_the_terminal(folder: Path) -> None:
    for name in ("soft/umbra/float64/velocity/order", "stiff/pymunk/float64/energy order"):
        assert max(map(len, explain(name, folder))) <= WIDTH


def test_an_unknown_cell_is_told_with_the_nearest(folder: Path) -> None:
    with pytest.raises(UmbraBenchError) as caught:
        explain("soft/umbra/float64/position/ordre", folder)
    assert "did you mean 'soft/umbra/float64/position/order'?" in str(caught.value)


def test_the_command(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = "soft/umbra/float64/position/order"
    monkeypatch.setattr("sys.argv", ["umbra-bench", "explain", cell, "--results", str(folder)])
    with pytest.raises(SystemExit) as ending:
        cli.main()
    assert ending.value.code == 0
    assert capsys.readouterr().out.splitlines() == explain(cell, folder)


def test_a_long_run_is_told_with_its_samples_and_its_command(tmp_path: Path) -> None:
    run_drift(load_scenario("spring"), ["umbra"], ["float32"], 50, 0.01, tmp_path)
    lines = explain("drift/spring/umbra/float32/0.01", tmp_path)
    samples = [int(line.split()[1]) for line in lines if line.startswith("  step ")]
    assert samples == [*sample_steps(50), 50]
    text = " ".join(line.strip() for line in lines)
    assert "drift spring --method umbra --precision float32 --dt 0.01 --steps 50 --restart" in text
    assert max(map(len, lines)) <= WIDTH
    with pytest.raises(UmbraBenchError, match="is no long run; did you mean 'spring/umbra"):
        explain("drift/spring/umbar/float32/0.01", tmp_path)


def test_a_command_is_quoted_for_the_shell() -> None:
    assert reproduce("a b", "native:x.so") == "umbra-bench study 'a b' --method native:x.so"
