"""Sweeps: lanes that never idle, grids, records, stores that are gone on with, executors."""

import inspect
import os
import shutil
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path

import diffrax
import equinox as eqx
import jax
import numpy as np
import pytest
import xarray
import zarr
from public import every_name
from sweeping import elastic, hanging, pendulum

import spherejax as sj
from spherejax.motion.integration.lanes import Block
from spherejax.motion.integration.status import Status
from spherejax.motion.runs.many import simulate_many
from spherejax.output.io import load, save
from spherejax.studies.sweep.grids import product, random_samples, sobol_samples, zipped

TESTS = str(Path(__file__).parent)
TS = np.linspace(0.0, 0.5, 6)
GRID = {"gravity": np.linspace(1.0, 20.0, 7), "tilt": np.linspace(0.2, 1.2, 5)}
RECORD = ["position.bob", "final kinetic_energy", "peak reaction.pivot"]


def swept(**options):
    """The sweep that most tests look at: one program, made once."""
    options = {"chunk": 6, "workers": 2, "progress": False, **options}
    return sj.sweep(pendulum, GRID, TS, record=RECORD, **options)


@pytest.fixture(scope="module")
def result():
    return swept()


# The engine --------------------------------------------------------------------------------------------------------


def test_lanes_make_the_same_runs_as_simulate():
    clearances = np.linspace(5e-5, 2e-4, 9)
    ts = np.linspace(0.0, 0.05, 4)
    runs = simulate_many(hanging, {"clearance": clearances}, ts, rtol=1e-9, block=Block(4, 2))
    for lane in (0, 4, 8):
        alone = sj.simulate(hanging(clearances[lane]), ts, rtol=1e-9)
        np.testing.assert_allclose(runs.trajectories.ys[lane, :, :13], alone.ys[:, :13], atol=1e-8)
        assert int(runs.trajectories.stats.n_onsets[lane, 0]) == int(alone.stats.n_onsets[0]) > 3
        # One engine makes both; the order of operations, and with it rounding, differs with the width.
        assert int(runs.trajectories.stats.n_steps[lane]) == pytest.approx(int(alone.stats.n_steps), rel=0.05)
    assert np.all(runs.time_in_contact > 0)
    assert np.all(runs.time_in_contact < 0.05)


def test_a_stiff_method_runs_in_lanes():
    stiffness = np.array([1e5, 3e5, 1e6])
    ts = np.array([0.0, 0.01])
    runs = simulate_many(
        elastic, {"stiffness": stiffness}, ts, rtol=1e-7, solver=sj.solvers.Ros34PW2(), block=Block(2, 1)
    )
    alone = sj.simulate(elastic(stiffness[1]), ts, rtol=1e-10, solver=diffrax.Dopri8())
    np.testing.assert_allclose(runs.trajectories.position("bob")[1, -1], alone.position("bob")[-1], atol=1e-7)


@pytest.mark.parametrize(("n_runs", "least"), [(1000, 0.9), pytest.param(5000, 0.95, marks=pytest.mark.slow)])
def test_lanes_hardly_idle_when_costs_differ_tenfold(n_runs, least):
    # Steps grow with the root of gravity.
    gravity = np.random.default_rng(1).uniform(1.0, 10.0, n_runs) ** 2 * 10
    runs = simulate_many(pendulum, {"gravity": gravity}, np.array([0.0, 1.0]), rtol=1e-9)
    n_steps = np.asarray(runs.trajectories.stats.n_steps)
    assert n_steps.max() > 5 * n_steps.min()
    assert float(runs.lane_efficiency) >= least
    assert np.all(runs.trajectories.status == Status.SUCCEEDED)


def test_failing_lanes_tell_why_and_leave_the_others_alone():
    gravity = np.array([9.81, 1e8, 3.0, np.nan, 20.0])
    ts = np.array([0.0, 1.0])
    runs = simulate_many(pendulum, {"gravity": gravity}, ts, max_steps=200, block=Block(4, 2)).trajectories
    ok, slow, bad = Status.SUCCEEDED, Status.TOO_MANY_STEPS, Status.BAD_VALUE
    assert np.asarray(runs.status).tolist() == [ok, slow, ok, bad, ok]
    assert float(runs.t_reached[1]) < 1.0
    assert np.all(np.isnan(runs.ys[1, -1]))
    assert "lane 1: stopped" in runs.diagnosis
    alone = simulate_many(pendulum, {"gravity": np.full(5, 20.0)}, ts, max_steps=200, block=Block(4, 2)).trajectories
    np.testing.assert_array_equal(runs.ys[4], alone.ys[4])


def test_traced_assembly_in_lanes():
    tilts = np.array([0.3, 0.6])
    runs = simulate_many(pendulum, {"tilt": tilts}, np.array([0.0, 0.1])).trajectories
    np.testing.assert_allclose(runs.position("bob")[:, 0, 0], np.sin(tilts), atol=1e-9)


# Grids -------------------------------------------------------------------------------------------------------------


def test_grids():
    grid = product({"a": [1.0, 2.0], "b": [3.0, 4.0, 5.0]})
    assert grid.shape == (2, 3)
    assert grid.values["a"].tolist() == [1, 1, 1, 2, 2, 2]
    assert grid.values["b"].tolist() == [3, 4, 5, 3, 4, 5]
    assert zipped({"a": [1.0, 2.0], "b": [3.0, 4.0]}).n_runs == 2
    sample = random_samples({"a": (1.0, 100.0), "b": (0.0, 1.0)}, 1000, rng=3, logarithmic=["a"])
    assert abs(np.mean(np.log10(sample.values["a"])) - 1) < 0.1
    assert np.all((sample.values["b"] >= 0) & (sample.values["b"] <= 1))
    again = random_samples({"a": (1.0, 100.0), "b": (0.0, 1.0)}, 1000, rng=3, logarithmic=["a"])
    assert sample.fingerprint == again.fingerprint
    assert sample.fingerprint != random_samples({"a": (1.0, 100.0), "b": (0.0, 1.0)}, 1000, rng=4).fingerprint
    even = sobol_samples({"a": (0.0, 1.0)}, 64).values["a"]
    assert np.all(np.histogram(even, 8, (0, 1))[0] == 8)


def test_random_numbers_come_from_a_number_a_generator_or_anew():
    ranges = {"a": (1.0, 2.0)}
    for samples in (sj.studies.random_samples, sj.studies.sobol_samples):
        first = samples(ranges, 4, rng=3).values["a"]
        np.testing.assert_array_equal(samples(ranges, 4, rng=np.random.default_rng(3)).values["a"], first)
        assert np.any(samples(ranges, 4, rng=None).values["a"] != first)
        with pytest.warns(DeprecationWarning, match="seed= is called rng="):
            np.testing.assert_array_equal(samples(ranges, 4, seed=3).values["a"], first)
        with pytest.raises(TypeError, match="give one of both"):
            samples(ranges, 4, seed=3, rng=3)
        with pytest.raises(sj.SceneError, match=r"rng = 'x' must be a whole number"):
            samples(ranges, 4, rng="x")


def test_no_public_function_has_a_seed():
    calls = [
        thing for name, thing in every_name().items() if name != "RandomRoad"
    ]  # whose seed is a number of the scene
    with_rng = [call for call in calls if callable(call) and "rng" in _arguments(call)]
    assert len(with_rng) == 10
    assert not [call for call in calls if callable(call) and "seed" in _arguments(call)]
    with pytest.warns(DeprecationWarning, match="seed= is called rng="):
        assert sj.studies.GrowingHorizon(seed=3) == sj.studies.GrowingHorizon(rng=3)


def _arguments(call) -> set[str]:
    try:
        return set(inspect.signature(call).parameters)
    except (TypeError, ValueError):
        return set()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: product({}), "a sweep needs parameters"),
        (lambda: product({"a": [1.0, np.nan]}), "parameter 'a' must be finite; entry 1"),
        (lambda: product({"a": "wide"}), "parameter 'a' must be a list of numbers"),
        (lambda: zipped({"a": [1.0], "b": [1.0, 2.0]}), "equal length"),
        (lambda: random_samples({"a": (2.0, 1.0)}, 3), "needs a range"),
        (lambda: random_samples({"a": (0.0, 1.0)}, 3, logarithmic=["a"]), "must be positive"),
        (lambda: random_samples({"a": (0.0, 1.0)}, 3, logarithmic=["b"]), "names no parameter"),
        (lambda: sobol_samples({"a": (0.0, 1.0)}, 0), "at least one run"),
    ],
)
def test_bad_grids(make, words):
    with pytest.raises(sj.SceneError, match=words):
        make()


# The result --------------------------------------------------------------------------------------------------------


def test_the_result_is_labelled(result):
    assert dict(result.sizes) == {"gravity": 7, "tilt": 5, "time": 6, "axis": 3}
    alone = sj.simulate(pendulum(20.0, 1.2), TS, rtol=1e-10)
    found = result["position.bob"].sel(gravity=20.0, tilt=1.2)
    np.testing.assert_allclose(found, alone.position("bob"), atol=1e-6)
    assert found.attrs["units"] == "m"
    assert result["final_kinetic_energy"].attrs["units"] == "J"
    assert np.all(result["status"] == 0)
    assert 0 < result.attrs["lane_efficiency"] <= 1
    assert result.attrs["rtol"] == 1e-8
    assert result.attrs["failures"] == ""
    assert result.attrs["jax_version"] == jax.__version__


def test_peaks_are_those_of_all_steps(result):
    # From rest at 1.2 rad the largest reaction is at the lowest point, which is passed between two samples.
    gravity, tilt = 20.0, 1.2
    fine = sj.simulate(pendulum(gravity, tilt), np.linspace(0.0, 0.5, 501), rtol=1e-10)
    largest = np.linalg.norm(fine.reaction("pivot"), axis=1).max()
    sampled = np.linalg.norm(fine.reaction("pivot")[::100], axis=1).max()
    found = float(result["peak_reaction.pivot"].sel(gravity=gravity, tilt=tilt))
    assert sampled * (1 - 1e-6) < found < largest * (1 + 1e-6)


def test_peaks_miss_no_impact():
    peak, ts = "peak acceleration.bob", np.array([0.0, 0.02])
    found = sj.sweep(hanging, {"mu": [0.0, 0.2]}, ts, record=[peak], rtol=1e-7, progress=False)
    fine = sj.simulate(hanging(mu=0.2), np.linspace(0.0, 0.02, 20_001), rtol=1e-7)
    largest = np.linalg.norm(fine.acceleration("bob"), axis=1).max()
    assert float(found["peak_acceleration.bob"][1]) == pytest.approx(largest, rel=0.05)
    assert largest > 3 * np.linalg.norm(np.asarray(fine.acceleration("bob"))[[0, -1]], axis=1).max()


def test_functions_are_kept():
    found = sj.sweep(
        pendulum,
        zipped({"gravity": [5.0, 10.0], "tilt": [0.5, 0.6]}),
        TS,
        record={"drop": lambda run: run.position("bob")[0, 2] - run.position("bob")[-1, 2]},
        progress=False,
    )
    alone = sj.simulate(pendulum(10.0, 0.6), TS).position("bob")
    assert found["drop"].dims == ("run",)
    np.testing.assert_allclose(found["drop"][1], alone[0, 2] - alone[-1, 2], atol=1e-7)
    assert found["gravity"].values.tolist() == [5.0, 10.0]


def test_work_and_contacts_are_kept():
    record = ["onsets.hook", "time_in_contact.hook", "final dissipated_energy.hook"]
    found = sj.sweep(hanging, {"mu": [0.0, 0.2]}, np.array([0.0, 0.05]), record=record, progress=False)
    assert np.all(found["onsets.hook"] > 0)
    assert np.all(found["final_dissipated_energy.hook"] > 0)


def test_derivatives_of_a_sweep():
    def height(gravity):
        return sj.simulate(pendulum(gravity), np.array([0.0, 0.3])).position("bob")[-1, 2]

    gravity = np.array([5.0, 10.0])
    slopes = jax.vmap(jax.grad(height))(gravity)
    shift = 1e-4
    found = [
        sj.sweep(pendulum, {"gravity": gravity + s}, [0.0, 0.3], record=["final position.bob"], progress=False)
        for s in (-shift, shift)
    ]
    below, above = (each["final_position.bob"].sel(axis="z").values for each in found)
    np.testing.assert_allclose(slopes, (above - below) / (2 * shift), rtol=1e-3)


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ([], "asks for nothing"),
        (["speed.bob"], "names no quantity"),
        (["max position.bob"], r"or .final. or .peak. before one, as .peak position.bob."),
        (["position.bib"], "one of 'bob'"),
        (["onsets.pivot"], "has no contact"),
        (["position.bob", "position.bob"], "twice"),
        ([3], "neither"),
        ({"status": lambda run: run.ts[0]}, "choose another name"),
    ],
)
def test_bad_records(record, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.sweep(pendulum, {"gravity": [1.0]}, TS, record=record)


def test_a_parameter_that_build_does_not_know():
    with pytest.raises(sj.SceneError, match="cannot be called with the parameters weight"):
        sj.sweep(pendulum, {"weight": [1.0]}, TS, record=RECORD)


# The store ---------------------------------------------------------------------------------------------------------


class StopError(Exception):
    pass


def _stop(seen):
    if seen.n_done >= 12:
        raise StopError


def test_a_stopped_sweep_goes_on_and_ends_the_same(result, tmp_path):
    path = tmp_path / "sweep.zarr"
    with pytest.raises(StopError):
        swept(store=path, workers=1, progress=_stop)
    seen = []
    found = swept(store=path, progress=seen.append)
    assert seen[0].n_done_before == 12
    for name in result.data_vars:
        np.testing.assert_array_equal(found[name], result[name])
    # A third time there is nothing left to do.
    assert swept(store=path, progress=seen.append).equals(found)
    assert seen[-1].n_done_before == 35


def heavier(gravity, tilt):
    """The same mechanism with another number that is not swept."""
    scene = pendulum(gravity, tilt)
    return eqx.tree_at(lambda s: s.bodies["bob"].mass, scene, 2.0)


def test_a_function_in_the_scene_does_not_make_it_another_sweep(tmp_path):
    # Another function object, as another process would have it.
    def build_with(push):
        def build(gravity):
            scene = pendulum(gravity)
            return sj.Scene(scene.bodies, scene.joints, {"push": sj.AppliedWrench("bob", push)}, gravity=scene.gravity)

        return build

    def pushes():
        def push(t):
            return np.array([0.0, 0.0, 1.0]) * t

        return push

    grid, options = {"gravity": [5.0, 10.0]}, {"record": RECORD[1:2], "progress": False, "store": tmp_path / "s.zarr"}
    first = sj.sweep(build_with(pushes()), grid, TS, **options)
    assert sj.sweep(build_with(pushes()), grid, TS, **options).equals(first)


def test_the_store_of_another_sweep_is_refused(tmp_path):
    path = tmp_path / "sweep.zarr"
    swept(store=path)
    with pytest.raises(sj.SceneError, match="store of another sweep: its rtol is 1e-08"):
        swept(store=path, rtol=1e-9)
    with pytest.raises(sj.SceneError, match="store of another sweep: its record"):
        sj.sweep(pendulum, GRID, TS, record=RECORD[:1], store=path)
    with pytest.raises(sj.SceneError, match="store of another sweep: its numbers"):
        sj.sweep(heavier, GRID, TS, record=RECORD, store=path)
    (tmp_path / "notes").mkdir()
    with pytest.raises(sj.SceneError, match="is no store of a sweep"):
        swept(store=tmp_path / "notes")


def test_a_store_is_read_where_it_is_looked_at(result, tmp_path, monkeypatch):
    found = swept(store=tmp_path / "sweep.zarr")
    n_read = []
    array = type(zarr.open_group(tmp_path / "sweep.zarr", mode="r")["status"])
    get = array.__getitem__
    monkeypatch.setattr(array, "__getitem__", lambda self, key: n_read.append(self.name) or get(self, key))
    later = sj.open_sweep(tmp_path / "sweep.zarr")
    n_read.clear()
    some = later["position.bob"].isel(gravity=slice(2, 4), axis=2, time=-1)
    assert n_read == []
    np.testing.assert_array_equal(some, result["position.bob"].values[2:4, :, -1, 2])
    assert n_read == ["/position.bob"]
    for key in ({"gravity": [5, 1], "tilt": 3}, {"gravity": -1, "tilt": slice(None, None, -2)}, {"tilt": []}):
        np.testing.assert_array_equal(later["position.bob"].isel(key), result["position.bob"].isel(key))
    assert later.equals(found)
    assert later.attrs["method"] == result.attrs["method"]
    assert later["final_kinetic_energy"].attrs == result["final_kinetic_energy"].attrs
    # Any reader of Zarr finds names, units and parameters.
    plain = xarray.open_zarr(tmp_path / "sweep.zarr", consolidated=False, chunks=None)
    assert plain["position.bob"].dims == ("run", "time", "axis")
    np.testing.assert_array_equal(plain["tilt"][:5], GRID["tilt"])
    assert set(plain.coords) == {"time", "gravity", "tilt"}


def test_a_sweep_survives_netcdf(result, tmp_path):
    for found, name in ((result, "memory.nc"), (swept(store=tmp_path / "sweep.zarr"), "store.nc")):
        again = load(save(found, tmp_path / name))
        assert again.identical(found.assign_attrs(again.attrs))
        for key, value in found.attrs.items():
            np.testing.assert_array_equal(again.attrs[key], value)


def test_what_is_no_folder_is_no_store(tmp_path):
    with pytest.raises(sj.SceneError, match=r"result.to_netcdf\('sweep.nc'\)"):
        swept(store=tmp_path / "sweep.nc")
    assert not list(tmp_path.iterdir())
    with pytest.raises(sj.SceneError, match="there is no store"):
        sj.open_sweep(tmp_path / "sweep.zarr")


def test_a_parameter_with_the_name_of_a_result():
    with pytest.raises(sj.SceneError, match="a parameter is called 'time'"):
        sj.sweep(lambda time: pendulum(time), {"time": [1.0]}, TS, record=RECORD)


def test_a_damaged_store_is_refused(tmp_path):
    whole = tmp_path / "sweep.zarr"
    swept(store=whole)
    for folder, name, word in (
        ("position.bob", "c", "chunk"),
        ("digest", "c", "digest"),
        ("status", "zarr.json", "array"),
    ):
        path = tmp_path / f"{folder}.zarr"
        shutil.copytree(whole, path)
        victim = next(file for file in (path / folder / name, *(path / folder).rglob(f"{name}/**/*")) if file.is_file())
        content = bytearray(victim.read_bytes())
        content[len(content) // 2] ^= 0xFF
        victim.write_bytes(bytes(content))
        with pytest.raises(sj.SceneError, match=f"is damaged: .*{word}"):
            swept(store=path)
    shutil.rmtree(whole / "n_steps")
    with pytest.raises(sj.SceneError, match="is damaged: an array"):
        swept(store=whole)


# Elsewhere ---------------------------------------------------------------------------------------------------------


class LosingExecutor:
    """Runs what it is given at once, and loses the second thing once, as a worker that dies."""

    def __init__(self):
        self.n_given = 0

    def submit(self, function, *arguments):
        self.n_given += 1
        future: Future = Future()
        if self.n_given == 2:
            future.set_exception(RuntimeError("the worker has died"))
        else:
            future.set_result(function(*arguments))
        return future


def test_a_lost_chunk_runs_again(result):
    executor = LosingExecutor()
    found = swept(executor=executor)
    assert executor.n_given == 7
    for name in result.data_vars:
        np.testing.assert_array_equal(found[name], result[name])


FOUR_DEVICES = """
import sys
sys.path.insert(0, {tests!r})
import jax
import test_sweep as t
jax.config.update("jax_compilation_cache_dir", {cache!r})
assert jax.local_device_count() == 4
t.swept(store={path!r}, workers=None)
try:
    t.swept(store={path!r} + ".stopped", workers=None, progress=t._stop)
except t.StopError:
    pass
"""


def test_several_devices_share_the_chunks_to_the_last_bit(result, tmp_path):
    path = str(tmp_path / "sharded.zarr")
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=4"
    code = FOUR_DEVICES.format(tests=TESTS, path=path, cache=jax.config.jax_compilation_cache_dir)
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "XLA_FLAGS": flags}, check=True)
    found, stopped = sj.open_sweep(path), sj.open_sweep(path + ".stopped")
    # Six chunks: four devices, then two of them. The other sweep was stopped while the four were under way or after
    # them; what was finished by then is kept.
    assert int(np.sum(stopped["status"] == 0)) >= 24
    gone_on = swept(store=path + ".stopped")
    for name in result.data_vars:
        np.testing.assert_array_equal(found[name], result[name])
        np.testing.assert_array_equal(gone_on[name], result[name])


def test_what_cannot_be_sent_is_named():
    class Unsendable:
        def __reduce__(self):
            raise TypeError("not me")

    keep = Unsendable()
    with pytest.raises(sj.SceneError, match="cannot be sent to another process"):
        sj.sweep(
            lambda gravity: pendulum(gravity + (keep is None)),
            {"gravity": [1.0]},
            TS,
            record=["final position.bob"],
            executor=LosingExecutor(),  # pyright: ignore[reportArgumentType]
        )
