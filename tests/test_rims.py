"""Journals that tilt in their bearing until they touch both rims."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax.motion.integration.audit import CHECKS
from spherejax.physics.kinematics import body_motion

CYLINDER = sj.laws.JohnsonCylinder(0.02)
LENGTH, MASS, INERTIA, OVERHANG, GRAVITY = 0.04, 0.5, 2e-4, 0.05, 9.81
"""A shaft that hangs out of its bearing: its center of mass is OVERHANG before the bearing's middle."""


def stiff(clearance=2e-4, stiffness=1e9, **numbers):
    return sj.Dry(clearance, normal=sj.LankaraniNikravesh(0.8, stiffness=stiffness), **numbers)


def shaft(model, *, pitch=0.0, **numbers):
    """A shaft along x, in a bearing of the ground whose middle is the origin; it starts in the middle, and pitches."""
    body = sj.Body(MASS, (1e-4, INERTIA, INERTIA), (OVERHANG, 0, 0), angular_velocity=(0, -pitch, 0))
    rims = sj.joints.tilting_journal(
        "shaft", ("ground", "rotor"), (0, 0, 0), (1, 0, 0), model, length=LENGTH, **numbers
    )
    return sj.Scene({"rotor": body}, rims)


# Against a journal that cannot tilt -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(sj.Dry(5e-4, conformity=CYLINDER, friction=sj.Threlfall(0.1)), marks=pytest.mark.slow),
        stiff(),
    ],
)
def test_a_journal_that_nothing_tilts_moves_as_a_revolute_joint(model):
    scene = sj.gallery.piston(model)
    joints = dict(scene.joints)
    pin = joints.pop("pin")
    rims = sj.joints.tilting_journal("pin", pin.bodies, pin.point, pin.axis, model, length=0.02)
    ts = jnp.linspace(0.0, 0.004, 5)
    whole = sj.simulate(scene, ts, rtol=1e-10, throw=True)
    tilting = sj.simulate(dataclasses.replace(scene, joints={**joints, **rims}), ts, rtol=1e-10, throw=True)
    assert int(whole.stats.n_onsets[0]) >= 2
    np.testing.assert_allclose(tilting.position("piston"), whole.position("piston"), atol=1e-9)
    both = tilting.reaction("pin_1") + tilting.reaction("pin_2")
    size = np.abs(whole.reaction("pin")).max()
    np.testing.assert_allclose(both[:, ::2], whole.reaction("pin")[:, ::2], atol=1e-5 * size)


def test_ideal_rims_are_a_revolute_joint():
    ts = jnp.linspace(0.0, 0.5, 6)
    body = sj.Body(MASS, (1e-3, 2e-3, 3e-3), (0.02, 0.1, 0), velocity=(0, 0, 0.1), angular_velocity=(1, 0, 0))
    rims = sj.joints.tilting_journal("pivot", ("ground", "bob"), (0, 0, 0), (1, 0, 0), length=LENGTH)
    hinge = {"pivot": sj.Revolute(("ground", "bob"), (0, 0, 0), (1, 0, 0))}
    one, other = (sj.simulate(sj.Scene({"bob": body}, j), ts, rtol=1e-11, throw=True) for j in (rims, hinge))
    np.testing.assert_allclose(one.position("bob"), other.position("bob"), atol=1e-10)
    both = one.reaction("pivot_1") + one.reaction("pivot_2")
    np.testing.assert_allclose(both, other.reaction("pivot"), atol=1e-7)


# Against equations written by hand ------------------------------------------------------------------------------------


def reference(model, t_end, pitch):
    """Height of the first rim's point and angle of the shaft at `t_end`, and the onsets of each rim.

    Its own equations in the plane: coordinates (z, theta), the shaft's point at the collar keeps x = -L/2.
    """
    clearance, half = float(model.clearance), 0.5 * float(model.normal.stiffness)
    chi = 3 * (1 - 0.8**2) / 4
    arm = 0.5 * LENGTH + OVERHANG

    def depths(y):
        z, rate, turn = y[0], y[2], y[3]
        sine, cosine = np.sin(y[1]), np.cos(y[1])
        first, second = z, z + LENGTH * sine
        return (first, rate), (second, rate + LENGTH * cosine * turn)

    def force(place, onset):
        e, rate = place
        depth = abs(e) - clearance
        if onset == 0 or depth <= 0:
            return 0.0
        return -np.sign(e) * max(half * depth**1.5 * (1 + chi * np.sign(e) * rate / onset), 0.0)

    def slope(t, y, onsets):
        _, theta, rate, turn = y
        sine, cosine = np.sin(theta), np.cos(theta)
        f = [force(place, onset) for place, onset in zip(depths(y), onsets, strict=True)]
        mass = np.array([[MASS, MASS * arm * cosine], [MASS * arm * cosine, MASS * arm**2 + INERTIA]])
        push = [
            f[0] + f[1] - MASS * GRAVITY + MASS * arm * sine * turn**2,
            f[1] * LENGTH * cosine - MASS * GRAVITY * arm * cosine,
        ]
        return [rate, turn, *np.linalg.solve(mass, push)]

    t, y, onsets, counts = 0.0, np.array([0, 0, -pitch * arm, pitch]), [0.0, 0.0], [0, 0]
    while t < t_end:

        def event(i):
            def touches(t, state, *_):
                return abs(depths(state)[i][0]) - clearance

            touches.terminal, touches.direction = True, 1.0 if onsets[i] == 0 else -1.0
            return touches

        found = solve_ivp(
            slope, (t, t_end), y, "DOP853", events=[event(0), event(1)], rtol=1e-12, atol=1e-16, args=(onsets,)
        )
        t, y = found.t[-1], found.y[:, -1]
        for i in range(2):
            if len(found.t_events[i]):
                counts[i] += onsets[i] == 0
                onsets[i] = abs(depths(y)[i][1]) if onsets[i] == 0 else 0.0
                y = y + 1e-13 * np.array(slope(t, y, onsets))
                t = t + 1e-13
    return y[:2], counts


def test_a_shaft_that_tilts_to_both_rims_moves_as_by_hand():
    model, t_end, pitch = stiff(), 0.02, 0.5
    scene = shaft(model, pitch=pitch, starts_concentric=False)
    run = sj.simulate(scene, jnp.array([0.0, t_end]), rtol=1e-11, throw=True)
    (z, theta), counts = reference(model, t_end, pitch)
    assert min(counts) >= 1
    assert sum(counts) >= 4
    np.testing.assert_array_equal(np.asarray(run.stats.n_onsets), counts)
    turned = Rotation.from_quat(np.array(run.quaternion("rotor"))[-1], scalar_first=True).as_rotvec()
    assert -float(turned[1]) == pytest.approx(theta, abs=1e-8)
    assert float(run.eccentricity("shaft_1")[-1, 2]) == pytest.approx(z, abs=1e-9)


def test_at_rest_the_rims_carry_the_lever():
    """F_1 = W (a/L - 1/2) upwards on the far rim, F_2 = W (a/L + 1/2) on the near one; each depth by Hertz."""
    model = sj.Dry(2e-4, normal=sj.laws.HuntCrossleyDissipation(1e3, stiffness=1e9))
    run = sj.simulate(shaft(model), jnp.array([0.0, 0.3]), throw=True)
    forces = MASS * GRAVITY * np.array([0.5 - OVERHANG / LENGTH, 0.5 + OVERHANG / LENGTH])
    depths = (np.abs(forces) / 0.5e9) ** (1 / 1.5)
    for name, force, depth in zip(("shaft_1", "shaft_2"), forces, depths, strict=True):
        assert float(run.reaction(name)[-1, 2]) == pytest.approx(force, rel=1e-3)
        assert float(run.penetration(name)[-1]) == pytest.approx(depth, rel=1e-3)


# What must be kept ----------------------------------------------------------------------------------------------------


def momenta(run):
    linear, angular = 0.0, 0.0
    for name, body in run.system.bodies.items():
        axes = Rotation.from_quat(np.array(run.quaternion(name)), scalar_first=True).as_matrix()
        inertia = np.diag(body.inertia)
        w, r, v = (np.asarray(f(name)) for f in (run.angular_velocity, run.position, run.velocity))
        linear = linear + body.mass * v
        angular = angular + np.einsum("nij,jk,nlk,nl->ni", axes, inertia, axes, w) + body.mass * np.cross(r, v)
    return linear, angular


@pytest.fixture(scope="module")
def free_pair():
    """Two bodies in space that tumble about each other, without a collar: the shaft slides along as well."""
    first = sj.Body(1.0, (2e-3, 3e-3, 2.5e-3), angular_velocity=(0.5, 2.0, 0.3))
    second = sj.Body(0.5, (1e-3, 1.5e-3, 1e-3), (0.1, 0, 0), velocity=(0.05, 0.02, 0.1), angular_velocity=(0, 8, 1))
    rims = sj.joints.tilting_journal(
        "pair",
        ("first", "second"),
        (0.05, 0.0, 0.0),
        (0.1, 1.0, 0.2),
        sj.Dry(5e-4, conformity=CYLINDER, friction=sj.BrownMcPhee()),
        length=LENGTH,
        starts_concentric=False,
    )
    rims = {name: sj.joints.Rim(rim.bodies, rim.point, rim.axis, rim.model, False) for name, rim in rims.items()}
    scene = sj.Scene({"first": first, "second": second}, rims, gravity=(0.0, 0.0, 0.0))
    return sj.simulate(scene, jnp.linspace(0.0, 0.05, 11), rtol=1e-10, throw=True, track_work=True)


def test_a_free_pair_keeps_its_momenta(free_pair):
    linear, angular = momenta(free_pair)
    assert min(int(n) for n in free_pair.stats.n_onsets) > 0
    assert np.abs(linear - linear[0]).max() < 1e-9 * np.abs(linear).max()
    assert np.abs(angular - angular[0]).max() < 1e-8 * np.abs(angular).max()


def test_what_a_free_pair_loses_its_rims_absorb(free_pair):
    energy = np.asarray(free_pair.kinetic_energy)
    absorbed = sum(np.asarray(free_pair.absorbed_work(name)) for name in ("pair_1", "pair_2"))
    np.testing.assert_allclose(energy + absorbed, energy[0], atol=1e-8 * energy[0])
    assert absorbed[-1] > 1e-4 * energy[0]


def test_what_is_of_balls_is_refused(free_pair):
    with pytest.raises(sj.SceneError, match="'pair_1' is a rim of a journal that tilts"):
        sj.wear(free_pair, "pair_1", k_socket=1e-15, k_ball=0.0)


def falling_over(mass):
    """A single rim holds no direction."""
    rim = sj.joints.Rim(("ground", "rotor"), (0, 0, 0), (1, 0, 0), stiff(), is_thrust=True)
    return sj.Scene({"rotor": sj.Body(mass, (1e-4, INERTIA, INERTIA), (OVERHANG, 0, 0))}, {"rim": rim})


def alone(ts):
    return sj.simulate(falling_over(MASS), ts).stats


def in_lanes(ts):
    return sj.simulate_many(falling_over, np.array([MASS]), ts).trajectories.stats


@pytest.mark.parametrize("way", [alone, in_lanes])
def test_a_rim_that_is_tilted_too_far_says_so(way):
    """The shaft falls over until its section in the rim is no circle any more."""
    with pytest.warns(sj.errors.OutOfRangeWarning, match="tilted in a rim.*other rim"):
        stats = way(jnp.array([0.0, 0.05]))
    assert float(np.max(stats.audit[..., CHECKS.index("tilt")])) > 1


def test_two_rims_hold_the_tilt_where_it_is_right(free_pair):
    assert 0 < float(free_pair.stats.audit[CHECKS.index("tilt")]) < 0.1


def test_the_crossing_has_the_rate_that_it_has():
    """However the axis turns, and however far along it the journal has slid."""
    rim = sj.joints.Rim(("a", "b"), (0.1, 0.2, 0.3), (0.0, 0.3, 1.0), stiff(), starts_concentric=False)
    bodies = {"a": sj.Body(1.0, (1, 1, 1)), "b": sj.Body(1.0, (1, 1, 1), (0.3, 0.1, 0.0))}
    placed = sj.equations.compile_scene(sj.Scene(bodies, {"rim": rim})).system.joints["rim"]
    speeds = {"a": ((0.3, -0.2, 0.5), (1.0, 2.0, -0.7)), "b": ((-0.1, 0.4, 0.2), (0.5, -1.5, 0.9))}

    def value(t):
        motions = {}
        for name, (v, w) in speeds.items():
            v, w = jnp.array(v), jnp.array(w)
            angle = jnp.linalg.norm(w) * (t + 0.3)
            q = jnp.concatenate([jnp.cos(angle / 2)[None], jnp.sin(angle / 2) * w / jnp.linalg.norm(w)])
            motions[name] = body_motion(jnp.asarray(bodies[name].position) + v * (t + 0.1), q, v, w)
        return placed.model.crossing(placed.relative_motion(motions))

    _, slope = jax.jvp(lambda t: value(t).value, (0.0,), (1.0,))
    assert float(slope) == pytest.approx(float(value(0.0).rate), rel=1e-12)


# As every other joint -------------------------------------------------------------------------------------------------


def test_lanes_make_the_runs_that_simulate_makes():
    clearances, ts = np.array([4e-4, 2e-4, 1e-4]), [0.0, 0.01]
    swept = sj.sweep(lambda c: shaft(stiff(c)), {"c": clearances}, ts, record=["final position.rotor"], progress=False)
    for i, c in enumerate(clearances):
        alone = sj.simulate(shaft(stiff(c)), jnp.array(ts), throw=True)
        np.testing.assert_allclose(swept["final_position.rotor"][i], alone.position("rotor")[-1], atol=1e-8)


@pytest.mark.slow
def test_derivatives_agree_with_differences():
    def height(c, length):
        body = sj.Body(MASS, (1e-4, INERTIA, INERTIA), (OVERHANG, 0.0, 0.0))
        rims = sj.joints.tilting_journal("shaft", ("ground", "rotor"), (0, 0, 0), (1, 0, 0), stiff(c), length=length)
        run = sj.simulate(sj.Scene({"rotor": body}, rims), jnp.array([0.0, 0.009]), rtol=1e-11)
        return run.position("rotor")[-1, 2]

    value = jax.jit(height)
    found = jax.jit(jax.jacfwd(height, (0, 1)))(2e-4, LENGTH)
    for i, (h, slope) in enumerate(zip((1e-8, 1e-6), found, strict=True)):
        step = np.array([h if j == i else 0.0 for j in range(2)])
        up, down = (value(*(np.array([2e-4, LENGTH]) + sign * step)) for sign in (1, -1))
        assert float(slope) == pytest.approx(float(up - down) / (2 * h), rel=1e-4)


def test_a_shaft_goes_through_a_file(tmp_path):
    scene = shaft(sj.Dry(2e-4, conformity=sj.laws.EsduCylinder(LENGTH), friction=sj.LuGre()), starts_concentric=False)
    sj.save_scene(scene, tmp_path / "shaft.toml")
    again = sj.load_scene(tmp_path / "shaft.toml")
    assert jax.tree.structure(again) == jax.tree.structure(scene)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(scene), strict=True))


OIL = sj.Lubricated(1e-4, 0.4, film=sj.laws.ShortBearing(0.01), conformity=CYLINDER)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: shaft(OIL), "joint 'shaft_1': model.*be ideal or dry.*film between tilted"),
        (lambda: shaft(sj.Bushing(1e6, 1e-3)), "be ideal or dry"),
        (lambda: shaft(sj.Ideal(friction=sj.Threlfall(0.1), radius=0.01)), "be left out of an ideal rim"),
        (lambda: shaft(sj.Dry(1e-4)), "conformity.*JohnsonCylinder"),
        (lambda: shaft(stiff(-1e-4)), "joint 'shaft_1': clearance"),
        (
            lambda: sj.joints.tilting_journal("pin", ("a", "b"), (0, 0, 0), (1, 0, 0), length=0.0),
            "journal 'pin': length",
        ),
        (lambda: sj.joints.tilting_journal("pin", ("a", "b"), (0, 0, 0), (0, 0, 0), length=0.1), "journal 'pin': axis"),
    ],
)
def test_what_a_rim_cannot_have_is_refused(build, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.simulate(build(), jnp.array([0.0, 0.01]))


def test_a_contact_whose_half_is_not_known_is_refused():
    with pytest.raises(TypeError, match="half of SphericalProfile"):
        shaft(sj.Dry(1e-4, conformity=sj.laws.SphericalProfile()))
