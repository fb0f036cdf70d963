"""Chains of 5 to 100 bodies in spherejax, MuJoCo and Pinocchio: time for one second of motion at equal achieved error.

    pip install -e '.[benchmarks]'
    python benchmarks/scaling_peers.py          # one minute

Rods that hang on each other by revolutes fall from the horizontal. The error is the largest of all bodies' positions at
the end, against a run of spherejax at a tolerance of 1e-13, which is checked against both others. Each tool runs at
several step sizes or tolerances; times at an error are read between those, by powers. One core; the shortest of five.

MuJoCo and Pinocchio have the joints' angles as coordinates, n numbers, and methods of O(n) without constraints;
spherejax has the bodies' positions and rotations, 13 n numbers, and solves for the joints' forces, for joints that are
not ideal and loops. MuJoCo steps in C by RK4. Pinocchio has accelerations alone (`aba`, in C++), and is stepped from
Python, by RK4 and by SciPy's DOP853.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import pairwise
from typing import Any, NamedTuple

from machine import use_one_core, write

use_one_core()

import jax  # noqa: E402
import numpy as np  # noqa: E402
from peers import mujoco_scene  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

import spherejax as sj  # noqa: E402

# Neither has types that a checker could read.
mujoco: Any = import_module("mujoco")
pin: Any = import_module("pinocchio")

SIZES = (5, 10, 20, 50, 100)
ERRORS = (1e-5, 1e-8)
"""Errors at which times are compared [m]."""

END = 1.0
"""Duration of the motion [s]."""

REFERENCE_RTOL = 1e-13
TOLERANCES = 10.0 ** -np.arange(2.0, 13.0)
N_STEPS = (50, 100, 200, 400, 800, 1600, 3200)


class Motion(NamedTuple):
    """A motion, to be made again and again.

    Attributes:
        run: makes it.
        positions: of what `run` gives, the bodies' positions at the end [m], shape (n, 3).
    """

    run: Callable[[], Any]
    positions: Callable[[Any], np.ndarray]


def by_spherejax(n: int, rtol: float) -> Motion:
    """The chain's motion by spherejax, with the method that it chooses."""
    scene = sj.gallery.chain(n)
    ts = np.array([0.0, END])

    def run() -> sj.Trajectory:
        return jax.block_until_ready(sj.simulate(scene, ts, rtol=rtol, throw=True))

    return Motion(run, lambda run: np.stack([np.asarray(run.position(name)[-1]) for name in scene.bodies]))


def by_mujoco(n: int, n_steps: int) -> Motion:
    """By MuJoCo's RK4, all steps by one call."""
    scene = sj.gallery.chain(n)
    model = mujoco_scene.model_of(scene, END / n_steps)
    numbers = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in scene.bodies]

    def run() -> Any:
        state = mujoco.MjData(model)
        mujoco.mj_step(model, state, nstep=n_steps)
        mujoco.mj_kinematics(model, state)
        return state

    return Motion(run, lambda state: state.xpos[numbers])


class Chain:
    """The chain in Pinocchio."""

    def __init__(self, n: int):
        scene = sj.gallery.chain(n)
        self.model = pin.Model()
        self.model.gravity.linear = np.array([0.0, -9.81, 0.0])
        before, place = 0, pin.SE3.Identity()
        for name, body in scene.bodies.items():
            before = self.model.addJoint(before, pin.JointModelRZ(), place, name)
            own = pin.Inertia(float(body.mass), np.array([0.5, 0.0, 0.0]), np.diag(np.asarray(body.inertia)))
            self.model.appendBodyToJoint(before, own, pin.SE3.Identity())
            place = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
        self.data = self.model.createData()
        self.none = np.zeros(n)

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of the joints' angles."""
        return pin.aba(self.model, self.data, q, v, self.none)

    def positions(self, q: np.ndarray) -> np.ndarray:
        """Centers of the rods, of their joints' angles."""
        pin.forwardKinematics(self.model, self.data, q)
        return np.stack([place.translation + place.rotation[:, 0] * 0.5 for place in list(self.data.oMi)[1:]])


def by_pinocchio(n: int, n_steps: int) -> Motion:
    """By RK4, in Python."""
    chain, h = Chain(n), END / n_steps

    def run() -> np.ndarray:
        q, v, a = np.zeros(n), np.zeros(n), chain.acceleration
        for _ in range(n_steps):
            a1 = a(q, v)
            v2 = v + 0.5 * h * a1
            a2 = a(q + 0.5 * h * v, v2)
            v3 = v + 0.5 * h * a2
            a3 = a(q + 0.5 * h * v2, v3)
            v4 = v + h * a3
            a4 = a(q + h * v3, v4)
            q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        return q

    return Motion(run, chain.positions)


def by_pinocchio_and_scipy(n: int, rtol: float) -> Motion:
    """By SciPy's DOP853."""
    chain = Chain(n)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        del t
        return np.concatenate([y[n:], chain.acceleration(y[:n], y[n:])])

    def run() -> np.ndarray:
        return solve_ivp(rate, (0.0, END), np.zeros(2 * n), "DOP853", rtol=rtol, atol=rtol).y[:n, -1]

    return Motion(run, chain.positions)


TOOLS = {
    "spherejax": (by_spherejax, TOLERANCES),
    "MuJoCo, RK4": (by_mujoco, N_STEPS),
    "Pinocchio, RK4 in Python": (by_pinocchio, N_STEPS),
    "Pinocchio, SciPy DOP853": (by_pinocchio_and_scipy, TOLERANCES),
}


def seconds_at(points: list[tuple[float, float]], error: float) -> float | None:
    """Time at an error, between runs of other errors by powers; None where no run is as good.

    Args:
        points: error [m] and time [s] of each run, from the coarsest on.
        error: the error [m].
    """
    if points[0][0] <= error:
        return points[0][1]
    for (coarse, before), (fine, after) in pairwise(points):
        if fine <= error <= coarse:
            share = np.log(coarse / error) / np.log(coarse / fine)
            return float(before * (after / before) ** share)
    return None


def shortest(motion: Motion) -> float:
    """Time of a motion [s]."""
    seconds = []
    for _ in range(5):
        begin = time.perf_counter()
        motion.run()
        seconds.append(time.perf_counter() - begin)
        if sum(seconds) > 5:
            break
    return min(seconds)


def rows_of(sizes) -> Iterator[dict]:
    """A row for each size, tool and error."""
    for n in sizes:
        exact = by_spherejax(n, REFERENCE_RTOL)
        reference = exact.positions(exact.run())
        of_tool = {}
        for tool, (make, choices) in TOOLS.items():
            points = []
            for choice in choices:
                motion = make(n, choice)
                error = float(np.max(np.abs(motion.positions(motion.run()) - reference)))
                points.append((error, shortest(motion)))
                if error < min(ERRORS):
                    break
            of_tool[tool] = points
            print(n, tool, [(f"{e:.1e}", f"{1e3 * s:.2f} ms") for e, s in points], flush=True)
        for error in ERRORS:
            own = seconds_at(of_tool["spherejax"], error)
            for tool, points in of_tool.items():
                taken = seconds_at(points, error)
                yield {
                    "bodies": n,
                    "error_m": f"{error:.0e}",
                    "tool": tool,
                    "ms": "" if taken is None else f"{1e3 * taken:.2f}",
                    "of_spherejax": "" if taken is None or own is None else f"{taken / own:.2f}",
                    "least_error_m": f"{min(e for e, _ in points):.0e}",
                }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    options = parser.parse_args()
    rows = list(rows_of(options.sizes))
    for row in rows:
        print(row)
    packages = ("spherejax", "jax", "numpy", "scipy", "mujoco", "pin")
    write("scaling_peers", "python benchmarks/scaling_peers.py", rows, packages)


if __name__ == "__main__":
    main()
