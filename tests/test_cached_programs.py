"""Compiled programs: found again by what they compute, kept in bounded numbers, and let go."""

import gc
import re
import weakref
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sweeping import pendulum

import spherejax as sj
from spherejax.motion.equations.programs import made_program
from spherejax.motion.integration.one_run import advance_window, before_first_window, integrated
from spherejax.motion.integration.through_diffrax import integrate_through_diffrax
from spherejax.motion.runs.many import many, simulate_many
from spherejax.program_cache import cached_jit, folders
from spherejax.program_cache.fingerprints import program_fingerprint, value_fingerprint
from spherejax.studies.sweep.chunks import _program

PACKAGE = Path(sj.__file__).parent


class Shift:
    """Something static."""

    def __init__(self, by):
        self.by = by


def shifting(n_programs):
    traced = []

    @cached_jit(n_programs=n_programs)
    def shifted(shift, x):
        traced.append(shift.by)
        return {"x": x + shift.by, "by": shift}

    return shifted, traced


def test_programs_are_kept_and_the_oldest_is_let_go():
    shifted, traced = shifting(2)
    shifts = [Shift(by) for by in range(3)]
    x = np.arange(3.0)
    for shift in (shifts[0], shifts[1], shifts[0], shifts[2], shifts[0]):
        found = shifted(shift, x)
        np.testing.assert_array_equal(found["x"], x + shift.by)
        assert found["by"] is shift
    assert traced == [0, 1, 2]
    assert shifted.n_programs == 2
    shifted(shifts[1], x)
    assert traced == [0, 1, 2, 1]
    # Another length is another program.
    shifted(shifts[1], np.arange(4.0))
    assert traced == [0, 1, 2, 1, 1]


def test_what_is_let_go_is_freed():
    shifted, _ = shifting(1)
    first = Shift(1.0)
    shifted(first, np.arange(3.0))
    there = weakref.ref(first)
    del first
    gc.collect()
    assert there() is not None
    shifted(Shift(2.0), np.arange(3.0))
    gc.collect()
    assert there() is None


def test_bounded_programs_are_differentiated_and_mapped():
    shifted, _ = shifting(2)
    shift = Shift(2.0)
    total = lambda x: jnp.sum(shifted(shift, x)["x"] ** 2)  # noqa: E731
    np.testing.assert_allclose(jax.grad(total)(jnp.arange(3.0)), 2 * (np.arange(3.0) + 2))
    np.testing.assert_allclose(jax.vmap(total)(jnp.eye(2)), [13.0, 13.0])
    compiled = shifted.compiled(shift, jnp.arange(3.0))
    np.testing.assert_array_equal(compiled(shift, jnp.ones(3))["x"], [3.0, 3.0, 3.0])


def test_equal_lambdas_share_one_program():
    def swept(share):
        return sj.sweep(
            lambda gravity: pendulum(share * gravity),
            {"gravity": [1.0, 5.0]},
            np.array([0.0, 0.1]),
            record={"height": lambda run: run.position("bob")[-1, 2]},
            workers=1,
            chunk=2,
            progress=False,
        )["height"].values

    _program.clear()
    first = swept(1.0)
    assert _program.n_programs == 1
    np.testing.assert_array_equal(swept(1.0), first)
    assert _program.n_programs == 1
    assert not np.any(swept(0.5) == first)
    assert _program.n_programs == 2


def test_builders_that_close_over_traced_values_are_not_confused():
    def height(share):
        runs = simulate_many(lambda gravity: pendulum(share * gravity), {"gravity": np.ones(2)}, np.array([0.0, 0.1]))
        return runs.trajectories.ys[0, -1, 2]

    first, second = (float(jax.jit(height)(share)) for share in (1.0, 9.0))
    assert first > second + 1e-3
    assert float(height(9.0)) == pytest.approx(second, abs=1e-12)


def falling(gravity):
    """A ball that is let go: after 0.1 s it is gravity/200 below its start."""
    return sj.Scene({"ball": sj.Body(1.0, (1e-3, 1e-3, 1e-3))}, {}, gravity=jnp.stack([0.0, 0.0, -1.0]) * gravity)


def test_runs_within_jit_with_parameters_that_are_known():
    """The builder closes over a traced value; its parameters were made tracers, and no method could be chosen."""

    @jax.jit
    def height(share):
        parameters = {"gravity": np.array([1.0, 2.0])}
        runs = simulate_many(lambda gravity: falling(share * gravity), parameters, np.array([0.0, 0.1]))
        return runs.trajectories.ys[:, -1, 2]

    for share in (1.0, 9.0):
        np.testing.assert_allclose(height(share), [-share / 200, -share / 100], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("is_kept", [False, True])
def test_a_run_leaves_nothing_behind_when_its_program_is_let_go(is_kept, tmp_path, monkeypatch):
    """diffrax keeps a trace of its own of each integration, which held the functions of ours for ever."""
    monkeypatch.setattr(folders, "_in_use", [tmp_path] if is_kept else [])
    scene = pendulum(9.81, 1.0)
    by_diffrax = diffrax.RecursiveCheckpointAdjoint()
    for programs, name, adjoint, lengths, n_programs in (
        (integrated, "integrated", None, (1, 2), 2),
        (advance_window, "advance_window", None, (3, 4), 1),
        (integrate_through_diffrax, "integrate_through_diffrax", by_diffrax, (2, 3), 2),
    ):
        programs.clear()
        gc.collect()
        before, of_loops = _n_traces_of(name), _n_traces_of("diffeqsolve")
        for n in lengths:
            sj.simulate(scene, np.linspace(0.0, 0.01, n), adjoint=adjoint, max_steps=100)
        assert programs.n_programs == n_programs
        assert is_kept or _n_traces_of(name) == before + n_programs
        assert _n_traces_of("diffeqsolve") == of_loops
        programs.clear()
        gc.collect()
        assert _n_traces_of(name) == before


def _n_traces_of(name: str) -> int:
    from jax._src.interpreters import partial_eval

    functions = (key[0]() for key in partial_eval.trace_to_jaxpr.cache_keys())
    # Programs that are kept on disk carry their keys in their names.
    return sum(
        re.fullmatch(f"{name}(_[0-9a-f]+)?", getattr(function, "__name__", "")) is not None for function in functions
    )


def test_every_cache_is_bounded():
    """What compiles goes through `cached_jit`, or hangs on an object that is let go; tables say how long they are."""
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        assert not re.search(r"^[^#`\n]*(@|= )eqx\.filter_jit", text, re.M), path
        assert "maxsize=None" not in text, path
    for cached in (integrate_through_diffrax, integrated, before_first_window, advance_window, many, _program):
        assert cached.n_programs <= 24
    assert made_program.cache_info().maxsize is not None


def test_fingerprints_tell_programs_and_values():
    x = jax.ShapeDtypeStruct((3,), float)
    one = program_fingerprint(lambda x: jnp.where(x > 0, 2 * x, 1.0), x)
    assert one == program_fingerprint(lambda other: jnp.where(other > 0, 2 * other, 1.0), x)
    assert one != program_fingerprint(lambda x: jnp.where(x > 0, 2.0000000000000004 * x, 1.0), x)
    table = np.arange(2000.0)  # too long to be printed
    changed = np.where(table == 1000, 1000.5, table)
    assert program_fingerprint(lambda x: x + table[:3], x) == program_fingerprint(lambda x: x + changed[:3], x)
    assert program_fingerprint(lambda x: jnp.sum(jnp.asarray(table)) + x, x) != program_fingerprint(
        lambda x: jnp.sum(jnp.asarray(changed)) + x, x
    )

    def scaled(factor):
        return lambda t: factor * t

    assert value_fingerprint(scaled(2.0)) == value_fingerprint(scaled(2.0))
    assert value_fingerprint(scaled(2.0)) != value_fingerprint(scaled(3.0))
    assert value_fingerprint({"a": 1, "b": table}) == value_fingerprint({"b": table, "a": 1})
    assert value_fingerprint(table) != value_fingerprint(changed)
