"""Wide blocks of lanes, as accelerators need them: on the CPU, which can run them as well."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sweeping import pendulum

import spherejax as sj
from spherejax.compiler.emit.llvm import LANES_AT_A_TIME
from spherejax.motion.integration import widths
from spherejax.motion.integration.lanes import Block, lane
from spherejax.motion.integration.status import Status
from spherejax.motion.runs.many import batch_settings, many, simulate_many
from spherejax.motion.settings import RunSettings
from spherejax.studies.sweep.run import LARGEST_SAMPLES, _chunk_size

TS = np.array([0.0, 0.5])


def test_the_block_is_as_wide_as_the_platform_asks_for():
    assert widths.platform_of_runs() == "cpu"
    assert widths.block_for() == widths.block_for("cpu") == Block()
    assert widths.block_for("gpu").width > 100 * widths.block_for("cpu").width
    with jax.default_device(jax.devices("cpu")[0]):
        assert widths.platform_of_runs() == "cpu"


def test_a_block_has_no_lanes_that_idle_from_the_start():
    block = Block()
    widths_of = {1: 1, 8: 8, 23: 23, 24: 24, 25: 16, 32: 16, 33: 24, 48: 24, 49: 24, 250: 24}
    assert {n: block.width_for(n) for n in widths_of} == widths_of
    assert lane.IN_A_GROUP == LANES_AT_A_TIME
    assert Block(2, 1).width_for(5) == 2
    for n_runs in range(1, 200):
        width = block.width_for(n_runs)
        assert -(-n_runs // width) == -(-n_runs // block.width)


def test_a_sweep_takes_the_block_of_its_platform(monkeypatch):
    monkeypatch.setattr(widths, "platform_of_runs", lambda: "gpu")
    grid = {"gravity": np.linspace(1.0, 20.0, 40)}
    found = sj.sweep(pendulum, grid, TS, record=["final position.bob"], workers=1, progress=False)
    assert found.attrs["lanes"].startswith("65536,")
    assert np.all(found["status"] == 0)
    # Let go at rest: never higher than at the start.
    heights = found["final_position.bob"].sel(axis="z")
    assert heights.max() < -np.cos(1.0) + 1e-6
    assert np.unique(heights).size == 40


@pytest.mark.parametrize("block", [Block(), widths.ON_ACCELERATOR])
def test_chunks_are_equal_and_memory_is_bounded(block):
    for n_runs in (1, 999, 100_000, 10_000_000):
        size = _chunk_size(n_runs, 2, block, 5 * 3)
        n_chunks = -(-n_runs // size)
        assert n_chunks * size - n_runs < n_chunks
        assert n_chunks >= min(2, n_runs)
    # Many samples make chunks short, but not shorter than the block is wide.
    n_samples = 3 * 2000
    size = _chunk_size(10_000_000, 2, block, n_samples)
    assert size <= max(LARGEST_SAMPLES / (n_samples * 13 * 8), block.width)


def compiled(width: int, n_runs: int):
    rows = {"gravity": jnp.linspace(1.0, 20.0, n_runs)}
    method = batch_settings(
        pendulum, rows, RunSettings(solver=diffrax.Dopri8(), max_steps=10_000), Block(width, width // 8)
    )

    def ends(rows, is_wanted):
        runs = many(pendulum, method, rows, jnp.asarray(TS), is_wanted)
        return runs.trajectories.ys[:, -1], runs.trajectories.status, runs.lane_efficiency

    arguments = rows, jnp.ones(n_runs, bool)
    return jax.jit(ends).lower(*arguments).compile(), arguments


@pytest.mark.slow
def test_ten_thousand_lanes_run_in_bounded_memory():
    width, n_runs = 10_000, 20_000
    program, arguments = compiled(width, n_runs)
    ys, status, efficiency = program(*arguments)
    assert np.all(status == Status.SUCCEEDED)
    assert efficiency > 0.5
    some = np.array([0, 9_999, 10_000, 19_999])
    alone = simulate_many(pendulum, {"gravity": arguments[0]["gravity"][some]}, TS, solver=diffrax.Dopri8())
    np.testing.assert_allclose(ys[some, :13], alone.trajectories.ys[:, -1, :13], rtol=0, atol=1e-9)
    # A state of 13 numbers, 14 stages of it, what the lane knows, and the results of two runs: 5 kB.
    assert program.memory_analysis().temp_size_in_bytes / width < 15_000
