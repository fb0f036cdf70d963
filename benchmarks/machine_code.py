"""What machine code saves of first calls, and what it costs in run time: the four-bar's film and its derivatives.

    python benchmarks/machine_code.py     # four minutes, most of it XLA's

Processor time of the first call of a process without a cache, imports not counted, and the shortest of 31 calls after
it, with machine code and with XLA for all (`SPHEREJAX_MACHINE_CODE=0`), `TURNS` times by turns; the median is written.
0.2 s, 21 samples, rtol 1e-8, c 0.1 mm, 0.4 Pa s. The last column is the largest difference of
results, over the largest entry.
"""

import os
import subprocess
import sys

import numpy as np
from machine import write

CODE = """
import time, jax, jax.numpy as jnp
import spherejax as sj
ts = jnp.linspace(0.0, 0.2, 21)
def ys(clearance, viscosity):
    return sj.simulate(sj.gallery.four_bar(sj.Lubricated(clearance, viscosity)), ts, rtol=1e-8).ys[..., :27]
known = lambda: ys(1e-4, 0.4)
by_two = jax.jit(jax.jacfwd(lambda c, v: ys(c, v)[-1], (0, 1)))
by_one = jax.jit(jax.grad(lambda c: ys(c, 0.4)[-1, 2]))
run = jax.jit(lambda c: ys(c, 0.4))
call = {call}
[getattr(sj, name) for name in sj.__all__]
begin = time.process_time()
found = jax.block_until_ready(call())
first = time.process_time() - begin
taken = []
for _ in range(31):
    begin = time.perf_counter()
    jax.block_until_ready(call())
    taken.append(time.perf_counter() - begin)
print(first, min(taken), *[float(x).hex() for x in jnp.concatenate([x.ravel() for x in jax.tree.leaves(found)])])
"""

CALLS = {
    "a run": "known",
    "a run, traced by jit": "lambda: run(1e-4)",
    "gradient by the clearance": "lambda: by_one(1e-4)",
    "derivatives by clearance and viscosity": "lambda: by_two(1e-4, 0.4)",
}
TURNS = 1


def said(call: str, machine_code: str) -> tuple[float, float, np.ndarray]:
    """Processor time of the first call [s], the shortest of the others [s], and what comes out."""
    environment = {**os.environ, "SPHEREJAX_CACHE": "0", "SPHEREJAX_MACHINE_CODE": machine_code}
    code = CODE.format(call=call)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    first, shortest, *numbers = done.stdout.split()
    return float(first), float(shortest), np.array([float.fromhex(number) for number in numbers])


def main() -> None:
    """Every row by turns."""
    rows = []
    for what, call in CALLS.items():
        found = {way: [] for way in ("1", "0")}
        for _ in range(TURNS):
            for way, each in found.items():
                each.append(said(call, way))
        first, shortest = ({way: float(np.median([x[i] for x in each])) for way, each in found.items()} for i in (0, 1))
        one, other = found["1"][0][2], found["0"][0][2]
        rows.append(
            {
                "what": what,
                "first_call_cpu_s": f"{first['1']:.1f}",
                "by_xla_cpu_s": f"{first['0']:.1f}",
                "run_ms": f"{1e3 * shortest['1']:.2f}",
                "by_xla_ms": f"{1e3 * shortest['0']:.2f}",
                "difference": f"{np.max(np.abs(one - other)) / np.max(np.abs(other)):.0e}",
            }
        )
        print(rows[-1], flush=True)
    write("machine_code", "python benchmarks/machine_code.py", rows)


if __name__ == "__main__":
    main()
