"""Derivatives of impacting motions: by every number, through many impacts, to 1e-6 at the default tolerance."""

import bouncing
import cases
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reduction
from bouncing import SCALE, VALUES

import spherejax as sj
from spherejax.motion.derivatives import sensitivities
from spherejax.motion.integration.sensitivity_rows import share_of_own_size

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

    def at(rtol, **options):
        states, push = jax.linearize(lambda x: planar_states(x, jnp.asarray(sample_times), rtol, **options), ZERO)
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


@pytest.mark.parametrize(("rtol", "agreement"), [(1e-6, 3e-4), (1e-8, 1e-6), (1e-11, 2e-7)])
def test_states_by_every_number(jacobian_at, reference_slopes, rtol, agreement):
    _, slopes = jacobian_at(rtol)
    errors = {n: relative(slopes[i, 2, :5], reference_slopes.states[i]).max() for i, n in enumerate(IMPACTS)}
    assert max(errors.values()) < agreement, errors


def test_derivatives_have_a_tolerance_of_their_own(jacobian_at, reference_slopes):
    """Less of it lets more errors in, by the impact; the motion keeps its tolerance."""
    errors, motions = [], []
    for factor in (0.2, 20.0, np.inf):
        states, slopes = jacobian_at(1e-8, derivative_rtol=factor * 1e-8)
        errors.append(max(relative(slopes[i, 2, :5], reference_slopes.states[i]).max() for i in range(len(IMPACTS))))
        motions.append(states[:, 2, :5])
    assert errors[0] < 1e-6
    assert errors[0] < errors[1] < errors[2] < 3e-2
    assert errors[2] > 1e-4
    for motion in motions[1:]:
        np.testing.assert_allclose(motion / SCALE, motions[0] / SCALE, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"derivative_rtol": 0.0}, "derivative_rtol = 0 must be positive"),
        ({"derivative_rtol": np.nan}, "derivative_rtol"),
        ({"derivative_rtol": (1e-6, 1e-6)}, "derivative_rtol"),
        ({"derivative_rtol": 1e-6, "adjoint": diffrax.DirectAdjoint()}, "adjoint of your own"),
        ({"derivative_rtol": 1e-6, "stepsize_controller": diffrax.PIDController(1e-8, 1e-8)}, "controller"),
    ],
)
def test_a_tolerance_of_derivatives_that_cannot_be(options, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.simulate(ball_scene(VALUES), jnp.array([0.0, 1e-3]), **options)


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
    # To the tolerance: one integration makes both, with the steps that the derivatives need. Ten impacts multiply it:
    # with tolerances from 1e-6 to 1e-10 the plain run is off by 300 to 4,500 times its tolerance.
    apart = np.abs(states.reshape(-1, 6) - np.asarray(plain)[1:])[:, :5] / SCALE
    assert apart.max() < 5e-5


def _score(x, ts):
    """A number made of the states at all samples but the start."""
    return jnp.sum(planar_states(x, ts)[1:, :5] / SCALE)


def test_reverse_equals_forward(jacobian_at, sample_times):
    _, slopes = jacobian_at(1e-8)
    forward = np.sum(slopes[:, :, :5] / SCALE[:, None], (0, 1, 2))
    assert np.asarray(jax.grad(_score)(ZERO, jnp.asarray(sample_times))) == pytest.approx(forward, rel=1e-12)


@pytest.mark.slow
def test_vmap_of_a_gradient_equals_a_loop(sample_times):
    ts = jnp.asarray(sample_times)
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


@pytest.mark.slow
def test_a_four_bar_with_friction_by_every_number_of_the_joint():
    """Through 11 impacts, against differences of the event-exact reduction, which are good to about 4e-7."""
    values, h, t_end = {"clearance": 1e-4, "restitution": 0.9, "mu": 0.1}, 1e-4, 0.05

    def rocker_z(x):
        c, restitution, mu = (value * (1 + x[i]) for i, value in enumerate(values.values()))
        normal, friction = sj.LankaraniNikravesh(restitution=restitution), sj.Threlfall(mu=mu, v1=1e-3)
        scene = cases.exact_four_bar(sj.Dry(clearance=c, normal=normal, friction=friction))
        return sj.simulate(scene, cases.times(t_end)).position("rocker")[-1, 2]

    def reference(name, step):
        joint = reduction.DryJoint(**{**values, name: values[name] * (1 + step)})
        return reduction.dry_motion(t_end, joint, rtol=1e-13, atol=1e-17)[0]

    found = jax.jacfwd(rocker_z)(jnp.zeros(len(values)))
    for slope, name in zip(found, values, strict=True):
        low2, low, high, high2 = (reference(name, k * h) for k in (-2, -1, 1, 2))
        assert float(slope) == pytest.approx((low2 - 8 * low + 8 * high - high2) / (12 * h), rel=1e-6)


@pytest.mark.slow
def test_bristles_begin_to_move_at_the_onset():
    """Their sensitivities jump at an onset by their speed times the delay."""
    ts, h, number = jnp.array([0.0, *AFTER.values()]), 5e-4, jnp.eye(len(VALUES))

    def states(x, rtol):
        return planar_states(x, ts, rtol, friction=lambda mu: sj.LuGre(mu_kinetic=mu, mu_static=1.5 * mu))

    _, push = jax.linearize(lambda x: states(x, 1e-9), ZERO)
    slopes = np.stack([push(e) for e in number], -1)[1:, :5]
    plain = jax.jit(states)
    columns = []
    for e in number:
        low2, low, high, high2 = (np.asarray(plain(k * h * e, 1e-12)) for k in (-2, -1, 1, 2))
        columns.append((low2 - 8 * low + 8 * high - high2) / (12 * h))
    expected = np.stack(columns, -1)[1:, :5]
    for found, differences in zip(slopes, expected, strict=True):
        assert relative(found, differences).max() < 1e-5


@pytest.mark.slow
def test_own_solver_and_controller_control_the_sensitivities_too(reference_slopes):
    ts = jnp.array([0.0, *AFTER.values()])
    size = sj.simulate(ball_scene(VALUES), ts[:1]).ys.shape[1]
    controller = diffrax.PIDController(rtol=1e-9, atol=jnp.full(size, 1e-13), pcoeff=0.3, icoeff=0.4)
    options = {"solver": diffrax.Tsit5(), "stepsize_controller": controller}
    _, push = jax.linearize(lambda x: planar_states(x, ts, **options), ZERO)
    slopes = np.stack([push(e) for e in jnp.eye(len(VALUES))], -1)[1:, :5]
    for found, expected in zip(slopes, reference_slopes.states, strict=True):
        assert relative(found, expected).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("solver", [sj.solvers.Rodas5P(), sj.solvers.Ros34PW2()])
def test_stiff_methods_control_the_sensitivities(solver):
    """Of a film, against differences of tight runs by another method."""
    ts, h = jnp.array([0.0, 2e-3, 4e-3]), 1e-4

    def eccentricities(viscosity, rtol=1e-7, solver=solver):
        scene = sj.gallery.four_bar(sj.Lubricated(clearance=1e-4, viscosity=viscosity))
        return sj.simulate(scene, ts, rtol=rtol, solver=solver).eccentricity("coupler_rocker")

    slopes = jax.jacfwd(eccentricities)(0.4)
    low, high = (eccentricities(0.4 * (1 + s), 1e-10, sj.solvers.Rodas5P()) for s in (-h, h))
    differences = (high - low) / (2 * h * 0.4)
    np.testing.assert_allclose(slopes, differences, atol=1e-3 * np.abs(differences).max())


@pytest.mark.slow
def test_a_derivative_that_was_not_reached_is_not_zero():
    """The sensitivities need more steps; where max_steps ends them early, the state that comes with them is NaN too."""
    ts = jnp.array([0.0, *AFTER.values()])
    n_steps = int(sj.simulate(ball_scene(VALUES), ts, atol=1e-12).stats.n_steps)
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        states, slope = jax.jvp(lambda x: planar_states(x, ts, max_steps=n_steps + 5), (ZERO,), (jnp.ones_like(ZERO),))
    assert np.isfinite(states[:-1]).all()
    assert np.isfinite(slope[:-1]).all()
    assert np.any(slope[:-1])
    assert np.isnan(states[-1]).all()
    assert np.isnan(slope[-1]).all()
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        states, slope = jax.jvp(lambda x: planar_states(x, ts, max_steps=20), (ZERO,), (jnp.ones_like(ZERO),))
    assert np.isnan(states[-1]).all()
    assert np.isnan(slope[-1]).all()


@pytest.mark.parametrize(
    "solver", [sj.solvers.Rodas5P(), sj.solvers.Ros34PW2()], ids=["exact matrix", "inexact matrix"]
)
def test_sensitivities_by_a_rosenbrock_method_follow_the_steps_of_the_motion(solver):
    """And are right: each step is differentiated, its matrix included."""
    values, ts = {"stiffness": 1e6, "damping": 1e-2}, np.linspace(0.0, 0.004, 3)

    def build(stiffness, damping):
        return cases.ball_in_socket(sj.Bushing(stiffness, damping), 0.2, (0.0, 0.1, 0.2))

    def swept(numbers, record, rtol, solver=solver):
        return sj.sweep(build, numbers, ts, record=record, rtol=rtol, solver=solver, progress=False)

    one = {name: [value] for name, value in values.items()}
    plain = swept(one, ["final position.ball"], 1e-7)
    found = swept(one, ["sensitivity final position.ball"], 1e-7)
    assert int(found["n_steps"].values.max()) <= 1.1 * int(plain["n_steps"].values.max()) + 2
    slopes = found["sensitivity_final_position.ball"].values.reshape(3, 2)
    for i, (name, value) in enumerate(values.items()):
        h = 1e-4 * value
        ends = swept({**one, name: [value - h, value + h]}, ["final position.ball"], 1e-11, sj.solvers.Rodas5P())
        position = ends["final_position.ball"].values.reshape(2, 3)
        difference = (position[1] - position[0]) / (2 * h)
        np.testing.assert_allclose(slopes[:, i], difference, atol=2e-4 * np.abs(difference).max())


@pytest.mark.parametrize(
    "hessian", [jax.hessian, lambda f: jax.jit(jax.jacfwd(jax.jacfwd(f)))], ids=["hessian", "forward"]
)
def test_second_derivatives_of_what_is_smooth(hessian):
    def place(numbers):
        scene = sj.gallery.simple_pendulum(length=numbers[0], mass=numbers[1])
        return sj.simulate(scene, jnp.linspace(0.0, 0.1, 3), rtol=1e-10).ys[-1, 1]

    at, step = jnp.array([2.0, 1.0]), 1e-3
    gradient = jax.grad(place)
    differences = [(gradient(at + step * e) - gradient(at - step * e)) / (2 * step) for e in jnp.eye(2)]
    np.testing.assert_allclose(hessian(place)(at), jnp.stack(differences), rtol=1e-5, atol=2e-11)


def height_in_a_socket(clearance):
    return sj.simulate(sj.gallery.four_bar(sj.Dry(clearance)), jnp.linspace(0.0, 0.01, 3)).ys[-1, 2]


def height_on_a_stop(stiffness):
    up = (0.0, 0.0, 1.0)
    scene = sj.Scene(
        bodies={"falling": sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 0.01))},
        forces={
            "stop": sj.forces.BumpStop(("ground.floor", "falling"), shortest=0.0, stiffness=stiffness, direction=up)
        },
        ground_points={"floor": (0.0, 0.0, 0.0)},
    )
    return sj.simulate(scene, jnp.linspace(0.0, 0.055, 3)).ys[-1, 2]


def test_second_derivatives_that_would_take_all_memory_are_refused(monkeypatch):
    """Andrews' mechanism has 13,000 operations: its process was killed."""
    monkeypatch.setattr(sensitivities, "MOST_FOR_SECOND", 10)

    def place(length):
        return sj.simulate(sj.gallery.simple_pendulum(length=length), jnp.linspace(0.0, 0.05, 3)).ys[-1, 0]

    with pytest.raises(sj.SceneError, match=r"has \d+ scalar operations take more memory .* differences of jax\.grad"):
        jax.hessian(place)(2.0)
    assert np.isfinite(jax.grad(place)(2.0))


@pytest.mark.parametrize(("height", "at"), [(height_in_a_socket, 1e-4), (height_on_a_stop, 1e4)])
def test_second_derivatives_through_contact_are_refused(height, at):
    """In the socket they would be wrong by percents, on the stop NaN."""
    with pytest.raises(sj.SceneError, match=r"differences of jax\.grad"):
        jax.hessian(height)(at)


def test_a_row_is_judged_by_its_own_largest_part_where_it_is_small():
    rows = jnp.array([[1.0, 0.0], [1e-5, 1e-7], [0.0, 0.0], [3.0, 0.0]])
    share = share_of_own_size(rows, 0.5 * rows, jnp.array([1e-10, 1e-12]), 1e-8)
    # 1e-8 of the largest part over the absolute tolerance, in each row: within 1e-6 and 1.
    np.testing.assert_allclose(share, [1.0, 1e-3, 1e-6, 1.0])
    np.testing.assert_array_equal(share_of_own_size(rows, rows, 0.0, 1e-8), np.ones(4))
    np.testing.assert_array_equal(share_of_own_size(rows, rows, jnp.zeros(2), jnp.full(2, 1e-8)), np.ones(4))
