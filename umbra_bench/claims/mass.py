"""Newton's laws, inertia, inverse mass, and gravity as a force."""

from __future__ import annotations

import math

import numpy as np
from scipy import integrate

from umbra_bench.claims.lab import Lab
from umbra_bench.claims.statement import Evidence, at_least, at_most, statement
from umbra_bench.umbra import Bodies, BodyDefinition, UmbraState, step
from umbra_bench.wording import number

NEWTON = "Newton's Laws: Where Forces Enter"
INERTIA = "The Angular Equivalent: Torque and Rotational Inertia"
INVERSE = "Inverse Mass: The Static Body Trick"
GRAVITY = "Gravity as a Force"

DT = 0.01
ROUNDING = 1e-5
"""Relative: what float32 rounds in a frame of this size."""


def _acceleration(
    lab: Lab, body: BodyDefinition, force: float, torque: float
) -> tuple[float, float]:
    """What one frame's force along x and torque change, over dt: m/s^2 and rad/s^2.

    The published average spreads a frame's force over two frames, so two are stepped.
    """
    world = lab.world(body)
    world.apply_force(0, (force, 0.0))
    world.apply_torque(0, torque)
    world.step(DT)
    world.step(DT)
    state = world.read(0)
    return state.velocity[0] / DT, state.angular_velocity / DT


@statement(
    "force-is-mass-times-acceleration",
    NEWTON,
    "10 N give a body of 2 kg 5 m/s², and one of 20 kg 0.5 m/s².",
)
def newton(lab: Lab) -> Evidence:
    light, heavy = (
        _acceleration(lab, BodyDefinition(mass=mass), 10.0, 0.0)[0] for mass in (2.0, 20.0)
    )
    return Evidence(
        required=(
            at_most("relative error at 2 kg", abs(light / 5.0 - 1.0), ROUNDING),
            at_most("relative error at 20 kg", abs(heavy / 0.5 - 1.0), ROUNDING),
        ),
        holds=f"Measured: {light:.6g} and {heavy:.6g} m/s², once the frame after has added its half.",
        fails=f"Measured: {light:.6g} and {heavy:.6g} m/s².",
    )


@statement("torque-is-inertia-times-acceleration", INERTIA, "Torque τ turns a body by α = τ/I.")
def torque(lab: Lab) -> Evidence:
    errors = [
        abs(_acceleration(lab, BodyDefinition(inertia=inertia), 0.0, 3.0)[1] * inertia / 3.0 - 1.0)
        for inertia in (0.02, 0.7, 40.0)
    ]
    return Evidence(
        required=(
            at_most("largest relative error, I from 0.02 to 40 kg m²", max(errors), ROUNDING),
        ),
        holds="To the rounding of float32.",
        fails=f"Off by {number(max(errors))}.",
    )


def _inertia(lab: Lab, body: BodyDefinition) -> float:
    """The inertia that a body shows when it is turned, kg m^2."""
    return 1.0 / _acceleration(lab, body, 0.0, 1.0)[1]


@statement("disk-inertia", INERTIA, "A solid disk has I = m r²/2, computed where none is given.")
def disk(lab: Lab) -> Evidence:
    mass, radius = 3.0, 0.7
    shown = _inertia(lab, BodyDefinition(mass=mass, disk_radius=radius))
    density = mass / (math.pi * radius**2)
    truth, _ = integrate.quad(lambda r: density * 2 * math.pi * r**3, 0.0, radius)
    return Evidence(
        required=(
            at_most(
                "relative distance from ∫ r² dm by quadrature", abs(shown / truth - 1), ROUNDING
            ),
        ),
        holds=f"A disk of {mass:g} kg and {radius:g} m turns as if I = {shown:.6g} kg m².",
        fails=f"It turns as if I = {shown:.6g}, and ∫ r² dm is {truth:.6g} kg m².",
    )


@statement(
    "box-inertia",
    INERTIA,
    "A solid rectangle has I = m (w² + h²)/12, computed where none is given.",
)
def box(lab: Lab) -> Evidence:
    mass, (width, height) = 3.0, (1.3, 0.4)
    shown = _inertia(lab, BodyDefinition(mass=mass, box=(width, height)))
    density = mass / (width * height)
    truth, _ = integrate.dblquad(
        lambda y, x: density * (x * x + y * y), -width / 2, width / 2, -height / 2, height / 2
    )
    return Evidence(
        required=(
            at_most(
                "relative distance from ∫ r² dm by quadrature", abs(shown / truth - 1), ROUNDING
            ),
        ),
        holds=f"A box of {mass:g} kg, {width:g} m x {height:g} m turns as if I = {shown:.6g} kg m².",
        fails=f"It turns as if I = {shown:.6g}, and ∫ r² dm is {truth:.6g} kg m².",
    )


@statement(
    "inertia-given", INERTIA, "Inertia is computed from the shape only where the user gives none."
)
def inertia_given(lab: Lab) -> Evidence:
    shown = _inertia(lab, BodyDefinition(mass=3.0, inertia=0.25, disk_radius=0.7))
    return Evidence(
        required=(
            at_most("relative distance from the 0.25 given", abs(shown / 0.25 - 1), ROUNDING),
        ),
        holds="A disk with an inertia of its own turns by that.",
        fails=f"It turns as if I = {shown:.6g} kg m².",
    )


@statement(
    "rod-harder-than-disk",
    INERTIA,
    "A long thin rod is harder to spin than a compact body of the same mass.",
)
def rod(lab: Lab) -> Evidence:
    rod, compact = (
        _acceleration(lab, body, 0.0, 1.0)[1]
        for body in (
            BodyDefinition(mass=2.0, box=(2.0, 0.05)),
            BodyDefinition(mass=2.0, disk_radius=math.sqrt(0.1 / math.pi)),
        )
    )
    return Evidence(
        required=(
            at_least("spin of a disk over that of a rod, same mass and area", compact / rod, 1.0),
        ),
        holds=f"The same torque spins a disk of equal mass and area {compact / rod:.3g} times as fast.",
        fails=f"The disk spins {compact / rod:.3g} times as fast.",
    )


@statement(
    "inverse-mass-zero-is-immovable",
    INVERSE,
    "Inverse mass zero makes a body immovable under any force, without a special case.",
)
def immovable(lab: Lab) -> Evidence:
    def moved(force: float, times: int) -> float:
        world = lab.world(BodyDefinition(mass=0.0), gravity=(0.0, -9.81))
        with np.errstate(over="ignore"):
            for _ in range(times):
                world.apply_force(0, (force, 0.0))
            world.apply_torque(0, 1e30)
        for _ in range(10):
            world.step(DT)
        state = world.read(0)
        return float(np.abs([*state.position, *state.velocity, state.angular_velocity]).max())

    strong, overflowing = moved(3e38, 1), moved(3e38, 2)
    return Evidence(
        required=(at_most("largest coordinate or velocity after 3e38 N", strong, 0.0),),
        limits=(at_most("the same, where two forces of 3e38 N add up", overflowing, 0.0),),
        holds="It does not move at all.",
        condition=(
            "As long as the accumulated force is finite. Where forces add up beyond float32, infinity "
            "times zero is not a number, and neither is the body's position from then on."
        ),
        fails=f"It moved by {number(strong)}.",
    )


@statement(
    "kinematic-and-sleeping",
    INVERSE,
    "Kinematic and sleeping bodies need no special case: zero inverse mass leaves them out.",
)
def kinematic(lab: Lab) -> Evidence:
    world = lab.world(
        BodyDefinition(kind="kinematic", velocity=(2.0, 0.0)), BodyDefinition(velocity=(2.0, 0.0))
    )
    world.sleep(1)
    for _ in range(100):
        for body in (0, 1):
            world.apply_force(body, (1e6, 1e6))
        world.step(DT)
    platform, sleeper = world.read(0), world.read(1)
    strayed = max(
        abs(platform.position[0] - 2.0), *map(abs, (*sleeper.position, platform.position[1]))
    )
    literal = Bodies.of([BodyDefinition(kind="kinematic", velocity=(2.0, 0.0))])
    literal = literal._replace(damping=np.full((3, 1), 0.975, np.float32))
    state = UmbraState.of([BodyDefinition(kind="kinematic", velocity=(2.0, 0.0))])
    for _ in range(100):
        state = step(literal, state, np.float32(DT))
    lost = 1.0 - float(state.velocity[0, 0]) / 2.0
    awake = Bodies.of([BodyDefinition()])
    awake = awake._replace(inverse_mass=0.0 * awake.inverse_mass)
    coasting = step(awake, UmbraState.of([BodyDefinition(velocity=(2.0, 0.0))]), np.float32(DT))
    coasted = float(coasting.position[0, 0])
    return Evidence(
        required=(
            at_most(
                "how far forces of 1e6 N move them from their paths in 1 s", strayed, 1e-5, "m"
            ),
        ),
        limits=(
            at_most(
                "part of a platform's velocity that the damping of 0.975 takes in 1 s", lost, 0.0
            ),
            at_most("way of a body put to sleep in motion, in a frame", coasted, 0.0, "m"),
        ),
        holds="Forces do not move them, and nothing else does.",
        condition=(
            "For forces. Damping multiplies velocities without asking for the mass: a moving platform "
            f"loses {100 * lost:.2g} % of its speed in a second, unless it is left out (as it is here). "
            "And zero inverse mass alone does not stop a moving body: it has to be put to rest."
        ),
        fails=f"They strayed by {number(strayed)} m.",
    )


@statement(
    "gravity-same-for-all", GRAVITY, "All bodies fall alike, whatever their mass (m g over m is g)."
)
def gravity(lab: Lab) -> Evidence:
    masses = np.geomspace(1e-6, 1e6, 25)
    world = lab.world(*(BodyDefinition(mass=m) for m in masses), gravity=(0.0, -9.81))
    for _ in range(100):
        world.step(DT)
    speeds = np.array([world.read(i).velocity[1] for i in range(len(masses))])
    spread = float(np.ptp(speeds) / abs(speeds.mean()))
    return Evidence(
        required=(
            at_most("relative spread of the speeds, 1e-6 to 1e6 kg, after 1 s", spread, ROUNDING),
        ),
        holds=f"Twelve decades of mass differ by {number(spread)} of their speed: float32's rounding.",
        fails=f"The speeds differ by {number(spread)}.",
    )


@statement("gravity-flag", GRAVITY, "Gravity can be switched off for each body.")
def gravity_flag(lab: Lab) -> Evidence:
    world = lab.world(
        BodyDefinition(affected_by_gravity=False), BodyDefinition(), gravity=(0.0, -9.81)
    )
    for _ in range(100):
        world.step(DT)
    floating, falling = (abs(world.read(i).velocity[1]) for i in (0, 1))
    return Evidence(
        required=(
            at_most("speed of the body without gravity after 1 s", floating, 0.0, "m/s"),
            at_least("speed of the one beside it", falling, 9.0, "m/s"),
        ),
        holds="The flag holds one body and lets the other fall.",
        fails=f"The body without gravity moves at {number(floating)} m/s.",
    )
