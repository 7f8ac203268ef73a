"""Every fault of the catalogue turns the gate red; harmless changes leave it green."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from faults import FAULTS, HARMLESS

from umbra_bench import integrators
from umbra_bench.errors import UmbraBenchError
from umbra_bench.gate import exit_code
from umbra_bench.self_test import Change, Examiner, changed

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def examiner() -> Examiner:
    return Examiner(ROOT / "results" / "baseline.json")


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_turns_the_gate_red(fault: Change, examiner: Examiner) -> None:
    assert exit_code(examiner.examine(fault)) == 1


@pytest.mark.parametrize("change", HARMLESS, ids=lambda change: change.name)
def test_a_harmless_change_leaves_it_green(change: Change, examiner: Examiner) -> None:
    assert exit_code(examiner.examine(change)) == 0


def test_a_change_is_undone() -> None:
    before = integrators.rk4.__code__
    fault = next(f for f in FAULTS if f.module == "integrators" and "RK4" in f.name)
    with changed(fault):
        assert integrators.rk4.__code__ != before
    assert integrators.rk4.__code__ == before


def test_a_fault_whose_text_is_gone_is_an_error_not_a_pass() -> None:
    stale = FAULTS[0]._replace(old="no such text")
    with pytest.raises(UmbraBenchError, match="occurs 0 times"), changed(stale):
        pass


@pytest.mark.parametrize(
    "flags",
    [
        pytest.param("--xla_cpu_max_isa=AVX", id="without fused multiply-add"),
        pytest.param("--xla_cpu_multi_thread_eigen=false", id="one thread"),
        pytest.param("--xla_cpu_prefer_vector_width=128", id="narrow vectors"),
    ],
)
def test_another_processor_does_not_turn_it_red(flags: str) -> None:
    """A fresh process, since the compiler's flags are read once."""
    code = (
        "from pathlib import Path; from umbra_bench import gate;"
        "lines = [gate.Line('orbit_eccentric', m, p)"
        " for m in ('umbra', 'rk4') for p in ('float32', 'float64')];"
        "found = gate.judge(gate.measure_lines(lines), gate.load_baseline(gate.BASELINE));"
        "print([j for j in found if j.verdict != 'pass']);"
        "raise SystemExit(gate.exit_code(found))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "XLA_FLAGS": flags},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
