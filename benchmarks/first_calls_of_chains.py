"""First calls and runs of mechanisms with many bodies, and of their gradients by one mass.

    python benchmarks/first_calls_of_chains.py          # six minutes
    python benchmarks/first_calls_of_chains.py --both   # ten minutes: both paths, of chains of 10 to 40 bodies, printed

Chains of revolute joints, 1 s, eleven samples, at the default tolerance; each row is a process of its own without
caches. First calls in processor time, for compilers use several cores, without the imports of the package's modules
(`benchmarks/start_up.py`); times of runs are the shortest of five.
"""

import argparse

from machine import write
from start_up import numbers_printed

CODE = """
import time
import equinox as eqx, jax, jax.numpy as jnp
import spherejax as sj
ts = jnp.linspace(0.0, 1.0, 11)
all_names = [getattr(sj, name) for name in sj.__all__]  # each loads its module: an import, and not the call
def end(mass):
    scene = sj.gallery.{mechanism}({n})
    last = list(scene.bodies)[-1]
    scene = eqx.tree_at(lambda scene: scene.bodies[last].mass, scene, mass)
    run = sj.simulate(scene, ts, scalar={scalar})
    return run.ys[-1, 0], run
def call():
    return jax.block_until_ready({call})
begin = time.process_time()
steps = int(call(){steps})
first = time.process_time() - begin
taken = []
for _ in range(5):
    begin = time.perf_counter()
    call()
    taken.append(time.perf_counter() - begin)
print(first, min(taken), steps)
"""
# The gradient of a run, and the run itself: both with its number of steps.
RUN = "end(0.7)", "[1].stats.n_steps"
GRADIENT = "jax.value_and_grad(lambda mass: end(mass), has_aux=True)(0.7)", "[0][1].stats.n_steps"
SIZES = {"chain": (5, 10, 20, 50, 100), "n_four_bar": (2, 8)}
GRADIENTS = {"chain": (5, 10, 20, 50), "n_four_bar": (2,)}


BOTH = {"chain": (10, 15, 20, 30, 40), "n_four_bar": (4, 8)}
"""What is measured on both paths; closed loops are for their runs alone."""


def rows_of(mechanism: str, sizes, what: str, how: tuple[str, str], scalar: bool | None = None):
    """A row for each size; `scalar` as of `simulate`."""
    for n in sizes:
        call, steps = how
        code = CODE.format(mechanism=mechanism, n=n, call=call, steps=steps, scalar=scalar)
        first, taken, n_steps = numbers_printed(code, "0", 3)
        row = {
            "mechanism": mechanism,
            "n": n,
            "what": what,
            "first_call_cpu_s": f"{first:.1f}",
            "milliseconds": f"{1e3 * taken:.2f}",
            "steps": int(n_steps),
            "us_per_step_and_n": f"{1e6 * taken / n_steps / n:.1f}",
        }
        print(row, flush=True)
        yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--both", action="store_true", help="scalar program and array code, printed")
    if parser.parse_args().both:
        for mechanism, sizes in BOTH.items():
            for scalar in (True, False):
                print("scalar program:" if scalar else "array code:")
                list(rows_of(mechanism, sizes, "run", RUN, scalar))
                if mechanism == "chain":
                    list(rows_of(mechanism, sizes, "gradient", GRADIENT, scalar))
        return
    rows = []
    for mechanism in SIZES:
        rows += rows_of(mechanism, SIZES[mechanism], "run", RUN)
        rows += rows_of(mechanism, GRADIENTS[mechanism], "gradient", GRADIENT)
    write("first_calls_of_chains", "python benchmarks/first_calls_of_chains.py", rows)


if __name__ == "__main__":
    main()
