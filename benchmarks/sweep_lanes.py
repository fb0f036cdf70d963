"""Lanes on an accelerator: lanes per second and kernels per step by width of the block; a part of `sweeps.py`.

    python benchmarks/sweep_lanes.py                  # widths 1e2 to 1e6 on a GPU; says so and ends where there is none
    python benchmarks/sweep_lanes.py --cpu 64 256     # some widths on the CPU, to see that it works
    python benchmarks/sweep_lanes.py --cores          # a sweep on all cores, what the accelerator is compared with

The dry four-bar with friction, float64, as many runs as lanes. What a step costs on an accelerator is counted in the
compiled program: each fusion, copy, scatter, reduction, ... within the loop is a kernel that is launched.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from machine import write
from sweep_scenes import dry

import spherejax as sj
from spherejax.motion.integration.widths import block_for
from spherejax.motion.runs.many import batch_settings, many
from spherejax.motion.settings import RunSettings

WIDTHS = (100, 1_000, 10_000, 100_000, 1_000_000)
DURATION = 0.02
LIGHT = "parameter|constant|get-tuple-element|tuple|bitcast|while|conditional|call|iota"


def gpu(widths=WIDTHS, on_cpu: bool = False) -> None:
    """Lanes per second, kernels per step, memory, by width; and a sweep on all cores.

    The latter in a process without the accelerator: machine code is made there alone.
    """
    if not on_cpu and jax.default_backend() == "cpu":
        print("no accelerator: lanes are left out (on the CPU: python benchmarks/sweep_lanes.py --cpu 64 256)")
        return
    rows = []
    for width in widths:
        rows.append(measured(width, jax.devices()[0]))
        print(rows[-1], flush=True)  # the next one may not fit into memory
    if on_cpu:
        return
    command, environment = [sys.executable, __file__, "--cores"], {**os.environ, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    rows.append({name: "" for name in rows[0]} | json.loads(done.stdout.splitlines()[-1]))
    write("sweep_lanes", "python benchmarks/sweep_lanes.py", rows)


def measured(width: int, device, n_blocks: int = 1) -> dict:
    """One width on one device."""
    rows = {"clearance": np.linspace(5e-5, 2e-4, width * n_blocks)}
    block = sj.solvers.Block(width=width, narrow=max(width // 8, 1))
    method = batch_settings(dry, rows, RunSettings(solver=diffrax.Dopri8(), max_steps=1_000_000), block)

    def heights(rows, is_wanted):
        runs = many(dry, method, rows, jnp.array([0.0, DURATION]), is_wanted)
        return runs.trajectories.ys[:, -1], runs.trajectories.stats.n_steps, runs.n_lane_steps

    with jax.default_device(device):
        is_wanted = np.ones(width * n_blocks, bool)
        begin = time.perf_counter()
        program = jax.jit(heights).lower(rows, is_wanted).compile()
        compiled = time.perf_counter() - begin
        jax.block_until_ready(program(rows, is_wanted))
        begin = time.perf_counter()
        _, n_steps, n_lane_steps = jax.block_until_ready(program(rows, is_wanted))
        seconds = time.perf_counter() - begin
    n_turns = int(n_lane_steps) / width
    return {
        "device": f"{device.platform}: {device.device_kind}",
        "lanes": width,
        "runs": width * n_blocks,
        "runs_per_second": f"{width * n_blocks / seconds:.0f}",
        "ns_per_useful_step": f"{1e9 * seconds / int(n_steps.sum()):.1f}",
        "us_per_turn": f"{1e6 * seconds / n_turns:.1f}",
        "lane_efficiency": f"{int(n_steps.sum()) / int(n_lane_steps):.3f}",
        "kernels_per_turn": kernels_per_turn(program.as_text()),
        "bytes_per_lane": int(program.memory_analysis().temp_size_in_bytes) // (width * n_blocks),
        "compile_s": f"{compiled:.1f}",
    }


def on_all_cores(n_runs: int = 20_000) -> dict:
    """A sweep; its second call finds what the first one compiled."""
    grid = {"clearance": np.linspace(5e-5, 2e-4, n_runs)}
    for _ in range(2):
        begin = time.perf_counter()
        found = sj.sweep(dry, grid, [0.0, DURATION], record=["final position.rocker"], progress=False)
        seconds = time.perf_counter() - begin
    return {
        "device": f"cpu: {len(os.sched_getaffinity(0))} cores",
        "lanes": block_for("cpu").width,
        "runs": n_runs,
        "runs_per_second": f"{n_runs / seconds:.0f}",
        "ns_per_useful_step": f"{1e9 * seconds / int(found['n_steps'].sum()):.1f}",
        "lane_efficiency": f"{found.attrs['lane_efficiency']:.3f}",
    }


# Kernels -------------------------------------------------------------------------------------------------------------


def kernels_per_turn(program: str) -> int:
    """Kernels in one turn of the loop with the most of them, loops within it counted as often as they turn.

    Args:
        program: a compiled module in HLO's text.
    """
    bodies = _computations(program)
    loops = [_loop(line) for lines in bodies.values() for line in lines]
    # Loops without a known number of turns go on until the runs have ended.
    endless = [(body, condition) for body, condition, turns in loops if body and not turns]
    return max((_kernels(body, bodies) + _kernels(condition, bodies) for body, condition in endless), default=0)


def _kernels(name: str, bodies: dict[str, list[str]]) -> int:
    total = 0
    for line in bodies.get(name, ()):
        body, condition, turns = _loop(line)
        if body:
            total += max(turns, 1) * (_kernels(body, bodies) + _kernels(condition, bodies))
        elif branches := _branches(line):
            total += max(_kernels(branch, bodies) for branch in branches)
        elif called := re.search(r"\bcall\(.*to_apply=%?([\w.\-]+)", line):
            total += _kernels(called.group(1), bodies)
        elif (op := _operation(line)) and not re.fullmatch(LIGHT, op):
            total += 1
    return total


def _computations(program: str) -> dict[str, list[str]]:
    """Lines of each computation, by name."""
    bodies: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in program.splitlines():
        head = re.match(r"(?:ENTRY )?%?([\w.\-]+) \(.*\{\s*$", line)
        if head:
            lines = bodies.setdefault(head.group(1), [])
        elif " = " in line:
            lines.append(line)
    return bodies


def _operation(line: str) -> str | None:
    # NAME = TYPE OPERATION(...): a type can be a tuple, with spaces in it.
    found = re.search(r" = (?:\([^=]*?\)|\S+) ([\w\-]+)\(", line)
    return found.group(1) if found else None


def _loop(line: str) -> tuple[str, str, int]:
    """Body and condition of a loop and how often it turns (0: unknown); empty where the line is none."""
    found = re.search(r"\bwhile\(.*condition=%?([\w.\-]+), body=%?([\w.\-]+)", line)
    if not found:
        return "", "", 0
    turns = re.search(r'known_trip_count":\{"n":"(\d+)"', line)
    return found.group(2), found.group(1), int(turns.group(1)) if turns else 0


def _branches(line: str) -> list[str]:
    named = re.search(r"branch_computations=\{([^}]*)\}", line)
    if named:
        return [name.strip().lstrip("%") for name in named.group(1).split(",")]
    return re.findall(r"(?:true|false)_computation=%?([\w.\-]+)", line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cpu", nargs="+", type=int, metavar="LANES", help="widths, on the CPU")
    parser.add_argument("--cores", action="store_true", help="a sweep on all cores")
    options = parser.parse_args()
    if options.cores:
        print(json.dumps(on_all_cores()))
        return
    gpu(options.cpu, True) if options.cpu else gpu()


if __name__ == "__main__":
    main()
