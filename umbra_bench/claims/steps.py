"""Motion in continuous time, explicit Euler, semi-implicit Euler, and who uses it."""

from __future__ import annotations

import numpy as np

from umbra_bench.analysis.oscillator import spectral_radius
from umbra_bench.analysis.stability import largest_stable_step, measured_growth
from umbra_bench.analysis.symplectic import ROUNDING, symplectic_defect
from umbra_bench.claims.lab import Lab, distance_from, particle
from umbra_bench.claims.statement import Evidence, Waiting, at_least, at_most, statement
from umbra_bench.errors import EngineFailed
from umbra_bench.identify import MATCH, identify
from umbra_bench.methods import METHODS
from umbra_bench.simulation import simulate
from umbra_bench.wording import number

MOTION = "Motion in Continuous Time"
EXPLICIT = "Explicit Euler: The Naive Approach"
SEMI_IMPLICIT = "Semi-Implicit (Symplectic) Euler"

MILLION = 1_000_000

ORDER_MARGIN = 0.1
"""An observed order this near to a whole number is that order."""


@statement("near-3.05", MOTION, "A body at 3 m that moves at 5 m/s is near 3.05 m after 0.01 s.")
def near(lab: Lab) -> Evidence:
    free, pulled = (
        float(
            simulate(
                particle((5.0, 0.0), position=(3.0, 0.0), gravity=gravity),
                lab.subject,
                0.01,
                steps=1,
                precision="float32",
            ).position[-1, 0, 0]
        )
        for gravity in ((0.0, 0.0), (10.0, 0.0))
    )
    return Evidence(
        required=(
            at_most("distance from 3.05 m without a force", abs(free - 3.05), 1e-6, "m"),
            at_most("distance from 3.05 m at 10 m/s²", abs(pulled - 3.05), 1e-2, "m"),
        ),
        holds=f"Without a force {free:.7f} m, with 10 m/s² {pulled:.7f} m.",
        fails=f"Without a force {free:.7f} m, with 10 m/s² {pulled:.7f} m.",
    )


@statement(
    "ten-a-second", MOTION, "An acceleration of 10 m/s² adds 10 m/s to the velocity every second."
)
def ten_a_second(lab: Lab) -> Evidence:
    run = simulate(particle(gravity=(10.0, 0.0)), lab.subject, 0.01, steps=200, every=100)
    first, second = np.diff(run.velocity[:, 0, 0])
    return Evidence(
        required=(at_most("error of the gain in the 2nd second", abs(second - 10), 1e-9, "m/s"),),
        limits=(at_most("error of the gain in the 1st second", abs(first - 10), 1e-9, "m/s"),),
        holds="In every second, the first included.",
        condition=(
            f"From the second frame on. The first frame averages with a stored acceleration of zero "
            f"and takes half: after the first second the velocity is {first:.4g} m/s."
        ),
        fails=f"The second second adds {second:.6g} m/s.",
    )


@statement("explicit-euler-first-order", EXPLICIT, "Explicit Euler is of first order.")
def explicit_first_order(lab: Lab) -> Evidence:
    order = lab.order("spring", "explicit-euler")
    return Evidence(
        required=(at_most("|observed order − 1|, spring", abs(order - 1.0), ORDER_MARGIN),),
        holds=f"Its position error on the spring shrinks with order {order:.2f}.",
        fails=f"Its observed order on the spring is {order:.2f}.",
    )


_OMEGA_DT = np.geomspace(1e-4, 2.0, 60)


@statement(
    "explicit-euler-adds-energy",
    EXPLICIT,
    "Explicit Euler adds energy on a spring, at every step size.",
)
def explicit_adds_energy(lab: Lab) -> Evidence:
    growth = measured_growth("explicit-euler", _OMEGA_DT)
    theory = np.array([spectral_radius("explicit-euler", w) for w in _OMEGA_DT])
    least = float((growth - 1.0).min())
    return Evidence(
        required=(
            at_least("least growth of the amplitude per step, ω dt from 1e-4 to 2", least, 1e-10),
            at_most("distance from √(1 + ω²dt²)", float(abs(growth - theory).max()), 1e-12),
        ),
        holds="Its amplitude grows by √(1 + ω²dt²) a step, which is above 1 for every dt.",
        fails=f"At some step its amplitude grows by {number(least)} only.",
    )


@statement(
    "explicit-euler-bounces-higher",
    EXPLICIT,
    "With explicit Euler a ball on a spring bounces higher each time.",
)
def explicit_bounces_higher(lab: Lab) -> Evidence:
    run = lab.run("spring", "explicit-euler", 0.01, 2000)
    energy = run.at.energy[:: round(np.pi / 0.01)]  # the period of the spring is pi seconds
    least = float((energy[1:] / energy[:-1] - 1.0).min())
    return Evidence(
        required=(at_least("least gain of energy in a period, dt = 0.01 s", least, 1e-3),),
        holds=f"Every period adds at least {100 * least:.3g} % of energy.",
        fails=f"A period gains {100 * least:.3g} % only.",
    )


@statement(
    "explicit-euler-slower-for-smaller-dt",
    EXPLICIT,
    "The smaller dt is, the slower explicit Euler diverges, but it never stops.",
)
def explicit_slower(lab: Lab) -> Evidence:
    def largest_ratio(omega_dt: np.ndarray) -> float:
        """Of the rate of energy growth at one dt to that at the next longer one."""
        rate = 2.0 * np.log(measured_growth("explicit-euler", omega_dt)) / omega_dt
        return float((rate[:-1] / rate[1:]).max())

    short, long = np.geomspace(1e-4, 1.0, 60), np.linspace(1.0, 4.0, 60)
    ratio, beyond = largest_ratio(short), largest_ratio(long)
    least = float(2.0 * np.log(measured_growth("explicit-euler", short[:1]))[0] / short[0])
    return Evidence(
        required=(
            at_most(
                "largest ratio of the rate to that of the next longer dt, ω dt ≤ 1", ratio, 1.0
            ),
            at_least("rate of energy growth over ω at ω dt = 1e-4", least, 1e-6),
        ),
        limits=(at_most("the same ratio, ω dt from 1 to 4", beyond, 1.0),),
        holds="At every step that was tried.",
        condition=(
            "For steps that are short for the spring: at ω dt = 1e-4 energy still grows at a rate of "
            f"{least:.2g} ω. Near ω dt = 2 the rate ln(1 + ω²dt²)/dt has its maximum, and beyond it a "
            "shorter step diverges faster."
        ),
        fails=f"The rate changes by a factor of {ratio:.4g} from one dt to the next shorter.",
    )


@statement("explicit-euler-spirals", EXPLICIT, "With explicit Euler an orbit spirals outward.")
def explicit_spirals(lab: Lab) -> Evidence:
    turn = round(2 * np.pi / 0.01)
    run = lab.run("orbit_circular", "explicit-euler", 0.01, 10 * turn)
    radius = distance_from((0.0, 0.0), run)[:-1].reshape(10, turn).mean(axis=1)
    least, total = float((radius[1:] / radius[:-1]).min()), float(radius[-1])
    return Evidence(
        required=(
            at_least("least ratio of one turn's mean radius to the last's", least, 1.0 + 1e-4),
            at_least("mean radius of the tenth turn's time, of a circle of 1 m", total, 1.05, "m"),
        ),
        holds=f"A circle of radius 1 m has grown to {total:.3g} m after ten turns' time at dt = 0.01 s.",
        fails=f"The radius after ten turns' time is {total:.6g} m.",
    )


@statement(
    "semi-implicit-symplectic",
    SEMI_IMPLICIT,
    "Semi-implicit Euler preserves the geometric structure of phase space.",
)
def semi_implicit_symplectic(lab: Lab) -> Evidence:
    defects = {
        name: symplectic_defect(
            lab.scenario(name), lab.reference(name), "semi-implicit-euler"
        ).as_read
        for name in ("orbit_eccentric", "elastic_pendulum")
    }
    return Evidence(
        required=tuple(
            at_most(f"largest |JᵀΩJ − Ω|, 64 states of {name}", value, ROUNDING)
            for name, value in defects.items()
        ),
        holds="The Jacobian of its step is symplectic to round-off at every state that was tried.",
        fails=f"The Jacobian misses by {number(max(defects.values()))}.",
    )


@statement(
    "semi-implicit-energy-on-average",
    SEMI_IMPLICIT,
    "Semi-implicit Euler conserves energy on average.",
)
def semi_implicit_on_average(lab: Lab) -> Evidence:
    run = lab.run("spring", "semi-implicit-euler", 0.01, MILLION, 100)
    error = run.at.energy / run.at.energy[0] - 1.0
    swing = float(np.ptp(error))
    halves = [float(half.mean()) for half in np.array_split(error[1:], 2)]
    shift = abs(halves[1] - halves[0]) / swing
    return Evidence(
        required=(
            at_most("change of the mean energy between two halves, over its swing", shift, 1e-3),
        ),
        holds=(
            f"Over a million steps on the spring the energy swings by {100 * swing:.2g} %, and its "
            f"mean moves by {number(shift)} of that swing."
        ),
        fails=f"The mean energy moves by {number(shift)} of its swing.",
    )


@statement(
    "semi-implicit-never-blows-up",
    SEMI_IMPLICIT,
    "With semi-implicit Euler a spring wobbles around the true amplitude but never blows up.",
)
def semi_implicit_never_blows_up(lab: Lab) -> Evidence:
    run = lab.run("spring", "semi-implicit-euler", 0.01, MILLION, 100)
    high = float(run.high.energy.max() / run.at.energy[0] - 1.0)
    limit = largest_stable_step("semi-implicit-euler")
    return Evidence(
        required=(at_most("largest gain of energy in a million steps, ω dt = 0.02", high, 0.1),),
        limits=(at_least("largest ω dt without growth, of those up to 4", limit, 4.0),),
        holds="At every step that was tried.",
        condition=f"Only up to ω dt = {limit:.3g}: a stiffer spring grows without bound.",
        fails=f"The energy rose by {100 * high:.3g} %.",
    )


@statement(
    "semi-implicit-stable-orbit",
    SEMI_IMPLICIT,
    "With semi-implicit Euler an orbit stays on a stable path indefinitely.",
)
def semi_implicit_stable_orbit(lab: Lab) -> Evidence:
    def errors(name: str) -> tuple[float, float]:
        """The largest energy error over the energy; the second half million steps' over the first's."""
        run = lab.run(name, "semi-implicit-euler", 0.01, MILLION, 100)
        truth = run.at.energy[0]
        worst = np.maximum(abs(run.high.energy - truth), abs(run.low.energy - truth)) / abs(truth)
        first, second = np.array_split(worst, 2)
        return float(worst.max()), float(second.max() / first.max())

    found = {
        "circular orbit": errors("orbit_circular"),
        "eccentricity 0.6": errors("orbit_eccentric"),
        "eccentricity 0.9": errors("orbit_extreme"),
    }
    criteria = {
        name: (
            at_most(f"largest energy error over the energy, a million steps, {name}", error, 0.1),
            at_most(f"second half million steps' largest over the first's, {name}", ratio, 1.05),
        )
        for name, (error, ratio) in found.items()
    }
    comet, _ = found["eccentricity 0.9"]
    return Evidence(
        required=(*criteria["circular orbit"], *criteria["eccentricity 0.6"]),
        limits=criteria["eccentricity 0.9"],
        holds="The energy error of a million steps stays small, at any eccentricity tried.",
        condition=(
            "As long as the step is short for the closest approach. At eccentricity 0.9 and dt = 0.01 s "
            f"the energy is off by up to {100 * comet:.3g} % of itself."
        ),
        fails="The energy error is not small, or grows.",
    )


@statement(
    "engines-use-it",
    SEMI_IMPLICIT,
    "Box2D, Bullet and PhysX use a variant of symplectic integration.",
)
def engines_use_it(lab: Lab) -> Evidence:
    engines = ("box2d", "bullet", "physx")
    missing = [METHODS[name].missing for name in engines if not METHODS[name].installed]
    if missing:
        raise Waiting(f"Not measured: {missing[0]}.")
    try:
        found = {METHODS[name].title: identify(name) for name in engines}
    except EngineFailed as reason:
        raise Waiting(f"Not measured: {reason}.") from None
    distances = {
        title: min(c.position for c in identity.comparisons if c.candidate in SYMPLECTIC)
        for title, identity in found.items()
    }
    answers = "; ".join(f"{title}: {identity.integrator}" for title, identity in found.items())
    return Evidence(
        required=tuple(
            at_most(
                f"positions of {title} from the nearest symplectic integrator's, in round-off",
                distance,
                MATCH,
            )
            for title, distance in distances.items()
        ),
        holds=f"Their trajectories say so to round-off. {answers}.",
        fails=f"Their trajectories say: {answers}.",
    )


SYMPLECTIC = (
    "semi-implicit-euler",
    "drift-kick",
    "velocity-verlet",
    "drift-kick-drift",
    "yoshida4",
)
