"""Cycles of mechanisms with constraints and of joints with clearance, against Mathieu's equation and ideal impacts."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize

import spherejax as sj

Y = (0.0, 1.0, 0.0)


def sorted_by_size(values):
    return values[np.lexsort((values.imag, np.abs(values)))]


class Nodding(eqx.Module):
    """The height of what is shaken; `delay` later, if that is asked for."""

    amplitude: float
    frequency: float
    delay: float = 0.0

    def __call__(self, t):
        return self.amplitude * jnp.cos(2 * jnp.pi * self.frequency * (t - self.delay))


def mathieu(amplitude, frequency, damping=0.05):
    """A pendulum on a slide that a driver shakes: J theta'' + c theta' + (g - a w^2 cos w t) l theta = 0."""
    slide = sj.Body(1.0, (1e-2, 1e-2, 1e-2))
    bob = sj.Body(1.0, (2e-2, 1e-2, 1.5e-2), (0.0, 0.0, -0.5))
    joints = {
        "slide": sj.Prismatic(("ground", "slide"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        "shaker": sj.TranslationDriver(
            ("ground", "slide"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), Nodding(amplitude, frequency)
        ),
        "pivot": sj.Revolute(("slide", "bob"), (0.0, 0.0, 0.0), Y),
    }
    return sj.Scene(
        {"slide": slide, "bob": bob}, joints, {"drag": sj.TorsionalSpring(("slide", "bob"), Y, 0.0, damping)}
    )


def mathieu_multipliers(amplitude, frequency, damping=0.05):
    J, w = 1e-2 + 0.25, 2 * np.pi * frequency

    def rate(t, y):
        stiffness = 0.5 * (9.81 - amplitude * w * w * np.cos(w * t)) / J
        return (np.array([[0.0, 1.0], [-stiffness, -damping / J]]) @ y.reshape(2, 2)).ravel()

    found = scipy.integrate.solve_ivp(rate, (0.0, 1 / frequency), [1.0, 0.0, 0.0, 1.0], rtol=1e-11, atol=1e-12)
    return np.linalg.eigvals(found.y[:, -1].reshape(2, 2))


@pytest.mark.slow
def test_a_shaken_pendulum_has_the_multipliers_of_mathieu():
    """At twice its own frequency it leaves the vertical by period doubling, which is located along the amplitude."""
    branch = sj.studies.continuation(
        lambda amplitude: mathieu(amplitude, 1.4), "amplitude", (0.002, 0.06), period=1 / 1.4, settle=0
    )
    assert branch.succeeded, branch.diagnosis
    for k in (0, len(branch) - 1):
        wanted = mathieu_multipliers(branch.values[k], 1.4)
        found = branch.points[k].multipliers.values
        np.testing.assert_allclose(sorted_by_size(found), sorted_by_size(wanted), atol=1e-5)
    (event,) = branch.events
    assert event.kind == "period doubling"
    least = scipy.optimize.brentq(lambda a: np.abs(mathieu_multipliers(a, 1.4)).max() - 1, 0.005, 0.06)
    assert event.value == pytest.approx(least, rel=1e-4)


@pytest.mark.slow
def test_disturbed_starts_keep_to_the_constraints():
    """The same pendulum by a stiff method: a driver, a slide and a hinge hold, and the multipliers are SciPy's."""
    cycle = sj.steady_cycle(mathieu(0.02, 1.4), period=1 / 1.4, settle=0, solver=sj.solvers.Rodas5P())
    assert cycle.succeeded, cycle.diagnosis
    assert 0 < cycle.multipliers.doubt < 1e-9
    wanted = mathieu_multipliers(0.02, 1.4)
    np.testing.assert_allclose(sorted_by_size(cycle.multipliers.values), sorted_by_size(wanted), atol=1e-7)


# Joints with clearance ---------------------------------------------------------------------------------------------

RESTITUTION, JUMP = 0.8, 0.01
"""Of a ball, and for how long it flies [s]."""

TAKEOFF = 9.81 * JUMP / 2
"""Its speed [m/s] after an impact, by which it is back at the same height when the next is due."""

WALL = TAKEOFF * (1 - RESTITUTION) / (1 + RESTITUTION)
"""Speed [m/s] of the wall at the impacts."""


def bouncing(phase, clearance=2e-4):
    """A ball on a guide in a socket that a driver shakes, at the top of its jump.

    At the impacts, in the middle of the cycle, the socket is `phase` past its own middle and has the speed `WALL`: the
    cycle closes if they take no time.
    """
    w = 2 * np.pi / JUMP
    amplitude = WALL / (w * np.cos(phase))
    z, height = (0.0, 0.0, 1.0), amplitude * np.sin(phase) - clearance + 9.81 * JUMP**2 / 8
    bodies = {
        "slide": sj.Body(1.0, (1e-2, 1e-2, 1e-2), points={"socket": (0.0, 0.0, 0.0)}),
        "ball": sj.Body(1e-4, (1e-8, 1e-8, 1e-8), (0.0, 0.0, height), points={"center": (0.0, 0.0, 0.0)}),
    }
    # A sine whose phase is `phase` at half of the period.
    shaker = Nodding(amplitude, 1 / JUMP, JUMP / 2 + (np.pi / 2 - phase) / w)
    joints = {
        "slide": sj.Prismatic(("ground", "slide"), (0.0, 0.0, 0.0), z),
        "shaker": sj.TranslationDriver(("ground", "slide"), (0.0, 0.0, 0.0), z, shaker),
        "guide": sj.Prismatic(("ground", "ball"), (0.0, 0.0, height), z),
        "play": sj.Spherical(
            "slide.socket", "ball.center", sj.Dry(clearance, normal=sj.ExactRestitution(restitution=RESTITUTION))
        ),
    }
    return sj.Scene(bodies, joints)


def bouncing_multipliers(phase):
    """Of an impact that takes no time: u1 = (1 + e) s'(t1) - e v1, v1 = u - g (t1 - t0), at the next crossing.

    Along small changes of u and t0, with s' = w and s'' = a at impacts: dt1 = dt0 - T du / (v1 - w).
    """
    acceleration = -WALL * np.tan(phase) * 2 * np.pi / JUMP
    du, dt0 = np.eye(2)
    dt1 = dt0 + JUMP / (TAKEOFF + WALL) * du
    dv1 = du - 9.81 * (dt1 - dt0)
    return np.linalg.eigvals([(1 + RESTITUTION) * acceleration * dt1 - RESTITUTION * dv1, dt1])


@pytest.mark.slow
@pytest.mark.parametrize(("phase", "is_stable"), [(0.2, True), (1.27, False)])
def test_a_ball_that_bounces_in_its_socket_once_a_cycle(phase, is_stable):
    """A dry joint with clearance, driven: the steady bounce with the multipliers of impacts that take no time.

    Beyond the phase where -1 is one of them no simulation shows the bounce, and it is found.
    """
    cycle = sj.steady_cycle(bouncing(phase), period=JUMP, settle=0, rtol=1e-9)
    assert cycle.succeeded, cycle.diagnosis
    assert cycle.is_stable == is_stable
    hits = cycle.run.impacts("play")
    assert hits.sizes["contact"] == 1
    assert float(hits["approach_speed"][0]) == pytest.approx(TAKEOFF + WALL, rel=2e-3)
    found, wanted = cycle.multipliers.values, bouncing_multipliers(phase)
    assert np.prod(found).real == pytest.approx(RESTITUTION**2, rel=2e-3)
    np.testing.assert_allclose(sorted_by_size(found), sorted_by_size(wanted), rtol=1e-2)


@pytest.mark.slow
def test_a_motion_that_does_not_repeat_itself_says_so():
    """A piston whose pin strikes to and fro in its play: nothing after ten cycles is one.

    Rounding decides where it is then, and so which of two things is said.
    """
    pin = sj.Dry(5e-4, conformity=sj.laws.JohnsonCylinder(0.02))
    off, changed = r"still off by .* may repeat itself after several periods only, or never", "and did not before"
    with pytest.warns(sj.errors.CycleWarning, match=f"{off}|{changed}"):
        cycle = sj.steady_cycle(sj.gallery.piston(pin), period=0.012, rtol=1e-7)
    assert not cycle.succeeded
