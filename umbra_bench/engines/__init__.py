"""Foreign engines behind one protocol, one file each.

An engine creates its bodies from a scenario, takes the forces of the harness's own force laws before
each step, steps, and tells its state. What it cannot do it refuses with a reason.
"""

from umbra_bench.engines.protocol import Engine, EngineRun, open_engine

__all__ = ["Engine", "EngineRun", "open_engine"]
