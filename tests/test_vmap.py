"""`jax.vmap` of runs is a queue of lanes: alone, nested, differentiated, under jit; and equals a loop."""

import controlling
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.lanes.landing import _bend
from spherejax.motion.integration.lanes.stages import own_time
from spherejax.motion.integration.status import Status

TS = jnp.linspace(0.0, 0.03, 4)
"""Through three contacts of the dry four-bar."""

CLEARANCES = jnp.array([7e-5, 1e-4, 1.3e-4])


def scene(clearance, mu=0.1):
    return sj.gallery.four_bar(sj.Dry(clearance=clearance, friction=sj.Threlfall(mu=mu, v1=1e-3)))


def run(clearance, mu=0.1, ts=TS):
    return sj.simulate(scene(clearance, mu), ts, rtol=1e-9)


def height(clearance, mu=0.1):
    return run(clearance, mu).position("rocker")[-1, 2]


def alone(function, *columns):
    return np.stack([np.asarray(function(*numbers)) for numbers in zip(*columns, strict=True)])


def operations(jaxpr) -> list:
    """All operations of a program, those inside others too."""
    found = []
    for eqn in jaxpr.eqns:
        found.append(eqn)
        for value in eqn.params.values():
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                found += operations(inner)
    return found


def queues(function, *arguments) -> list[int]:
    """Numbers of runs of the queues in a program."""
    program = jax.make_jaxpr(function)(*arguments).jaxpr
    return [eqn.outvars[1].aval.shape[0] for eqn in operations(program) if eqn.primitive.name == "runs"]


def test_mapped_runs_are_one_queue_and_equal_a_loop():
    assert queues(jax.vmap(height), CLEARANCES) == [3]
    runs = jax.vmap(run)(CLEARANCES)
    singles = [run(float(c)) for c in CLEARANCES]
    np.testing.assert_allclose(runs.ys, np.stack([one.ys for one in singles]), rtol=0, atol=1e-7)
    positions = jax.vmap(lambda one: one.position("rocker"))(runs)
    np.testing.assert_allclose(positions, np.stack([one.position("rocker") for one in singles]), rtol=0, atol=1e-11)
    np.testing.assert_array_equal(runs.stats.n_onsets, np.stack([one.stats.n_onsets for one in singles]))
    assert np.asarray(runs.stats.n_onsets).sum() >= 3
    np.testing.assert_array_equal(runs.status, Status.SUCCEEDED)
    assert np.all(np.asarray(runs.stats.audit) < 1)
    np.testing.assert_array_equal(runs.t_reached, TS[-1])


def test_nested_maps_are_one_queue():
    mus = jnp.array([0.05, 0.15])

    def grid(cs, mus):
        return jax.vmap(lambda c: jax.vmap(lambda mu: height(c, mu))(mus))(cs)

    assert queues(grid, CLEARANCES, mus) == [6]
    expected = [[height(float(c), float(mu)) for mu in mus] for c in CLEARANCES]
    np.testing.assert_allclose(jax.jit(grid)(CLEARANCES, mus), expected, rtol=0, atol=1e-11)


def test_sample_times_that_differ_are_worked_off_one_after_the_other():
    ts = jnp.stack([TS, TS / 2])
    with pytest.warns(sj.errors.SerialRunsWarning, match="sample times"):
        found = jax.vmap(lambda ts: run(1e-4, ts=ts).position("rocker"))(ts)
    np.testing.assert_allclose(found[0], run(1e-4).position("rocker"), rtol=0, atol=1e-11)
    np.testing.assert_allclose(found[1], run(1e-4, ts=ts[1]).position("rocker"), rtol=0, atol=1e-11)


@pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning")  # pressed beyond what Eq. 24 is for
def test_start_conditions_are_mapped():
    def thrown(speed):
        ball = sj.Body(
            mass=0.2,
            inertia=jnp.full(3, 1e-5),
            velocity=jnp.array([0.0, 0.0, 1.0]) * speed,
            points={"center": jnp.zeros(3)},
        )
        joint = sj.Spherical("ground.socket", "ball.center", sj.Dry(clearance=1e-4), starts_concentric=False)
        scene = sj.Scene({"ball": ball}, {"socket": joint}, ground_points={"socket": (0.0, 0.0, 0.0)})
        return sj.simulate(scene, jnp.linspace(0, 2e-3, 5), rtol=1e-9).position("ball")

    speeds = jnp.array([0.1, 0.4, 0.9])
    assert queues(jax.vmap(thrown), speeds) == [3]
    np.testing.assert_allclose(jax.vmap(thrown)(speeds), alone(thrown, speeds), rtol=0, atol=1e-11)


def test_one_lane_that_cannot_run_is_one_status():
    runs = jax.vmap(run)(jnp.array([1e-4, -1e-4, 2e-4]))
    np.testing.assert_array_equal(runs.status, [Status.SUCCEEDED, Status.BAD_VALUE, Status.SUCCEEDED])
    assert np.isnan(np.asarray(runs.ys[1, 1:])).all()
    assert np.isfinite(np.asarray(runs.ys[jnp.array([0, 2])])).all()


@pytest.mark.slow
def test_derivatives_of_mapped_runs():
    slopes = alone(jax.grad(height), CLEARANCES)
    mapped = jax.vmap(jax.grad(height))
    assert queues(mapped, CLEARANCES) == [3]
    np.testing.assert_allclose(mapped(CLEARANCES), slopes, rtol=1e-6)


@pytest.mark.slow
def test_derivatives_through_a_map():
    slopes = jax.vmap(jax.grad(height))(CLEARANCES)
    total = jax.grad(lambda cs: jnp.sum(jax.vmap(height)(cs)))
    assert queues(total, CLEARANCES) == [3]
    np.testing.assert_allclose(total(CLEARANCES), slopes, rtol=1e-6)
    matrix = jax.jacfwd(jax.vmap(height))(CLEARANCES)
    np.testing.assert_allclose(matrix, np.diag(slopes), rtol=1e-6, atol=1e-12)


def test_a_run_and_its_derivative_are_one_integration():
    def with_slope(c):
        return jax.jvp(height, (c,), (1.0,))

    assert queues(with_slope, 1e-4) == [1]
    value, slope = jax.jit(with_slope)(1e-4)
    assert float(value) == pytest.approx(float(height(1e-4)), abs=1e-11)
    h = 1e-8
    reference = (height(1e-4 + h) - height(1e-4 - h)) / (2 * h)
    assert float(slope) == pytest.approx(float(reference), rel=1e-3)


@pytest.mark.parametrize("bend", [-1.0, -0.4, 0.0, 0.3, 1.0])
def test_a_step_in_a_time_of_its_own_ends_where_it_ends(bend):
    x = jnp.linspace(0.0, 1.0, 11)
    share = (1 - bend) * x + bend * x * x
    np.testing.assert_allclose(own_time(share, jnp.asarray(bend)), x, rtol=0, atol=1e-15)


def test_time_is_bent_by_the_root_of_the_time_since_an_onset():
    # t = (x0 + (x1 - x0) x)^2 from 1 to 4: roots 1 and 2.
    bend = float(_bend(jnp.array(1.0), jnp.array(4.0)))
    x = 0.3
    assert 1 + 3 * ((1 - bend) * x + bend * x * x) == pytest.approx((1 + x) ** 2, rel=1e-15)
    assert float(_bend(jnp.array(0.0), jnp.array(2.0))) == 1.0
    assert float(_bend(jnp.array(jnp.inf), jnp.array(jnp.inf))) == 0.0


def drawn(width, place):
    """A ball that the force of a network moves."""
    network = eqx.nn.MLP(2, "scalar", width, 2, activation=jnp.tanh, key=jax.random.key(1))
    force = controlling.NeuralForce(sj.Network(network))
    ball = sj.Body(1.0, (1.0, 1.0, 1.0), position=jnp.stack([place, 0 * place, 0 * place]))
    return sj.Scene({"ball": ball}, forces={"law": force}, gravity=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(("width", "alone"), [(8, False), (32, True)])
def test_programs_that_are_long_sums(width, alone):
    structure, _ = flatten_system(compile_scene(drawn(width, jnp.asarray(0.5))).system)
    assert program_for(state_rate, structure).scalar.is_of_long_sums is alone


def test_runs_of_a_large_network_are_made_one_by_one():
    """In vectors over runs its sums would take longer than one run's, which are loops over vectors."""
    places, ts = jnp.array([0.3, 0.5, 0.9]), jnp.linspace(0.0, 3.0, 7)

    def of(place):
        return sj.simulate(drawn(32, place), ts, rtol=1e-8)

    def both(place):
        return jax.value_and_grad(lambda place: of(place).position("ball")[-1, 0])(place)

    of_one, of_all = jax.jit(of), jax.jit(jax.vmap(of))(places)
    singles = [of_one(place) for place in places]
    np.testing.assert_allclose(of_all.ys, np.stack([one.ys for one in singles]), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(of_all.stats.n_steps, [one.stats.n_steps for one in singles])
    results, expected = jax.jit(jax.vmap(both))(places), [jax.jit(both)(place) for place in places]
    np.testing.assert_allclose(results, np.transpose(expected), rtol=1e-9)
