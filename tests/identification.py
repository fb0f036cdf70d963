"""Hard cases of identification: what was measured in them, and the rule by which the estimates are judged."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj

BALL = {"clearance": 1e-4, "restitution": 0.8}
DRY = {"clearance": 1e-4, "restitution": 0.6, "mu": 0.1}
FILM = {"viscosity": 0.4}
MOUNT = {"k_x": 2e4, "k_y": 5e4, "k_z": 1e4, "t_x": 40.0, "t_y": 60.0, "t_z": 25.0}
MOTION_NOISE = {"position": 1e-6, "velocity": 1e-4}  # [m], [m/s]
WHEEL_NOISE = {"position": 1e-5, "velocity": 1e-3}

DETERMINED, WITHIN, OTHERWISE = 0.005, 0.02, 3.0
"""Below this best possible standard deviation (relative), within this of the truth; otherwise so many times it."""


def assert_identified(fitted: sj.studies.Fit, truth: dict) -> None:
    """The rule of this project for estimates."""
    for name, true in truth.items():
        error = np.abs(np.asarray(fitted.estimates[name]) - true)
        best = np.asarray(fitted.best_possible[name])
        allowed = np.where(best < DETERMINED * np.abs(true), WITHIN * np.abs(true), OTHERWISE * best)
        assert np.all(error <= allowed), (name, fitted.estimates[name], true, best)


def relative_best(fitted: sj.studies.Fit, truth: dict) -> np.ndarray:
    """Best possible standard deviations as shares of the true values."""
    return np.concatenate([np.ravel(fitted.best_possible[name] / np.abs(true)) for name, true in truth.items()])


def measured(scene, body, ts, noise, seed=0, components="", rtol=1e-9, **options) -> sj.Measured:
    """Position and velocity of a body with white noise; of one component, if it is named."""
    run = sj.simulate(scene, np.concatenate([[0.0], ts]), rtol=rtol, **options)
    random = np.random.default_rng(seed)
    values, noises = {}, {}
    for kind, motion in (("position", run.position(body)), ("velocity", run.velocity(body))):
        true = np.asarray(motion)[1:]
        name, true = (f"{kind}.{body}.{components}", true[:, 2]) if components else (f"{kind}.{body}", true)
        values[name], noises[name] = true + noise[kind] * random.normal(size=true.shape), noise[kind]
    return sj.Measured(ts, values, noise=noises)


def dry(clearance, restitution, mu) -> sj.Dry:
    normal = sj.LankaraniNikravesh(restitution=restitution)
    return sj.Dry(clearance=clearance, normal=normal, friction=sj.Threlfall(mu=mu, v1=1e-3))


def ball_in_socket(clearance, restitution) -> sj.Scene:
    """A ball that bounces in its socket without gravity and friction."""
    ball = sj.Body(
        0.05, (2e-6,) * 3, position=(0.0, 3e-5, 0.0), velocity=(0.3, 0.0, 0.0), points={"center": (0.0, 0.0, 0.0)}
    )
    model = sj.Dry(clearance=clearance, normal=sj.LankaraniNikravesh(restitution=restitution))
    joint = sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)
    socket = {"socket": (0.0, 0.0, 0.0)}
    return sj.Scene({"ball": ball}, {"joint": joint}, gravity=(0.0, 0.0, 0.0), ground_points=socket)


def dry_four_bar(clearance, restitution, mu) -> sj.Scene:
    return sj.gallery.four_bar(dry(clearance, restitution, mu))


def lubricated_four_bar(viscosity) -> sj.Scene:
    return sj.gallery.four_bar(sj.Lubricated(clearance=2e-4, viscosity=viscosity))


def mount(velocity, angular_velocity):
    """A block on a rubber mount with six stiffnesses, thrown off its rest: a builder."""

    def build(k_x, k_y, k_z, t_x, t_y, t_z):
        K, K_r = (jnp.diag(jnp.stack(each)) for each in ((k_x, k_y, k_z), (t_x, t_y, t_z)))
        law = sj.laws.MatrixElastomer(K, 1e-3 * K, K_r, 1e-3 * K_r)
        place = {"mount": (0.03, 0.02, -0.04)}
        block = sj.Body(2.0, (4e-3, 6e-3, 5e-3), velocity=velocity, angular_velocity=angular_velocity, points=place)
        joint = sj.Spherical("ground.mount", "block.mount", sj.Bushing(law=law), starts_concentric=False)
        return sj.Scene({"block": block}, {"mount": joint}, ground_points=place)

    return build


LENGTH, TRAVEL, RATE = 0.40, 0.05, 0.20  # [m], [m], [m/s]

SHOCK = {
    "spring": np.polynomial.Polynomial([-4.0092e6, 2.8397e7, -6.7061e7, 5.2796e7])(
        np.polynomial.Polynomial([LENGTH, TRAVEL])
    ).coef,
    "damper": np.array([9945.627, 33955.72, -59832.25, -395651.0]) * RATE ** np.arange(1, 5),
}
"""Coefficients of the suspension's shock absorber [N] (Eqs 42 and 43): tension of the spring in powers of
(length - 0.40 m) / 0.05 m, of the damper in powers of rate / 0.2 m/s. Of size one in powers of metres they would be
the same polynomials, but nobody could read their standard deviations."""


def shock_absorber(spring, damper) -> sj.SpringDamper:
    """Beyond -0.20 and 0.21 m/s the damper goes on along its tangent, as the paper's does."""
    along = sj.functions.Polynomial(jnp.concatenate([jnp.zeros(1), damper / RATE ** np.arange(1, 5)]))

    def tangent(rate):
        tension, slope = jax.jvp(along, (jnp.asarray(rate),), (1.0,))
        return sj.functions.Linear(slope, tension - slope * rate)

    return sj.SpringDamper(
        ("ground.shock", "a_arm.shock"),
        spring=sj.functions.Polynomial(spring / TRAVEL ** np.arange(4), center=LENGTH),
        damper=sj.functions.Piecewise([-0.20, 0.21], [tangent(-0.20), along, tangent(0.21)]),
    )


def suspension_over_a_bump(spring, damper) -> sj.Scene:
    """At 20 m/s over a bump of 10 cm, which the wheel meets after 0.1 s."""
    scene = sj.gallery.suspension(speed=20.0)
    road = sj.functions.Bump(height=0.1, start=2.0, length=10.0)
    tyre = sj.forces.Tyre("wheel", radius=0.36325, stiffness=460e3, road=road, speed=20.0)
    forces = {**scene.forces, "shock": shock_absorber(spring, damper), "tyre": tyre}
    return eqx.tree_at(lambda s: s.forces, scene, forces)
