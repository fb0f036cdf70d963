"""Laws that look something up: a run by scalar programs, and on array code.

    python benchmarks/tabulated_laws.py                  # five minutes
    python benchmarks/tabulated_laws.py --only "a map" --gradients

The ideal four-bar, 20 s, 31 samples, rtol 1e-6, with a force on its rocker that is read from a table, or chosen; the
first one looks nothing up. With `--gradients` the gradient of the last place by all numbers of the law, too. Each in a
process of its own, without a cache: processor time of the first call, and the shortest of the calls after it, of half a
second and 5 calls at least.
"""

import argparse
import os
import subprocess
import sys

from machine import write

CODE = """
import sys, time, warnings, equinox as eqx, jax, jax.numpy as jnp, numpy as np, spherejax as sj
warnings.simplefilter("ignore", sj.errors.ArrayPathWarning)
[getattr(sj, name) for name in sj.__all__]
random = np.random.default_rng(0)

def table(n):
    knots = np.linspace(-1.0, 1.0, n)
    knots[1:-1] += random.uniform(-0.3, 0.3, n - 2) * 2 / n
    return jnp.asarray(knots), jnp.asarray(np.sin(2 * knots))

def interpolated(x, v, t, knots, entries):
    return jnp.interp(x, knots, entries)

def periodic(x, v, t, knots, entries):
    return jnp.interp(2 * x, knots, entries, period=2.1)

def hermite(x, v, t, knots, entries):
    slopes = jnp.gradient(entries, knots)
    i = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2)
    h = knots[i + 1] - knots[i]
    s = (x - knots[i]) / h
    values = (1 + 2 * s) * (1 - s) ** 2 * entries[i] + s**2 * (3 - 2 * s) * entries[i + 1]
    return values + h * (s * (1 - s) ** 2 * slopes[i] + s**2 * (s - 1) * slopes[i + 1])

def bilinear(x, v, t, xs, vs, z):
    i = jnp.clip(jnp.searchsorted(xs, x) - 1, 0, xs.size - 2)
    j = jnp.clip(jnp.searchsorted(vs, v) - 1, 0, vs.size - 2)
    a, b = (x - xs[i]) / (xs[i + 1] - xs[i]), (v - vs[j]) / (vs[j + 1] - vs[j])
    below = (1 - a) * z[i, j] + a * z[i + 1, j]
    return (1 - b) * below + b * ((1 - a) * z[i, j + 1] + a * z[i + 1, j + 1])

def selected(x, v, t, a):
    # A drag: a push along the motion would turn the crank ever faster.
    return -jnp.select([v < -0.3, v < 0.4], [a[0] * (v + 0.3) - 0.3 * a[1], a[1] * v], a[2] * (v - 0.4) + 0.4 * a[1])

def switched(x, v, t, a):
    place = jnp.floor(2 * x).astype(jnp.int32) + 2
    branches = [lambda s, k=k: a[k] + s * (a[k + 1] - a[k]) for k in range(4)]
    return jax.lax.switch(place, branches, 2 * x - jnp.floor(2 * x))

def by_time(x, v, t, entries):
    i = jnp.clip((2 * t).astype(int), 0, entries.size - 2)
    return v * (entries[i] + (2 * t - i) * (entries[i + 1] - entries[i]))

def middle(x, v, t, a):
    return jnp.median(a * jnp.stack([x, v, x * v]))

def formula(x, v, t, a):
    return jnp.sin(a[0] * x)

grid = table(7)[0], jnp.linspace(-3.0, 3.0, 5)
few = jnp.asarray([0.5, -0.8, 0.9, 1.4, 0.3])
LAWS = {
    "a formula": (formula, (few,)),
    "jnp.interp, 10": (interpolated, table(10)),
    "jnp.interp, 100": (interpolated, table(100)),
    "jnp.interp, 1000": (interpolated, table(1000)),
    "with a period, 10": (periodic, table(10)),
    "hermite, 10": (hermite, table(10)),
    "a map, 7 x 5": (bilinear, (*grid, jnp.sin(grid[0])[:, None] * jnp.cos(grid[1]))),
    "jnp.select": (selected, (jnp.abs(few[:3]),)),
    "jax.lax.switch": (switched, (few,)),
    "by time, 41": (by_time, (jnp.sin(jnp.arange(41.0)),)),
    "jnp.median": (middle, (few[:3],)),
}

class Law(sj.forces.AbstractForce):
    numbers: tuple
    function: object = eqx.field(static=True)
    @property
    def body_names(self):
        return ("rocker",)
    def wrenches(self, t, motions):
        rocker = motions["rocker"]
        force = 0.3 * self.function(jnp.sin(20 * rocker.position[2]), rocker.velocity[2], t, *self.numbers)
        return {"rocker": sj.forces.Wrench(jnp.stack([0 * force, 0 * force, force]), jnp.zeros(3))}

function, numbers = LAWS[sys.argv[1]]
base, how = sj.gallery.four_bar(), {} if sys.argv[2] == "scalar" else {"scalar": False}

def end(numbers):
    scene = sj.Scene(base.bodies, base.joints, {"law": Law(numbers, function)}, gravity=base.gravity)
    return sj.simulate(scene, jnp.linspace(0.0, 20.0, 31), rtol=1e-6, **how).position("rocker")[-1, 2]

call = {"run": end, "gradient": jax.grad(end)}[sys.argv[3]]

def measured():
    begin = time.process_time()
    jax.block_until_ready(call(numbers))
    return time.process_time() - begin

first, begin, times = measured(), time.process_time(), []
while len(times) < 5 or time.process_time() - begin < 0.5:
    times.append(measured())
print(first, min(times))
"""

NAMES = [line.split('"')[1] for line in CODE.split("LAWS = {")[1].split("\n}")[0].splitlines() if '"' in line]


def seconds(name: str, way: str, what: str) -> tuple[float, float]:
    """Processor time [s] of the first call, and of a later one."""
    environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
    command = [sys.executable, "-c", CODE, name, way, what]
    lines = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.splitlines()
    first, later = map(float, lines[-1].split())
    return first, later


def main() -> None:
    """Measure, print, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="laws whose names have this in them; nothing is written then")
    parser.add_argument(
        "--gradients", action="store_true", help="with gradients, which take half an hour on array code"
    )
    options = parser.parse_args()
    rows = []
    for name in [name for name in NAMES if options.only is None or options.only in name]:
        row: dict[str, str | float] = {"law": name}
        for what in ("run", "gradient") if options.gradients else ("run",):
            for way, words in (("scalar", "scalar program"), ("arrays", "array code")):
                first, later = seconds(name, way, what)
                row[f"{what}, {words} [ms]"] = round(1e3 * later, 1)
                row[f"first call, {words} [s]" if what == "run" else f"first gradient, {words} [s]"] = round(first, 1)
        print(row, flush=True)
        rows.append(row)
    if options.only is None and not options.gradients:
        write("tabulated_laws", "python benchmarks/tabulated_laws.py", rows)


if __name__ == "__main__":
    main()
