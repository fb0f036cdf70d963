"""Surfaces that are not round: harmonics of the depth, and joints with them against larger, shifted and own ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

import spherejax as sj
from spherejax.physics.joints.contact import surface_contact
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.laws.depth import grid_of, harmonics

C, R = 1e-4, 1e-2
FRICTION = sj.Threlfall(mu=0.1)
RNG = np.random.default_rng(5)
SOCKET, BALL = 4e-6 * RNG.normal(size=16), 4e-6 * RNG.normal(size=9)
TS = np.linspace(0.0, 0.003, 31)


def scene(model, velocity=(0.3, 0.1, 0.4), spin=(20.0, -50.0, 30.0)):
    """A ball that flies in a socket which is free, too."""
    ball = sj.Body(
        0.2, (1e-5, 2e-5, 3e-5), velocity=velocity, angular_velocity=spin, points={"center": (0, 0, 0)},
        quaternion=(0.8, 0.6, 0.0, 0.0),
    )  # fmt: skip
    cup = sj.Body(0.5, (1e-4, 2e-4, 1e-4), points={"center": (0, 0, 0)}, quaternion=(0.6, 0.0, 0.8, 0.0))
    joint = sj.Spherical("cup.center", "ball.center", model, starts_concentric=False)
    return sj.Scene({"ball": ball, "cup": cup}, {"joint": joint}, gravity=(0, 0, 0))


def dry(clearance=C, **options):
    options = {"socket_radius": R, "normal": sj.LankaraniNikravesh(restitution=0.9), **options}
    return sj.Dry(clearance, **options)


def depths(socket=SOCKET, ball=BALL):
    return {"socket_depth": sj.laws.HarmonicDepth(socket), "ball_depth": sj.laws.HarmonicDepth(ball)}


# Harmonics ------------------------------------------------------------------------------------------------------------


def test_harmonics_are_those_of_scipy():
    u = RNG.normal(size=(50, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    polar, azimuth = np.arccos(u[:, 2]), np.arctan2(u[:, 1], u[:, 0])
    ours = harmonics(u, 12)
    for n in range(13):
        for m in range(n + 1):
            # Without the sign of Condon and Shortley, and with Schmidt's norm.
            y = (-1) ** m * np.sqrt(4 * np.pi / (2 * n + 1)) * sph_harm_y(n, m, polar, azimuth)
            factor = np.sqrt(2) if m else 1.0
            np.testing.assert_allclose(ours[:, n * n + n + m], factor * y.real, atol=1e-13)
            if m:
                np.testing.assert_allclose(ours[:, n * n + n - m], factor * y.imag, atol=1e-13)
    np.testing.assert_allclose(ours[:, 1:4], u[:, [1, 2, 0]], atol=1e-15)


def test_a_depth_and_its_gradient_are_those_of_the_harmonics():
    u, weights = grid_of(5)
    depth = sj.laws.HarmonicDepth(1e-5 * RNG.normal(size=36))
    value, gradient = jax.vmap(depth.depth_and_gradient)(jnp.asarray(u))
    np.testing.assert_allclose(value, harmonics(u, 5) @ depth.coefficients, atol=1e-18)
    assert float(weights @ value) == pytest.approx(float(depth.mean), rel=1e-12, abs=0)
    h = 1e-6
    for axis in np.eye(3):
        ahead, behind = (harmonics(_unit(u + s * h * axis), 5) @ depth.coefficients for s in (1, -1))
        across = gradient - np.sum(gradient * u, axis=1, keepdims=True) * u
        np.testing.assert_allclose(across @ axis, (ahead - behind) / (2 * h), atol=1e-9 * 1e-4)


def _unit(u):
    return u / np.linalg.norm(u, axis=-1, keepdims=True)


def test_a_users_own_depth_has_its_gradient_by_differentiation():
    own = Bump(jnp.asarray(2e-5), jnp.asarray([0.0, 0.6, 0.8]))
    u = jnp.asarray([0.6, 0.0, 0.8])
    value, gradient = own.depth_and_gradient(u)
    np.testing.assert_allclose(gradient, 4.0 * value * own.middle, rtol=1e-14)


class Bump(sj.laws.AbstractDepth):
    """A pocket around a direction."""

    deepest: sj.laws.AbstractDepth
    middle: sj.laws.AbstractDepth

    @property
    def mean(self):
        return self.deepest * (1 - np.exp(-8.0)) / 8.0

    @property
    def least(self):
        return 0.0

    def depth(self, u):
        return self.deepest * jnp.exp(4.0 * (u @ jnp.asarray(self.middle) - 1.0))

    def requirements(self):
        return []


# Joints ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [pytest.param("socket", marks=pytest.mark.slow), "ball"])
def test_a_uniform_depth_is_a_larger_clearance_to_rounding(side):
    more = 2e-5
    radius = R + more if side == "socket" else R
    larger = sj.simulate(scene(dry(C + more, socket_radius=radius, friction=FRICTION)), TS, rtol=1e-9)
    own = {f"{side}_depth": sj.laws.HarmonicDepth([more])}
    deep = sj.simulate(scene(dry(friction=FRICTION, **own)), TS, rtol=1e-9)
    assert larger.stats.n_onsets[0] > 3
    for body in ("ball", "cup"):
        np.testing.assert_allclose(deep.position(body), larger.position(body), atol=1e-12 * C)
        np.testing.assert_allclose(deep.angular_velocity(body), larger.angular_velocity(body), atol=1e-9)
    np.testing.assert_allclose(deep.penetration("joint"), larger.penetration("joint"), atol=1e-11 * C)


def test_three_harmonics_of_the_first_degree_shift_the_socket_to_second_order():
    """|e| - c - a.n against |e - a| - c: they differ by |a x n|^2/2|e|, and their gradients by a.n |a x n|/|e|^2."""
    n, along = _unit(RNG.normal(size=(2, 3)))
    differences = []
    for size in (2e-6, 1e-6):
        a = size * along
        surfaces = dry(socket_depth=sj.laws.HarmonicDepth([0.0, a[1], a[2], a[0]])).surfaces
        e = (C + a @ n + 1e-7) * n
        zero = jnp.zeros(3)
        motion = RelativeMotion(jnp.asarray(e), zero, jnp.eye(3), jnp.zeros(4), zero, zero, jnp.eye(3))
        touch = surface_contact(motion, surfaces)
        shifted = np.linalg.norm(e - a) - C
        assert float(touch.penetration) == pytest.approx(1e-7, rel=1e-9)
        second = np.linalg.norm(np.cross(a, n)) ** 2 / (2 * np.linalg.norm(e))
        assert shifted - float(touch.penetration) == pytest.approx(second, rel=0.05)
        differences.append(np.linalg.norm(np.asarray(touch.normal) - _unit(e - a)))
    assert differences[0] == pytest.approx(4 * differences[1], rel=0.05)


def test_forces_conserve_energy_and_momentum():
    run = sj.simulate(scene(dry(normal=sj.Hertz(stiffness=5e10), **depths())), TS, rtol=1e-10, atol=1e-14)
    energy = np.asarray(run.mechanical_energy)
    assert run.stats.n_onsets[0] > 3
    assert np.ptp(energy) < 1e-8 * energy[0]
    before, after = (_angular_momentum(run, i) for i in (0, -1))
    np.testing.assert_allclose(after, before, atol=1e-9 * np.linalg.norm(before))
    # The contact does turn the bodies, which without friction round surfaces never do.
    assert np.linalg.norm(run.angular_velocity("ball")[-1] - run.angular_velocity("ball")[0]) > 1.0


def _angular_momentum(run, i):
    total = np.zeros(3)
    for name, body in run.system.bodies.items():
        axes = Rotation.from_quat(np.roll(np.asarray(run.quaternion(name)[i]), -1)).as_matrix()
        spin = np.asarray(run.angular_velocity(name)[i])
        total += axes @ (np.asarray(body.inertia) * (axes.T @ spin))
        total += float(body.mass) * np.cross(np.asarray(run.position(name)[i]), np.asarray(run.velocity(name)[i]))
    return total


def _reference(t_end):
    """The same in SciPy: a potential in the poses of both bodies, its forces by differences of it."""
    stiffness, m, J = 5e10, (0.2, 0.5), (np.array([1e-5, 2e-5, 3e-5]), np.array([1e-4, 2e-4, 1e-4]))
    start = [Rotation.from_quat([0.6, 0, 0, 0.8]), Rotation.from_quat([0, 0.8, 0, 0.6])]

    def depth(x, turn):
        n = x / np.linalg.norm(x)
        h = (
            harmonics(turn[1].inv().apply(n)[None], 3)[0] @ SOCKET
            + harmonics(turn[0].inv().apply(n)[None], 2)[0] @ BALL
        )
        return max(0.0, np.linalg.norm(x) - C - h)

    def energy(x, turn):
        return stiffness * depth(x, turn) ** 2.5 / 2.5

    def rate(_, y):
        e = y[0:3] - y[3:6]
        turn = [Rotation.from_quat(y[12:16] / np.linalg.norm(y[12:16])), Rotation.from_quat(y[16:20])]
        spins = y[20:23], y[23:26]
        force, moments, h = np.zeros(3), np.zeros((2, 3)), 1e-10
        if np.linalg.norm(e) > 0.8 * C:
            for k, axis in enumerate(np.eye(3)):
                force[k] = -(energy(e + h * axis, turn) - energy(e - h * axis, turn)) / (2 * h)
                for body in (0, 1):
                    both = []
                    for s in (1e-6, -1e-6):
                        moved = list(turn)
                        moved[body] = Rotation.from_rotvec(s * axis) * turn[body]
                        both.append(energy(e, moved))
                    moments[body, k] = -(both[0] - both[1]) / 2e-6
        out = np.concatenate([y[6:12], force / m[0], -force / m[1]])
        quaternions, accelerations = [], []
        for body in (0, 1):
            # The ball's force acts at its center, the socket's at its own: the rest are the moments.
            w = spins[body]
            axes = turn[body].as_matrix()
            local = axes.T @ w
            moment = axes.T @ (moments[body])
            accelerations.append(axes @ ((moment - np.cross(local, J[body] * local)) / J[body]))
            q = turn[body].as_quat()
            quaternions.append(0.5 * np.concatenate([q[3] * w + np.cross(w, q[:3]), [-w @ q[:3]]]))
        return np.concatenate([out, *quaternions, *accelerations])

    y0 = np.concatenate([np.zeros(6), [0.3, 0.1, 0.4], np.zeros(3), start[0].as_quat(), start[1].as_quat(),
                         [20, -50, 30], np.zeros(3)])  # fmt: skip
    return solve_ivp(rate, (0, t_end), y0, method="DOP853", rtol=1e-9, atol=1e-13, max_step=2e-6).y[:, -1]


@pytest.mark.slow
def test_a_motion_is_that_of_scipy_with_forces_by_differences_of_the_energy():
    t_end = 6e-4
    model = dry(normal=sj.Hertz(stiffness=5e10), **depths())
    run = sj.simulate(scene(model), np.array([0.0, t_end]), rtol=1e-10, atol=1e-14)
    expected = _reference(t_end)
    assert run.stats.n_onsets[0] >= 1
    assert float(run.penetration("joint")[-1]) < 0
    np.testing.assert_allclose(run.position("ball")[-1], expected[0:3], atol=1e-5 * C)
    np.testing.assert_allclose(run.velocity("cup")[-1], expected[9:12], atol=1e-5)
    np.testing.assert_allclose(run.angular_velocity("ball")[-1], expected[20:23], atol=1e-4)
    np.testing.assert_allclose(run.angular_velocity("cup")[-1], expected[23:26], atol=1e-4)


# Derivatives, methods, files ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_derivatives_by_every_number_are_those_of_differences():
    """By both radii, the laws and all coefficients, forward and in reverse, through three impacts."""
    ts = np.array([0.0, 6e-4])

    def end(numbers):
        socket, ball, clearance, stiffness = numbers
        model = sj.Dry(
            clearance, socket_radius=R, normal=sj.HuntCrossley(restitution=0.8, stiffness=stiffness),
            friction=FRICTION, **depths(socket, ball),
        )  # fmt: skip
        run = sj.simulate(scene(model), ts, rtol=1e-11, atol=1e-15)
        return jnp.concatenate([run.position("ball")[-1] / C, run.angular_velocity("cup")[-1]])

    numbers = jnp.asarray(SOCKET[:9]), jnp.asarray(BALL[:4]), C, 5e10
    forward = jax.jacfwd(end)(numbers)
    reverse = jax.grad(lambda x: end(x) @ jnp.arange(1.0, 7.0))(numbers)
    steps = 2e-10, 2e-10, 2e-10, 5e4
    for part, step in enumerate(steps):
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


@pytest.mark.slow
def test_an_implicit_method_moves_alike():
    model = dry(normal=sj.HuntCrossley(restitution=0.8, stiffness=5e10), friction=FRICTION, **depths())
    ts = np.array([0.0, 4e-4])
    explicit = sj.simulate(scene(model), ts, rtol=1e-10, atol=1e-14)
    implicit = sj.simulate(scene(model), ts, rtol=1e-8, atol=1e-13, solver=sj.solvers.Ros34PW2())
    np.testing.assert_allclose(implicit.position("ball")[-1], explicit.position("ball")[-1], atol=1e-3 * C)


def test_what_is_compiled_for_round_surfaces_is_as_without_depths():
    plain, deep = (sj.effects(scene(dry(friction=FRICTION, **d)), timed=False) for d in ({}, depths()))
    assert [row.n_operations for row in deep.rows[:-1]] == [row.n_operations for row in plain.rows]
    assert "surfaces not round (socket HarmonicDepth, ball HarmonicDepth)" in str(deep)
    assert deep.rows[-1].n_operations > plain.rows[-1].n_operations


def test_a_file_has_them(tmp_path):
    path = tmp_path / "deep.toml"
    sj.save_scene(scene(dry(**depths())), path)
    model = sj.load_scene(path).joints["joint"].model
    np.testing.assert_array_equal(model.socket_depth.coefficients, SOCKET)
    assert "[joints.joint.model.socket_depth]" in path.read_text()


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({"socket_depth": sj.laws.HarmonicDepth([1e-5, 0.0])}, "coefficients.*must be 1, 4, 9, 16"),
        ({"socket_depth": sj.laws.HarmonicDepth([np.nan])}, "coefficients.*must be finite"),
        ({"socket_depth": sj.laws.HarmonicDepth(np.zeros(26**2))}, "degree up to 24"),
        ({"ball_depth": sj.laws.HarmonicDepth([0.0, 2 * C, 0.0, 0.0])}, "must be positive everywhere"),
        ({"ball_depth": 1e-5}, "ball_depth"),
    ],
)
def test_bad_depths_are_answered(model, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.simulate(scene(dry(**model)), TS)
