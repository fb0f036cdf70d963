"""Cost against the number of bodies: open chains and N-four-bars, scalar program and array code.

python benchmarks/scaling.py

The scalar program is compiled up to `LARGEST_COMPILED` operations only: beyond, compiling takes minutes.
"""

import argparse
import time

from machine import RESULTS, use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.model.system import compile_scene, flatten_system  # noqa: E402
from spherejax.motion.equations.dynamics import state_rate  # noqa: E402
from spherejax.motion.equations.programs import largest_scalar_program, program_for  # noqa: E402
from spherejax.motion.start.assembly import described_state  # noqa: E402

SIZES = (2, 5, 10, 20, 50, 100)
LARGEST_COMPILED = 30_000
REPEATS = 7


def spherical_chain(n: int) -> sj.Scene:
    """A chain of n rods of 0.2 m, joined by ideal spherical joints, released in the horizontal."""
    points = {"a": (-0.1, 0.0, 0.0), "b": (0.1, 0.0, 0.0)}
    inertia = (4e-5, 3.4e-4, 3.4e-4)
    bodies = {f"link_{i:03}": sj.Body(0.1, inertia, (0.2 * i + 0.1, 0.0, 0.0), points=points) for i in range(n)}
    ends = ["ground.origin", *(f"{name}.b" for name in bodies)]
    joints = {name: sj.Spherical(end, f"{name}.a") for end, name in zip(ends, bodies, strict=False)}
    return sj.Scene(bodies, joints, ground_points={"origin": (0.0, 0.0, 0.0)})


MECHANISMS = {
    "chain of revolutes": sj.gallery.chain,
    "chain of spherical joints": spherical_chain,
    "N-four-bar": lambda n: sj.gallery.n_four_bar(max(1, (n - 1) // 2)),
}


def right_hand_side(scene: sj.Scene, scalar: bool) -> dict[str, object]:
    """Seconds to trace and to compile a loop of right-hand sides, and microseconds for each."""
    system = compile_scene(scene).system
    structure, theta = flatten_system(system)
    begin = time.perf_counter()
    program = program_for(state_rate, structure, scalar)
    traced = time.perf_counter() - begin
    operations = program.scalar.n_operations if program.scalar else 0
    row: dict[str, object] = {
        "bodies": len(system.bodies),
        "path": "scalar" if scalar else "array",
        "operations": operations or "",
        "scalarize_s": f"{traced:.2f}" if scalar else "",
        "compile_s": "",
        "us_per_rhs": "",
    }
    if operations > LARGEST_COMPILED:
        return row
    n_calls = max(20, 20_000 // len(system.bodies))

    def loop(theta, y):
        ahead = program.ahead(theta)
        return jax.lax.fori_loop(0, n_calls, lambda _, y: y + 1e-12 * program.inside(theta, ahead, 0.0, y), y)

    arguments = jnp.asarray(theta), jnp.asarray(described_state(system))
    begin = time.perf_counter()
    compiled = jax.jit(loop).lower(*arguments).compile()
    row["compile_s"] = f"{time.perf_counter() - begin:.2f}"
    row["us_per_rhs"] = f"{_fastest(lambda: compiled(*arguments).block_until_ready()) / n_calls * 1e6:.3g}"
    return row


def _fastest(call) -> float:
    """Least time of several calls [s]: what others do on the machine only adds."""
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def simulation(scene: sj.Scene) -> dict[str, object]:
    """Seconds of the first run of a scene, and milliseconds for each of its steps when compiled."""

    def run():
        found = sj.simulate(scene, jnp.array([0.0, 0.05]), rtol=1e-6)
        jax.block_until_ready(found.ys)
        return found

    begin = time.perf_counter()
    n_steps = int(run().require_success().stats.n_steps)
    first = time.perf_counter() - begin
    return {"first_run_s": f"{first:.1f}", "ms_per_step": f"{_fastest(run) / n_steps * 1e3:.3g}"}


def slope(rows, path: str) -> float:
    """Exponent of the time of a right-hand side against the number of bodies, from 5 bodies on."""
    points = [(row["bodies"], float(row["us_per_rhs"])) for row in rows if row["path"] == path and row["us_per_rhs"]]
    n, seconds = np.log(np.array([point for point in points if point[0] >= 5])).T
    return float(np.polyfit(n, seconds, 1)[0])


def draw(rows) -> None:
    """Time of a right-hand side and of its compilation against the number of bodies."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for color, mechanism in zip(("C0", "C1", "C2"), MECHANISMS, strict=True):
        for path, line in (("array", "-o"), ("scalar", "--s")):
            own = [r for r in rows if (r["mechanism"], r["path"]) == (mechanism, path) and r["us_per_rhs"]]
            n = [r["bodies"] for r in own]
            for ax, column in zip(axes, ("us_per_rhs", "compile_s"), strict=True):
                ax.loglog(n, [float(r[column]) for r in own], line, color=color, ms=4, label=f"{mechanism}, {path}")
    n = np.array([2, 100])
    axes[0].loglog(n, 0.2 * n, ":", color="0.5", label="proportional")
    axes[0].set(xlabel="bodies", ylabel="one right-hand side [us]")
    axes[1].set(xlabel="bodies", ylabel="compile a loop of them [s]")
    axes[0].legend(fontsize=7)
    figure.savefig(RESULTS / "scaling.png", dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--no-runs", action="store_true", help="right-hand sides only")
    options = parser.parse_args()
    rows = []
    for mechanism, build in MECHANISMS.items():
        own = []
        for n in options.sizes:
            found = [right_hand_side(build(n), scalar) for scalar in (True, False)]
            is_scalar = found[0]["operations"] <= largest_scalar_program()
            runs = {} if options.no_runs else simulation(build(n))
            for row in found:
                is_chosen = (row["path"] == "scalar") == is_scalar
                measured = runs if is_chosen else {}
                own.append(
                    {
                        "mechanism": mechanism,
                        **row,
                        "chosen": is_chosen,
                        "first_run_s": "",
                        "ms_per_step": "",
                        **measured,
                    }
                )
                print(own[-1], flush=True)
        rows += own
        print(f"{mechanism}: time of the array code ~ bodies^{slope(own, 'array'):.2f}", flush=True)
    write("scaling", "python benchmarks/scaling.py", rows)
    draw(rows)


if __name__ == "__main__":
    main()
