"""What it gives that the loop of a single run is machine code as a whole, and not kernels of XLA's between calls.

    python benchmarks/loops.py     # two minutes

The four-bar, 0.2 s, 21 samples, rtol 1e-8, and its derivative by one number. In each process, without a cache:
processor time of the first call, imports not counted, and the shortest of 15 calls after it.
"""

import os
import subprocess
import sys

from machine import write

CODE = """
import sys, time, jax, jax.numpy as jnp
import spherejax as sj
from spherejax.compiler.native import loop_fusion
from spherejax.compiler.emit.llvm_arrays import NotWrittenError
def refused(*_):
    raise NotWrittenError("for comparison")
if {refuses}:
    loop_fusion.looped = refused
[getattr(sj, name) for name in sj.__all__]
ts = jnp.linspace(0.0, 0.2, 21)
height = lambda x: sj.simulate(sj.gallery.four_bar({joint}), ts).ys[-1, 2]
call = jax.jit({how})
begin = time.process_time()
jax.block_until_ready(call({number}))
first, taken = time.process_time() - begin, []
for _ in range(15):
    begin = time.perf_counter()
    jax.block_until_ready(call({number}))
    taken.append(time.perf_counter() - begin)
print(first, min(taken))
"""

JOINTS = {
    "dry with friction": ("sj.Dry(x, friction=sj.Threlfall())", 1e-4),
    "bushing": ("sj.Bushing(x, 1e-4)", 1e6),
    "lubricated": ("sj.Lubricated(x, viscosity=0.4)", 1e-4),
}


def measured(joint: str, number: float, how: str, refuses: bool) -> list[float]:
    """Processor time of the first call [s], and the time of the next ones [s]."""
    code = CODE.format(joint=joint, number=number, how=how, refuses=refuses)
    environment = {**os.environ, "SPHEREJAX_CACHE": "0"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True, text=True)
    return [float(x) for x in done.stdout.split()]


def main() -> None:
    """Print the table and write it."""
    rows = []
    for name, (joint, number) in JOINTS.items():
        for what, how in (("value", "height"), ("gradient", "jax.grad(height)")):
            (first, time), (first_in_kernels, in_kernels) = (
                measured(joint, number, how, refuses) for refuses in (0, 1)
            )
            rows.append(
                {
                    "case": name,
                    "what": what,
                    "milliseconds": f"{1e3 * time:.2f}",
                    "in_kernels_ms": f"{1e3 * in_kernels:.2f}",
                    "first_call_s": f"{first:.2f}",
                    "first_in_kernels_s": f"{first_in_kernels:.2f}",
                }
            )
            print(rows[-1], flush=True)
    write("loops", "python benchmarks/loops.py", rows)


if __name__ == "__main__":
    main()
