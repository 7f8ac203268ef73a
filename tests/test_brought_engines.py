"""Engines that the reader brings: a shared library, a process, a Python class; and how they fail."""

from __future__ import annotations

import shutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from umbra_bench import cli
from umbra_bench.engines import process
from umbra_bench.errors import EngineFailed, UmbraBenchError, UnsupportedScenario
from umbra_bench.identify import identify
from umbra_bench.methods import find_method
from umbra_bench.scenario import load_scenario
from umbra_bench.simulation import simulate
from umbra_bench.study import run_study

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler on this machine")


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example engine and its faulty twin, built as its own Makefile says."""
    folder = tmp_path_factory.mktemp("native") / "native"
    shutil.copytree(EXAMPLES / "native", folder)
    for target in ("libtoy.so", "libtoy-faulty.so"):
        subprocess.run(["make", "-C", str(folder), target, f"CXX={COMPILER}"], check=True)
    return folder


def compiled(folder: Path, function: str, code: str) -> str:
    """A library like the example's, but for one function."""
    example = EXAMPLES / "native"
    shutil.copy(example / "umbra_engine.h", folder)
    source = (example / "toy.cpp").read_text(encoding="utf-8")
    path = folder / f"{function}.cpp"
    path.write_text(
        f'#define {function} replaced\n{source}\n#undef {function}\nextern "C" {{ {code} }}\n',
        encoding="utf-8",
    )
    library = folder / f"{function}.so"
    subprocess.run([str(COMPILER), "-shared", "-fPIC", "-o", str(library), str(path)], check=True)
    return f"native:{library}"


def program(folder: Path, code: str) -> str:
    path = folder / "engine.py"
    path.write_text(textwrap.dedent(code), encoding="utf-8")
    return f"process:{sys.executable} {path}"


def run_cli(*arguments: str) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["umbra-bench", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
    return int(end.value.code or 0)


# A shared library ------------------------------------------------------------------------------------


@needs_compiler
def test_the_native_example_is_semi_implicit_euler(built: Path) -> None:
    method = f"native:{built / 'libtoy.so'}"
    found = identify(method)
    assert found.integrator == "semi-implicit Euler, velocity first"
    run = simulate(load_scenario("elastic_pendulum"), method, 0.01, steps=100)
    own = simulate(load_scenario("elastic_pendulum"), "semi-implicit-euler", 0.01, steps=100)
    np.testing.assert_allclose(run.position, own.position, atol=1e-12)
    assert (run.method, run.precision) == (method, "float64")


@needs_compiler
def test_its_fault_is_named_too(built: Path) -> None:
    assert identify(f"native:{built / 'libtoy-faulty.so'}").integrator == "explicit Euler"


@needs_compiler
def test_damping_reaches_a_library(built: Path) -> None:
    damped = load_scenario("spring_damped")
    run = simulate(damped, f"native:{built / 'libtoy.so'}", 0.01, steps=200)
    own = simulate(damped, "semi-implicit-euler", 0.01, steps=200)
    np.testing.assert_allclose(run.velocity, own.velocity, atol=1e-12)


@needs_compiler
def test_the_gate_of_an_engine_of_ones_own(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    library = tmp_path / "libtoy.so"
    library.write_bytes((built / "libtoy.so").read_bytes())
    gate = ("gate", "--method", "native:libtoy.so", "--baseline", "toy.json")
    monkeypatch.setattr("umbra_bench.gate.ENGINE_SCENARIOS", ("elastic_pendulum",))
    monkeypatch.setattr("umbra_bench.parallel.os.cpu_count", lambda: 1)
    assert run_cli(*gate) == 2  # no baseline yet
    assert "there is no baseline" in capsys.readouterr().err
    assert run_cli(*gate, "--update") == 0
    assert run_cli(*gate) == 0
    library.write_bytes((built / "libtoy-faulty.so").read_bytes())
    process.stated_precision.cache_clear()
    capsys.readouterr()
    assert run_cli(*gate) == 1
    assert "elastic_pendulum/native:libtoy.so/float64" in capsys.readouterr().out


def test_an_engines_gate_needs_a_baseline_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("gate", "--method", "umbra") == 2
    assert "--baseline" in capsys.readouterr().err


@needs_compiler
def test_a_crash_in_a_library_is_a_row_and_the_rest_goes_on(tmp_path: Path) -> None:
    method = compiled(
        tmp_path,
        "umbra_step",
        "void umbra_step(umbra_engine *, double) { __builtin_trap(); }",
    )
    quick = load_scenario("spring").with_sweep(0.04, 2)
    study = run_study([quick], [method, "semi-implicit-euler"], ["float64"])
    (row,) = study.skips.to_dicts()
    assert row["method"] == method
    assert "died of SIG" in row["reason"]
    assert study.runs["method"].unique().to_list() == ["semi-implicit-euler"]


@needs_compiler
def test_a_library_that_refuses_bodies_is_a_stated_skip(tmp_path: Path) -> None:
    method = compiled(
        tmp_path,
        "umbra_create",
        "umbra_engine *umbra_create(const umbra_body *, int) { return nullptr; }",
    )
    with pytest.raises(UnsupportedScenario, match="umbra_create returned NULL"):
        simulate(load_scenario("spring"), method, 0.01, steps=1)


@needs_compiler
def test_a_library_may_print(tmp_path: Path) -> None:
    method = compiled(
        tmp_path,
        "umbra_precision",
        'int puts(const char *); int umbra_precision(void) { puts("hello"); return 32; }',
    )
    assert find_method(method).precision == "float32"


@needs_compiler
@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("int umbra_abi(void) { return 7; }", "abi = 7; this version speaks 1"),
        ("int umbra_precision(void) { return 80; }", "precision = 'float80'; allowed"),
    ],
)
def test_a_library_of_another_interface_is_refused(tmp_path: Path, code: str, message: str) -> None:
    with pytest.raises(EngineFailed, match=message):
        find_method(compiled(tmp_path, code.split()[1].partition("(")[0], code))


def test_a_file_that_is_no_library(tmp_path: Path) -> None:
    path = tmp_path / "no.so"
    path.write_text("text", encoding="utf-8")
    with pytest.raises(EngineFailed, match=r"no\.so"):
        find_method(f"native:{path}")


# A process -------------------------------------------------------------------------------------------


def test_the_example_process_is_semi_implicit_euler() -> None:
    method = f"process:{sys.executable} {EXAMPLES / 'process' / 'engine.py'}"
    found = identify(method, [load_scenario("spring")])
    assert found.integrator == "semi-implicit Euler, velocity first"


HELLO = """
    import json, sys, time
    for line in sys.stdin:
        ask = json.loads(line)["ask"]
        if ask == "hello":
            print(json.dumps({"abi": 1, "precision": "float64"}), flush=True)
        elif ask == "create":
            print("{}", flush=True)
        else:
            STEP
"""


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("sys.exit('out of memory')", "exit code 1; it said: out of memory"),
        ("print('oops', flush=True)", "answered 'oops' to 'step'"),
        ("print('[1]', flush=True)", r"answered '\[1\]' to 'step'"),
        ("print('{}', flush=True)", "position = None in its answer to 'step'; expected 3 rows"),
        (
            'print(\'{"position": [[1]], "velocity": 2}\', flush=True)',
            r"position = \[\[1\]\] in its answer",
        ),
        ("sys.stdout.write('9' * 10**6); sys.stdout.flush(); time.sleep(60)", "gave no answer"),
        ("print('{\"position\": [[1' + '0' * 400 + ']]}', flush=True)", "position = "),
        ('print(\'{"position": [["1"], [0], [0]]}\', flush=True)', "position = .*expected 3 rows"),
        ("import os; os.kill(os.getpid(), 35)", "died of"),
        ("time.sleep(60)", "gave no answer to 'step' for 0.3 s"),
        ("__import__('os').close(1)", "exit code|closed its output"),
    ],
)
def test_a_process_that_fails_says_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, message: str
) -> None:
    method = program(tmp_path, HELLO.replace("STEP", step))
    find_method(method)
    monkeypatch.setattr(process, "TIME_OUT", 0.3)
    with pytest.raises(EngineFailed, match=message):
        simulate(load_scenario("spring"), method, 0.01, steps=3)


def test_numbers_that_are_not_finite_are_a_divergence(tmp_path: Path) -> None:
    rows = "[[None], [0.0], [0.0]]"
    answer = f"print(json.dumps({{'position': {rows}, 'velocity': {rows}}}), flush=True)"
    method = program(tmp_path, HELLO.replace("STEP", answer))
    run = simulate(load_scenario("spring"), method, 0.01, steps=10)
    assert run.diverged_at is not None
    assert np.isnan(run.position[-1, 0, 0])


def test_a_command_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(EngineFailed, match="cannot be started"):
        find_method(f"process:{tmp_path / 'nothing'}")


@pytest.mark.skipif(shutil.which("yes") is None, reason="no `yes` on this machine")
def test_a_process_that_never_listens_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    state = "[[1.0],[0.0],[0.0]]"
    answer = f'{{"abi":1,"precision":"float64","position":{state},"velocity":{state}}}'
    method = f"process:yes '{answer}'"
    assert find_method(method).precision == "float64"
    monkeypatch.setattr(process, "TIME_OUT", 0.3)
    with pytest.raises(EngineFailed, match="gave no answer to 'step'"):
        simulate(load_scenario("spring"), method, 0.001, steps=2000)


def test_what_an_engine_started_ends_with_it(tmp_path: Path) -> None:
    mark = tmp_path / "alive"
    loop = f"while true; do touch {mark}; sleep 0.05; done"
    conversation = process.Conversation(f"process:sh -c '({loop}) & cat > /dev/null; wait'")
    while not mark.exists():
        time.sleep(0.01)
    conversation.close()
    mark.unlink()
    time.sleep(0.2)
    assert not mark.exists()


def test_an_engine_that_refuses_everything_is_not_a_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("umbra_bench.gate.ENGINE_SCENARIOS", ("spring",))
    code = HELLO.replace('print("{}", flush=True)', 'print(\'{"refused": "no"}\', flush=True)')
    gate = ("gate", "--method", program(tmp_path, code.replace("STEP", "pass")))
    baseline = tmp_path / "b.json"
    assert run_cli(*gate, "--baseline", str(baseline), "--update") == 2
    assert not baseline.exists()
    told = capsys.readouterr()
    assert "not run: spring/process:" in told.err
    assert "PASS" not in told.out


def test_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("simulate", "spring", "--method", "process:false", "--dt", "0.01") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "ended with exit code 1" in captured.err


# A Python class --------------------------------------------------------------------------------------


def test_a_class_is_found_through_its_entry_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "toy_engine-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Name: toy-engine\nVersion: 1.0\n", encoding="utf-8")
    (installed / "entry_points.txt").write_text(
        "[umbra_bench.engines]\ntoy-verlet = toy_engine:ToyVerlet\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(EXAMPLES / "python"))
    found = identify("toy-verlet")
    assert found.integrator == "velocity Verlet"
    assert found.precision == "float64"


def test_a_name_that_is_nothing_suggests_the_nearest() -> None:
    with pytest.raises(UmbraBenchError, match=r"did you mean 'box2d'.*native:"):
        find_method("box2")
