"""A robot's first call and the runs after it: Panda, nine joints and a base that is fixed, 0.1 s.

    python benchmarks/robot_start.py     # two minutes; needs the extra `peers` for the robot's file

Processor time of the first `sj.simulate` of a process without a cache, imports not counted, and the median of 31 calls
after it: with machine code for its programs, and with XLA for all (`SPHEREJAX_MACHINE_CODE=0`), compiled soon and well
(`--well`: the options of small scenes, whatever the size; `spherejax.motion.integration.compiling`).
"""

import argparse
import importlib.metadata
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ["SPHEREJAX_CACHE"] = "0"

import jax
import jax.numpy as jnp
import numpy as np
from machine import write

import spherejax as sj
from spherejax.motion.integration import compiling

TS = jnp.linspace(0.0, 0.1, 11)
CONTROLS = {"Baumgarte": sj.solvers.Baumgarte(), "PostStabilization": sj.solvers.PostStabilization()}
TURNS = 31


def panda() -> Path:
    """The robot's file in `example-robot-data`."""
    found = importlib.metadata.files("example-robot-data") or []
    return next(Path(str(one.locate())).resolve() for one in found if one.name == "panda.urdf")


def measured(control: str) -> dict[str, object]:
    """The row of this process."""
    scene = sj.load_urdf(panda(), base="ground", ignore=("friction", "mimic", "extensions"), drift=CONTROLS[control])

    def run():
        return jax.block_until_ready(sj.simulate(scene, TS, rtol=1e-8).ys)

    begin = time.process_time()
    run()
    first = time.process_time() - begin
    taken = []
    for _ in range(TURNS):
        begin = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begin)
    return {"drift_control": control, "first_call_cpu_s": f"{first:.1f}", "run_ms": f"{1e3 * np.median(taken):.2f}"}


def main() -> None:
    """Every row in a process of its own, for a second first call is none."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--one", choices=CONTROLS)
    parser.add_argument("--well", action="store_true")
    given = parser.parse_args()
    if given.well:
        compiling.LARGE = sys.maxsize
    if given.one:
        row = measured(given.one)
        print(",".join(str(value) for value in row.values()))
        return
    rows = []
    for compiled in ("machine code", "XLA, soon", "XLA, well"):
        environment = {**os.environ, "SPHEREJAX_MACHINE_CODE": "1" if compiled == "machine code" else "0"}
        for control in CONTROLS:
            command = [sys.executable, __file__, "--one", control, *(["--well"] if "well" in compiled else [])]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            said = done.stdout.split()[-1]
            name, first, run = said.split(",")
            rows.append({"drift_control": name, "compiled": compiled, "first_call_cpu_s": first, "run_ms": run})
            print(rows[-1], flush=True)
    write("robot_start", "python benchmarks/robot_start.py", rows)


if __name__ == "__main__":
    main()
