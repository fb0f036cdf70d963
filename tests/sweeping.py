"""Small scenes that are swept in the tests; a module of its own, so that other processes can import it."""

import jax.numpy as jnp

import spherejax as sj


def pendulum(gravity=9.81, tilt=1.0):
    """A bob on a rod of 1 m, turning about the y axis."""
    start = jnp.stack([jnp.sin(tilt), jnp.zeros_like(tilt * 1.0), -jnp.cos(tilt)])
    bob = sj.Body(mass=1.0, inertia=(0.1, 0.1, 0.1), position=start)
    pivot = sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    return sj.Scene({"bob": bob}, {"pivot": pivot}, gravity=jnp.stack([0.0, 0.0, -1.0]) * gravity)


def hanging(clearance=1e-4, mu=0.1):
    """A bob that hangs in a dry joint and is let go to the side."""
    bob = sj.Body(mass=0.1, inertia=(1e-4, 1e-4, 1e-4), position=(0.05, 0.0, 0.0), points={"ball": (-0.05, 0.0, 0.0)})
    joint = sj.Spherical("ground.hook", "bob.ball", sj.Dry(clearance=clearance, friction=sj.Threlfall(mu=mu)))
    return sj.Scene({"bob": bob}, {"hook": joint}, ground_points={"hook": (0.0, 0.0, 0.0)})


def elastic(stiffness=1e5):
    """A bob that hangs in a bushing."""
    bob = sj.Body(mass=0.1, inertia=(1e-4, 1e-4, 1e-4), position=(0.05, 0.0, 0.0), points={"ball": (-0.05, 0.0, 0.0)})
    joint = sj.Spherical("ground.hook", "bob.ball", sj.Bushing(stiffness, 1e-3))
    return sj.Scene({"bob": bob}, {"hook": joint}, ground_points={"hook": (0.0, 0.0, 0.0)})
