"""The sweep of dry four-bars by Exudyn's ParameterVariation; a part of `sweeps.py`."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from baselines.parameters import BODIES, STIFFNESS, problem
from machine import write
from sweep_scenes import CLEARANCES, DURATION, N_CORES, dry, model_of

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix

N_RUNS = 4
STEPS = (4e-6, 2e-6, 5e-7)
"""Steps [s]; the last one is what the others are compared with."""


def exudyn() -> None:
    """Exudyn's ParameterVariation on all cores: the same mechanism with Exudyn's own contact, fewer runs.

    Errors are the worst of the runs against the finest step: they tell how well Exudyn solves its own equations, whose
    laws of contact and friction are not quite ours.
    """
    clearances = [float(c) for c in CLEARANCES[:: len(CLEARANCES) // N_RUNS][:N_RUNS]]
    numbers = numbers_of(clearances)
    found = {step: by_exudyn(clearances, {**numbers, "step": step}) for step in STEPS}
    finest = np.array(found[STEPS[-1]]["heights"])
    rows = [
        {
            "method": "Exudyn's ParameterVariation",
            "cores": N_CORES,
            "runs": len(clearances),
            "step_s": f"{step:.0e}",
            "worst_error_to_own_law_m": f"{np.abs(np.array(found[step]['heights']) - finest).max():.1e}",
            "runs_per_second": f"{len(clearances) / found[step]['seconds']:.2f}",
        }
        for step in STEPS[:-1]
    ]
    write("sweep_exudyn", "python benchmarks/sweeps.py exudyn", rows, ("exudyn",))


def by_exudyn(clearances: list[float], numbers: dict) -> dict:
    """Heights and seconds, by a process without JAX."""
    asked = {"clearances": clearances, "cores": N_CORES, "numbers": numbers}
    program = Path(__file__).parent / "peers" / "exudyn_clearance.py"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(program)],
        input=json.dumps(asked),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def numbers_of(clearances: list[float]) -> dict:
    """The four-bar as Exudyn's model of it needs it."""
    scene, y0 = sj.gallery.four_bar(sj.Ideal()), problem(sj.Ideal()).y0
    system = sj.equations.compile_scene(scene).system
    poses = {
        name: (y0[7 * i : 7 * i + 3], np.array(rotation_matrix(y0[7 * i + 3 : 7 * i + 7])))
        for i, name in enumerate(BODIES)
    }
    pin, studied = system.spherical("crank_coupler"), system.spherical("coupler_rocker")
    position, rotation = poses[pin.bodies[0]]
    model = model_of(clearances[0])
    return {
        "bodies": [
            {
                "name": name,
                "mass": float(body.mass),
                "inertia": np.asarray(body.inertia).tolist(),
                "position": poses[name][0].tolist(),
                "rotation": poses[name][1].tolist(),
            }
            for name, body in system.bodies.items()
        ],
        "pivots": [
            {
                "body": scene.joints[name].bodies[1],
                "point": np.asarray(scene.joints[name].point).tolist(),
                "axis": np.asarray(scene.joints[name].axis).tolist(),
            }
            for name in ("crank_pivot", "rocker_pivot")
        ],
        "pin": (position + rotation @ np.asarray(pin.socket_place)).tolist(),
        "socket": {"body": studied.bodies[0], "point": np.asarray(studied.socket_place).tolist()},
        "ball": {"body": studied.bodies[1], "point": np.asarray(studied.ball_place).tolist()},
        "gravity": np.asarray(system.gravity).tolist(),
        "socket_radius": float(model.socket_radius),
        "stiffness": {
            repr(c): float(problem(dry(c).joints["coupler_rocker"].model).parameters[STIFFNESS]) for c in clearances
        },
        "restitution": 0.9,
        "mu": float(model.friction.mu),
        "v1": float(model.friction.v1),
        "duration": DURATION,
    }
