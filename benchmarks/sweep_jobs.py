"""Many cheap runs: cost and memory by their number, and a sweep that is killed; a part of `sweeps.py`.

python benchmarks/sweep_jobs.py 5000 [store]     # one sweep, in a process of its own; prints what it took
"""

import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import diffrax
import numpy as np
from machine import write
from sweep_scenes import N_CORES, elastic

import spherejax as sj

COUNTS = (5_000, 20_000, 100_000)
CHUNK = 2_500
N_KILLS = 3
TS = np.linspace(0.0, 0.02, 5)


def swept(n: int, store: str | None):
    """Bushing four-bars of 0.02 s, stiffness 1e5 to 1e7 N/m; the rocker's position at five instants is kept."""
    return sj.sweep(
        elastic, {"stiffness": np.geomspace(1e5, 1e7, n)}, TS, record=["position.rocker"], rtol=1e-6,
        solver=diffrax.Dopri8(), chunk=CHUNK, store=store, progress=False,
    )  # fmt: skip


def took(n: int, store: str | None) -> dict:
    """One sweep: seconds and memory."""
    begin = time.perf_counter()
    result = swept(n, store)
    whole = time.perf_counter() - begin
    chunks = result.attrs["seconds_of_chunks"]
    return {
        "jobs": n,
        "results_in": "memory" if store is None else "store",
        "cores": N_CORES,
        "us_per_job_and_core": round(1e6 * float(np.sum(chunks)) / n, 1),
        "us_per_job_and_core_least": round(1e6 * float(np.min(chunks[: n // CHUNK])) / CHUNK, 1),
        "lane_efficiency": round(result.attrs["lane_efficiency"], 3),
        "whole_call_s": round(whole, 1),
        "result_MB": round(result.nbytes / 1e6, 1),
        "largest_memory_MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def jobs() -> None:
    """Cost per job and memory, each sweep in a process of its own; a first one fills the compilation cache."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for n in COUNTS:
            for store in (None, f"{folder}/{n}.zarr"):
                done = _started(n, store)
                answer, _ = done.communicate()
                rows.append(json.loads(answer.splitlines()[-1]))
    write("sweep_jobs", "python benchmarks/sweeps.py jobs", rows)


# A sweep that is killed ----------------------------------------------------------------------------------------------


def killed() -> None:
    """A sweep of 100,000 runs that is killed at three random points and gone on with, against one that is not."""
    n, random = COUNTS[-1], np.random.default_rng()
    with tempfile.TemporaryDirectory() as folder:
        whole, broken = f"{folder}/whole.zarr", f"{folder}/broken.zarr"
        begin = time.perf_counter()
        assert _started(n, whole).wait() == 0
        rows = [_row("not interrupted", whole, time.perf_counter() - begin)]
        for aim in np.sort(random.uniform(0.0, 1.0, N_KILLS)):
            begin = time.perf_counter()
            process = _started(n, broken)
            while process.poll() is None and _n_stored(broken) < aim * n:
                time.sleep(0.01)
            # Anywhere in a chunk, or in its being written.
            time.sleep(random.uniform(0.0, 0.5))
            process.send_signal(signal.SIGKILL)
            process.wait()
            rows.append(_row(f"killed by signal {-process.returncode}", broken, time.perf_counter() - begin))
        begin = time.perf_counter()
        assert _started(n, broken).wait() == 0
        rows.append(_row("gone on with to the end", broken, time.perf_counter() - begin))
        n_arrays = assert_identical(whole, broken)
    rows[-1]["what"] += f"; {n_arrays} arrays identical to the last bit"
    write("sweep_killed", "python benchmarks/sweeps.py killed", rows)


def assert_identical(first: str, second: str) -> int:
    """Compare all that is stored but seconds; return how many arrays."""
    import zarr

    arrays, others = dict(zarr.open_group(first, mode="r").arrays()), dict(zarr.open_group(second, mode="r").arrays())
    assert arrays.keys() == others.keys()
    compared = sorted(set(arrays) - {"seconds"})
    for name in compared:
        assert np.asarray(arrays[name]).tobytes() == np.asarray(others[name]).tobytes(), name
    status = sj.open_sweep(second)["status"]
    assert status.size == COUNTS[-1]
    assert int((status != 0).sum()) == 0
    return len(compared)


def _started(n: int, store: str | None) -> subprocess.Popen:
    command = [sys.executable, str(Path(__file__)), str(n), *([store] if store else [])]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _n_stored(path: str) -> int:
    return int((sj.open_sweep(path)["status"] >= 0).sum()) if Path(path).exists() else 0


def _row(what: str, path: str, seconds: float) -> dict:
    return {"what": what, "runs_in_the_store": _n_stored(path), "seconds": f"{seconds:.1f}"}


def main() -> None:
    n, *store = sys.argv[1:]
    print(json.dumps(took(int(n), *store or [None])))


if __name__ == "__main__":
    main()
