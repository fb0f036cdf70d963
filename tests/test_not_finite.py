"""A number that is not finite ends a run with a status of its own, on every road, and its part is named.

No run succeeds with a sample that is NaN, or short of its end.
"""

import re
import warnings
from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax import Status

TS = np.linspace(0.0, 1.0, 5)
FEW: dict[str, Any] = {"max_steps": 2_000}
ROADS: dict[str, dict[str, Any]] = {
    "lane": {},
    "two samples": {"ts": TS[[0, -1]]},
    "many windows": {"ts": np.linspace(0.0, 1.0, 5_000)},
    "array code": {"scalar": False},
    "Rosenbrock": {"solver": sj.solvers.Rodas5P()},
    "diffrax": {"solver": diffrax.Kvaerno5()},
    "adjoint": {"adjoint": diffrax.RecursiveCheckpointAdjoint()},
    "controller": {"stepsize_controller": diffrax.PIDController(rtol=1e-6, atol=1e-8)},
}
SLOW = {"array code", "diffrax", "adjoint", "controller"}
"""Roads whose programs take long to compile: the fast tests have one of them."""


@pytest.fixture(autouse=True)
def quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.SimulationWarning)
        yield


class Late(sj.forces.AbstractForce):
    """A force that is not a number from t = `last` on."""

    last: float

    @property
    def body_names(self):
        return ("ball",)

    def wrenches(self, t, motions):
        return {"ball": sj.forces.Wrench(jnp.array([jnp.where(t > self.last, jnp.nan, 1.0), 0.0, 0.0]), jnp.zeros(3))}


def ball():
    return sj.Body(mass=1.0, inertia=(1e-3, 1e-3, 1e-3), points={"end": (0.0, 0.0, 0.0)})


def driven(function):
    return sj.Scene({"ball": ball()}, {"hand": sj.joints.PositionDriver("ball.end", function)}, gravity=(0, 0, 0))


def pushed(function):
    return sj.Scene({"ball": ball()}, forces={"push": sj.AppliedWrench("ball", force=function)}, gravity=(0, 0, 0))


def late(last):
    return sj.Scene({"ball": ball()}, forces={"push": Late(last)}, gravity=(0, 0, 0))


def by_root(t):
    return jnp.array([jnp.sqrt(t), 0.0, 0.0])


def by_norm(t):
    return jnp.array([jnp.linalg.norm(jnp.array([t, t])), 0.0, 0.0])


def of(run):
    """What a run says: it has failed honestly, and its samples are finite up to the time that it reached."""
    positions = np.asarray(run.position("ball"))
    assert not np.isinf(positions).any()
    if run.status == Status.SUCCEEDED:
        assert run.t_reached == run.ts[-1]
        assert np.isfinite(positions).all()
    return run


def simulated(scene, **how):
    return of(sj.simulate(scene, how.pop("ts", TS), **{**FEW, **how}))


def roads(fast=""):
    return [
        pytest.param(ROADS[name], id=name, marks=[pytest.mark.slow] if name in SLOW - {fast} else []) for name in ROADS
    ]


@pytest.mark.parametrize("how", roads())
def test_driver_whose_derivative_is_infinite_at_the_start(how):
    fails_by_its_driver(by_norm, **how)


def test_driver_by_a_root_at_zero_is_refused_or_fails():
    """Its values rise so fast behind the start that they may count as a jump, which is refused; never in silence."""
    with pytest.raises((sj.SceneError, sj.SimulationError), match="driver 'hand'"):
        simulated(driven(by_root), throw=True)
    assert jax.jit(lambda ts: sj.simulate(driven(by_root), ts))(TS).status in (Status.NOT_FINITE, Status.BAD_VALUE)


def fails_by_its_driver(function, **how):
    run = simulated(driven(function), **how)
    assert run.status == Status.NOT_FINITE
    assert run.t_reached == 0.0
    assert "driver 'hand'" in run.diagnosis
    assert "t = 0 s" in run.diagnosis
    with pytest.raises(sj.SimulationError, match="driver 'hand'"):
        simulated(driven(function), throw=True, **how)


FORCES = {
    "NaN": lambda t: jnp.array([jnp.nan * t, 0.0, 0.0]),
    "infinite": lambda t: jnp.array([jnp.inf + t, 0.0, 0.0]),
    "pole": lambda t: jnp.array([1.0 / t, 0.0, 0.0]),
    "NaN behind the start": lambda t: jnp.array([jnp.where(t > 0.0, jnp.nan, 0.0), 0.0, 0.0]),
}


@pytest.mark.parametrize("name", list(FORCES))
def test_force_that_is_not_finite_at_the_start(name):
    fails_at_the_start(FORCES[name])


@pytest.mark.parametrize("how", roads())
def test_force_that_is_not_finite_at_the_start_on_every_road(how):
    fails_at_the_start(FORCES["pole"], **how)


def fails_at_the_start(force, **how):
    """Was: 20,000,000 steps, and the advice to raise max_steps."""
    run = simulated(pushed(force), **how)
    assert run.status == Status.NOT_FINITE
    assert run.stats.n_steps <= 200
    assert run.t_reached < 1e-6
    assert "force element 'push'" in run.diagnosis


@pytest.mark.parametrize("how", roads("adjoint"))
def test_force_that_ceases_to_be_finite(how):
    run = simulated(late(0.4), **how)
    assert run.status == Status.NOT_FINITE
    assert float(run.t_reached) == pytest.approx(0.4, abs=1e-9)
    assert "force element 'push'" in run.diagnosis
    assert "t = 0.4 s" in run.diagnosis
    reached = run.ts <= run.t_reached - 0.02
    assert np.asarray(run.position("ball"))[reached, 0] == pytest.approx(np.asarray(run.ts)[reached] ** 2 / 2, abs=1e-7)


def test_law_that_ceases_to_be_finite_where_the_motion_comes():
    run = simulated(pushed(lambda t, motions: jnp.array([1 + jnp.sqrt(0.1 - motions["ball"].position[0]), 0.0, 0.0])))
    assert run.status == Status.NOT_FINITE
    assert "force element 'push'" in run.diagnosis


def test_force_without_bound_is_named():
    run = simulated(pushed(lambda t: jnp.array([1.0 / (t - 0.4), 0.0, 0.0])))
    assert run.status == Status.STEP_TOO_SMALL
    assert "force element 'push' has grown" in run.diagnosis


def test_driver_that_is_not_finite_at_the_start_is_refused_by_name():
    with pytest.raises(sj.SceneError, match=r"driver 'hand'.*inf.*t = 0 s"):
        sj.simulate(driven(lambda t: jnp.array([1.0 / t, 0.0, 0.0])), TS)
    run = jax.jit(lambda ts: sj.simulate(driven(lambda t: jnp.array([1.0 / t, 0.0, 0.0])), ts))(TS)
    assert of(run).status == Status.NOT_FINITE


# Under transformations ------------------------------------------------------------------------------------------------

LAST = jnp.array([0.3, 5.0, -1.0])
ENDED = [Status.NOT_FINITE, Status.SUCCEEDED, Status.NOT_FINITE]


def end(last, **how):
    return sj.simulate(late(last), TS, **how).position("ball")[-1, 0]


def test_under_jit_and_vmap():
    assert of(jax.jit(lambda ts: sj.simulate(driven(by_norm), ts))(TS)).status == Status.NOT_FINITE
    runs = jax.vmap(lambda last: sj.simulate(late(last), TS))(LAST)
    assert np.asarray(runs.status).tolist() == ENDED
    assert np.asarray(runs.t_reached) == pytest.approx([0.3, 1.0, 0.0], abs=1e-9)
    assert "lane 0: stopped at t = 0.3 s" in runs.diagnosis
    assert "lane 2: stopped at t = 0 s" in runs.diagnosis
    assert runs.diagnosis.count("force element 'push'") == 2
    assert np.isfinite(np.asarray(runs.position("ball"))).all(axis=(1, 2)).tolist() == [False, True, False]


@pytest.mark.slow
def test_many_runs_and_sweeps():
    many = sj.simulate_many(late, {"last": LAST}, TS).trajectories
    assert np.asarray(many.status).tolist() == ENDED
    swept = sj.sweep(late, {"last": np.asarray(LAST)}, jnp.asarray(TS), record=["final position.ball"])
    assert swept.status.values.tolist() == ENDED
    assert np.isfinite(swept["final_position.ball"].values[:, 0]).tolist() == [False, True, False]


def failing(transformed, *arguments):
    """A failure that a program raises while it runs: its last line says when, why and what to do."""
    with pytest.raises((RuntimeError, jax.errors.JaxRuntimeError)) as raised:
        jax.block_until_ready(transformed(*arguments))
    last = str(raised.value).strip().splitlines()[-1]
    assert re.fullmatch(
        r"(SimulationError: )?a simulation stopped at t = \S+ s of \S+ s: a number of the motion.*", last
    )


def test_throw_raises_under_jit():
    failing(jax.jit(partial(end, throw=True)), jnp.asarray(0.3))


@pytest.mark.slow
def test_throw_raises_under_transformations():
    """Also where only a derivative is asked for, which JAX frees from checks that only the value depends on."""
    thrown = partial(end, throw=True)
    failing(eqx.filter_jit(thrown), jnp.asarray(0.3))
    failing(jax.vmap(thrown), LAST)
    failing(jax.jit(jax.grad(thrown)), jnp.asarray(0.3))
    failing(jax.jit(jax.vmap(jax.jacfwd(thrown))), LAST)
    assert float(jax.jit(jax.grad(thrown))(jnp.asarray(5.0))) == pytest.approx(0.0, abs=1e-12)


# Sample times ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [{}, {"solver": diffrax.Kvaerno5()}], ids=["lane", "diffrax"])
@pytest.mark.parametrize("ts", [TS[::-1], [0.0, 0.5, np.nan, 1.0], [0.0, 0.5, 0.4, 1.0], [0.5, 1.0, 0.2, 0.5]])
def test_traced_times_that_do_not_increase(ts, how):
    """Was: the start as all samples, of times that go back."""
    run = jax.jit(lambda ts: sj.simulate(late(5.0), ts, **FEW, **how))(jnp.asarray(ts))
    assert run.status == Status.BAD_VALUE
    assert "sample times" in run.diagnosis
    assert np.isnan(np.asarray(run.position("ball"))[1:]).all()
    with pytest.raises((RuntimeError, jax.errors.JaxRuntimeError)):
        jax.block_until_ready(
            jax.jit(lambda ts: sj.simulate(late(5.0), ts, throw=True, **FEW, **how))(jnp.asarray(ts)).ys
        )


def test_times_that_are_one_and_repeated_times():
    simulate = jax.jit(lambda ts: sj.simulate(late(5.0), ts))
    for ts in ([0.5], [0.5, 0.5], [0.0, 0.0, 0.5, 0.5, 1.0]):
        run = of(simulate(jnp.asarray(ts)))
        assert run.status == Status.SUCCEEDED
        assert np.asarray(run.position("ball"))[:, 0] == pytest.approx((np.array(ts) - ts[0]) ** 2 / 2, abs=1e-9)
    assert simulate(jnp.asarray([np.nan])).status == Status.BAD_VALUE
