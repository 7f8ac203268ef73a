"""MuJoCo, with its semi-implicit Euler and its Runge-Kutta 4.

State precision: float64.

======================  ==========================================================================
switched off            why
======================  ==========================================================================
gravity                 0: gravity is one of the harness's force laws
contacts, constraints   disabled: no body touches another
implicit joint damping  `eulerdamp` disabled; no joint has damping or armature
reset on bad numbers    `autoreset` disabled: divergence is a result
======================  ==========================================================================

Each body hangs on three joints of the world: slides along x and y, a hinge about z. Euler takes the
force as `qfrc_applied`, set before the step. Runge-Kutta evaluates the force at each of its stages, so
it takes it from the callback for passive forces. Static bodies have no counterpart: nothing touches
them. A kinematic body has none either: a skip.
"""

from __future__ import annotations

import mujoco
import numpy as np

from umbra_bench.engines.spatial import SpatialBodies
from umbra_bench.scenario import Scenario
from umbra_bench.system import compiled_force

# Its warnings of unstable motion go to a file in the working folder: here divergence is a result.
mujoco.set_mju_user_warning(lambda message: None)

_MODEL = """
<mujoco>
  <option integrator="{integrator}" gravity="0 0 0">
    <flag contact="disable" constraint="disable" eulerdamp="disable" autoreset="disable"/>
  </option>
  <worldbody>{bodies}</worldbody>
</mujoco>
"""
_BODY = """
<body>
  <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
  <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
</body>
"""


class _MuJoCo:
    """A MuJoCo model with the dynamic bodies of a scenario."""

    damps_itself = False
    integrator: str

    def __init__(self, scenario: Scenario) -> None:
        dynamic = SpatialBodies("mujoco", scenario).dynamic
        self._moved = np.array([i for i, _ in dynamic], int)
        self._force = compiled_force(scenario)
        bodies = "".join(_BODY.format(mass=d.mass, inertia=d.moment_of_inertia) for _, d in dynamic)
        self._model = mujoco.MjModel.from_xml_string(
            _MODEL.format(integrator=self.integrator, bodies=bodies)
        )
        self._data = mujoco.MjData(self._model)
        # One row a body, columns x, y, angle: views into the engine's own arrays.
        self._q, self._v = self._data.qpos.reshape(-1, 3), self._data.qvel.reshape(-1, 3)
        for row, (_, definition) in enumerate(dynamic):
            self._q[row] = *definition.position, definition.angle
            self._v[row] = *definition.velocity, definition.angular_velocity

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        position[:, self._moved] = self._q.T
        velocity[:, self._moved] = self._v.T

    def set_velocity(self, velocity: np.ndarray) -> None:
        self._v[:] = velocity[:, self._moved].T


class Euler(_MuJoCo):
    """`mujoco-euler`: the force of the state before the step."""

    integrator = "Euler"

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        self._model.opt.timestep = dt
        force = self._force(position, velocity)
        self._data.qfrc_applied[:] = force[:, self._moved].T.ravel()
        mujoco.mj_step(self._model, self._data)


class RungeKutta4(_MuJoCo):
    """`mujoco-rk4`: the force of each stage."""

    integrator = "RK4"

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        shape = (3, len(scenario.bodies))
        self._position, self._velocity = np.zeros(shape), np.zeros(shape)

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        self._model.opt.timestep = dt
        self._position[:], self._velocity[:] = position, velocity  # static bodies included
        mujoco.set_mjcb_passive(self._stage)
        try:
            mujoco.mj_step(self._model, self._data)
        finally:
            mujoco.set_mjcb_passive(None)

    def _stage(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._position[:, self._moved] = data.qpos.reshape(-1, 3).T
        self._velocity[:, self._moved] = data.qvel.reshape(-1, 3).T
        force = self._force(self._position, self._velocity)
        data.qfrc_passive[:] = force[:, self._moved].T.ravel()
