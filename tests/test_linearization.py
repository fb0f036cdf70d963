"""Linearization: closed forms, gyroscopic modes, and differences of the constrained flow."""

import cases
import numpy as np
import pytest
import scipy.linalg
from linearizing import by_differences, moment

import spherejax as sj

G = 9.81
Y = (0.0, 1.0, 0.0)
DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
"""From x to -z."""


def pendulum(angle=0.0, *, mass=1.0, moment=1e-2, arm=0.5, **options):
    """A body on a hinge along y, its center an arm away, turned by an angle from the vertical."""
    turned = (np.cos(angle / 2), 0.0, -np.sin(angle / 2), 0.0)
    place = (arm * np.sin(angle), 0.0, -arm * np.cos(angle))
    body = sj.Body(mass, (2 * moment, moment, 1.5 * moment), place, turned, points={"center": (0.0, 0.0, 0.0)})
    return sj.Scene({"bob": body}, {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)}, **options)


def rates(lin):
    """Eigenvalues, sorted by size and sign."""
    values = lin.modes().eigenvalues
    return values[np.lexsort((values.imag, np.abs(values)))]


# Closed forms --------------------------------------------------------------------------------------------------------


def test_a_physical_pendulum():
    """w^2 = m g l / (J + m l^2), whatever the start near rest."""
    lin = sj.linearize(pendulum(0.3), at="rest", inputs="gravity.z", outputs=["position.bob", "reaction.pivot.z"])
    w = np.sqrt(G * 0.5 / (1e-2 + 0.25))
    np.testing.assert_allclose(rates(lin), [1j * w], rtol=1e-9)
    modes = lin.modes()
    assert modes.frequency[0] == pytest.approx(w / (2 * np.pi), rel=1e-9)
    assert abs(modes.damping_ratio[0]) < 1e-12
    assert (modes.is_stable, modes.n_zero, lin.is_steady, lin.degrees_of_freedom) == (True, 0, True, 1)
    assert lin.states == ("x1", "u1")
    # A turn by dtheta about -y moves the center by l dtheta along x; z^H M z = 1 makes it 1 / sqrt(J + m l^2).
    shape = modes.shape(0, "bob")
    turn = 1 / np.sqrt(1e-2 + 0.25)
    np.testing.assert_allclose(np.abs(shape), [0.5 * turn, 0.0, 0.0, 0.0, turn, 0.0], atol=1e-9)
    # The joint carries the weight, -m dg_z; x moves with the coordinate alone.
    np.testing.assert_allclose(lin.D, [[0.0], [0.0], [0.0], [-1.0]], atol=1e-9)
    assert abs(abs(lin.C[0, 0]) - 0.5 * turn) < 1e-9
    np.testing.assert_allclose(lin.B, 0.0, atol=1e-9)


def test_a_pendulum_upright_falls():
    lin = sj.linearize(pendulum(np.pi))
    w = np.sqrt(G * 0.5 / (1e-2 + 0.25))
    np.testing.assert_allclose(np.sort(rates(lin).real), [-w, w], rtol=1e-9)
    assert not lin.modes().is_stable


def rod(length, center, mass=0.5):
    return sj.Body(
        mass,
        (1e-4, mass * length**2 / 12, mass * length**2 / 12),
        center,
        DOWN,
        points={"top": (-length / 2, 0.0, 0.0), "end": (length / 2, 0.0, 0.0)},
    )


def double_pendulum(joint):
    bodies = {"upper": rod(0.3, (0.0, 0.0, -0.15)), "lower": rod(0.2, (0.0, 0.0, -0.4), 0.3)}
    joints = {"shoulder": joint("ground", "upper", "top"), "elbow": joint("upper", "lower", "top")}
    return sj.Scene(bodies, joints, ground_points={"top": (0.0, 0.0, 0.0)})


def double_pendulum_rates():
    """From M and K by angles from the vertical."""
    m1, l1, m2, l2 = 0.5, 0.3, 0.3, 0.2
    M = np.array([[m1 * l1**2 / 3 + m2 * l1**2, m2 * l1 * l2 / 2], [m2 * l1 * l2 / 2, m2 * l2**2 / 3]])
    K = G * np.diag([m1 * l1 / 2 + m2 * l1, m2 * l2 / 2])
    return np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True))


def test_a_double_pendulum_on_hinges():
    places = {"upper": (0.0, 0.0, 0.0), "lower": (0.0, 0.0, -0.3)}
    scene = double_pendulum(lambda first, second, _: sj.Revolute((first, second), places[second], Y))
    np.testing.assert_allclose(rates(sj.linearize(scene)), 1j * double_pendulum_rates(), rtol=1e-9)


def test_a_double_pendulum_on_balls_swings_alike_in_all_planes():
    """Each eigenvalue twice, and the free spin of each rod; repeated ones have no derivative by one number."""
    scene = double_pendulum(
        lambda first, second, top: sj.Spherical(f"{first}.{'top' if first == 'ground' else 'end'}", f"{second}.{top}")
    )
    lin = sj.linearize(scene, at="rest")
    np.testing.assert_allclose(rates(lin), 1j * np.repeat(double_pendulum_rates(), 2), rtol=1e-9)
    modes = lin.modes()
    assert (modes.n_zero, lin.degrees_of_freedom) == (4, 6)
    assert "4 zero eigenvalues" in str(modes)
    assert not np.any(modes.is_simple)
    assert np.all(np.isnan(lin.eigenvalue_sensitivity("bodies.upper.mass")))
    with pytest.raises(sj.SceneError, match="mode 0 has a repeated eigenvalue"):
        modes.sensitivity(0, "bodies.upper.mass")


def on_rubber(**options):
    """A body whose center is in a bushing, without gravity."""
    model = sj.Bushing(
        law=sj.laws.MatrixElastomer(np.diag([1e4, 2e4, 3e4]), np.diag([10.0, 20.0, 30.0]), np.diag([5.0, 7.0, 9.0])),
        **options,
    )
    body = sj.Body(2.0, (1e-2, 2e-2, 2.5e-2), points={"ball": (0.0, 0.0, 0.0)})
    push = sj.AppliedWrench("body")
    return sj.Scene(
        {"body": body},
        {"mount": sj.Spherical("ground.socket", "body.ball", model)},
        {"push": push},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


def test_an_oscillator_on_a_bushing():
    """Six of them: m l^2 + c l + k = 0 with c = 1e-3 k; and the response 1 / (k + i w c - m w^2)."""
    lin = sj.linearize(on_rubber(), inputs="forces.push.force", outputs=["position.body", "acceleration.body.x"])
    inertia = np.array([2.0, 2.0, 2.0, 1e-2, 2e-2, 2.5e-2])
    stiffness = np.array([1e4, 2e4, 3e4, 5.0, 7.0, 9.0])
    wanted = np.concatenate([np.roots([m, 1e-3 * k, k]) for m, k in zip(inertia[:3], stiffness[:3], strict=True)])
    found = lin.modes().eigenvalues
    for value in wanted[wanted.imag > 0]:
        assert np.min(np.abs(found - value)) < 1e-9 * abs(value)
    assert lin.inputs == tuple(f"forces.push.force.{axis}" for axis in "xyz")
    assert lin.outputs[:3] == tuple(f"position.body.{axis}" for axis in "xyz")
    f = np.array([0.0, 3.0, 11.0, 40.0])
    w = 2 * np.pi * f
    response = lin.frequency_response(f)
    x = 1 / (1e4 + 1e-3 * 1e4 * 1j * w - 2.0 * w**2)
    np.testing.assert_allclose(response[:, 0, 0], x, rtol=1e-9)
    np.testing.assert_allclose(response[:, 3, 0], -(w**2) * x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(response[:, 1, 0], 0.0, atol=1e-15)


def test_relaxing_rubber():
    """(m l^2 + k + c l)(l + 1/T) + k1 l = 0: a branch of stiffness k1 and time T makes each quadratic a cubic."""
    lin = sj.linearize(on_rubber(branches=sj.laws.Maxwell([5e3], [2e-3])))
    found = lin.modes().eigenvalues
    for k in (1e4, 2e4, 3e4):
        cubic = np.polyadd(np.polymul([2.0, 1e-3 * k, k], [1.0, 1 / 2e-3]), [5e3, 0.0])
        for value in np.roots(cubic):
            if value.imag >= 0:
                assert np.min(np.abs(found - value)) < 1e-9 * abs(value)
    assert sum(name.startswith("mount.branch_1") for name in lin.states) == 3


# Motions -------------------------------------------------------------------------------------------------------------


def top(spin, *, tilt=0.0):
    return sj.Scene(
        {
            "top": sj.Body(
                15.0,
                (0.25, 0.25, 0.5),
                (np.sin(tilt), 0.0, np.cos(tilt)),
                (np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0),
                angular_velocity=(spin * np.sin(tilt), 0.0, spin * np.cos(tilt)),
                points={"tip": (0.0, 0.0, -1.0)},
            )
        },
        {"tip": sj.Spherical("ground.support", "top.tip")},
        ground_points={"support": (0.0, 0.0, 0.0)},
    )


@pytest.mark.parametrize("spin", [150.0, 20.0])
def test_a_sleeping_top(spin):
    """A x'' - i C w x' - m g l x = 0 for x + i y of its axis: nutation and precession, or a fall when it is slow."""
    A, C = 0.25 + 15.0, 0.5
    lin = sj.linearize(top(spin))
    roots = np.roots([A, -1j * C * spin, -15.0 * G])
    found = lin.modes().eigenvalues
    for value in (root if root.imag >= 0 else root.conjugate() for root in roots):
        assert np.min(np.abs(found - value)) < 1e-9 * abs(value)
    assert (lin.modes().n_zero, lin.is_steady) == (2, True)
    assert lin.modes().is_stable == (C * spin > 2 * np.sqrt(A * 15.0 * G))


@pytest.mark.slow
def test_a_conical_pendulum_in_axes_that_turn():
    """W^2 = (g / (l cos a)) (1 + 3 cos^2 a): constant in axes that turn with it, and not in others."""
    a, length = 0.6, 0.4
    speed = np.sqrt(G / (length * np.cos(a)))
    bob = sj.Body(
        1.0,
        (1e-2,) * 3,
        (length * np.sin(a), 0.0, -length * np.cos(a)),
        velocity=(0.0, speed * length * np.sin(a), 0.0),
        points={"center": (0.0, 0.0, 0.0)},
    )
    scene = sj.Scene(
        {"bob": bob},
        {"rod": sj.joints.Distance("ground.o", "bob.center", length)},
        ground_points={"o": (0.0, 0.0, 0.0)},
    )
    lin = sj.linearize(scene, turning=(0.0, 0.0, speed))
    wanted = 1j * speed * np.sqrt(1 + 3 * np.cos(a) ** 2)
    assert np.min(np.abs(lin.modes().eigenvalues - wanted)) < 1e-9 * abs(wanted)
    assert lin.is_steady
    standing = sj.linearize(scene)
    assert not standing.is_steady
    assert "not about a rest" in str(standing.modes())


@pytest.mark.slow
def test_a_pendulum_on_a_foundation_that_turns():
    """Foucault's: in axes that turn by W, rates +-sqrt(g/l) - W and +-sqrt(g/l) + W for a rod with free ends."""
    bob = sj.Body(1.0, (1e-2,) * 3, (0.0, 0.0, -2.0), points={"center": (0.0, 0.0, 0.0)})
    scene = sj.Scene(
        {"bob": bob}, {"rod": sj.joints.Distance("ground.o", "bob.center", 2.0)}, ground_points={"o": (0.0, 0.0, 0.0)}
    )
    lin = sj.linearize(scene, turning=(0.0, 0.0, 0.01))
    w = np.sqrt(G / 2.0)
    found = lin.modes().eigenvalues
    for wanted in (w - 0.01, w + 0.01):
        assert np.min(np.abs(found - 1j * wanted)) < 1e-9 * w
    assert lin.is_steady


def test_a_driven_pendulum():
    """A pendulum from the rim of a disc that is turned at W: in its axes g gives way to W^2 r.

    Without weight, hanging outward at radius r: w^2 = W^2 m r l / (J + m l^2).
    """
    r, arm, speed, moment = 0.3, 0.2, 7.0, 1e-2
    disc = sj.Body(1.0, (1e-2,) * 3, angular_velocity=(0.0, speed, 0.0))
    bob = sj.Body(
        1.0, (moment,) * 3, (r + arm, 0.0, 0.0), velocity=(0.0, 0.0, -speed * (r + arm)),
        angular_velocity=(0.0, speed, 0.0),
    )  # fmt: skip
    scene = sj.Scene(
        {"disc": disc, "bob": bob},
        {
            "axle": sj.Revolute(("ground", "disc"), (0.0, 0.0, 0.0), Y),
            "motor": sj.RotationDriver(("ground", "disc"), Y, sj.functions.Polynomial([0.0, speed])),
            "hinge": sj.Revolute(("disc", "bob"), (r, 0.0, 0.0), Y),
        },
        gravity=(0.0, 0.0, 0.0),
    )
    lin = sj.linearize(scene, turning=(0.0, speed, 0.0))
    wanted = 1j * speed * np.sqrt(r * arm / (moment + arm**2))
    np.testing.assert_allclose(rates(lin), [wanted], rtol=1e-9)
    assert (lin.is_steady, lin.degrees_of_freedom) == (True, 1)


# Against differences -------------------------------------------------------------------------------------------------

LUBRICATED = sj.Lubricated(clearance=cases.C, viscosity=0.4)
MOVING = {
    "film": (lambda: sj.gallery.four_bar(LUBRICATED), 2e-5, 1e-6),
    "pressed": (lambda: sj.gallery.four_bar(LUBRICATED), 1.2e-4, 1e-5),
    "rubber": (lambda: sj.gallery.four_bar(cases.MODELS["bushing_rubber"]), 1.2e-4, 1e-5),
    "redundant": (sj.gallery.bricard, 1e-3, 1e-5),
}
"""Mechanisms, how far they are displaced [m], and steps of the differences [m]."""


def assert_follows_the_flow(run, step, *, by_column=True):
    """To 1e-8 of each column; of the whole where forces of 500 kN leave too much rounding in the slow columns."""
    lin = sj.linearize(run)
    sizes, wrong = (np.linalg.norm(each, axis=0) for each in (lin.A, by_differences(lin, step) - lin.A))
    scale = np.maximum(sizes, 1e-9 * sizes.max()) if by_column else sizes.max()
    assert np.max(wrong / scale) < 1e-8


@pytest.mark.parametrize("name", MOVING)
def test_the_matrix_is_the_derivative_of_the_constrained_flow(name):
    build, distance, step = MOVING[name]
    assert_follows_the_flow(moment(build(), distance=distance), step)


ROUNDED = ("dry_hertz", "lubricated_hertz", "lubricated_warm", "bushing_rubber_turning")
"""Where rounding of large forces, or small steps of what is remembered, drown the slow columns of the differences."""


@pytest.mark.slow
@pytest.mark.parametrize("name", cases.MODELS)
def test_the_matrix_is_the_derivative_of_the_flow_whatever_the_joint(name):
    distance = 1e-3 if name.startswith("ideal") else 1.2e-4
    run = moment(sj.gallery.four_bar(cases.MODELS[name]), distance=distance)
    assert_follows_the_flow(run, 1e-5, by_column=name not in ROUNDED)


@pytest.mark.slow
@pytest.mark.parametrize(
    "build", [sj.gallery.chain, sj.gallery.slider_crank, sj.gallery.suspension, sj.gallery.heavy_top]
)
def test_the_matrix_is_the_derivative_of_the_flow_of_other_mechanisms(build):
    assert_follows_the_flow(moment(build()), 1e-5)
