"""What the tests of `sj.fit` measure: the four-bar with a bushing, and an oscillator whose motion is known exactly."""

import jax.numpy as jnp
import numpy as np

import spherejax as sj

STIFFNESS, DAMPING = 1e5, 1e-3  # [N/m], [s]
NOISE = 1e-6  # [m]
TS = np.linspace(1e-3, 0.5, 500)  # [s]


def bushing_four_bar(stiffness, damping):
    return sj.gallery.four_bar(sj.Bushing(stiffness, damping))


def rocker_motion(stiffness=STIFFNESS, damping=DAMPING, ts=TS) -> np.ndarray:
    """The rocker's z without noise [m]."""
    run = sj.simulate(bushing_four_bar(stiffness, damping), jnp.concatenate([jnp.zeros(1), ts]), rtol=1e-10)
    return np.asarray(run.position("rocker"))[1:, 2]


def measured(motion, noise=NOISE, seed=0, ts=TS) -> dict:
    """What a sensor with white noise would have said."""
    return {"time": ts, "position.rocker.z": motion + noise * np.random.default_rng(seed).normal(size=ts.size)}


# A ball on a spring and a damper ------------------------------------------------------------------------------------

MASS, FREE_LENGTH, OFFSET = 2.0, 1.0, 0.1  # [kg], [m], [m]
SPRING, DAMPER = 200.0, 1.5  # [N/m], [N s/m]
INSTANTS = np.sort(np.random.default_rng(1).uniform(0.02, 2.0, 80))  # [s]
SENSOR = 1e-4  # [m]


def oscillator(stiffness, damping, speed=0.0):
    """A ball beside a wall, `OFFSET` from where the spring rests, with a speed [m/s] away from the wall."""
    start = speed * jnp.array([1.0, 0.0, 0.0])
    position = (FREE_LENGTH + OFFSET, 0.0, 0.0)
    ball = sj.Body(MASS, (1e-3,) * 3, position=position, velocity=start, points={"center": (0.0, 0.0, 0.0)})
    spring = sj.SpringDamper(
        ("ground.wall", "ball.center"), stiffness=stiffness, damping=damping, free_length=FREE_LENGTH
    )
    return sj.Scene(
        {"ball": ball}, {}, forces={"spring": spring}, gravity=(0.0, 0.0, 0.0), ground_points={"wall": (0.0, 0.0, 0.0)}
    )


def oscillation(ts=INSTANTS, stiffness=SPRING, damping=DAMPER, speed=0.0) -> np.ndarray:
    """The ball's distance from the wall, exactly [m]: a damped vibration."""
    decay = damping / (2 * MASS)
    frequency = np.sqrt(stiffness / MASS - decay**2)
    sine = (speed + decay * OFFSET) / frequency
    return FREE_LENGTH + np.exp(-decay * ts) * (OFFSET * np.cos(frequency * ts) + sine * np.sin(frequency * ts))


def seen(seed=0, ts=INSTANTS, noise=SENSOR, **motion) -> dict:
    """The oscillation as a sensor has seen it."""
    values = oscillation(ts, **motion) + noise * np.random.default_rng(seed).normal(size=ts.size)
    return {"time": ts, "position.ball.x": values}


START = {"stiffness": 80.0, "damping": 0.4}
"""Off by a factor of more than two."""
