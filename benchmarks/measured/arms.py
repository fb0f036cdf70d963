"""Arms that turn about y while z points up, and what resists them: for the pendulums."""

import jax.numpy as jnp

import spherejax as sj

AXIS = (0.0, 1.0, 0.0)


def arm(mass, center, inertia, angle, rate, top=None, velocity_of_top=None):
    """An arm that hangs at a point and stands at an angle from upright.

    Args:
        mass: [kg].
        center: of mass, from the point [m].
        inertia: about the center of mass [kg m^2].
        angle: from upright [rad].
        rate: [rad/s].
        top: the point [m]; None: the origin.
        velocity_of_top: [m/s]; None: at rest.
    """
    s, c = jnp.sin(angle), jnp.cos(angle)
    zero, origin = jnp.zeros_like(s), jnp.zeros(3)
    return sj.Body(
        mass,
        (inertia, inertia, inertia),
        (origin if top is None else top) + center * jnp.stack([s, zero, c]),
        quaternion=jnp.stack([jnp.cos(angle / 2), zero, jnp.sin(angle / 2), zero]),
        velocity=(origin if velocity_of_top is None else velocity_of_top) + rate * center * jnp.stack([c, zero, -s]),
        angular_velocity=rate * jnp.array(AXIS),
    )


def end_of(length, angle, rate):
    """Place [m] and velocity [m/s] of the far end of an arm that hangs at the origin."""
    s, c = jnp.sin(angle), jnp.cos(angle)
    zero = jnp.zeros_like(s)
    return length * jnp.stack([s, zero, c]), rate * length * jnp.stack([c, zero, -s])


def bearing(moment=None, mu=None, breakaway=None, *, radius, rate):
    """An ideal hinge with friction.

    Args:
        moment: dry moment without load [N m]; None: none.
        mu: coefficient of a friction that follows the reaction [-]; None: none.
        breakaway: by how much more than the moment of fast turning the slowest one takes, as a share of it [-]; the
            moment is largest at `rate`, and falls with the speed beyond; None: one moment at all speeds.
        radius: of the bearing [m].
        rate: angular speed at which three quarters of the dry friction act [rad/s].
    """
    if moment is None and mu is None:
        return sj.Ideal()
    kinetic = 1.0 if mu is None else mu
    if breakaway is None:
        law = sj.Threlfall(mu=kinetic, v1=radius * rate)
    else:
        law = sj.BrownMcPhee(kinetic, kinetic * (1.0 + breakaway), stribeck_velocity=radius * rate)
    pressure = sj.laws.PreloadAlone() if mu is None else sj.laws.CosinePressure()
    return sj.Ideal(friction=law, radius=radius, pressure=pressure, preload=moment)


def drag(bodies, viscous=0.0, square=None):
    """Resistance that grows with the speed [N m s/rad], and with its square [N m s^2/rad^2]; it counts the angle."""
    law = None if square is None else Square(square)
    return sj.TorsionalSpring(bodies, AXIS, damping=viscous, damper=law)


class Square(sj.functions.AbstractFunction):
    """A resistance by the square of a speed.

    Attributes:
        factor: [N m s^2/rad^2].
    """

    factor: float

    def __call__(self, x):
        """factor |x| x."""
        return self.factor * jnp.abs(x) * x

    def room(self, x, is_forward):
        """No kink that a step must end on."""
        return jnp.inf


def angle_of(body, encoder):
    """From a run to the angle of an arm from upright [rad]; the encoder turns against the ground."""

    def angle(run):
        w, _, y, _ = run.quaternion(body)[0]
        return run.force(encoder)["angle"] + 2 * jnp.arctan2(y, w)

    return angle
