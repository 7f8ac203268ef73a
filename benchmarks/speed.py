"""How fast is a step? This harness, plain C, Diffrax, numba, NumPy and pymunk, side by side.

The same problem for all: bodies on Kepler orbits, the published pipeline, the largest energy kept
(Diffrax: its own semi-implicit Euler, no energy; pymunk: its own step, the force in the velocity
callback). Machines are shared, so the contenders take turns and the best round of each counts:
compare the ratios of one run, not the nanoseconds of two.

    python benchmarks/speed.py [--quick]

"C -O3 native" is -O3 -march=native; the lines "without metrics" and "nor forces" are this harness with
parts of its step left out, which tells where its time goes.

writes results/speed.csv and reports/speed.svg. Compilation is told apart from running. A contender
that cannot run here is a row with the reason.
"""

from __future__ import annotations

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from umbra_bench.scenario import Scenario, load_scenario

DT = 1e-3
MU = 1.0
ROOT = Path(__file__).resolve().parent


class Contender(NamedTuple):
    """Something that takes `steps` steps when called, and the seconds that it took to make ready."""

    run: Callable[[int], Any]
    compile_seconds: float


class Missing(Exception):
    """A contender that cannot run on this machine."""


def orbits(bodies: int) -> Scenario:
    """So many bodies, each alone on a circular orbit of radius 1 m."""
    one = load_scenario("orbit_circular")
    body, force = one.bodies[0], one.forces[0]
    phases = 2.0 * np.pi * np.arange(bodies) / bodies + 0.6435
    return one.model_copy(
        update={
            "bodies": tuple(
                body.model_copy(
                    update={
                        "name": f"b{i}",
                        "position": (float(np.cos(p)), float(np.sin(p))),
                        "velocity": (float(-np.sin(p)), float(np.cos(p))),
                    }
                )
                for i, p in enumerate(phases)
            ),
            "forces": tuple(force.model_copy(update={"body": f"b{i}"}) for i in range(bodies)),
        }
    )


def _started() -> float:
    return time.perf_counter()


def harness(bodies: int, precision: str) -> Contender:
    """This project's compiled loop with all that a study streams."""
    from umbra_bench.compiled import CompiledRun
    from umbra_bench.system import build_system, initial_state

    scenario = orbits(bodies)
    system, start = build_system(scenario, precision), initial_state(scenario, precision)
    run = CompiledRun("umbra", system, start, DT)
    began = _started()
    run.compile(1)
    return Contender(lambda steps: run.advance(steps, 1), time.perf_counter() - began)


def bare_loop(forces: bool) -> Callable[[int, str], Contender]:
    """The harness's loop with nothing streamed, and without the forces: what is left is their price."""

    def make(bodies: int, precision: str) -> Contender:
        import jax

        from umbra_bench import compiled
        from umbra_bench.jax_settings import float64_allowed
        from umbra_bench.system import build_system, initial_state

        scenario = orbits(bodies)
        whole, initial = build_system(scenario, precision), initial_state(scenario, precision)
        method = compiled.COMPILED_METHODS["umbra"]
        dt = np.dtype(precision).type(DT)
        a_turn = compiled.STEPS_A_TURN if bodies > compiled.MANY else 1

        def loop(system: Any, state: Any, steps: Any) -> Any:
            apart, together = compiled.carried(state)
            parts = compiled.take_steps(
                lambda n, parts: apart(method.step(system, together(parts), dt)),
                np.int64(0),
                steps,
                apart(state),
                a_turn,
            )
            return together(parts)

        serial = 3 * bodies <= compiled.SERIAL
        within = compiled.as_one_function if serial else lambda call: call
        started = jax.jit(
            lambda system, state, steps: within(lambda s: loop(system, s, steps))(state),
            compiler_options=compiled.options_for(bodies),
        )
        system = whole if forces else whole._replace(laws=())

        def run(steps: int) -> Any:
            with float64_allowed():
                state = method.start(system, initial)
                return jax.block_until_ready(started(system, state, np.int64(steps)))  # type: ignore[no-untyped-call]

        began = _started()
        run(1)
        return Contender(run, time.perf_counter() - began)

    return make


def rows(bodies: int, precision: str) -> list[np.ndarray]:
    """x, y, angle, their velocities and their stored accelerations."""
    phases = 2.0 * np.pi * np.arange(bodies) / bodies + 0.6435
    none = np.zeros(bodies)
    of = [np.cos(phases), np.sin(phases), none, -np.sin(phases), np.cos(phases), *[none] * 4]
    return [np.array(row, precision) for row in of]


def c_loop(*flags: str) -> Callable[[int, str], Contender]:
    """The C loop, compiled on the spot."""

    def make(bodies: int, precision: str) -> Contender:
        compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if compiler is None:
            raise Missing("no C compiler")
        real = {"float64": "double", "float32": "float"}[precision]
        number: Any = {"float64": ctypes.c_double, "float32": ctypes.c_float}[precision]
        began = _started()
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "loop.so"
            command = [compiler, *flags, f"-DREAL={real}", "-shared", "-fPIC"]
            subprocess.run([*command, str(ROOT / "loop.c"), "-o", str(library), "-lm"], check=True)
            orbit = ctypes.CDLL(str(library)).orbit
        compiled = time.perf_counter() - began
        orbit.restype = number
        arrays = rows(bodies, precision)
        places = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]

        def run(steps: int) -> Any:
            assert arrays  # they live as long as the function that writes to them
            return orbit(
                ctypes.c_int(bodies), ctypes.c_long(steps), number(DT), number(MU), *places
            )

        return Contender(run, compiled)

    return make


def numba_loop(bodies: int, precision: str) -> Contender:
    """The same loop in Python, compiled by numba."""
    try:
        import numba
    except ImportError:
        raise Missing("numba is not installed; `pip install 'umbra-bench[bench]'`") from None
    real = np.dtype(precision).type
    half, two_pi, zero, one = real(0.5), real(2.0 * np.pi), real(0.0), real(1.0)

    @numba.njit
    def orbit(steps, dt, mu, x, y, angle, vx, vy, omega, ax, ay, alpha):  # type: ignore[no-untyped-def]
        highest = -np.inf
        for _ in range(steps):
            energy = zero
            for i in range(len(x)):
                inverse = one / np.sqrt(x[i] * x[i] + y[i] * y[i])
                square = vx[i] * vx[i] + vy[i] * vy[i] + omega[i] * omega[i]
                energy += half * square - mu * inverse
                pull = -(mu * inverse) * (inverse * inverse)
                fx, fy, torque = pull * x[i], pull * y[i], zero
                vx[i] += (ax[i] + fx) * half * dt
                vy[i] += (ay[i] + fy) * half * dt
                omega[i] += (alpha[i] + torque) * half * dt
                ax[i], ay[i], alpha[i] = fx, fy, torque
                x[i] += vx[i] * dt + fx * (dt * dt * half)
                y[i] += vy[i] * dt + fy * (dt * dt * half)
                turned = angle[i] + (omega[i] * dt + torque * (dt * dt * half))
                turned -= two_pi * np.floor(turned / two_pi)
                angle[i] = zero if turned >= two_pi or turned < zero else turned
            highest = max(highest, energy)
        return highest

    arrays = rows(bodies, precision)
    began = _started()
    orbit(1, real(DT), real(MU), *arrays)
    compiled = time.perf_counter() - began
    return Contender(lambda steps: orbit(steps, real(DT), real(MU), *arrays), compiled)


def numpy_loop(bodies: int, precision: str) -> Contender:
    """This project's own stages, called on NumPy arrays, one step at a time."""
    from umbra_bench.system import build_system, initial_state
    from umbra_bench.umbra.bodies import UmbraState
    from umbra_bench.umbra.pipeline import step

    scenario = orbits(bodies)
    system = build_system(scenario, precision)
    start = UmbraState.at(*initial_state(scenario, precision))
    dt = np.dtype(precision).type(DT)

    def run(steps: int) -> Any:
        state, highest = start, -np.inf
        for _ in range(steps):
            highest = max(highest, system.energy(state.position, state.velocity))
            force = system.force(state.position, state.velocity)
            state = step(system.bodies, state._replace(force=force), dt)
        return highest

    return Contender(run, 0.0)


def diffrax_loop(bodies: int, precision: str) -> Contender:
    """Diffrax's own semi-implicit Euler at constant step, the same force law, no energy."""
    import diffrax
    import jax
    import jax.numpy as jnp

    from umbra_bench.jax_settings import float64_allowed
    from umbra_bench.system import build_system, initial_state

    scenario = orbits(bodies)
    system, start = build_system(scenario, precision), initial_state(scenario, precision)
    real = np.dtype(precision).type
    terms = (
        diffrax.ODETerm(lambda t, v, args: v),
        diffrax.ODETerm(lambda t, x, args: system.acceleration(x, jnp.zeros_like(x))),
    )

    @jax.jit
    def solve(position: Any, velocity: Any, end: Any) -> Any:
        return diffrax.diffeqsolve(
            terms,
            diffrax.SemiImplicitEuler(),
            t0=real(0.0),
            t1=end,
            dt0=real(DT),
            y0=(position, velocity),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.ConstantStepSize(),
            max_steps=None,
        ).ys

    def run(steps: int) -> Any:
        with float64_allowed():
            return jax.block_until_ready(solve(*start, real(steps * DT)))  # type: ignore[no-untyped-call]

    began = _started()
    run(1)
    return Contender(run, time.perf_counter() - began)


def pymunk_loop(bodies: int, precision: str) -> Contender:
    """pymunk as the study drives it, the force in its velocity callback."""
    from umbra_bench.simulation import open_run

    if precision != "float64":
        raise Missing("keeps float64")
    run = open_run(orbits(bodies), "pymunk-velocity-func", DT)
    return Contender(lambda steps: run.advance(steps, 1), 0.0)


CONTENDERS: dict[str, Callable[[int, str], Contender]] = {
    "C -O2": c_loop("-O2"),
    "C -O3 native": c_loop("-O3", "-march=native"),
    "umbra-bench": harness,
    "- without metrics": bare_loop(forces=True),
    "- nor forces": bare_loop(forces=False),
    "Diffrax": diffrax_loop,
    "numba": numba_loop,
    "NumPy": numpy_loop,
    "pymunk": pymunk_loop,
}
SLOW = {"NumPy": 100, "pymunk": 100}
"""These take so many times fewer steps: their time grows with the steps all the same."""


def measure(
    bodies: int, precision: str, steps: int, rounds: int, names: list[str]
) -> list[dict[str, Any]]:
    """One row a contender: they take turns, and the best of the rounds counts."""
    ready: dict[str, Contender] = {}
    found = []
    for name in names:
        try:
            ready[name] = CONTENDERS[name](bodies, precision)
        except Missing as reason:
            found.append(_row(name, bodies, precision, steps, None, None, str(reason)))
    best: dict[str, float] = {}
    for _ in range(rounds):
        for name, contender in ready.items():
            taken = max(1, steps // SLOW.get(name, 1))
            began = _started()
            contender.run(taken)
            seconds = (time.perf_counter() - began) / taken * steps
            best[name] = min(seconds, best.get(name, np.inf))
    return found + [
        _row(name, bodies, precision, steps, seconds, ready[name].compile_seconds, "")
        for name, seconds in best.items()
    ]


def _row(
    name: str, bodies: int, precision: str, steps: int, seconds: Any, compiled: Any, why: str
) -> dict[str, Any]:
    return {
        "contender": name,
        "bodies": bodies,
        "precision": precision,
        "steps": steps,
        "seconds": seconds,
        "nanoseconds": seconds and seconds / steps / bodies * 1e9,
        "compile_seconds": compiled,
        "missing": why,
    }


def peak_memory(name: str, steps: int) -> float:
    """MB at the peak of a fresh process that takes so many steps of one body."""
    code = (
        "import sys, resource; sys.path.insert(0, sys.argv[1]); import speed;"
        "speed.CONTENDERS[sys.argv[2]](1, 'float64').run(int(sys.argv[3]));"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    command = [sys.executable, "-c", code, str(ROOT), name, str(steps)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def sweep_ratio(runs: int, steps: int) -> dict[str, float]:
    """Seconds a spring run: in a sweep, through `simulate`, and through its compiled loop alone."""
    from umbra_bench.compiled import CompiledRun
    from umbra_bench.simulation import simulate
    from umbra_bench.sweep.plan import Task, load_plan
    from umbra_bench.sweep.work import run_task
    from umbra_bench.system import build_system, initial_state

    with tempfile.TemporaryDirectory() as folder:
        plan = load_plan(spring_sweep(Path(folder), runs, steps))
        run_task(plan, Task(0, "umbra", "float64", 0, 2))
        began = _started()
        for task in plan.tasks:
            run_task(plan, task)
        swept = (time.perf_counter() - began) / runs
    single = max(20, runs // 100)
    scenarios = [plan.scenario(plan.values(point)) for point in range(single)]
    simulate(scenarios[0], "umbra", 0.01, steps=steps, every=steps)
    began = _started()
    for scenario in scenarios:
        simulate(scenario, "umbra", 0.01, steps=steps, every=steps)
    whole = (time.perf_counter() - began) / single
    opened = [CompiledRun("umbra", build_system(s), initial_state(s), 0.01) for s in scenarios]
    began = _started()
    for run in opened:
        run.advance(steps, 1)
    return {"sweep": swept, "simulate": whole, "loop": (time.perf_counter() - began) / single}


def scenarios_growth(counts: tuple[int, ...], steps: int) -> list[tuple[int, float, float]]:
    """Seconds for so many scenarios of one shape: one by one through `simulate`, and as a sweep.

    Nothing is compiled again for another scenario, so both grow with their number alone.
    """
    from umbra_bench.simulation import simulate
    from umbra_bench.sweep.plan import load_plan
    from umbra_bench.sweep.work import run_task

    found = []
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            plan = load_plan(spring_sweep(Path(folder), count, steps))
        scenarios = [plan.scenario(plan.values(point)) for point in range(count)]
        began = _started()
        for scenario in scenarios:
            simulate(scenario, "umbra", 0.01, steps=steps, every=steps)
        singly = time.perf_counter() - began
        began = _started()
        for task in plan.tasks:
            run_task(plan, task)
        found.append((count, singly, time.perf_counter() - began))
    return found


def spring_sweep(folder: Path, runs: int, steps: int) -> Path:
    """The file of a sweep over the stiffness of the spring."""
    path = folder / "springs.toml"
    path.write_text(
        f'scenario = "spring"\nmethods = ["umbra"]\nsteps = {steps}\n[[vary]]\n'
        f'key = "forces[0].stiffness"\nrange = {{ start = 1.0, stop = 100.0, count = {runs} }}\n'
    )
    return path


def draw(table: pl.DataFrame, path: Path) -> None:
    """Nanoseconds a body-step against the number of bodies."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from umbra_bench.plots import log_scale, save, styled

    with styled():
        figure = Figure(figsize=(7.2, 3.9))
        FigureCanvasAgg(figure)
        for place, precision in enumerate(("float64", "float32")):
            axes = figure.add_axes((0.09 + 0.33 * place, 0.14, 0.29, 0.76))
            axes.set_ylim(1.0, 1e5)
            axes.tick_params(labelleft=not place)
            log_scale(axes, "x")
            log_scale(axes, "y")
            for number, name in enumerate(n for n in CONTENDERS if not n.startswith("-")):
                line = (
                    table.filter((pl.col("contender") == name) & (pl.col("precision") == precision))
                    .drop_nulls("nanoseconds")
                    .sort("bodies")
                )
                marker = "osDv^XP"[number]
                axes.plot(
                    line["bodies"], line["nanoseconds"], marker=marker, ms=4, lw=1.2, label=name
                )
            axes.set_title(precision, loc="left")
            axes.set_xlabel("bodies")
            if not place:
                axes.set_ylabel("ns a body and step")
                handles = axes.get_legend_handles_labels()
        figure.legend(*handles, loc="center left", bbox_to_anchor=(0.745, 0.5))
        save(figure, path)


def main() -> None:
    """Measure, print, write and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer steps, fewer rounds")
    quick = parser.parse_args().quick
    console = Console(width=100)
    work, rounds = (10**6, 3) if quick else (4 * 10**6, 7)
    found: list[dict[str, Any]] = []
    for precision in ("float64", "float32"):
        for bodies in (1, 1000, 10_000) if quick else (1, 10, 100, 1000, 10_000, 100_000):
            names = [n for n in CONTENDERS if n != "pymunk" or bodies <= 100]
            found += measure(bodies, precision, max(20, work // bodies), rounds, names)
    table = pl.DataFrame(found)
    _print_speed(console, table)

    growth = Table("steps", "C -O2, s", "umbra-bench, s", "ratio", title="one body, float64")
    for steps in (10**3, 10**5, 10**7) if quick else (10**3, 10**4, 10**5, 10**6, 10**7, 10**8):
        pair = measure(1, "float64", steps, 3 if steps < 10**8 else 1, ["C -O2", "umbra-bench"])
        seconds = {row["contender"]: row["seconds"] for row in pair}
        ours, limit = seconds["umbra-bench"], seconds["C -O2"]
        ratio = f"{ours / limit:.2f}" if limit else "no compiler"
        growth.add_row(f"{steps:.0e}", f"{limit:.3g}" if limit else "", f"{ours:.3g}", ratio)
    console.print(growth)

    memory = Table(
        "contender", "10^4 steps, MB", "10^8 steps, MB", title="peak memory of a process"
    )
    few, many = (10**4, 10**7) if quick else (10**4, 10**8)
    memory.add_row("umbra-bench", *(f"{peak_memory('umbra-bench', n):.0f}" for n in (few, many)))
    console.print(memory)

    swept = sweep_ratio(1000 if quick else 10_000, 10_000)
    batch = Table("a spring run of 10,000 steps", "ms", "sweep is faster by", title="sweeps")
    for name, seconds in swept.items():
        batch.add_row(name, f"{1e3 * seconds:.3f}", f"{seconds / swept['sweep']:.1f}")
    console.print(batch)

    number = Table("scenarios", "one by one, s", "as a sweep, s", title="springs of 10,000 steps")
    for count, singly, together in scenarios_growth((1, 10, 100, 1000), 10_000):
        number.add_row(str(count), f"{singly:.3g}", f"{together:.3g}")
    console.print(number)

    Path("results").mkdir(exist_ok=True)
    table.write_csv("results/speed.csv")
    draw(table, Path("reports/speed"))
    console.print("results/speed.csv and reports/speed.svg are written")


def _print_speed(console: Console, table: pl.DataFrame) -> None:
    shown = Table(
        "contender", "precision", "bodies", title="ns a body and step", box=None, pad_edge=False
    )
    for column in ("ns", "steps/s", "to C -O2", "to C -O3", "compile, s"):
        shown.add_column(column, justify="right", no_wrap=True)
    for row in table.sort(
        "precision", "bodies", descending=[True, False], maintain_order=True
    ).to_dicts():
        line = (row["contender"], row["precision"], str(row["bodies"]))
        if row["missing"]:
            shown.add_row(*line, "", row["missing"])
            continue
        ratios = [_ratio(table, row, name) for name in ("C -O2", "C -O3 native")]
        pace = f"{row['steps'] / row['seconds']:.3g}"
        shown.add_row(
            *line, f"{row['nanoseconds']:.1f}", pace, *ratios, f"{row['compile_seconds']:.2f}"
        )
    console.print(shown)


def _ratio(table: pl.DataFrame, row: dict[str, Any], name: str) -> str:
    limit = table.filter(
        (pl.col("contender") == name)
        & (pl.col("bodies") == row["bodies"])
        & (pl.col("precision") == row["precision"])
    )["seconds"]
    return f"{row['seconds'] / limit[0]:.2f}" if len(limit) and limit[0] else ""


if __name__ == "__main__":
    main()
