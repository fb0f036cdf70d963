"""Gears with backlash: closed forms, other integrations, losses, trains, racks and screws."""

import importlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import spherejax as sj
from spherejax.studies.inverse import inverse_dynamics

AXIS = (0.0, 0.0, 1.0)
ONE, TWO = (sj.Turn(("ground", name), AXIS) for name in ("one", "two"))
NO_GRAVITY = {"gravity": (0.0, 0.0, 0.0)}


def rotors(inertias, speeds, forces):
    """Rotors on axes of their own."""
    names = ("one", "two", "three")
    bodies, joints = {}, {}
    for i, (name, inertia, speed) in enumerate(zip(names, inertias, speeds, strict=False)):
        place = (float(i), 0.0, 0.0)
        bodies[name] = sj.Body(1.0, (inertia,) * 3, position=place, angular_velocity=(0.0, 0.0, speed))
        joints[f"bearing_{name}"] = sj.Revolute(("ground", name), place, AXIS)
    return sj.Scene(bodies, joints, forces, **NO_GRAVITY)


class Pair(NamedTuple):
    """Two free rotors with an undamped mesh between them."""

    first: float = 0.01
    second: float = 0.04
    ratio: float = -0.5
    backlash: float = 0.02
    stiffness: float = 500.0

    @property
    def mass(self) -> float:
        return 1 / (1 / self.second + self.ratio**2 / self.first)

    def lag(self, t, speed):
        """Straight lines in the gap, half waves on the flanks."""
        w = np.sqrt(self.stiffness / self.mass)
        half, contact = self.backlash / 2 / speed, np.pi / w
        period = 2 * half + contact
        n = np.floor((t - half) / period)
        s, side = t - half - n * period, np.where(n % 2 == 0, 1.0, -1.0)
        pressed = self.backlash / 2 + speed / w * np.sin(w * s)
        flying = self.backlash / 2 - speed * (s - contact)
        return np.where(t < half, speed * t, side * np.where(s < contact, pressed, flying))


def test_flanks_met_in_turn_are_the_piecewise_closed_form():
    pair, ts = Pair(), np.linspace(0.0, 1.0, 201)
    mesh = sj.forces.Gear(ONE, TWO, pair.ratio, pair.backlash, pair.stiffness)
    run = sj.simulate(rotors((pair.first, pair.second), (30.0, -14.0), {"mesh": mesh}), ts, rtol=1e-10)
    found = run.require_success().force("mesh")
    speed = -14.0 - pair.ratio * 30.0
    # Some thirty meetings while both rotors make turns.
    assert np.sum(np.diff(np.sign(found["force"])) != 0) > 20
    np.testing.assert_allclose(found["lag"], pair.lag(ts, speed), atol=1e-6 * pair.backlash)
    w = [np.asarray(run.angular_velocity(name))[:, 2] for name in ("one", "two")]
    momentum = pair.first * w[0] / pair.ratio + pair.second * w[1]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-12)


def law(u, rate, gear):
    """f on x_2 and on x_1 over the ratio, written out: the law of the module's head."""
    depth, side = abs(u) - gear["backlash"] / 2, np.sign(u)
    if depth <= 0:
        return 0.0
    onset = gear.get("onset", 0.0)
    ramp = depth - onset / 2 if depth >= onset else depth**2 / (2 * onset)
    rise = 1.0 if depth >= onset else (depth / onset) ** 2 * (3 - 2 * depth / onset)
    return -side * max(0.0, gear["stiffness"] * ramp + rise * gear["damping"] * side * rate)


@pytest.mark.slow
def test_backlash_of_an_actuator_against_scipy():
    """The numbers of mujoco's issue 3468: rotor 0.01 kg m^2, dead band +-0.05 rad, 1e4 N m/rad, 2 N m s/rad."""
    gear = {"backlash": 0.1, "stiffness": 1e4, "damping": 2.0, "onset": 1e-4}
    rotor, load, torque, rate = 0.01, 0.1, 3.0, 2.0
    forces = {
        "mesh": sj.forces.Gear(ONE, TWO, 1.0, **gear),
        "motor": sj.Actuator(ONE, sj.functions.Sine(torque, rate)),
        "friction": sj.TorsionalSpring(("ground", "two"), AXIS, damping=0.3),
    }
    ts = np.linspace(0.0, 0.6, 121)
    run = sj.simulate(rotors((rotor, load), (0.0, 0.0), forces), ts, rtol=1e-9, atol=1e-11).require_success()

    def rates(t, y):
        f = law(y[1] - y[0], y[3] - y[2], gear)
        drive = torque * np.sin(2 * np.pi * rate * t)
        return [y[2], y[3], (drive - f) / rotor, (f - 0.3 * y[3]) / load]

    def lag(t, y, border):
        return abs(y[1] - y[0]) - border

    # From flank to flank: an integrator restarted wherever the law has a kink.
    t, y, states = 0.0, np.zeros(4), []
    borders = (0.05, 0.05 + gear["onset"])
    while t < ts[-1]:
        events = [lambda t, y, border=border: lag(t, y, border) for border in borders]
        for event in events:
            event.terminal = True
        wanted = ts[(ts >= t) & (ts <= ts[-1])]
        part = solve_ivp(
            rates, (t, ts[-1]), y, "DOP853", rtol=1e-11, atol=1e-13, events=events, dense_output=True, max_step=2e-3
        )
        end = part.t[-1]
        states += [part.sol(s) for s in wanted if s <= end and len(states) < len(ts)][: len(ts) - len(states)]
        t, y = end, part.y[:, -1]
        if part.status == 1:
            # A step beyond the kink, by the equations themselves.
            small = 1e-9
            y, t = y + small * np.array(rates(t, y)), t + small
    expected = np.array(states[: len(ts)])
    found = run.force("mesh")
    assert found["force"].min() < -1.0 < 1.0 < found["force"].max()
    np.testing.assert_allclose(found["lag"], expected[:, 1] - expected[:, 0], atol=1e-5 * gear["backlash"])
    np.testing.assert_allclose(run.angular_velocity("two")[:, 2], expected[:, 3], atol=1e-5)


class RattleMap(NamedTuple):
    """One rattling stage with ideal impacts, from meeting to meeting: Pfeiffer and Kunert (1990)."""

    backlash: float
    restitution: float
    drag: float
    amplitude: float
    frequency: float

    def relative(self, s, start):
        """Lag and its rate after s, from (t, u, rate, wheel's speed): the wheel slows down, the pinion swings."""
        t, u, _, speed = start
        w = 2 * np.pi * self.frequency
        decay = np.exp(-self.drag * s)
        travel = speed * (1 - decay) / self.drag
        swing = self.amplitude * (np.sin(w * (t + s)) - np.sin(w * t))
        return u + travel + swing, speed * decay + self.amplitude * w * np.cos(w * (t + s))

    def meetings(self, start, n):
        """Instants [s] and rates of the lag just before [m/s]."""
        found = []
        for _ in range(n):

            def beyond(s, start=start):
                return np.abs(self.relative(s, start)[0]) - self.backlash / 2

            grid = np.linspace(1e-6, 0.2, 40001)
            first = np.argmax(beyond(grid) > 0)
            s = brentq(beyond, grid[first - 1], grid[first])
            u, rate = self.relative(s, start)
            speed = start[3] * np.exp(-self.drag * s)
            found.append((start[0] + s, rate))
            start = (start[0] + s, np.sign(u) * self.backlash / 2, rate, speed - (1 + self.restitution) * rate)
        return np.array(found)


@pytest.mark.slow
def test_a_rattling_wheel_follows_the_map_of_impacts():
    """One stage as published, in the limit of hard flanks: instants and speeds of the first meetings."""
    module = importlib.import_module("spherejax.gallery.rattling_gears")
    inertia = module.MASSES[1] * module.WHEEL**2 / 2
    drag, backlash, e = 0.05, 2e-4, 0.8
    exact = RattleMap(backlash, e, drag / inertia, 0.02 * module.PINION, 20.0).meetings((0.0, 0.0, None, 0.0), 5)
    ts = np.linspace(0.0, float(exact[-1, 0]) + 1e-3, 4001)
    errors = []
    for stiffness in (1e8, 1e10):
        scene = sj.gallery.rattling_gears(speed=0.0, drag=drag)
        mesh = scene.forces["mesh"]
        hard = sj.forces.Gear(mesh.first, mesh.second, -1.0, backlash, stiffness, restitution=e, transition=1e-4)
        scene = sj.Scene(scene.bodies, scene.joints, {**scene.forces, "mesh": hard})
        run = sj.simulate(scene, ts, rtol=1e-9, atol=1e-12).require_success()
        outside = np.abs(run.force("mesh")["lag"]) >= backlash / 2
        before = np.flatnonzero(outside[1:] & ~outside[:-1])
        found = np.stack([ts[before], run.force("mesh")["lag_rate"][before]], 1)
        assert found.shape == exact.shape
        errors.append(np.max(np.abs(found[:, 1] / exact[:, 1] - 1)))
    assert errors[1] < 1e-2 < errors[0] < 1e-1


@pytest.mark.slow
def test_a_stiffness_that_varies_with_the_teeth_keeps_the_energy():
    teeth = 21
    profile = {"profile": sj.functions.Sine(0.3, 1.0, offset=1.0), "pitch": 2 * np.pi / teeth}
    mesh = sj.forces.Gear(ONE, TWO, -0.5, 0.02, 500.0, **profile)
    ts = np.linspace(0.0, 0.5, 101)
    run = sj.simulate(rotors((0.01, 0.04), (30.0, -14.0), {"mesh": mesh}), ts, rtol=1e-10).require_success()
    energy = np.asarray(run.mechanical_energy)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    # And against an integration of its own, by the force alone.
    inertias, ratio, gap = (0.01, 0.04), -0.5, 0.02

    def rates(t, y):
        u = y[1] - ratio * y[0]
        depth = max(abs(u) - gap / 2, 0.0)
        phase = teeth * y[0]
        factor, slope = 1 + 0.3 * np.sin(phase), 0.3 * teeth * np.cos(phase)
        f = np.sign(u) * 500.0 * factor * depth
        return [y[2], y[3], (ratio * f - 500.0 * slope * depth**2 / 2) / inertias[0], -f / inertias[1]]

    other = solve_ivp(rates, (0, 0.5), [0, 0, 30.0, -14.0], "DOP853", t_eval=ts, rtol=1e-11, atol=1e-13, max_step=2e-4)
    lag = other.y[1] - ratio * other.y[0]
    np.testing.assert_allclose(run.force("mesh")["lag"], lag, atol=1e-6)


def test_a_rack_rattles_on_its_pinion_as_the_piecewise_closed_form_says():
    """A turn and a travel: u = x - r a, and I w/r + m v stays as it is."""
    pair, speed, ts = Pair(0.002, 1.5, 0.04, 2e-4, 4e5), 0.05, np.linspace(0.0, 0.03, 301)
    pinion = sj.Body(1.0, (pair.first,) * 3, angular_velocity=(0.0, 0.0, 2.0))
    rack = sj.Body(pair.second, (0.1,) * 3, position=(0.0, 0.04, 0.0), velocity=(2.0 * pair.ratio + speed, 0.0, 0.0))
    turn, travel = sj.Turn(("ground", "pinion"), AXIS), sj.Travel(("ground", "rack"), (1.0, 0.0, 0.0))
    scene = sj.Scene(
        {"pinion": pinion, "rack": rack},
        {
            "bearing": sj.Revolute(("ground", "pinion"), (0.0, 0.0, 0.0), AXIS),
            "guide": sj.Prismatic(("ground", "rack"), (0.0, 0.04, 0.0), (1.0, 0.0, 0.0)),
        },
        {"teeth": sj.forces.Gear(turn, travel, pair.ratio, pair.backlash, pair.stiffness)},
        **NO_GRAVITY,
    )
    run = sj.simulate(scene, ts, rtol=1e-10)
    np.testing.assert_allclose(run.force("teeth")["lag"], pair.lag(ts, speed), atol=1e-8)
    spin, way = run.angular_velocity("pinion")[:, 2], run.velocity("rack")[:, 0]
    momentum = pair.first * spin / pair.ratio + pair.second * way
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)
    assert np.ptp(spin) > 1.0  # the flanks have met


@pytest.mark.parametrize("efficiency", [pytest.param(1.0, marks=pytest.mark.slow), 0.6])
def test_a_screw_lifts_and_falls_by_its_efficiency(efficiency):
    lead = 0.005 / (2 * np.pi)
    nut = sj.Body(20.0, (0.1, 0.1, 0.1), position=(0.0, 0.0, 0.0))

    def moment(speed):
        scene = sj.Scene(
            {"nut": nut, "screw": sj.Body(1.0, (1e-3,) * 3, angular_velocity=(0.0, 0.0, speed))},
            {
                "guide": sj.Prismatic(("ground", "nut"), (0.0, 0.0, 0.0), AXIS),
                "bearing": sj.Revolute(("ground", "screw"), (0.0, 0.0, 0.0), AXIS),
                "motor": sj.RotationDriver(("ground", "screw"), AXIS, rate=speed),
            },
            {
                "thread": sj.forces.Gear(
                    sj.Turn(("ground", "screw"), AXIS),
                    sj.Travel(("ground", "nut"), AXIS),
                    lead,
                    backlash=1e-4,
                    stiffness=1e7,
                    damping=2e4,
                    onset=1e-6,
                    offset=0.5e-4 + 20.0 * 9.81 / 1e7,
                    efficiency=efficiency,
                )
            },
        )
        run = sj.simulate(scene, np.linspace(0.0, 0.2, 3), rtol=1e-8).require_success()
        return run.driving_effort("motor")[-1]

    weight = 20.0 * 9.81 * lead
    # The nut hangs on the lower flank; u is offset so that it starts there.
    assert moment(10.0) == pytest.approx(weight / efficiency, rel=1e-4)
    assert moment(-10.0) == pytest.approx(weight * (2 - 1 / efficiency), rel=1e-4)


@pytest.mark.slow
def test_a_train_of_two_meshes_and_inverse_dynamics():
    """Three shafts: at a steady speed the moment goes through by the ratios; inverse dynamics gives it back."""
    three = sj.Turn(("ground", "three"), AXIS)
    meshes = {
        "first_mesh": sj.forces.Gear(ONE, TWO, -0.5, 1e-3, 1e3, 1.0, 1e-5),
        "second_mesh": sj.forces.Gear(TWO, three, -0.25, 1e-3, 1e3, 1.0, 1e-5),
        "brake": sj.TorsionalSpring(("ground", "three"), AXIS, damping=2.0),
    }
    scene = rotors((1e-3, 1e-3, 1e-3), (16.0, -8.0, 2.0), meshes)
    motor = {"motor": sj.RotationDriver(("ground", "one"), AXIS, rate=16.0)}
    scene = sj.Scene(scene.bodies, {**scene.joints, **motor}, scene.forces, **NO_GRAVITY)
    run = sj.simulate(scene, np.linspace(0.0, 2.0, 21), rtol=1e-8).require_success()
    effort = run.driving_effort("motor")
    assert effort[-1] == pytest.approx(2.0 * 2.0 / 8.0, rel=1e-6)
    np.testing.assert_allclose(run.position("three")[-1], [2.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(inverse_dynamics(scene, run).effort("motor"), effort, atol=1e-9)


@pytest.mark.slow
def test_derivatives_by_every_number():
    gear = {"backlash": 0.02, "stiffness": 500.0, "damping": 0.5, "onset": 1e-3, "offset": 1e-3}
    start = {"ratio": -0.5, **gear, "pitch": 0.3, "efficiency": 0.9}

    def end(numbers):
        numbers = dict(numbers)
        mesh = sj.forces.Gear(ONE, TWO, profile=sj.functions.Sine(0.2, 1.0, offset=1.0), **numbers)
        run = sj.simulate(rotors((0.01, 0.04), (30.0, -14.0), {"mesh": mesh}), jnp.array([0.0, 0.05]), rtol=1e-11)
        return run.angular_velocity("two")[-1, 2]

    exact = jax.jacfwd(end)(start)
    assert min(abs(float(x)) for x in exact.values()) > 1e-6
    for name, value in start.items():
        step = 3e-4 * abs(value)
        difference = (end({**start, name: value + step}) - end({**start, name: value - step})) / (2 * step)
        assert float(exact[name]) == pytest.approx(float(difference), rel=1e-3), name


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"backlash": 0.0}, "use a Coupler"),
        ({"stiffness": 0.0}, "stiffness"),
        ({"damping": 1.0}, "onset"),
        ({"efficiency": 1.2}, r"efficiency .* lie in \(0, 1\]"),
        ({"pitch": 0.1}, "pitch .* stand with a profile"),
        ({"profile": sj.functions.Sine(0.1, 1.0, offset=1.0)}, "pitch .* stand with a profile"),
        ({"restitution": 1.5}, "restitution"),
    ],
)
def test_bad_numbers(more, message):
    numbers = {"backlash": 0.01, "stiffness": 10.0, **more}
    scene = rotors((0.01, 0.04), (1.0, 0.0), {"mesh": sj.forces.Gear(ONE, TWO, **numbers)})
    with pytest.raises(sj.SceneError, match=message):
        sj.simulate(scene, np.linspace(0.0, 0.1, 3))
