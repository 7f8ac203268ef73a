"""Damping, angles, the force pipeline, and the default step."""

from __future__ import annotations

import math

import numpy as np

from umbra_bench.analysis.stability import largest_stable_step
from umbra_bench.claims.lab import Lab, particle
from umbra_bench.claims.statement import Evidence, at_least, at_most, statement
from umbra_bench.simulation import Trajectory, simulate
from umbra_bench.umbra import Bodies, BodyDefinition, UmbraState, apply_damping, step
from umbra_bench.wording import number

DAMPING = "Exponential Damping"
PIPELINE = "Putting It All Together: The Integration Pipeline"
FORCES = "The Force Pipeline"
DIFFERENTIALS = "From Differentials to Integration"

DT = 0.01
RATES = (25, 50, 100, 200)
"""Frames per second."""

ROUNDING = 1e-5


def _spread(values: list[float]) -> float:
    numbers: np.ndarray = np.array(values)
    return float(np.ptp(numbers) / abs(numbers.mean()))


@statement(
    "damping-frame-rate-independent",
    DAMPING,
    "Damping by d^dt takes the same energy per second at any frame rate.",
)
def damping(lab: Lab) -> Evidence:
    def energy(rate: int, gravity: tuple[float, float], seconds: int) -> float:
        scenario = particle((3.0, 0.0), gravity=gravity, kept=0.5)
        run = simulate(scenario, lab.subject, 1.0 / rate, steps=rate * seconds, every=rate)
        return float((run.velocity[-1, :2, 0] ** 2).sum() / 2)

    free = _spread([energy(rate, (0.0, 0.0), 1) for rate in RATES])
    falling = _spread([energy(rate, (0.0, -9.81), 20) for rate in RATES])
    return Evidence(
        required=(at_most("spread of the energy left after 1 s, 25 to 200 frames/s", free, 1e-12),),
        limits=(
            at_most("spread of the energy of a body that falls at its final speed", falling, 1e-6),
        ),
        holds="With and without a force.",
        condition=(
            "Only where no force acts. A falling body's final energy differs by "
            f"{100 * falling:.2g} % between 25 and 200 frames/s (half the speed kept per second): the "
            "force of a frame is damped as a whole, however long the frame is."
        ),
        fails=f"The energy left differs by {number(free)}.",
    )


@statement("damping-numbers", DAMPING, "0.975^0.01 is about 0.99975, and 0.975^0.02 about 0.99949.")
def damping_numbers(lab: Lab) -> Evidence:
    kept = [
        float(
            apply_damping(np.ones(1, np.float32), np.full(1, 0.975, np.float32), np.float32(dt))[0]
        )
        for dt in (0.01, 0.02)
    ]
    errors = [abs(k - said) for k, said in zip(kept, (0.99975, 0.99949), strict=True)]
    return Evidence(
        required=tuple(
            at_most(f"distance of what a frame of {dt:g} s keeps", error, 5e-6)
            for dt, error in zip((0.01, 0.02), errors, strict=True)
        ),
        holds=f"A frame keeps {kept[0]:.6f} and {kept[1]:.6f}.",
        fails=f"A frame keeps {kept[0]:.6f} and {kept[1]:.6f}.",
    )


@statement(
    "naive-damping-depends-on-rate",
    DAMPING,
    "Damping by a constant per frame depends on frame rate.",
)
def naive_damping(lab: Lab) -> Evidence:
    def left(rate: int) -> float:
        velocity = 1.0
        for _ in range(rate):
            velocity *= 0.99
        return velocity

    spread = _spread([left(rate) for rate in RATES])
    return Evidence(
        required=(
            at_least("spread of the velocity left after 1 s, 25 to 200 frames/s", spread, 0.1),
        ),
        holds=(
            f"After a second {left(50):.3g} of the velocity is left at 50 frames/s, "
            f"{left(100):.3g} at 100."
        ),
        fails=f"The velocity left differs by {number(spread)}.",
    )


@statement(
    "damping-of-each-body", DAMPING, "Each body can override the damping of the world around it."
)
def damping_of_each_body(lab: Lab) -> Evidence:
    shared, own = 0.5, 0.9
    scenario = particle((3.0, 0.0), angular_velocity=2.0, kept=shared)
    first = scenario.bodies[0]
    second = first.model_copy(update={"name": "other", "linear_damping": own})
    both = scenario.model_copy(update={"bodies": (first, second)})
    run = simulate(both, lab.subject, DT, steps=100, every=100)
    kept = run.velocity[-1, [0, 2]] / run.velocity[0, [0, 2]]  # of vx and omega, per body
    errors = (abs(kept[0, 0] - shared), abs(kept[0, 1] - own), abs(kept[1, 1] - shared))
    return Evidence(
        required=(
            at_most("error of what a body without its own keeps in 1 s", errors[0], 1e-9),
            at_most("error of what a body with its own keeps", errors[1], 1e-9),
            at_most(
                "error of the spin that the latter keeps, which is not overridden", errors[2], 1e-9
            ),
        ),
        holds=f"Of two bodies one keeps {kept[0, 0]:.3g} of its speed in a second, one {kept[0, 1]:.3g}.",
        fails=f"They keep {kept[0, 0]:.6g} and {kept[0, 1]:.6g} of their speed.",
    )


@statement("angles-in-range", PIPELINE, "Angles are brought to [0, 2π) after every step.")
def angles_in_range(lab: Lab) -> Evidence:
    lowest, highest = math.inf, -math.inf
    for spin in (-31.4, -0.01, 0.01, 12.5):
        run = simulate(
            particle(angular_velocity=spin), lab.subject, DT, steps=1000, precision="float32"
        )
        angle = run.position[1:, 2, 0].astype(float)
        lowest, highest = min(lowest, angle.min()), max(highest, angle.max())
    return Evidence(
        required=(
            at_least("lowest angle, spins in both senses, float32", lowest, 0.0, "rad"),
            at_most("highest angle", highest, float(np.nextafter(2 * math.pi, 0.0)), "rad"),
        ),
        holds=f"They lie between {lowest:.3g} and {highest:.7g} rad.",
        fails=f"They lie between {lowest:.4g} and {highest:.8g} rad.",
    )


@statement(
    "wrapping-prevents-drift",
    PIPELINE,
    "Keeping angles in [0, 2π) prevents floating-point drift over many rotations.",
)
def wrapping(lab: Lab) -> Evidence:
    spin, dt, steps, every = 7.3, 2.0**-7, 2**21, 2**9
    turn = 2 * math.pi

    def error(method: str, precision: str) -> np.ndarray:
        """The angle's error so far, without turns taken off: a clock that is a turn late is late."""
        run = simulate(
            particle(angular_velocity=spin),
            method,
            dt,
            steps=steps,
            every=every,
            precision=precision,
        )
        gap = run.position[:, 2, 0].astype(float) - float(np.float32(spin)) * run.times
        whole_turns = np.concatenate([[0.0], np.cumsum(np.round(np.diff(gap) / turn))])
        return np.maximum.accumulate(np.abs(gap - turn * whole_turns if wraps(run) else gap))

    def wraps(run: Trajectory) -> bool:
        return float(np.abs(run.position[:, 2, 0]).max()) < 4 * math.pi

    wrapped = error(lab.subject, "float32")
    unwrapped = error("semi-implicit-euler", "float32")
    turns = spin * dt * steps / turn
    after = int(np.searchsorted(np.arange(len(wrapped)) * every * dt, 1000 * turn / spin))
    of_two_pi = 1000 * abs(float(np.float32(turn)) - turn)
    late, later = float(wrapped[after]), float(wrapped[-1])
    return Evidence(
        required=(
            at_most(
                f"angle's error over that without wrapping, {turns:.0f} turns in float32",
                later / float(unwrapped[-1]),
                0.5,
            ),
        ),
        limits=(at_most("the angle's error after 1000 turns", late, 1e-3, "rad"),),
        holds=f"The wrapped angle is off by {number(late)} rad after 1000 turns.",
        condition=(
            f"It drifts less, not nothing: {number(late)} rad after 1000 turns and {number(later)} rad "
            f"after {turns:.0f}, where the angle that is not wrapped is off by "
            f"{number(float(unwrapped[after]))} and {number(float(unwrapped[-1]))} rad. Of the former "
            f"{number(of_two_pi)} rad come from float32's 2π, which is too large; the rest from rounding "
            "the same sum in every step."
        ),
        fails=(
            f"After {turns:.0f} turns the wrapped angle is off by {number(later)} rad, the other by "
            f"{number(float(unwrapped[-1]))}."
        ),
    )


@statement(
    "forces-cleared-each-frame", FORCES, "Forces act in their frame and are cleared after it."
)
def cleared(lab: Lab) -> Evidence:
    body = BodyDefinition(mass=2.0)
    bodies, state = Bodies.of([body]), UmbraState.of([body])
    state.force[:, 0] = 10.0, 0.0, 3.0
    first = step(bodies, state, np.float32(DT))
    second = step(bodies, first, np.float32(DT))
    third = step(bodies, second, np.float32(DT))
    left = float(np.abs(first.force).max())
    late = float(abs(second.velocity[0, 0] - first.velocity[0, 0]) / first.velocity[0, 0])
    later = float(np.abs(third.velocity - second.velocity).max())
    return Evidence(
        required=(
            at_most("what is left of force and torque after the frame", left, 0.0, "N"),
            at_most("velocity gained in the third frame", later, 0.0, "m/s"),
        ),
        limits=(at_most("velocity gained in the second frame, over the first's", late, 0.0),),
        holds="Nothing of a force is felt after its frame.",
        condition=(
            "The accumulators are. But the stored acceleration carries a force into the next frame, "
            f"which gains {100 * late:.4g} % of the velocity that the force's own frame did."
        ),
        fails=f"{number(left)} N are left, and the third frame gains {number(later)} m/s.",
    )


@statement("impulses-act-at-once", FORCES, "An impulse changes the velocity at once, by J/m.")
def impulses(lab: Lab) -> Evidence:
    world = lab.world(BodyDefinition(mass=2.0, velocity=(1.0, 0.0)))
    world.apply_impulse(0, (3.0, -1.0))
    vx, vy = world.read(0).velocity
    error = max(abs(vx - 2.5), abs(vy + 0.5))
    return Evidence(
        required=(at_most("distance from v + J/m before any step", error, 1e-6, "m/s"),),
        holds="Before any step.",
        fails=f"The velocity is off by {number(error)} m/s.",
    )


@statement(
    "impulse-at-a-point-turns",
    FORCES,
    "An impulse off the centre also changes the spin, by r x J/I.",
)
def impulse_at_point(lab: Lab) -> Evidence:
    world = lab.world(BodyDefinition(mass=2.0, inertia=0.5, position=(1.0, 2.0)))
    world.apply_impulse_at_point(0, (3.0, 2.0), (1.4, 1.7))
    state = world.read(0)
    truth = (0.4 * 2.0 - (-0.3) * 3.0) / 0.5
    return Evidence(
        required=(
            at_most(
                "relative error of the spin", abs(state.angular_velocity / truth - 1), ROUNDING
            ),
            at_most("error of the velocity", abs(state.velocity[0] - 1.5), 1e-6, "m/s"),
        ),
        holds=f"It spins at {state.angular_velocity:.6g} rad/s before any step.",
        fails=f"It spins at {state.angular_velocity:.6g} rad/s, and r x J/I is {truth:.6g}.",
    )


@statement("off-centre-force-turns", FORCES, "A force off the centre also exerts the torque r x F.")
def off_centre(lab: Lab) -> Evidence:
    body = BodyDefinition(mass=2.0, inertia=0.5, position=(1.0, 2.0))
    world = lab.world(body)
    world.apply_force_at_point(0, (3.0, 2.0), (1.4, 1.7))
    world.step(DT)
    world.step(DT)
    shown = world.read(0).angular_velocity / DT * 0.5
    truth = 0.4 * 2.0 - (-0.3) * 3.0
    return Evidence(
        required=(at_most("relative error of the torque", abs(shown / truth - 1.0), ROUNDING),),
        holds=f"It turns by {shown:.6g} N m, as r x F says.",
        fails=f"It turns by {shown:.6g} N m, r x F is {truth:.6g}.",
    )


@statement("central-force-translates", FORCES, "A force through the centre is pure translation.")
def central(lab: Lab) -> Evidence:
    world = lab.world(BodyDefinition(mass=2.0, inertia=0.5, position=(1.0, 2.0)))
    for _ in range(100):
        world.apply_force_at_point(0, (3.0, 2.0), world.read(0).position)
        world.step(DT)
    state = world.read(0)
    return Evidence(
        required=(
            at_most("angular velocity after 1 s", abs(state.angular_velocity), 0.0, "rad/s"),
            at_least("speed after 1 s", math.hypot(*state.velocity), 1.0, "m/s"),
        ),
        holds="The body does not turn at all.",
        fails=f"It turns at {number(abs(state.angular_velocity))} rad/s.",
    )


@statement("default-step-is-sensible", DIFFERENTIALS, "0.01 s is a sensible default step.")
def default_step(lab: Lab) -> Evidence:
    limit = largest_stable_step(lab.subject)
    stiffness = (limit / DT) ** 2
    frequency = limit / DT / (2 * math.pi)
    energy = lab.at_step("spring", lab.subject, "energy_error_max")
    orbit = lab.at_step("orbit_eccentric", lab.subject, "energy_error_max")
    return Evidence(
        required=(at_least("stiffest stable spring, stiffness over mass", stiffness, 1e4, "1/s²"),),
        limits=(
            at_most("energy error on a spring of 0.3 Hz", energy, 0.01),
            at_most("energy error on an orbit of eccentricity 0.6", orbit, 0.01),
        ),
        holds=(
            f"Springs are stable up to {number(stiffness)} N/m per kg ({frequency:.3g} Hz), and the "
            f"energy of slow motions is right within {100 * max(energy, orbit):.2g} %."
        ),
        condition=(
            f"Stable it is, for springs up to {number(stiffness)} N/m per kg ({frequency:.3g} Hz). "
            f"Accurate to a percent it is not, even for slow motions: the energy of a spring of 0.3 Hz "
            f"is off by {100 * energy:.2g} %, that of the orbit by {100 * orbit:.2g} %."
        ),
        fails=f"Springs above {number(stiffness)} N/m per kg are unstable.",
    )
