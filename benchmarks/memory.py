"""Memory of a process that asks for ever new programs: lengths of records, equal lambdas, builders.

    python benchmarks/memory.py            # a quarter of an hour; --n 40 for fewer programs of each kind

Each case runs in a process of its own and calls `n` times. What is written is the resident memory after the calls, when
Python has collected its garbage; the first call brings imports and compiler. Programs are compiled, not read from JAX's
persistent cache.
"""

import argparse
import gc
import os
import subprocess
import sys

import numpy as np
from machine import write

CASES = {
    "lengths": "simulate with another number of samples each time",
    "lambdas": "sweep with an equal lambda as builder, and one in record=, each time",
    "builders": "sweep with another builder each time",
}
AFTER = 6
"""Points of the curve."""


def resident_megabytes() -> float:
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def calls_of(case: str):
    """The n-th call."""
    import spherejax as sj

    scene = sj.gallery.four_bar(sj.Bushing(1e6, 1e-4))
    ts = np.array([0.0, 0.001])

    def lengths(turn):
        sj.simulate(scene, np.linspace(0.0, 1e-3, turn + 2)).position("rocker")

    def swept(build):
        record = {"x": lambda run: run.position("rocker")[-1]}
        sj.sweep(build, {"stiffness": [1e6, 2e6]}, ts, record=record, workers=1, progress=False)

    def lambdas(turn):
        swept(lambda stiffness: sj.gallery.four_bar(sj.Bushing(stiffness, 1e-4)))

    def builders(turn):
        swept(lambda stiffness: sj.gallery.four_bar(sj.Bushing(stiffness * (1 + 1e-3 * turn), 1e-4)))

    return {"lengths": lengths, "lambdas": lambdas, "builders": builders}[case]


def measure(case: str, n: int) -> None:
    """Print the number of calls and the resident memory, a line each."""
    call = calls_of(case)
    points = {1, *np.linspace(0, n, AFTER, dtype=int)[1:].tolist()}
    for turn in range(1, n + 1):
        call(turn)
        if turn in points:
            print(turn, resident_megabytes(), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--case", choices=CASES, help="one case, in this process")
    options = parser.parse_args()
    if options.case:
        measure(options.case, options.n)
        return
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    rows = []
    for case, what in CASES.items():
        command = [sys.executable, __file__, "--case", case, "--n", str(options.n)]
        printed = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
        found = [line.split() for line in printed.splitlines()]
        first = float(found[0][1])
        rows += [
            {
                "case": what,
                "calls": calls,
                "resident_MB": f"{float(megabytes):.0f}",
                "MB_a_call": f"{(float(megabytes) - first) / max(int(calls) - 1, 1):.2f}",
            }
            for calls, megabytes in found
        ]
    write("memory", f"python benchmarks/memory.py --n {options.n}", rows, ["spherejax", "jax", "equinox"])


if __name__ == "__main__":
    main()
