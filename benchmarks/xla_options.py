"""What runs take without the option of XLA that lets one kernel have several results (`compiler/xla_flags.py`).

    python benchmarks/xla_options.py     # two minutes

With that option XLA (jaxlib 0.10) ends the process over some programs of a user's (`docs/howto/platforms.md`). Where
all of a run is machine code the option changes little; these two are compiled by XLA for the most part: 24 runs of the
four-bar with bushings under `jax.vmap`, 0.1 s, and a derivative of one such run by an adjoint of diffrax. Each in a
process of its own, without a cache: processor time of the first call, and the shortest of seven after it.
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
    return sj.simulate(scene, ts, **options).position("rocker")[-1, 2]

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

CASES = {"24 runs with bushings": "runs", "derivative by RecursiveCheckpointAdjoint": "derivative"}
WITHOUT = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=false"


def main() -> None:
    rows = []
    for case, name in CASES.items():
        for option, flags in (("set", ""), ("left out", WITHOUT)):
            environment = {**os.environ, "SPHEREJAX_CACHE": "0", "XLA_FLAGS": flags}
            code = CODE.format(case=name)
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
