"""What it is worth that LLVM is not told which numbers of a film's program do not overlap (`LESS_ALIASING`).

    python benchmarks/fewer_words.py            # two minutes

Each way in a process of its own, without anything kept: processor time of the first call, and of one run of 0.2 s.
"""

import os
import subprocess
import sys
import time

from machine import use_one_core, write

WAYS = {"as it is": False, "with all words": True}
TURNS = 9


def measured(with_all_words: bool) -> str:
    """Seconds of the first call and of a later one, and where the rocker ends; in a fresh process."""
    import jax.numpy as jnp
    import numpy as np

    import spherejax as sj
    from spherejax.compiler import hooks

    if with_all_words:
        hooks.LESS_ALIASING = {}
    scene = sj.gallery.four_bar(sj.Lubricated(1e-4, viscosity=0.4))

    def seconds() -> float:
        begin = time.process_time()
        sj.simulate(scene, jnp.linspace(0.0, 0.2, 21)).ys.block_until_ready()
        return time.process_time() - begin

    first, later = seconds(), [seconds() for _ in range(TURNS)]
    end = sj.simulate(scene, jnp.linspace(0.0, 0.2, 21)).position("rocker")[-1]
    return f"{first:.2f},{np.median(later):.5f},{np.asarray(end).tobytes().hex()}"


def main() -> None:
    rows, ends = [], set()
    for way, with_all_words in WAYS.items():
        code = f"import fewer_words; print(fewer_words.measured({with_all_words}))"
        environment = {**os.environ, "SPHEREJAX_CACHE": "0", "PYTHONPATH": os.path.dirname(os.path.abspath(__file__))}
        told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        first, later, end = told.stdout.split()[-1].split(",")
        ends.add(end)
        rows.append({"way": way, "first_call_s": first, "run_ms": f"{1e3 * float(later):.2f}"})
        print(rows[-1], flush=True)
    assert len(ends) == 1, "the two ways differ in a bit"
    write("fewer_words", "python benchmarks/fewer_words.py", rows)


if __name__ == "__main__":
    use_one_core()
    main()
