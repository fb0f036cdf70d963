"""Sweeps in other processes: a Dask scheduler with a worker that is killed, a sweep that is killed, a process pool."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from sweeping import pendulum

import spherejax as sj
from spherejax.studies.sweep.store import Store

TESTS = str(Path(__file__).parent)
TS = np.linspace(0.0, 0.5, 3)
GRID = {"gravity": np.linspace(1.0, 20.0, 60)}
RECORD = ["final position.bob"]
CHUNK = 6


def swept(**options):
    return sj.sweep(pendulum, GRID, TS, record=RECORD, chunk=CHUNK, **{"workers": 1, "progress": False, **options})


@pytest.fixture(scope="module")
def here():
    return swept()


@pytest.fixture(scope="module", autouse=True)
def environment():
    """Other processes find the scenes, and keep to one core each."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [TESTS, before]))
    yield
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


def assert_same(found, here):
    for name in here.data_vars:
        np.testing.assert_array_equal(found[name], here[name])


def started(module: str, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-m", module, *arguments, "--no-dashboard"]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and two workers in processes of their own, on loopback."""
    import distributed

    at = ("--scheduler-file", str(tmp_path / "scheduler.json"))
    processes = [started("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *at)]
    worker = ("distributed.cli.dask_worker", *at, "--nthreads", "1", "--no-nanny")
    processes += [started(*worker, "--name", name) for name in ("first", "second")]
    with distributed.Client(scheduler_file=at[1], timeout=60) as client:
        client.wait_for_workers(2, timeout=60)
        yield client, processes
    for process in reversed(processes):
        process.kill()
        process.wait()


def test_a_killed_worker_of_a_cluster_loses_nothing(cluster, here):
    client, (_, first, _) = cluster
    kills = []

    def kill_one(seen):
        if seen.n_done and not kills:
            kills.append(seen.n_done)
            first.send_signal(signal.SIGKILL)

    found = swept(executor=client.get_executor(), progress=kill_one)
    assert kills
    assert kills[0] < 60
    assert first.wait(timeout=10) == -signal.SIGKILL
    assert_same(found, here)


@pytest.mark.slow
def test_a_pool_of_processes(here):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert_same(swept(executor=pool), here)


KILLED = """
import sys
sys.path.insert(0, {tests!r})
import time
import test_sweep_elsewhere as t
t.swept(store={path!r}, progress=lambda seen: time.sleep(2.0))
"""


@pytest.mark.slow
def test_a_sweep_that_is_killed_three_times_ends_the_same(here, tmp_path):
    path = tmp_path / "killed.zarr"
    random = np.random.default_rng(5)
    n_before = 0
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", KILLED.format(tests=TESTS, path=str(path))])
        aim = n_before + int(random.integers(1, 3))
        while process.poll() is None and _n_stored(path) < aim:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.wait()
        n_before = _n_stored(path)
        assert n_before < 10, "it was done before it could be killed"
    assert n_before >= 3
    assert_same(swept(store=path), here)


def _n_stored(path: Path) -> int:
    import zarr

    try:
        store = Store(path, zarr.open_group(path, mode="r"))
        return int(np.sum(np.asarray(store.group["digest"]) != 0))
    except Exception:
        return 0
