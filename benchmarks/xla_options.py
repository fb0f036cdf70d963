"""What runs take without the option of XLA that lets one kernel have several results (`compiler/several_results.py`).

    python benchmarks/xla_options.py     # two minutes

A program that reduces two pairs (`argmax`, `argmin`) is compiled without it, for with it XLA (jaxlib 0.10) may end the
process. Where all of a run is machine code the option changes little; these two are compiled by XLA for the most part:
24 runs of the four-bar with bushings under `jax.vmap`, 0.1 s, and a derivative of one such run by an adjoint of
diffrax; alone, and in a function that also picks two samples. Each in a process of its own, without a cache: processor
time of the first call, and the shortest of seven after it.
"""

import os
import subprocess
import sys

from machine import write

CODE = """
import time, diffrax, jax, jax.numpy as jnp, spherejax as sj
ts = jnp.linspace(0.0, 0.1, 21)

def end(stiffness, **options):
    scene = sj.gallery.four_bar(sj.Bushing(stiffness, 1e3))
    heights = sj.simulate(scene, ts, **options).position("rocker")[:, 2]
    return heights[-1] + {picked}

runs = jax.jit(jax.vmap(end)), jnp.linspace(1e6, 1.2e6, 24)
by_adjoint = dict(adjoint=diffrax.RecursiveCheckpointAdjoint(), solver=diffrax.Tsit5(), max_steps=4096)
derivative = jax.jit(jax.grad(lambda stiffness: end(stiffness, **by_adjoint))), 1e5
call, argument = {case}
begin = time.process_time()
jax.block_until_ready(call(argument))
first, taken = time.process_time() - begin, []
for _ in range(7):
    begin = time.perf_counter()
    jax.block_until_ready(call(argument))
    taken.append(time.perf_counter() - begin)
print(first, min(taken))
"""

PICKED = "0.0 * (heights[jnp.argmax(heights * stiffness)] - heights[jnp.argmin(heights - stiffness)])"
CASES = {"24 runs with bushings": "runs", "derivative by RecursiveCheckpointAdjoint": "derivative"}


def main() -> None:
    rows = []
    for case, name in CASES.items():
        for option, picked in (("given", "0.0"), ("left out", PICKED)):
            environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
            code = CODE.format(case=name, picked=picked)
            done = subprocess.run(
                [sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True
            )
            first, taken = map(float, done.stdout.split()[-2:])
            row = {"case": case, "option": option, "milliseconds": f"{taken * 1e3:.0f}", "first_call_s": f"{first:.0f}"}
            rows.append(row)
            print(row, flush=True)
    write("xla_options", "python benchmarks/xla_options.py", rows)


if __name__ == "__main__":
    main()
