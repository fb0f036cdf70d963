"""Bearings and journals that are not round: against larger and shifted ones, a potential in SciPy, differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spherejax as sj
from spherejax.physics.laws.depth import waves

C, R, STIFFNESS = 1e-4, 1e-2, 1e10
FRICTION = sj.Threlfall(mu=0.1)
RNG = np.random.default_rng(8)
BEARING, JOURNAL = 3e-6 * RNG.normal(size=9), 3e-6 * RNG.normal(size=5)
TS = np.linspace(0.0, 0.004, 21)
TILT = (0.3, 1.0, -0.4)
"""The axis: no axis of the world."""


def scene(model, axis=TILT, place=(0.0, 0.0, 0.0)):
    """A journal that flies in a bearing which is free, too; their bodies are turned against each other."""
    a = np.array(axis) / np.linalg.norm(axis)
    x = np.cross(a, [1.0, 0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(a, x)
    shaft = sj.Body(
        0.2, (1e-6,) * 3, velocity=tuple(0.3 * x + 0.1 * y), angular_velocity=tuple(-40.0 * a), position=place,
        quaternion=(0.8, 0.6, 0.0, 0.0),
    )  # fmt: skip
    bush = sj.Body(0.5, (1e-5,) * 3, quaternion=(0.6, 0.0, 0.8, 0.0), position=place)
    joint = sj.Revolute(("bush", "shaft"), place, axis, model, starts_concentric=False)
    return sj.Scene({"shaft": shaft, "bush": bush}, {"joint": joint}, gravity=(0, 0, 0))


def dry(clearance=C, **options):
    options = {"socket_radius": R, "normal": sj.LankaraniNikravesh(0.9, stiffness=STIFFNESS, exponent=1.5), **options}
    return sj.Dry(clearance, **options)


def elastic(**options):
    return dry(normal=sj.Hertz(stiffness=STIFFNESS, exponent=1.5), **options)


def depths(bearing=BEARING, journal=JOURNAL):
    return {"socket_depth": sj.laws.FourierDepth(bearing), "ball_depth": sj.laws.FourierDepth(journal)}


def test_a_depth_and_its_gradient_are_those_of_cosines_and_sines():
    turn = np.linspace(0.0, 6.0, 23)
    u = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
    depth = sj.laws.FourierDepth(BEARING)
    value, gradient = jax.vmap(depth.depth_and_gradient)(jnp.asarray(u))
    m = np.arange(1, 5)
    expected = BEARING[0] + np.cos(np.outer(turn, m)) @ BEARING[1::2] + np.sin(np.outer(turn, m)) @ BEARING[2::2]
    slope = np.cos(np.outer(turn, m)) @ (m * BEARING[2::2]) - np.sin(np.outer(turn, m)) @ (m * BEARING[1::2])
    np.testing.assert_allclose(value, expected, atol=1e-19)
    np.testing.assert_allclose(waves(u, 4) @ BEARING, expected, atol=1e-19)
    along = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], -1)
    np.testing.assert_allclose(np.sum(np.asarray(gradient) * along, 1), slope, atol=1e-18)
    fine = np.linspace(0, 2 * np.pi, 20001)
    all_around = waves(np.stack([np.cos(fine), np.sin(fine)], -1), 4) @ BEARING
    assert float(depth.least) == pytest.approx(all_around.min(), abs=2e-7)
    assert float(depth.mean) == pytest.approx(all_around[:-1].mean(), rel=1e-12)


@pytest.mark.parametrize("side", ["socket", pytest.param("ball", marks=pytest.mark.slow)])
def test_a_uniform_depth_is_a_larger_clearance_to_rounding(side):
    more = 2e-5
    radius = R + more if side == "socket" else R
    larger = sj.simulate(scene(dry(C + more, socket_radius=radius, friction=FRICTION)), TS, rtol=1e-9)
    own = {f"{side}_depth": sj.laws.FourierDepth([more])}
    deep = sj.simulate(scene(dry(friction=FRICTION, **own)), TS, rtol=1e-9)
    assert larger.stats.n_onsets[0] > 2
    for body in ("shaft", "bush"):
        np.testing.assert_allclose(deep.position(body), larger.position(body), atol=1e-12 * C)
        np.testing.assert_allclose(deep.angular_velocity(body), larger.angular_velocity(body), atol=1e-9)
    np.testing.assert_allclose(deep.penetration("joint"), larger.penetration("joint"), atol=1e-11 * C)


def test_forces_conserve_energy_and_momentum():
    run = sj.simulate(scene(elastic(**depths())), TS, rtol=1e-10, atol=1e-14)
    energy = np.asarray(run.mechanical_energy)
    assert run.stats.n_onsets[0] > 2
    assert np.ptp(energy) < 1e-8 * energy[0]
    before, after = (_momenta(run, i) for i in (0, -1))
    np.testing.assert_allclose(after[0], before[0], atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], atol=1e-9 * np.linalg.norm(before[1]))
    # The contact does turn the bodies, which without friction round surfaces never do.
    assert np.linalg.norm(run.angular_velocity("shaft")[-1] - run.angular_velocity("shaft")[0]) > 0.1


def _momenta(run, i):
    """Both bodies turn alike about all axes."""
    linear, angular = np.zeros(3), np.zeros(3)
    for name, body in run.system.bodies.items():
        p = float(body.mass) * np.asarray(run.velocity(name)[i])
        linear = linear + p
        spin = float(np.asarray(body.inertia).ravel()[0]) * np.asarray(run.angular_velocity(name)[i])
        angular = angular + spin + np.cross(np.asarray(run.position(name)[i]), p)
    return linear, angular


def _reference(t_end):
    """The same in the plane, in SciPy: a potential in the places and angles of both, its forces by differences."""
    masses, inertias = np.array([0.2, 0.5]), np.array([1e-6, 1e-5])

    def wave(angle, a):
        m = np.arange(1, len(a) // 2 + 1)
        return a[0] + np.cos(m * angle) @ a[1::2] + np.sin(m * angle) @ a[2::2]

    def energy(q):
        e = q[0:2] - q[2:4]
        length, angle = np.hypot(*e), np.arctan2(e[1], e[0])
        delta = length - C - wave(angle - q[5], BEARING) - wave(angle - q[4], JOURNAL)
        return STIFFNESS * max(0.0, delta) ** 2.5 / 2.5

    inertia = np.array([masses[0], masses[0], masses[1], masses[1], *inertias])
    steps = np.array([1e-9] * 4 + [1e-6] * 2)

    def rate(_, y):
        q = y[:6]
        force = np.zeros(6)
        if np.hypot(*(q[0:2] - q[2:4])) > 0.6 * C:
            for k in range(6):
                h = np.zeros(6)
                h[k] = steps[k]
                force[k] = -(energy(q + h) - energy(q - h)) / (2 * steps[k])
        return np.concatenate([y[6:], force / inertia])

    y0 = np.concatenate([np.zeros(6), [0.3, 0.1, 0, 0, -40.0, 0.0]])
    return solve_ivp(rate, (0, t_end), y0, method="DOP853", rtol=1e-9, atol=1e-13, max_step=2e-6).y[:, -1]


def test_a_motion_is_that_of_scipy_with_forces_by_differences_of_the_energy():
    """About z, where the joint's x is the world's y and its y is minus the world's x."""
    t_end = 1.5e-3
    about_z = scene(elastic(**depths()), axis=(0, 0, 1.0))
    run = sj.simulate(about_z, np.array([0.0, t_end]), rtol=1e-10, atol=1e-14)
    expected = _reference(t_end)
    assert run.stats.n_onsets[0] >= 2
    for body, at in (("shaft", 0), ("bush", 1)):
        place, velocity = np.asarray(run.position(body)[-1]), np.asarray(run.velocity(body)[-1])
        np.testing.assert_allclose([place[1], -place[0]], expected[2 * at : 2 * at + 2], atol=2e-5 * C)
        np.testing.assert_allclose([velocity[1], -velocity[0]], expected[6 + 2 * at : 8 + 2 * at], atol=2e-5)
        np.testing.assert_allclose(run.angular_velocity(body)[-1], [0, 0, expected[10 + at]], atol=2e-4)


@pytest.mark.slow
def test_derivatives_by_every_number_are_those_of_differences():
    """By both radii's difference, the stiffness and all coefficients, forward and in reverse, through impacts."""
    ts = np.array([0.0, 1.5e-3])

    def end(numbers):
        bearing, journal, clearance, stiffness = numbers
        model = sj.Dry(
            clearance, socket_radius=R, normal=sj.HuntCrossley(0.8, stiffness=stiffness, exponent=1.5),
            friction=FRICTION, **depths(bearing, journal),
        )  # fmt: skip
        run = sj.simulate(scene(model), ts, rtol=1e-11, atol=1e-15)
        return jnp.concatenate([run.position("shaft")[-1] / C, run.angular_velocity("bush")[-1]])

    numbers = jnp.asarray(BEARING), jnp.asarray(JOURNAL), C, STIFFNESS
    forward = jax.jacfwd(end)(numbers)
    reverse = jax.grad(lambda x: end(x) @ jnp.arange(1.0, 7.0))(numbers)
    for part, step in enumerate((2e-10, 2e-10, 2e-10, 1e4)):
        for index in np.ndindex(np.shape(numbers[part])):

            def moved(s, part=part, index=index, step=step):
                changed = list(numbers)
                changed[part] = jnp.asarray(numbers[part]).at[index].add(s * step)
                return np.asarray(end(tuple(changed)))

            difference = (moved(1) - moved(-1)) / (2 * step)
            ours = np.asarray(forward[part])[(slice(None), *index)]
            np.testing.assert_allclose(ours, difference, atol=1e-4 * np.abs(difference).max())
            total = float(ours @ np.arange(1.0, 7.0))
            assert float(np.asarray(reverse[part])[index]) == pytest.approx(total, rel=1e-6, abs=1e-9 * abs(total))


def test_a_bearing_that_is_not_round_serves_a_rim():
    """A rim's journal that nothing tilts moves as one that is held parallel."""

    def both(kind):
        a = np.array(TILT) / np.linalg.norm(TILT)
        shaft = sj.Body(0.2, (3e-5,) * 3, velocity=tuple(0.3 * np.cross(a, [1.0, 0, 0])))
        model = elastic(socket_depth=sj.laws.FourierDepth(BEARING))
        joint = kind(("ground", "shaft"), (0, 0, 0), TILT, model, starts_concentric=False)
        return sj.simulate(sj.Scene({"shaft": shaft}, {"joint": joint}, gravity=(0, 0, 0)), TS, rtol=1e-10, atol=1e-14)

    held, tilts = both(sj.Revolute), both(sj.joints.Rim)
    assert held.stats.n_onsets[0] > 2
    np.testing.assert_allclose(tilts.position("shaft"), held.position("shaft"), atol=1e-6 * C)


def test_what_is_compiled_for_a_round_journal_is_as_without_depths():
    plain, deep = (sj.effects(scene(dry(friction=FRICTION, **d)), timed=False) for d in ({}, depths()))
    assert [row.n_operations for row in deep.rows[:-1]] == [row.n_operations for row in plain.rows]
    assert "surfaces not round (socket FourierDepth, ball FourierDepth)" in str(deep)
    assert deep.rows[-1].n_operations > plain.rows[-1].n_operations


def test_a_file_has_them(tmp_path):
    path = tmp_path / "deep.toml"
    sj.save_scene(scene(dry(**depths())), path)
    model = sj.load_scene(path).joints["joint"].model
    np.testing.assert_array_equal(model.socket_depth.coefficients, BEARING)
    assert "[joints.joint.model.socket_depth]" in path.read_text()


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({"socket_depth": sj.laws.FourierDepth([1e-5, 0.0])}, "coefficients.*must be 1, 3, 5"),
        ({"socket_depth": sj.laws.FourierDepth([np.nan])}, "coefficients.*must be finite"),
        ({"socket_depth": sj.laws.FourierDepth(np.zeros(131))}, "order up to 64"),
        ({"ball_depth": sj.laws.FourierDepth([0.0, 2 * C, 0.0])}, "must be positive everywhere"),
        ({"socket_depth": sj.laws.HarmonicDepth([1e-5])}, "be of a journal in its bearing.*FourierDepth"),
    ],
)
def test_bad_depths_are_answered(model, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.simulate(scene(dry(**model)), TS)


def test_a_ball_and_a_rims_journal_have_no_depth_around_an_axis():
    around = sj.laws.FourierDepth([1e-5])
    ball = sj.Body(1.0, (1e-5,) * 3, points={"center": (0, 0, 0)})
    joint = sj.Spherical("ground.socket", "ball.center", sj.Dry(C, socket_depth=around))
    with pytest.raises(sj.SceneError, match=r"be of a ball in its socket.*HarmonicDepth"):
        sj.simulate(sj.Scene({"ball": ball}, {"joint": joint}, ground_points={"socket": (0, 0, 0)}), TS)
    rim = sj.joints.Rim(("ground", "ball"), (0, 0, 0), (0, 0, 1), dry(ball_depth=around))
    with pytest.raises(sj.SceneError, match="be left out of a rim"):
        sj.simulate(sj.Scene({"ball": ball}, {"rim": rim}), TS)
