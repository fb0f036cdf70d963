"""Derivatives of every run of a sweep by its parameters, through contact onsets."""

import os
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
import pytest
from sweeping import elastic, hanging, pendulum

import spherejax as sj
from spherejax.motion.integration.lanes import Block
from spherejax.motion.runs.many import simulate_many

TS = np.linspace(0.0, 0.05, 3)
GRID = {"clearance": np.array([0.8e-4, 1.0e-4, 1.2e-4]), "mu": np.array([0.05, 0.1])}
POSITION, SLOPES = "final_position.bob", "sensitivity_final_position.bob"


def speeds(run):
    """Squared speed of the bob along time."""
    return np.array([1.0, 1.0, 1.0]) @ (run.velocity("bob") ** 2).T


RECORD = [
    "final position.bob",
    "sensitivity final position.bob",
    "onsets.hook",
    sj.studies.Sensitivity("penetration.hook", by=("mu",)),
    sj.studies.Sensitivity(speeds),
]
RUNS = {name: values.ravel() for name, values in zip(GRID, np.meshgrid(*GRID.values(), indexing="ij"), strict=True)}


def swept(**options):
    """The sweep that all tests look at: one program, made once."""
    given = {"record": RECORD, "chunk": 4, "workers": 1, "progress": False}
    return sj.sweep(hanging, GRID, TS, **{**given, **options})


@pytest.fixture(scope="module")
def result():
    return swept()


def alone(clearance, mu):
    """What is kept of one run."""
    run = sj.simulate(hanging(clearance, mu), TS)
    return run.position("bob")[-1], run.penetration("hook"), speeds(run)


@pytest.mark.slow
def test_they_are_those_of_simulate_lane_by_lane(result):
    """By a vmapped reverse mode, for two clearances."""
    lanes = GRID["clearance"][:2], np.full(2, GRID["mu"][1])
    assert np.all(result["onsets.hook"] > 5)
    slopes = [np.stack(each, -1) for each in jax.vmap(jax.jacrev(alone, (0, 1)))(*lanes)]
    found = result.isel(clearance=slice(2), mu=1)
    for name, expected in zip((SLOPES, "sensitivity_penetration.hook", "sensitivity_speeds"), slopes, strict=True):
        errors, sizes = (np.max(np.abs(x), tuple(range(expected.ndim - 1))) for x in (found[name] - expected, expected))
        assert np.all(errors < 1e-5 * sizes), name


def test_they_are_differences(result):
    ends = {}
    for name, shift in (
        ("none", 0.0),
        *(("clearance", s * 1e-9) for s in (-1, 1)),
        *(("mu", s * 1e-5) for s in (-1, 1)),
    ):
        runs = {**RUNS, name: RUNS[name] + shift} if name in RUNS else RUNS
        ends[name, shift] = simulate_many(hanging, runs, TS, rtol=1e-10).trajectories.position("bob")[:, -1]
    np.testing.assert_allclose(result[POSITION].values.reshape(6, 3), ends["none", 0.0], atol=1e-9)
    for name, shift in (("clearance", 1e-9), ("mu", 1e-5)):
        differences = np.asarray(ends[name, shift] - ends[name, -shift]) / (2 * shift)
        found = result[SLOPES].sel(parameter=name).values.reshape(6, 3)
        assert np.max(np.abs(found - differences)) < 1e-3 * np.max(np.abs(differences)), name


def test_they_have_a_tolerance_of_their_own(result, tmp_path):
    """Fewer steps, and derivatives that are still near; the store of another tolerance is refused."""
    path = tmp_path / "slopes.zarr"
    coarse = swept(derivative_rtol=1e-6, store=path)
    assert coarse.attrs["derivative_rtol"] == 1e-6
    assert "derivative_rtol" not in result.attrs
    assert np.all(coarse["n_steps"] < 0.8 * result["n_steps"])
    change = np.abs(coarse[SLOPES] - result[SLOPES]).max() / np.abs(result[SLOPES]).max()
    assert 0 < change < 1e-4
    np.testing.assert_allclose(coarse[POSITION], result[POSITION], rtol=0, atol=1e-9)
    with pytest.raises(sj.SceneError, match="store of another sweep: its derivative_rtol is 1e-06, not None"):
        swept(store=path)


def test_a_tolerance_of_nothing_is_refused():
    with pytest.raises(sj.SceneError, match=r"derivative_rtol = 1e-06 is for sensitivities, and none is recorded"):
        swept(record=["final position.bob"], derivative_rtol=1e-6)
    with pytest.raises(sj.SceneError, match="derivative_rtol = -1 must be positive"):
        swept(derivative_rtol=-1.0)


def test_they_are_labelled(result):
    found = result[SLOPES]
    assert found.dims == ("clearance", "mu", "axis", "parameter")
    assert found["parameter"].values.tolist() == ["clearance", "mu"]
    assert found.attrs["units"] == "m per unit of the parameter"
    assert result["sensitivity_penetration.hook"].dims == ("clearance", "mu", "time", "parameter")
    assert result["sensitivity_speeds"].dims == ("clearance", "mu", "sensitivity_speeds_0", "parameter")
    assert "sensitivity: sensitivity_penetration.hook by clearance, mu" in result.attrs["record"]


def test_a_stopped_sweep_goes_on_and_ends_the_same(result, tmp_path):
    path = tmp_path / "slopes.zarr"

    def stop(seen):
        if seen.n_done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        swept(store=path, progress=stop)
    assert_same(swept(store=path), result)
    with pytest.raises(sj.SceneError, match="store of another sweep: its record"):
        sj.sweep(
            hanging,
            GRID,
            TS,
            record=[*RECORD[:3], sj.studies.Sensitivity(speeds, by=("mu",))],
            store=path,
            progress=False,
        )


class SendingExecutor:
    """Runs what it is given at once; the work has been pickled for it."""

    def submit(self, function, *arguments):
        future: Future = Future()
        future.set_result(function(*arguments))
        return future


def test_executors_make_the_same(result):
    assert_same(swept(executor=SendingExecutor()), result)


@pytest.mark.slow
def test_other_processes_make_the_same(result, monkeypatch):
    tests = str(Path(__file__).parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")]))
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert_same(swept(executor=pool), result)


def assert_same(found, expected):
    for name in expected.data_vars:
        np.testing.assert_array_equal(found[name], expected[name])


@pytest.mark.parametrize(
    ("record", "words"),
    [
        (["sensitivity peak position.bob"], "derivatives are kept of samples, final values"),
        (["sensitivity onsets.hook"], "derivatives are kept of samples, final values"),
        (["sensitivity position.bib"], "one of 'bob'"),
        (["sensitivity position"], "belongs to a body"),
        (
            [sj.studies.Sensitivity("position.bob", by=("mass",))],
            "sensitivities by 'mass': no such parameter; the sweep has",
        ),
        (["sensitivity position.bob", sj.studies.Sensitivity("position.bob")], "twice"),
    ],
)
def test_bad_requests(record, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.sweep(hanging, GRID, TS, record=record, progress=False)


@pytest.mark.slow
def test_a_stiff_method():
    ts, stiffness, h = np.array([0.0, 0.005]), np.array([1e5, 1e6]), 1e-3

    def ends(scale, **options):
        return simulate_many(elastic, {"stiffness": stiffness * scale}, ts, **options)

    runs = ends(1.0, rtol=1e-6, solver=sj.solvers.Ros34PW2(), by=("stiffness",), block=Block(2, 1))
    above, below = (np.asarray(ends(1 + s, rtol=1e-11).trajectories.ys[:, -1, :3]) for s in (h, -h))
    differences = (above - below) / (2 * h * stiffness[:, None])
    sizes = np.max(np.abs(differences), 1)
    assert np.all(np.max(np.abs(runs.slopes.ys[:, 0, -1, :3] - differences), 1) < 1e-3 * sizes)


def test_requests_that_lanes_refuse():
    with pytest.raises(sj.SceneError, match="no such parameter"):
        simulate_many(pendulum, {"gravity": np.ones(2)}, TS, by=("mass",))
    with pytest.raises(sj.SceneError, match="one number for each run"):
        simulate_many(lambda gravity: pendulum(gravity[0]), {"gravity": np.ones((2, 2))}, TS, by=("gravity",))


def test_a_failing_run_has_no_derivatives_and_leaves_the_others_alone():
    h, ts = 1e-4, np.array([0.0, 0.3])
    gravity = np.array([9.81 - h, np.nan, 9.81, 9.81 + h])
    runs = simulate_many(pendulum, {"gravity": gravity}, ts, rtol=1e-10, by=("gravity",), block=Block(2, 1))
    heights, slopes = runs.trajectories.ys[:, -1, 2], np.asarray(runs.slopes.ys[:, 0, -1, 2])
    assert np.isnan(slopes).tolist() == [False, True, False, False]
    assert slopes[2] == pytest.approx(float(heights[3] - heights[0]) / (2 * h), rel=1e-5)
