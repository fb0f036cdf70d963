"""Seconds until the first result: imports, the first call of `simulate`, and the same in a new process.

    python benchmarks/start_up.py

The scene is the four-bar, dry with friction, 0.2 s. The first process has an empty compilation cache, the next ones
find what it left (JAX's persistent cache, `JAX_COMPILATION_CACHE_DIR`).
"""

import os
import subprocess
import sys
import tempfile

import numpy as np
from machine import use_one_core, write

RUN = """
import time
begin = time.perf_counter()
import jax.numpy as jnp
import spherejax as sj
imported = time.perf_counter()
joint = sj.Dry(1e-4, friction=sj.Threlfall())
def call():
    begin = time.perf_counter()
    float(sj.simulate(sj.gallery.four_bar(joint), jnp.linspace(0.0, 0.2, 21)).position("rocker")[-1, 2])
    return time.perf_counter() - begin
first = call()
again = min(call() for _ in range(5))
print(imported - begin, first, again)
"""

REPEATS = 3


def seconds_in_new_process(cache: str) -> np.ndarray:
    """Seconds of imports, of the first call, and of a repeated call in the same process."""
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    output = subprocess.run(
        [sys.executable, "-c", RUN], env=environment, check=True, capture_output=True, text=True
    ).stdout
    return np.array([float(word) for word in output.split()])


def main() -> None:
    use_one_core()
    with tempfile.TemporaryDirectory() as cache:
        fresh = seconds_in_new_process(cache)
        cached = np.median([seconds_in_new_process(cache) for _ in range(REPEATS)], axis=0)
    rows = [
        {
            "process": name,
            "imports_s": f"{seconds[0]:.2f}",
            "first_call_s": f"{seconds[1]:.2f}",
            "repeated_call_s": f"{seconds[2]:.4f}",
        }
        for name, seconds in (("first, empty cache", fresh), ("new process, cache filled", cached))
    ]
    write("start_up", "python benchmarks/start_up.py", rows)


if __name__ == "__main__":
    main()
