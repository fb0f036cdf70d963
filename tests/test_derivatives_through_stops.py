"""Derivatives through stops whose stiffness is there at once: the rates of the derivatives jump where they touch.

A ball between linear stops has a closed form: it flies, and is in contact for pi / omega.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

NEAR, FAR = 0.32, -0.1
"""Where the ball touches the two stops [m]."""


def ball_scene(stiffness, start=0.0, speed=1.0, mass=1.0) -> sj.Scene:
    """A ball that flies along x between two stops, without gravity."""
    ball = sj.Body(mass, (1e-3,) * 3, position=(start, 0.0, 0.0), velocity=(speed, 0.0, 0.0))
    return sj.Scene(
        {"ball": ball},
        forces={
            "near": sj.BumpStop(("ball", "ground.near"), shortest=0.2, stiffness=stiffness),
            "far": sj.BumpStop(("ball", "ground.far"), shortest=0.2, stiffness=stiffness),
        },
        gravity=(0.0, 0.0, 0.0),
        ground_points={"near": (NEAR + 0.2, 0.0, 0.0), "far": (FAR - 0.2, 0.0, 0.0)},
    )


def exact(stiffness, start, speed, mass, t):
    """Position and velocity at time t: in flight and in contact by turns."""
    omega = jnp.sqrt(stiffness / mass)
    begin, place, wall, way = 0.0, start, NEAR, 1.0
    answer = jnp.stack([start, speed])
    for _ in range(5):
        touch = begin + (wall - place) * way / speed
        flying = jnp.stack([place + way * speed * (t - begin), way * speed])
        phase = omega * (t - touch)
        pressed = jnp.stack([wall + way * speed / omega * jnp.sin(phase), way * speed * jnp.cos(phase)])
        answer = jnp.where(t >= begin, jnp.where(t < touch, flying, pressed), answer)
        begin, place, wall, way = touch + jnp.pi / omega, wall, NEAR + FAR - wall, -way
    return answer


def found(numbers, ts, **options):
    run = sj.simulate(ball_scene(*numbers), jnp.concatenate([jnp.zeros(1), jnp.asarray(ts)]), **options)
    return jnp.stack([run.position("ball")[1:, 0], run.velocity("ball")[1:, 0]], 1)


def errors(stiffness, ts, derivative=jax.jacfwd, **options):
    """By stiffness, start, speed and mass, each in units of itself, relative to the largest effect of any of them."""
    numbers = jnp.array([stiffness, 0.0, 1.0, 1.0])
    units = jnp.array([stiffness, 1.0, 1.0, 1.0])
    slopes = derivative(lambda numbers: found(numbers, ts, **options))(numbers) * units
    wanted = jnp.stack([jax.jacfwd(lambda n, t=t: exact(*n, t))(numbers) for t in ts]) * units
    scale = jnp.max(jnp.abs(wanted), axis=2, keepdims=True)
    return np.max(np.abs((slopes - wanted) / scale))


def touch_of(stiffness):
    """When the ball touches first [s], and how long for."""
    return NEAR, np.pi / np.sqrt(stiffness)


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8, 1e10])
def test_a_ball_between_two_linear_stops_by_all_its_numbers(stiffness):
    """In contact, just behind both ends of it, and three impacts later.

    It was wrong by stiffness over mass times 4e-10, and from 1e9 on the run failed where it was differentiated.
    """
    at, lasts = touch_of(stiffness)
    assert errors(stiffness, [at - 1e-7, at + 1e-7, at + 0.4 * lasts, at + lasts + 1e-7, 0.5]) < 1e-6
    assert errors(stiffness, [1.9]) < 2e-6


def test_in_reverse_and_in_lanes():
    """Runs that share a loop, each with its own touches."""
    assert errors(1e7, [0.5, 1.0], jax.jacrev) < 1e-6
    stiffnesses = jnp.array([1e5, 1e6, 1e7, 1e8])

    def end(stiffness, start):
        return found((stiffness, start, 1.0, 1.0), [1.0])[0]

    slopes = jax.jit(jax.vmap(jax.jacfwd(end, 1), (0, None)))(stiffnesses, 0.05)
    wanted = jnp.stack([jax.jacfwd(lambda x, k=k: exact(k, x, 1.0, 1.0, 1.0))(0.05) for k in stiffnesses])
    np.testing.assert_allclose(slopes, wanted, atol=1e-6)


@pytest.mark.slow
def test_by_an_array_program():
    assert errors(1e7, [0.5, 1.0], scalar=False) < 1e-6


def test_a_damped_stop_with_an_onset_against_differences():
    """Its stiffness builds up over a depth, so that no rate jumps; its damping lets go before the ball does."""

    def end(numbers, rtol=1e-8):
        stop = sj.BumpStop(("ball", "ground.o"), shortest=0.2, stiffness=numbers[0], damping=numbers[1], onset=1e-4)
        ball = sj.Body(1.0, (1e-3,) * 3, position=(numbers[2], 0.0, 0.0), velocity=(1.0, 0.0, 0.0))
        points = {"o": (0.52, 0.0, 0.0)}
        scene = sj.Scene({"ball": ball}, forces={"stop": stop}, gravity=(0.0, 0.0, 0.0), ground_points=points)
        return sj.simulate(scene, jnp.array([0.0, 0.5]), rtol=rtol).ys[-1, 0]

    at = jnp.array([1e6, 300.0, 0.0])
    slopes, steps = jax.grad(end)(at) * jnp.array([1e6, 300.0, 1.0]), np.array([1e2, 3e-2, 1e-4])
    differences = [
        (end(at.at[i].add(h), 1e-12) - end(at.at[i].add(-h), 1e-12)) / (2 * h) * unit
        for i, (h, unit) in enumerate(zip(steps, (1e6, 300.0, 1.0), strict=True))
    ]
    np.testing.assert_allclose(slopes, differences, atol=2e-6)
