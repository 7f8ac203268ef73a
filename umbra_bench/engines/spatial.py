"""What the engines of three dimensions share: which bodies of a scenario they are given."""

from __future__ import annotations

from umbra_bench.errors import UnsupportedScenario
from umbra_bench.scenario import Scenario
from umbra_bench.system import body_definition
from umbra_bench.umbra.bodies import BodyDefinition


class SpatialBodies:
    """The dynamic bodies of a scenario, by their place in its list.

    Raises:
        UnsupportedScenario: a kinematic body, or one that no torque turns.
    """

    def __init__(self, engine: str, scenario: Scenario) -> None:
        self.dynamic: list[tuple[int, BodyDefinition]] = []
        for i, body in enumerate(scenario.bodies):
            definition = body_definition(body, scenario)
            if definition.kind == "kinematic":
                raise UnsupportedScenario(
                    f"{engine}: body {body.name!r} is kinematic, which this adapter does not drive"
                )
            if definition.is_static:
                continue
            if not definition.moment_of_inertia > 0.0:
                raise UnsupportedScenario(
                    f"{engine}: body {body.name!r} has no inertia, which the engine needs"
                )
            self.dynamic.append((i, definition))
