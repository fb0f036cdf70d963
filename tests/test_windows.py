"""Runs of numbers, whose samples are written window after window: one program for any number of samples."""

import gc
import os
import re
import signal
import threading
import time
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import FOUR_BAR_MODELS
from controlling import sampled_motor

import spherejax as sj
from spherejax.motion.integration import one_run
from spherejax.motion.integration.lanes import windows
from spherejax.motion.integration.one_run import advance_window, before_first_window, integrated
from spherejax.motion.integration.row_blocks import in_blocks, joined_rows
from spherejax.motion.results import observed as observing
from spherejax.motion.results.observed import looked_up_at, observed
from spherejax.motion.results.steps import COMPARED, _compared
from spherejax.motion.results.steps import repeated_in_steps as repeated
from spherejax.motion.runs import simulate
from spherejax.program_cache import cached_jit

PROGRAMS = (before_first_window, advance_window, integrated, observed, looked_up_at)


def at_once(monkeypatch, make):
    """A run whose program is one for its number of samples."""
    with monkeypatch.context() as patched:
        patched.setattr(one_run, "_are_known", lambda *_: False)
        simulate._call.table.clear()
        run = make()
    simulate._call.table.clear()
    return run


def require_same(run, expected):
    """All that is told of two runs, to rounding: other sizes are compiled to other orders of operations.

    An impact makes 1e-8 of it: what is the last bit of an onset is one of a penetration of 1e-8 m.
    """
    np.testing.assert_allclose(run.ys, expected.ys, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(run.y_reached, expected.y_reached, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(run.t_reached, expected.t_reached, rtol=1e-12)
    assert int(run.ended) == int(expected.ended)
    for count in ("n_steps", "n_accepted", "n_rejected", "n_evaluations", "n_onsets"):
        np.testing.assert_array_equal(getattr(run.stats, count), getattr(expected.stats, count))
    np.testing.assert_allclose(run.stats.audit, expected.stats.audit, rtol=1e-3, atol=1e-9)


@pytest.fixture
def small_windows(monkeypatch):
    """Of seven samples: most steps of a fine run end in one and have samples in the next."""
    monkeypatch.setattr(windows, "WINDOW", 7)
    simulate._call.table.clear()


def test_another_number_of_samples_needs_no_other_program():
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["friction"])
    runs = {}
    for n in (3, 40, 2048, 5001):
        runs[n] = sj.simulate(scene, np.linspace(0.0, 0.02, n))
        runs[n].parts("coupler_rocker")
        if n == 3:
            known = [program.n_programs for program in PROGRAMS]
    assert [program.n_programs for program in PROGRAMS] == known
    for n, run in runs.items():
        assert run.ts.shape == (n,)
        assert run.ys.shape[0] == run.kinetic_energy.shape[0] == run.penetration("coupler_rocker").shape[0] == n
        np.testing.assert_array_equal(run.ys[-1], runs[3].ys[-1])
        np.testing.assert_array_equal(run.kinetic_energy[-1], runs[3].kinetic_energy[-1])
    np.testing.assert_array_equal(runs[5001].ys[::2500], runs[3].ys)


@pytest.mark.parametrize(
    "name", ["friction", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ideal", "lubricated", "bushing"))]
)
def test_windows_change_nothing(name, small_windows, monkeypatch):
    """Many samples in a step, steps over the ends of windows, a last window that is full, and one that is not."""
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS[name])
    for n in (7, 8, 199):

        def made(n=n):
            return sj.simulate(scene, np.linspace(0.0, 0.02, n), track_work=True)

        require_same(made(), at_once(monkeypatch, made))


@pytest.mark.slow
def test_windows_change_nothing_of_what_is_corrected_at_its_samples(small_windows, monkeypatch):
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["dry"], drift=sj.solvers.PostStabilization())

    def made():
        return sj.simulate(scene, np.linspace(0.0, 0.02, 101))

    require_same(made(), at_once(monkeypatch, made))


@pytest.mark.slow
def test_windows_change_nothing_of_forces_that_sample(small_windows, monkeypatch):
    scene = sampled_motor(0.01)

    def made():
        return sj.simulate(scene, np.linspace(0.0, 0.1, 101))

    require_same(made(), at_once(monkeypatch, made))


def test_a_run_that_fails_fails_in_its_window(small_windows, monkeypatch):
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["bushing"])

    def made():
        with pytest.warns(sj.SimulationWarning):
            return sj.simulate(scene, np.linspace(0.0, 0.01, 61), max_steps=30)

    run = made()
    require_same(run, at_once(monkeypatch, made))
    assert run.status == sj.Status.TOO_MANY_STEPS
    reached = np.asarray(run.ts) <= float(run.t_reached)
    assert 7 < reached.sum() < 61
    np.testing.assert_array_equal(np.isfinite(np.asarray(run.ys)).all(axis=1), reached)


@pytest.mark.parametrize("turns", [1, 3, 100])
@pytest.mark.parametrize("name", ["friction", pytest.param("lubricated", marks=pytest.mark.slow)])
def test_a_run_is_the_same_bits_wherever_it_pauses(name, turns, monkeypatch):
    """After each turn (a look at the start, a step, one that is repeated, one with several samples), and seldom."""
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS[name])

    def made():
        simulate._call.table.clear()
        return sj.simulate(scene, np.linspace(0.0, 0.02, 199), track_work=True)

    whole = made()
    n_calls = []

    class Short(windows.WindowPace):
        @property
        def n_turns(self):
            n_calls.append(1)
            return turns

    monkeypatch.setattr(one_run, "_pace", lambda *_: Short())
    run = made()
    assert len(n_calls) >= int(whole.stats.n_steps) // turns
    for found, expected in zip(jax.tree.leaves(run), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_run_that_fails_between_pauses_fails_as_it_would(monkeypatch):
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["bushing"])

    def made():
        simulate._call.table.clear()
        with pytest.warns(sj.SimulationWarning):
            return sj.simulate(scene, np.linspace(0.0, 0.01, 61), max_steps=30)

    whole = made()
    monkeypatch.setattr(windows, "FIRST_TURNS", 4)
    monkeypatch.setattr(windows.WindowPace, "note", lambda *_: None)
    run = made()
    for found, expected in zip(jax.tree.leaves(run), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_calls_are_as_long_as_ctrl_c_may_wait():
    pace = windows.WindowPace()
    assert pace.n_turns == windows.FIRST_TURNS
    pace.note(1000, 5.0)  # it was compiled
    assert pace.n_turns == windows.FIRST_TURNS
    pace.note(1000, 1.0)  # 1 ms each
    assert pace.n_turns == 1000 * windows.HEARD_AFTER
    pace.note(250, 0.0)  # a clock with large ticks
    assert pace.n_turns * windows.SHORTEST_TURN <= 1.01 * windows.HEARD_AFTER
    pace.note(0, 0.1)
    pace.note(10, 100.0)
    assert pace.n_turns == 1


@pytest.mark.usefixtures("hears_interrupts")
def test_ctrl_c_stops_a_long_run_and_says_how_far_it_came(monkeypatch):
    """A pendulum for a day; it was heard when the run had ended."""
    scene, ts = sj.gallery.simple_pendulum(), np.linspace(0.0, 86400.0, 1001)
    one_run._pace.cache_clear()  # nothing is known of the time of a turn
    sj.simulate(scene, ts[:3] / 1000)  # compiled
    simulate._call.table.clear()
    steps = []

    def noted(pace, n_turns, seconds):
        steps.append(n_turns)
        if len(steps) == 3:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(windows.WindowPace, "note", noted)
    with pytest.raises(KeyboardInterrupt) as stop:
        sj.simulate(scene, ts)
    assert steps == [windows.FIRST_TURNS] * 3
    (note,) = stop.value.__notes__
    assert re.fullmatch(r"simulate: stopped at t = [\d.]+ s of 86400 s, after [\d,]+ steps; .*", note)
    assert sj.simulate(scene, ts[:3] / 1000).status == sj.Status.SUCCEEDED


@pytest.mark.slow
@pytest.mark.usefixtures("hears_interrupts")
def test_ctrl_c_is_heard_within_a_second():
    """In the pauses of a run of minutes; the time is of the processor, for a machine may be busy."""
    scene, ts = sj.gallery.simple_pendulum(), np.linspace(0.0, 1e7, 1001)
    sj.simulate(scene, ts[:3] / 1000)
    sent = []

    def send():
        sent.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(2.0, send)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sj.simulate(scene, ts)
    assert time.process_time() - sent[0] < 1.0


def test_a_known_run_is_numbers_where_something_else_is_traced():
    scene = sj.gallery.simple_pendulum()
    ts = np.linspace(0.0, 0.1, 5)
    known = sj.simulate(scene, ts)

    @jax.jit
    def shifted(x):
        run = sj.simulate(scene, ts)
        body = next(iter(run.system.bodies))
        return x + run.ys[-1, 0] + run.position(body)[0, 0] + 0 * run.kinetic_energy[0]

    expected = 1.0 + known.ys[-1, 0] + known.ys[0, 0]
    assert float(shifted(1.0)) == pytest.approx(float(expected), rel=1e-12)
    np.testing.assert_allclose(jax.vmap(shifted)(jnp.ones(2)), expected, rtol=1e-12)


@pytest.mark.parametrize("looks_for", [jax.debug_nans, jax.debug_infs])
def test_runs_go_on_where_jax_looks_for_nan_and_infinity(looks_for):
    scene = sj.gallery.simple_pendulum()
    expected = sj.simulate(scene, np.linspace(0.0, 0.1, 6))
    simulate._call.table.clear()
    with looks_for(True):
        run = sj.simulate(scene, np.linspace(0.0, 0.1, 6))
        np.testing.assert_allclose(run.kinetic_energy, expected.kinetic_energy, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.ys, expected.ys, rtol=1e-9, atol=1e-12)


def test_runs_of_fewer_samples_than_a_block_are_observed_as_those_of_more(monkeypatch):
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["friction"])
    run = sj.simulate(scene, np.linspace(0.0, 0.02, 50))
    expected = jax.tree.map(np.asarray, run.observation)
    monkeypatch.setattr(observing, "BLOCK", 16)
    again = sj.simulate(scene, np.linspace(0.0, 0.02, 50))
    for one, other in zip(jax.tree.leaves(again.observation), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.max(np.abs(other), initial=0))


@pytest.mark.slow
def test_steps_are_told_of_any_number_of_samples_by_one_program():
    scene = sj.gallery.four_bar(FOUR_BAR_MODELS["friction"])
    tables, known = {}, []
    for n in (2, 20, 300):
        tables[n] = sj.simulate(scene, np.linspace(0.0, 0.05, n)).impacts("coupler_rocker")
        known.append(repeated.n_programs)
    assert len(set(known)) == 1
    assert tables[2].sizes["contact"] > 1
    for n in (20, 300):
        for name in ("onset", "peak_force", "energy_lost"):
            np.testing.assert_allclose(tables[n][name], tables[2][name], rtol=1e-4)


@pytest.mark.parametrize("n", [2, 3, 17, COMPARED - 1, COMPARED, COMPARED + 1, 1000, 200_001])
def test_runs_are_compared_at_as_many_instants(n):
    ts = np.sort(np.random.default_rng(n).random(n))
    told, times, places = _compared(ts)
    assert len(times) == COMPARED
    assert np.all(np.diff(times) > 0)
    np.testing.assert_array_equal(times[places], ts[told])
    assert (told[0], told[-1]) == (0, n - 1)
    assert len(np.unique(told)) == min(n, COMPARED)
    assert (times[0], times[-1]) == (ts[0], ts[-1])


# Rows -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 4, 5, 7, 8, 13])
@pytest.mark.parametrize("shared", [0, 1])
def test_rows_are_put_together(n, shared):
    """Parts of four rows; the first ones of later parts are of nobody."""
    whole = {"a": np.arange(26.0).reshape(13, 2), "b": np.arange(13)}

    def parts():
        for first in range(0, max(1, n - shared), 4 - shared):
            rows = np.minimum(np.arange(first, first + 4), 12)
            part = {name: values[rows].copy() for name, values in whole.items()}
            for values in part.values():
                values[: shared if first else 0] = -1
            yield part

    found = joined_rows(parts(), n, shared)
    for name, values in whole.items():
        assert isinstance(found[name], jax.Array)
        np.testing.assert_array_equal(found[name], values[:n])
    assert joined_rows(iter([{"nothing": {}}]), n) == {"nothing": {}}


def test_a_few_rows_do_not_keep_the_part_that_they_are_of():
    part = np.zeros((4096, 8))
    few, many = (joined_rows(iter([part]), n) for n in (5, 4000))
    begin, end = part.ctypes.data, part.ctypes.data + part.nbytes
    assert not begin <= few.unsafe_buffer_pointer() < end
    assert many.shape == (4000, 8)


def test_a_part_is_let_go_before_the_next_one_is_made():
    class Part(np.ndarray):
        """Arrays of NumPy's own cannot be watched."""

    made, alive = [], []

    def parts():
        for _ in range(10):
            gc.collect()
            alive.append(sum(part() is not None for part in made))
            part = np.zeros((4, 2)).view(Part)
            made.append(weakref.ref(part))
            yield part
            del part

    joined_rows(parts(), 40)
    assert alive == [0] * 10


@pytest.mark.parametrize("n", [1, 4, 9])
def test_functions_are_evaluated_in_blocks(n):
    asked = []

    @cached_jit
    def scaled(factor, x, y):
        asked.append(x.shape)
        return {"sum": x + y, "square": factor * jnp.square(x)}

    x, y = np.arange(1.0, n + 1), np.ones(n)
    found = in_blocks(scaled, (jnp.asarray(2.0),), 4, x, y)
    assert asked == [(4,)]  # compiled once
    np.testing.assert_array_equal(found["sum"], x + 1)
    np.testing.assert_array_equal(found["square"], 2 * x**2)
