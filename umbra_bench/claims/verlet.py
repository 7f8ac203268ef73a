"""UMBRA's own integrator, which its devlog calls velocity Verlet."""

from __future__ import annotations

import numpy as np

from umbra_bench.analysis.identity import distance, undamped
from umbra_bench.analysis.stability import measured_growth
from umbra_bench.analysis.symplectic import ROUNDING, symplectic_defect
from umbra_bench.claims.lab import Lab, distance_from
from umbra_bench.claims.statement import Evidence, at_least, at_most, statement
from umbra_bench.claims.steps import MILLION
from umbra_bench.identify import identify
from umbra_bench.scenario import list_scenarios
from umbra_bench.wording import number

VERLET = "Velocity Verlet: Second-Order Accuracy"
PIPELINE = "Putting It All Together: The Integration Pipeline"

SECOND = 1.9
"""An observed order of at least this is second order."""

SAME = 1e-6
"""Two methods whose positions differ by no more than this part of their error are one."""


COMPARED = ("spring", "orbit_circular", "orbit_eccentric", "elastic_pendulum")
"""Where the integrator is compared with semi-implicit Euler, at dt = 0.01 s."""


def _ratio(
    lab: Lab, name: str, column: str, *, of: str = "", over: str = "semi-implicit-euler"
) -> float:
    """An error of the subject, or of another method, over that of a method to be beaten."""
    return lab.at_step(name, of or lab.subject, column) / lab.at_step(name, over, column)


@statement("umbra-second-order", VERLET, "UMBRA's integrator is of second order.")
def second_order(lab: Lab) -> Evidence:
    orders = {
        (name, quantity): lab.order(name, lab.subject, quantity)
        for name in ("spring", "orbit_eccentric")
        for quantity in ("position", "velocity")
    }
    verlet = lab.order("spring", "velocity-verlet")
    low, high = min(orders.values()), max(orders.values())
    return Evidence(
        required=tuple(
            at_least(f"observed order of {quantity}, {name}", order, SECOND)
            for (name, quantity), order in orders.items()
        ),
        holds=f"Its observed orders are {low:.2f} to {high:.2f}.",
        fails=(
            f"Its observed orders are {low:.2f} to {high:.2f}; velocity Verlet itself has "
            f"{verlet:.2f} on the spring."
        ),
    )


@statement(
    "umbra-one-step-further",
    VERLET,
    "UMBRA's integrator goes one step further than semi-implicit Euler.",
)
def one_step_further(lab: Lab) -> Evidence:
    apart = {
        name: distance(lab.scenario(name), lab.reference(name), lab.subject, "semi-implicit-euler")
        for name in list_scenarios()
        if undamped(lab.scenario(name))
    }
    where, farthest = max(apart.items(), key=lambda item: item[1].of_error)
    return Evidence(
        required=(
            at_least(
                f"largest distance of the two methods' positions over their error, {len(apart)} "
                "undamped scenarios",
                farthest.of_error,
                SAME,
            ),
        ),
        holds=f"Its positions are up to {number(farthest.of_error)} times its own error away from "
        "semi-implicit Euler's.",
        fails=(
            f"On all {len(apart)} undamped scenarios it has the positions of semi-implicit Euler: where "
            f"they differ most ({where}) it is by {farthest.ulps:.0f} units in the last place, "
            f"{number(farthest.of_error)} of the error that both share. Put u = v + a dt/2 and the "
            "formulas are the same."
        ),
    )


@statement("umbra-symplectic", VERLET, "UMBRA's integrator is symplectic.")
def symplectic(lab: Lab) -> Evidence:
    defects = {
        name: symplectic_defect(lab.scenario(name), lab.reference(name), lab.subject)
        for name in ("orbit_eccentric", "elastic_pendulum")
    }
    read = max(d.as_read for d in defects.values())
    return Evidence(
        required=tuple(
            at_most(f"largest |JᵀΩJ − Ω| of (x, v + a dt/2), {name}", d.half_a_kick_later, ROUNDING)
            for name, d in defects.items()
        ),
        limits=tuple(
            at_most(
                f"largest |JᵀΩJ − Ω| of (x, v) as a game reads them, {name}", d.as_read, ROUNDING
            )
            for name, d in defects.items()
        ),
        holds="The Jacobian of its step is symplectic to round-off at every state that was tried.",
        condition=(
            "In position and the velocity half a kick later. In the velocity that a game reads it is "
            f"conjugate to a symplectic map but not one itself: its Jacobian misses by {number(read)}. "
            "What follows from symplecticity in the long run, bounded energy, it has."
        ),
        fails=f"The Jacobian misses by {number(read)}.",
    )


@statement(
    "umbra-better-energy",
    VERLET,
    "UMBRA's integrator conserves energy more accurately than semi-implicit Euler.",
)
def better_energy(lab: Lab) -> Evidence:
    ratios = {name: _ratio(lab, name, "energy_error_max") for name in COMPARED}
    verlet = _ratio(lab, "spring", "energy_error_max", over="velocity-verlet")
    velocity = identify(lab.subject, [lab.scenario("spring")]).velocity
    return Evidence(
        required=tuple(
            at_most(f"its largest energy error over semi-implicit Euler's, {name}", ratio, 0.99)
            for name, ratio in ratios.items()
        ),
        holds=f"Its energy error is at most {number(max(ratios.values()))} times as large.",
        fails=(
            f"Its energy error is {number(min(ratios.values()))} to {number(max(ratios.values()))} "
            f"times that of semi-implicit Euler at dt = 0.01 s, and {number(verlet)} times that of "
            f"velocity Verlet on the spring. The velocity that it reports {velocity}."
        ),
    )


@statement(
    "umbra-smoother",
    VERLET,
    "Averaging the accelerations gives smoother, more accurate trajectories.",
)
def smoother(lab: Lab) -> Evidence:
    ratios = {name: _ratio(lab, name, "position_error_max") for name in COMPARED}
    return Evidence(
        required=tuple(
            at_most(f"its largest position error over semi-implicit Euler's, {name}", ratio, 0.99)
            for name, ratio in ratios.items()
        ),
        holds=f"Its position error is at most {number(max(ratios.values()))} times as large.",
        fails=(
            f"Its position error is {max(ratios.values()):.3g} times that of semi-implicit Euler, to "
            f"within {number(max(abs(ratio - 1.0) for ratio in ratios.values()))}."
        ),
    )


@statement(
    "stored-acceleration-pays",
    VERLET,
    "Storing the last acceleration is a small cost for measurably better quality.",
)
def stored_acceleration_pays(lab: Lab) -> Evidence:
    ratio = _ratio(lab, "spring", "position_error_max")
    repaired = _ratio(lab, "spring", "position_error_max", of="umbra-repaired")
    return Evidence(
        required=(
            at_most(
                "its position error over that of semi-implicit Euler, which stores none, spring",
                ratio,
                0.99,
            ),
        ),
        holds=f"With it the position error is {number(ratio)} times as large.",
        fails=(
            f"With it the position error is {100 * ratio:.4g} % of that of semi-implicit Euler, which "
            "stores none. The same storage, used in the repaired order, brings it down to "
            f"{100 * repaired:.2g} %."
        ),
    )


@statement(
    "umbra-no-spiral",
    VERLET,
    "UMBRA's a dt²/2 prevents the spiralling that first-order methods show.",
)
def no_spiral(lab: Lab) -> Evidence:
    def drift(method: str) -> float:
        run = lab.run("orbit_circular", method, 0.01, MILLION, 100)
        radius = distance_from((0.0, 0.0), run)
        tenth = len(radius) // 10
        return abs(float(radius[-tenth:].mean() / radius[:tenth].mean()) - 1.0)

    own, first_order = drift(lab.subject), drift("semi-implicit-euler")
    without = float(measured_growth("umbra-uncorrected", np.array([0.02]))[0])
    return Evidence(
        required=(
            at_most("change of the orbit's radius over a million steps", own, 1e-3),
            at_least(
                "growth per step of the same pipeline without the term, ω dt = 0.02",
                without,
                1.0 + 1e-6,
            ),
        ),
        limits=(
            at_least(
                "change of radius by semi-implicit Euler, of first order and without the term",
                first_order,
                1e-3,
            ),
        ),
        holds="It does not spiral, and first-order methods do.",
        condition=(
            "The term is needed in this pipeline, which without it spirals outward. But being of "
            "first order is not what makes a method spiral: semi-implicit Euler has no such term and "
            f"its orbit changes by {number(first_order)} in a million steps, as UMBRA's does by "
            f"{number(own)}."
        ),
        fails=f"Its orbit changes by {number(own)} in a million steps.",
    )


@statement(
    "umbra-order-of-phases",
    PIPELINE,
    "Velocity Verlet requires two phases in this order: forces to velocities, then positions.",
)
def order_of_phases(lab: Lab) -> Evidence:
    own = lab.order("orbit_eccentric", lab.subject)
    swapped = lab.order("orbit_eccentric", "umbra-repaired")
    alone = lab.order("orbit_eccentric", "umbra-swapped")
    return Evidence(
        required=(at_least("observed order of position, as published", own, SECOND),),
        holds=f"In its order the observed order is {own:.2f}.",
        fails=(
            f"In the published order it is of order {own:.2f}. The same two phases the other way round "
            f"are of order {swapped:.2f}, once the first stored acceleration is that of the start "
            f"({alone:.2f} without)."
        ),
    )
