"""Stores that cannot lie: another program, a flipped byte, two writers, a full disk, workers that die, a huge grid."""

import errno
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import zarr
from sweeping import pendulum

import spherejax as sj
from spherejax.motion.results.run_flags import flagged_runs
from spherejax.studies.sweep import lock
from spherejax.studies.sweep.dataset import SweepAccount
from spherejax.studies.sweep.grids import Combinations, product
from spherejax.studies.sweep.identity import points_of
from spherejax.studies.sweep.results import check_memory
from spherejax.studies.sweep.store import _seal

TESTS = str(Path(__file__).parent)
TS = np.array([0.0, 0.1])
GRID = {"gravity": np.array([1.0, 5.0, 9.0, 20.0])}
OPTIONS = {"workers": 1, "chunk": 2, "progress": False}


def height(run):
    return run.position("bob")[-1, 2]


def swept(build=pendulum, record=None, **options):
    return sj.sweep(build, GRID, TS, record=record or {"height": height}, **{**OPTIONS, **options})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished store, to be copied."""
    path = tmp_path_factory.mktemp("whole") / "sweep.zarr"
    swept(store=path)
    return path


@pytest.fixture
def store(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "sweep.zarr"))


# The same sweep ----------------------------------------------------------------------------------------------------


def edited(gravity):
    """Agrees with `pendulum` at the first run, and at no other."""
    return pendulum(1.0 + 0.5 * (gravity - 1.0))


def with_callback(share):
    """Scenes whose gravity is asked from Python: the traced program says nothing about it."""

    def of_host(gravity):
        return np.asarray(1.0 + share * (gravity - 1.0))

    return lambda gravity: pendulum(jax.pure_callback(of_host, jax.ShapeDtypeStruct((), float), gravity))


def test_an_edited_builder_that_agrees_at_the_first_run_is_another_sweep(store):
    with pytest.raises(sj.SceneError, match="store of another sweep: its builder made other scenes"):
        swept(edited, store=store)


def test_a_builder_that_only_reads_differently_is_the_same_sweep(store):
    def rewritten(gravity):
        """Another name, another text."""
        pulled_by = gravity
        return pendulum(pulled_by)

    swept(rewritten, {"height": lambda motion: motion.position("bob")[-1, 2]}, store=store)


FACTOR = 1.0


def scaled(run):
    return FACTOR * run.position("bob")[-1, 2]


def test_functions_that_are_recorded_are_compared_with_what_they_call(store, tmp_path, monkeypatch):
    with pytest.raises(sj.SceneError, match="a function in its record= computed something else"):
        swept(record={"height": lambda run: 2 * run.position("bob")[-1, 2]}, store=store)
    path = tmp_path / "scaled.zarr"
    swept(record={"height": scaled}, store=path)
    monkeypatch.setattr(sys.modules[__name__], "FACTOR", 1.5)
    with pytest.raises(sj.SceneError, match="a function in its record= computed something else"):
        swept(record={"height": scaled}, store=path)


def test_what_a_scene_asks_python_for_is_compared_by_code_and_numbers():
    from spherejax.motion.runs.traced_functions import known_build, numbers_fingerprint

    one, other = with_callback(1.0), with_callback(0.5)
    at = {"gravity": 9.0}
    assert numbers_fingerprint(one, at) != numbers_fingerprint(other, at)
    assert numbers_fingerprint(one, {"gravity": 1.0}) == numbers_fingerprint(other, {"gravity": 1.0})
    assert known_build(one, at, False).fingerprint != known_build(other, at, False).fingerprint
    # Equal code that talks to Python is not exchanged for one another within a process.
    assert known_build(one, at, False) != known_build(with_callback(1.0), at, False)


def test_a_force_in_the_scene_is_compared_by_what_it_does():
    from spherejax.motion.runs.traced_functions import known_build

    def build_with(push):
        def build(gravity):
            scene = pendulum(gravity)
            return sj.Scene(scene.bodies, scene.joints, {"push": sj.AppliedWrench("bob", push)}, gravity=scene.gravity)

        return build

    def push_of(size):
        return lambda t: jnp.array([0.0, 0.0, size]) * t

    at = {"gravity": 9.0}
    first, again, other = (known_build(build_with(push_of(size)), at, False) for size in (1.0, 1.0, 2.0))
    assert first == again
    assert first != other


def test_points_are_the_same_in_every_call_and_spread():
    grid = product({"a": np.arange(100.0), "b": np.arange(50.0)})
    points = points_of(grid)
    assert points == points_of(product({"a": np.arange(100.0), "b": np.arange(50.0)}))
    assert {0, 2500, 4999} < set(points)
    assert len(points) >= 6


# Every byte --------------------------------------------------------------------------------------------------------


def files_of(store: Path) -> list[Path]:
    return sorted(file for file in store.rglob("*") if file.is_file())


def test_every_flipped_byte_and_every_missing_file_is_found(store):
    n_found, whole = 0, sj.open_sweep(store).load()
    for file in files_of(store):
        content = file.read_bytes()
        for at in sorted({0, len(content) // 3, len(content) // 2, len(content) - 2}):
            file.write_bytes(content[:at] + bytes([content[at] ^ 0x01]) + content[at + 1 :])
            try:
                found = sj.open_sweep(store)
            except sj.SceneError:
                n_found += 1
            else:
                # White space of a description, or a byte that its compression does not read: nothing has changed.
                assert found.identical(whole), (file, at)
        file.unlink()
        # Without its digest a chunk counts as not made, and what it holds is not shown.
        if file.parent.parent == store / "digest":
            assert int(np.sum(sj.open_sweep(store)["status"] == -1)) == 2
            assert np.isnan(sj.open_sweep(store)["height"]).sum() == 2
        else:
            with pytest.raises(sj.SceneError):
                sj.open_sweep(store)
        file.write_bytes(content)
    assert n_found > 3 * len(files_of(store))
    assert sj.open_sweep(store).identical(whole)


def test_going_on_verifies_too(store):
    with zarr.config.set({"array.write_empty_chunks": True}):
        zarr.open_group(store, mode="r+")["gravity"][1] = 5.5
    with pytest.raises(sj.SceneError, match="is damaged: the parameters of its runs are not what was written"):
        swept(store=store)


def test_what_is_not_verified_is_said(store):
    zarr.open_group(store, mode="r+")["height"][0] = 7.0
    with pytest.warns(sj.errors.StoreWarning, match="compares nothing"):
        assert float(sj.open_sweep(store, verify=False)["height"][0]) == 7.0
    with pytest.raises(sj.SceneError, match="chunk 0 is not what was written"):
        sj.open_sweep(store)


def of_earlier_version(store: Path) -> None:
    """What stores were before they had a format: digests of the runs alone, nothing about programs."""
    group = zarr.open_group(store, mode="r+")
    found = sj.studies.sweep.store.Store(store, group)
    for chunk in range(found.n_chunks):
        values = {name: found.arrays[name][found.runs_of(chunk)] for name in found.names}
        found.arrays["digest"][chunk] = sj.studies.sweep.store._digest(values, {})
    identity = json.loads(group.attrs["identity"])
    for name in ("program", "points", "functions"):
        del identity[name]
    group.attrs["identity"] = json.dumps(identity)
    attrs = dict(group.attrs)
    del attrs["format"], attrs["seal"]
    group.attrs.put(attrs)


def test_a_store_of_an_earlier_version_opens_with_a_word(store):
    of_earlier_version(store)
    zarr.open_group(store, mode="r+")["digest"][1] = 0
    with pytest.warns(sj.errors.StoreWarning, match="written by an earlier version"):
        assert int(np.sum(sj.open_sweep(store)["status"] == 0)) == 2
    verified = pytest.warns(sj.errors.StoreWarning, match="have been verified")
    with verified, pytest.warns(sj.errors.StoreWarning, match="see to it yourself"):
        found = swept(store=store)
    assert np.all(found["status"] == 0)
    zarr.open_group(store, mode="r+")["height"][3] = 7.0
    with pytest.warns(sj.errors.StoreWarning), pytest.raises(sj.SceneError, match="chunk 1 is not what was written"):
        sj.open_sweep(store)


def test_a_store_without_warnings_goes_on_as_it_is(tmp_path, monkeypatch):
    path = tmp_path / "format_2.zarr"
    with monkeypatch.context() as earlier:
        for module in (sj.studies.sweep.store, sj.studies.sweep.dataset):
            earlier.delitem(module.COUNTED, "warnings")
        earlier.setattr(sj.studies.sweep.store, "FORMAT", 2)
        swept(store=path)
    zarr.open_group(path, mode="r+")["digest"][1] = 0
    assert np.all(swept(store=path)["status"] == 0)
    found = sj.open_sweep(path)
    assert "warnings" not in found
    assert flagged_runs(found) == []


def test_runs_that_are_missing_are_not_without_warnings(store):
    assert np.all(sj.open_sweep(store)["warnings"] == 0)
    zarr.open_group(store, mode="r+")["digest"][1] = 0
    assert sj.open_sweep(store)["warnings"].values.tolist() == [0, 0, -1, -1]


def test_the_seal_is_of_what_is_there(store):
    group = zarr.open_group(store, mode="r")
    assert _seal(store, group) == group.attrs["seal"]


# One writer --------------------------------------------------------------------------------------------------------

HOLDS = """
import sys, time
from pathlib import Path
from spherejax.studies.sweep.lock import held
with held(Path({path!r})):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_two_processes_do_not_write_one_store(store):
    code = HOLDS.format(path=str(store))
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(sj.SceneError, match=f"is being written by process {other.pid} on "):
            swept(store=store)
        other.kill()
    # Killed, it has left its lock lying, which is taken over.
    assert store.with_name("sweep.zarr.lock").exists()
    swept(store=store)
    assert not store.with_name("sweep.zarr.lock").exists()


def test_two_threads_do_not_either(tmp_path):
    path = tmp_path / "sweep.zarr"
    with lock.held(path), pytest.raises(sj.SceneError, match=f"is being written by process {os.getpid()}"):
        swept(store=path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_system_without_locks_is_named(tmp_path, monkeypatch):
    def no_locks(descriptor, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    with pytest.warns(sj.errors.StoreWarning, match="has no locks"), lock.held(tmp_path / "sweep.zarr"):
        pass


# What stops a sweep ------------------------------------------------------------------------------------------------


def test_a_full_disk_loses_nothing(whole, tmp_path, monkeypatch):
    path = tmp_path / "sweep.zarr"
    write, n_written = zarr.Array.__setitem__, []

    def until_full(self, key, value):
        if self.name == "/height":
            n_written.append(key)
            if len(n_written) == 2:
                raise OSError(errno.ENOSPC, "No space left on device")
        write(self, key, value)

    monkeypatch.setattr(zarr.Array, "__setitem__", until_full)
    with pytest.raises(
        sj.errors.SweepError, match=r"cannot write chunk 1 .* No space left on device.*Make room"
    ) as stop:
        swept(store=path)
    assert "2 of 4 runs are in" in stop.value.__notes__[0]
    monkeypatch.undo()
    assert swept(store=path).equals(sj.open_sweep(whole))


class Executor:
    """Computes one chunk, and answers the next ones with an error."""

    def __init__(self, error, at="future"):
        self.error, self.at, self.n_given = error, at, 0

    def submit(self, function, *arguments):
        self.n_given += 1
        future: Future = Future()
        if self.n_given == 1:
            future.set_result(function(*arguments))
        elif self.at == "submit":
            raise self.error
        elif self.error is None:
            future.cancel()
            future.set_running_or_notify_cancel()
        else:
            future.set_exception(self.error)
        return future


KilledWorker = type("KilledWorker", (Exception,), {})  # as Dask's


@pytest.mark.parametrize(
    ("executor", "words"),
    [
        (Executor(None), "the executor has stopped.*CancelledError"),
        (Executor(KilledWorker("4 workers died")), "exceed a limit of memory.*chunk=1 "),
        (Executor(BrokenProcessPool("terminated abruptly")), "exceed a limit of memory.*made anew"),
        (Executor(BrokenProcessPool("terminated abruptly"), "submit"), "exceed a limit of memory"),
        (Executor(MemoryError("Unable to allocate 3 GiB")), "does not fit in memory.*chunk=1 "),
        (Executor(RuntimeError("cannot schedule new futures after shutdown"), "submit"), "the executor has stopped"),
    ],
    ids=["scheduler", "worker", "pool", "pool that was broken", "memory", "shut down"],
)
def test_what_stops_a_sweep_is_said_and_loses_nothing(whole, tmp_path, executor, words):
    path = tmp_path / "sweep.zarr"
    with pytest.raises(sj.errors.SweepError, match=words) as stop:
        swept(store=path, executor=executor)
    assert "2 of 4 runs are in" in stop.value.__notes__[0]
    assert swept(store=path).equals(sj.open_sweep(whole))


# A huge grid -------------------------------------------------------------------------------------------------------


def test_a_huge_product_takes_no_memory():
    grid = product({"a": np.arange(10_000.0), "b": np.arange(10_000.0)})
    assert isinstance(grid.values, Combinations)
    assert grid.n_runs == 10**8
    rows = grid.rows(123_456, 123_460)
    assert rows["a"].tolist() == [12.0] * 4
    assert rows["b"].tolist() == [3456.0, 3457.0, 3458.0, 3459.0]
    assert grid.row(10**8 - 1) == {"a": 9999.0, "b": 9999.0}
    np.testing.assert_array_equal(
        np.concatenate(list(product({"a": [1.0, 2.0], "b": [3.0, 4.0]}).slabs("a"))), [1, 1, 2, 2]
    )


def test_results_that_memory_cannot_hold_are_refused_before_anything_is_computed(monkeypatch):
    shapes = {"position": jax.ShapeDtypeStruct((1000, 3), float)}
    with pytest.raises(sj.SceneError, match=r"of 100,000,000 runs take 2.4e\+03 GB.*store='sweep.zarr'.*'position'"):
        check_memory(10**8, shapes)
    monkeypatch.setattr("spherejax.studies.sweep.results.memory_of_machine", lambda: 100)
    with pytest.raises(sj.SceneError, match="the results of 4 runs"):
        swept()


def test_failures_are_counted_chunk_by_chunk():
    account = SweepAccount.of_nothing(np.ones(2, bool), 8, np.ones(2), np.array([10, 10]))
    account.add(0, np.array([0, 1, 1, 1]), np.array([2, 2, 2, 2]))
    account.add(4, np.array([1, 1, 1, 3]), np.array([2, 2, 2, -1]))
    assert account.failures.splitlines()[0].startswith("6 runs (1, 2, 3, 4, 5, ...), ")
    assert account.failures.splitlines()[1].startswith("1 runs (7), ")
    assert account.attributes["lane_efficiency"] == 14 / 20
