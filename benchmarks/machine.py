"""What every benchmark shares: timing by the rules, a description of the machine, and CSV files that carry both.

A timing is warmed up, blocks on the result, and is the median of five repeats.
"""

import csv
import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
REPEATS = 5


def median_seconds(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of a call [s], after one warm-up; the call must block on its result."""
    call()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def shortest_by_turns(calls: Sequence[Callable[[], object]], turns: int = 15) -> list[float]:
    """The shortest times [s] of calls that are made by turns, so that a machine that slows down slows all of them.

    For ratios on a machine whose speed wavers: the median of five in a row then tells which of two was unlucky.
    """
    times = []
    for _ in range(turns + 1):  # the first warms up
        times.append([])
        for call in calls:
            begin = time.perf_counter()
            call()
            times[-1].append(time.perf_counter() - begin)
    return list(np.min(times[1:], axis=0))


def use_one_core() -> None:
    """Pin this process to one core, before JAX starts its threads."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def described(packages: Sequence[str] = ("spherejax", "jax", "diffrax", "numpy")) -> dict[str, str]:
    """Machine and versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    versions = {name: _version(name) for name in packages}
    return {"processor": model, "python": platform.python_version(), **versions}


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def read(name: str) -> list[dict[str, str]]:
    """The rows of `results/NAME.csv`."""
    with (RESULTS / f"{name}.csv").open(newline="") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def write(name: str, command: str, rows: Sequence[Mapping[str, object]], packages: Sequence[str] = ()) -> Path:
    """Write rows to `results/NAME.csv`, headed by comment lines with command, machine and versions; print them."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.csv"
    facts = described(("spherejax", "jax", "diffrax", "numpy", *packages))
    with path.open("w", newline="") as stream:
        stream.write(f"# {command}\n# {'; '.join(f'{key} {value}' for key, value in facts.items())}\n")
        writer = csv.DictWriter(stream, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(path.read_text())
    return path
