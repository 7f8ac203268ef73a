"""umbra-bench: how far is a real-time physics engine from the truth, and at which step size?

    import umbra_bench as ub

    scenario = ub.load_scenario("spring")
    trajectory = ub.simulate(scenario, "umbra", dt=0.01, precision="float32")
    study = ub.run_study([scenario], ["umbra", "velocity-verlet"])
    print(study.orders)
    ub.draw_error(ub.tables_of(study)[0]).savefig("error.svg")

Importing this package imports no numerical library and changes no state of any; names are resolved
when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from umbra_bench.errors import ScenarioError, UmbraBenchError, UnsupportedScenario
    from umbra_bench.plots import draw_energy, draw_energy_over_time, draw_error, draw_motion
    from umbra_bench.reference import certified_reference
    from umbra_bench.report import tables_of, write_report
    from umbra_bench.results import save_study
    from umbra_bench.scenario import Scenario, list_scenarios, load_scenario
    from umbra_bench.simulation import Trajectory, simulate
    from umbra_bench.study import Study, run_study
    from umbra_bench.umbra import BodyDefinition, PhysicsService

_HOMES = {
    "ScenarioError": "errors",
    "UmbraBenchError": "errors",
    "UnsupportedScenario": "errors",
    "draw_energy": "plots",
    "draw_energy_over_time": "plots",
    "draw_error": "plots",
    "draw_motion": "plots",
    "certified_reference": "reference",
    "tables_of": "report",
    "write_report": "report",
    "save_study": "results",
    "Scenario": "scenario",
    "list_scenarios": "scenario",
    "load_scenario": "scenario",
    "Trajectory": "simulation",
    "simulate": "simulation",
    "Study": "study",
    "run_study": "study",
    "BodyDefinition": "umbra",
    "PhysicsService": "umbra",
}

__all__ = [
    "BodyDefinition",
    "PhysicsService",
    "Scenario",
    "ScenarioError",
    "Study",
    "Trajectory",
    "UmbraBenchError",
    "UnsupportedScenario",
    "certified_reference",
    "draw_energy",
    "draw_energy_over_time",
    "draw_error",
    "draw_motion",
    "list_scenarios",
    "load_scenario",
    "run_study",
    "save_study",
    "simulate",
    "tables_of",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'umbra_bench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"umbra_bench.{_HOMES[name]}"), name)
