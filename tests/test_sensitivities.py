"""Derivatives of impacting motions: by every number, through many impacts, to 1e-6 at the default tolerance."""

import bouncing
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bouncing import SCALE, VALUES

import spherejax as sj
from spherejax.motion.sensitivities import has_controlled_sensitivities

IMPACTS = (1, 2, 10)
AFTER = {1: 0.0040, 2: 0.0085, 10: 0.0600}
"""Times in flight after so many impacts [s]; no onset or release is near."""
CONTACT_SAMPLE = 3e-5  # [s] after an onset: in the middle of a contact


def ball_scene(values, offset=bouncing.OFFSET, friction=None) -> sj.Scene:
    c, restitution, modulus, mass, speed, radius, mu = values
    steel = sj.Material(modulus, bouncing.POISSON)
    model = sj.Dry(
        clearance=c,
        socket_radius=radius,
        normal=sj.LankaraniNikravesh(restitution=restitution),
        friction=sj.Threlfall(mu=mu, v1=bouncing.V1) if friction is None else friction(mu),
        ball_material=steel,
        socket_material=steel,
    )
    ball = sj.Body(
        mass,
        (bouncing.INERTIA,) * 3,
        position=(0.0, offset, 0.0),
        velocity=speed * jnp.array([1.0, 0.0, 0.0]),
        points={"center": (0.0, 0.0, 0.0)},
    )
    return sj.Scene(
        {"ball": ball},
        {"joint": sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


def planar_states(x, ts, rtol=1e-8, **options):
    """(x, y, x_rate, y_rate, spin, onset rate) at the sample times, for the numbers `VALUES` (1 + x)."""
    scene = {name: options.pop(name) for name in ("offset", "friction") if name in options}
    run = sj.simulate(ball_scene(VALUES * (1 + x), **scene), ts, rtol=rtol, atol=rtol * 1e-4, **options)
    plane = run.position("ball")[:, :2], run.velocity("ball")[:, :2], run.angular_velocity("ball")[:, 2:]
    return jnp.concatenate([*plane, run.state.memory[:, :1]], 1)


ZERO = jnp.zeros(len(VALUES))


@pytest.fixture(scope="module")
def reference():
    return bouncing.bounces(VALUES, list(AFTER.values()))


@pytest.fixture(scope="module")
def reference_slopes():
    return bouncing.slopes(list(AFTER.values()), 3e-4)


@pytest.fixture(scope="module")
def sample_times(reference):
    """For each of `IMPACTS`: its onset, an instant in the contact, and one in the flight behind it; 0 in front."""
    onsets = reference.onset_times[np.array(IMPACTS) - 1]
    return np.concatenate([[0.0], np.stack([onsets, onsets + CONTACT_SAMPLE, list(AFTER.values())], 1).ravel()])


@pytest.fixture(scope="module")
def jacobian_at(sample_times):
    """States and their derivatives, shapes (impacts, instants, 6) and (impacts, instants, 6, numbers), at a tolerance.

    Not under `jax.jit`: the tests then share the compiled parts.
    """

    def at(rtol):
        states, push = jax.linearize(lambda x: planar_states(x, jnp.asarray(sample_times), rtol), ZERO)
        slopes = np.stack([push(e) for e in jnp.eye(len(VALUES))], -1)
        shape = (len(IMPACTS), 3, 6)
        return np.asarray(states)[1:].reshape(shape), slopes[1:].reshape(*shape, -1)

    return at


def relative(found, expected):
    """Largest error by number, relative to the number's largest effect; states are measured by `SCALE`."""
    scale = SCALE[:, None]
    return np.max(np.abs(found - expected) / scale, 0) / np.max(np.abs(expected) / scale, 0)


def test_the_reference_knows_its_derivatives(reference, reference_slopes):
    assert len(reference.onset_times) == 10
    coarse = bouncing.slopes(list(AFTER.values()), 1e-3)
    for i in range(len(IMPACTS)):
        assert relative(coarse.states[i], reference_slopes.states[i]).max() < 2e-7
    assert coarse.onset_times == pytest.approx(reference_slopes.onset_times, abs=2e-7 * 0.06)
    assert coarse.onset_rates == pytest.approx(reference_slopes.onset_rates, abs=2e-7 * 0.05)


@pytest.mark.parametrize(("rtol", "agreement"), [(1e-6, 1e-4), (1e-8, 1e-6), (1e-11, 2e-7)])
def test_states_by_every_number(jacobian_at, reference_slopes, rtol, agreement):
    _, slopes = jacobian_at(rtol)
    errors = {n: relative(slopes[i, 2, :5], reference_slopes.states[i]).max() for i, n in enumerate(IMPACTS)}
    assert max(errors.values()) < agreement, errors


def test_times_and_rates_of_impacts_by_every_number(jacobian_at, reference, reference_slopes):
    states, slopes = jacobian_at(1e-8)
    for i, n in enumerate(IMPACTS):
        position, velocity, by = states[i, 0, :2], states[i, 0, 2:4], slopes[i, 0, :2]
        normal = position / np.linalg.norm(position)
        by_penetration = normal @ by - VALUES[0] * np.eye(len(VALUES))[0]
        by_time = -by_penetration / (normal @ velocity)
        expected = reference_slopes.onset_times[n - 1]
        assert by_time == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
        # The onset rate is remembered during the contact.
        assert states[i, 1, 5] == pytest.approx(reference.onset_rates[n - 1], rel=1e-7)
        expected = reference_slopes.onset_rates[n - 1]
        assert slopes[i, 1, 5] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_the_outcome_is_that_of_the_plain_run(jacobian_at, sample_times):
    states, _ = jacobian_at(1e-8)
    plain = jax.jit(planar_states, static_argnames="rtol")(ZERO, jnp.asarray(sample_times), 1e-8)
    assert states.reshape(-1, 6) == pytest.approx(np.asarray(plain)[1:], rel=1e-9, abs=1e-13)


def _score(x, ts):
    """A number made of the states at all samples but the start."""
    return jnp.sum(planar_states(x, ts)[1:, :5] / SCALE)


def test_reverse_equals_forward_and_vmap_equals_loop(jacobian_at, sample_times):
    ts = jnp.asarray(sample_times)
    _, slopes = jacobian_at(1e-8)
    forward = np.sum(slopes[:, :, :5] / SCALE[:, None], (0, 1, 2))
    assert np.asarray(jax.grad(_score)(ZERO, ts)) == pytest.approx(forward, rel=1e-12)
    lanes = 1e-3 * np.random.default_rng(0).standard_normal((2, len(VALUES)))
    batched = np.asarray(jax.vmap(jax.grad(_score), (0, None))(lanes, ts))
    looped = np.stack([jax.grad(_score)(lane, ts) for lane in lanes])
    assert np.ptp(looped, 0).max() > 1e-3
    assert batched == pytest.approx(looped, abs=1e-7 * np.abs(looped).max())


@pytest.mark.parametrize("gap", [1e-6, 1e-10, 1e-13, 0.0])
def test_grazing_onset_has_finite_derivatives(gap, sample_times):
    """The ball starts near the surface (gap / clearance) and flies along it: the onset is ever slower."""
    states, push = jax.linearize(
        lambda x: planar_states(x, jnp.asarray(sample_times), offset=VALUES[0] * (1 - gap)), ZERO
    )
    assert np.isfinite(states).all()
    assert np.all([np.isfinite(push(e)).all() for e in jnp.eye(len(VALUES))])


def test_explicit_methods_control_the_sensitivities():
    assert has_controlled_sensitivities(diffrax.Dopri8())
    assert not has_controlled_sensitivities(sj.Rodas5P())
    assert not has_controlled_sensitivities(diffrax.Kvaerno5())
