"""An engine in another process: one line of JSON in, one line of JSON out.

    umbra-bench identify "process:python3 examples/process/engine.py"

It could as well be C#, JavaScript or a game editor; this one is Python without any library.

The questions, in the order in which they come (numbers that are not finite are null):

    {"ask": "hello"}
        -> {"abi": 1, "precision": "float64"}
    {"ask": "create", "bodies": [{"mass", "inertia", "position", "angle", "velocity",
                                  "angular_velocity", "kind"}, ...]}
        -> {} or {"refused": "why this engine cannot hold these bodies"}
    {"ask": "step", "dt": 0.01, "force": [[fx, ...], [fy, ...], [torque, ...]]}
        -> {"position": [[x, ...], [y, ...], [angle, ...]], "velocity": [[...], [...], [...]]}
    {"ask": "set_velocity", "velocity": [[vx, ...], [vy, ...], [omega, ...]]}
        -> {}

The end of the input is the end of the run. What goes to standard error is shown where a run fails.
"""

import json
import sys


class Engine:
    """Semi-implicit Euler: velocities first, then positions by the new velocities."""

    def create(self, bodies):
        self.position = [[b["position"][0] for b in bodies], [b["position"][1] for b in bodies]]
        self.position.append([b["angle"] for b in bodies])
        self.velocity = [[b["velocity"][0] for b in bodies], [b["velocity"][1] for b in bodies]]
        self.velocity.append([b["angular_velocity"] for b in bodies])
        moved = [b["kind"] == "dynamic" and b["mass"] > 0 for b in bodies]
        mass = [1 / b["mass"] if m else 0.0 for b, m in zip(bodies, moved)]
        turn = [1 / b["inertia"] if m and b["inertia"] else 0.0 for b, m in zip(bodies, moved)]
        self.inverse = [mass, mass, turn]
        return {}

    def step(self, dt, force):
        for x, v, f, w in zip(self.position, self.velocity, force, self.inverse):
            for i in range(len(x)):
                v[i] += f[i] * w[i] * dt
                x[i] += v[i] * dt
        return {"position": self.position, "velocity": self.velocity}

    def set_velocity(self, velocity):
        self.velocity = velocity
        return {}

    def hello(self):
        return {"abi": 1, "precision": "float64"}


def main():
    engine = Engine()
    for line in sys.stdin:
        question = json.loads(line)
        answer = getattr(engine, question.pop("ask"))(**question)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
