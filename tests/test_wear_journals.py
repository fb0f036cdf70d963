"""Wear of journals and bearings: closed forms, a solution of its own along the cycles, conservation, bad input."""

import warnings

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import spherejax as sj
from spherejax.physics.laws.wear import journal_foundation_depth, journal_foundation_force
from spherejax.studies.wear.charts import CircleChart

C, R, L, LOAD, RATE = 1e-4, 1e-2, 0.02, 200.0, 30.0
K, FOUNDATION, SPRING, STIFFNESS = 1e-13, 1e12, 2e6, 1.5e10
TURN, SETTLED = 2 * np.pi / RATE, 0.1
TS = np.linspace(0.0, SETTLED + TURN, 21)
OPTIONS = {"k_socket": K, "k_ball": 0.0, "window": (SETTLED, SETTLED + TURN), "length": L}


def indentation(load):
    return (load / STIFFNESS) ** (2 / 3)


def dry(**options):
    law = sj.laws.HuntCrossleyDissipation(dissipation=30.0, stiffness=STIFFNESS, exponent=1.5)
    return sj.Dry(C, socket_radius=R, normal=law, **options)


def scene(spring=SPRING, model=None):
    """A journal that turns about y, and is pressed on its bearing's bottom by a spring, which wear relaxes."""
    start = -C - indentation(LOAD)
    center = {"center": (0, 0, 0)}
    shaft = sj.Body(
        1.0, (1e-3,) * 3, position=(0, 0, start), angular_velocity=(0, RATE, 0), points=center,
        quaternion=(0.6, 0.8, 0, 0),
    )  # fmt: skip
    joint = sj.Revolute(
        ("ground", "shaft"), (0, 0, 0), (0, 1, 0), dry() if model is None else model, starts_concentric=False,
        second_point=(0, 0, start),
    )  # fmt: skip
    pull = sj.SpringDamper(("ground.anchor", "shaft.center"), spring, 300.0, 1.0 + start - LOAD / spring)
    ground = {"anchor": (0, 0, -1.0)}
    return sj.Scene({"shaft": shaft}, {"joint": joint}, {"spring": pull}, gravity=(0, 0, 0), ground_points=ground)


def near(value, rel):
    return pytest.approx(value, rel=rel, abs=0.0)


@pytest.fixture(scope="module")
def steady():
    """A spring so soft that the load does not change."""
    return sj.simulate(scene(spring=1e3), TS, rtol=1e-8)


# The law --------------------------------------------------------------------------------------------------------------


def test_the_foundation_of_an_arc_is_its_integral_and_its_inverse():
    for depth in (1e-9, 1e-6, 5e-5, 1e-3, 1e-2):
        half = np.arccos(C / (C + depth))

        def pressure(phi, depth=depth):
            return ((C + depth) * np.cos(phi) - C) * np.cos(phi)

        expected = FOUNDATION * R * L * quad(pressure, -half, half, epsabs=0, epsrel=1e-11)[0]
        force = float(journal_foundation_force(depth, C, R, L, FOUNDATION))
        assert force == near(expected, 1e-8)
        assert float(journal_foundation_depth(force, C, R, L, FOUNDATION)) == near(depth, 1e-12)
    small = 1e-12
    expected = 4 / 3 * R * L * small * (2 * small / C) ** 0.5
    assert float(journal_foundation_force(small, C, R, L, 1.0)) == near(expected, 1e-7)
    assert float(journal_foundation_depth(0.0, C, R, L, 1.0)) == 0.0


def test_a_map_around_the_axis_loses_nothing():
    chart = CircleChart(48)
    turn = np.linspace(-7.0, 7.0, 501)
    u = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
    cells, weights = (np.asarray(x) for x in chart.corners(u))
    np.testing.assert_allclose(weights.sum(1), 1.0, rtol=1e-14)
    assert weights.min() >= 0
    assert cells.min() >= 0
    assert cells.max() < 48
    values = np.sin(3 * np.arctan2(chart.centers[:, 1], chart.centers[:, 0]))
    np.testing.assert_allclose(np.asarray(chart.sampled(values, u)), np.sin(3 * turn), atol=0.03)


# Against closed forms -------------------------------------------------------------------------------------------------


def rigid_depth(cycles, load=LOAD):
    """How far a rigid journal has gone into a bearing that wears, and what it has rubbed off.

    It goes straight on, so that h = s cos phi - c where that is positive, and there the load is carried by
    p = (ds/dN) cos phi/(k 2 pi (R - s cos phi)).
    """

    def number(theta):
        def slope(t):
            s = C / np.cos(t)
            carried = quad(lambda phi: np.cos(phi) ** 2 / (R - s * np.cos(phi)), -t, t)[0]
            return C * np.sin(t) / np.cos(t) ** 2 * carried * R * L / (2 * np.pi * K * load)

        return quad(slope, 0, theta)[0]

    theta = brentq(lambda t: number(t) - cycles, 1e-6, 1.5)
    s = C / np.cos(theta)
    return s - C, 2 * R * L * (s * np.sin(theta) - C * theta)


@pytest.mark.slow
def test_a_journal_under_a_constant_load_wears_its_bearing_as_the_closed_form_says(steady):
    stiff = sj.wear(steady, "joint", cycles=2500.0, foundation=1e13, largest_block=0.1, **OPTIONS)
    depth, volume = rigid_depth(2500.0)
    assert stiff.succeeded
    assert stiff.volumes("socket")[-1] == near(volume, 3e-3)
    # The foundation yields by some 0.3 um of the 19 um.
    assert stiff.deepest("socket")[-1] == near(depth, 0.02)
    assert stiff.checks.lost < 1e-12
    angle = np.degrees(np.arctan2(*stiff.directions[np.argmax(stiff.depth("socket")), 1::-1]))
    # About y the joint's x is -z, where the load presses.
    assert abs(angle) < 1.0
    assert float(stiff.depth_at("socket", np.array([0, 0, -1.0]))) == near(stiff.deepest("socket")[-1], 1e-3)


def test_a_narrow_patch_wears_k_times_load_times_way(steady):
    worn = sj.wear(steady, "joint", foundation=1e14, **OPTIONS)
    way = 2 * np.pi * (R - C - indentation(LOAD))
    assert worn.volume_per_cycle["socket"] == near(K * LOAD * way, 1.5e-3)
    assert worn.checks.slid == near(LOAD * way, 1e-6)


def test_the_journal_itself_wears_evenly_around(steady):
    options = {**OPTIONS, "k_socket": 0.0, "k_ball": K}
    worn = sj.wear(steady, "joint", foundation=1e12, cells=96, **options)
    depth = worn.depth("ball")
    assert np.ptp(depth) < 0.02 * depth.mean()
    assert worn.volume_per_cycle["ball"] == near(K * worn.checks.rubbed, 1e-9)


def test_a_width_that_follows_from_hertz():
    """Of the contact of a cylinder: 2 R sqrt(f/c), b^2 = 4 R^2 f/c."""
    model = sj.Dry(C, socket_radius=R, conformity=sj.laws.JohnsonCylinder(L))
    depth = CircleChart.matched_depth(model, LOAD, 1e-6)
    f = 2 * (1 - 0.3**2) / 207e9 * LOAD / (np.pi * L)
    assert depth == near(2 * f, 1e-12)
    assert CircleChart.matched_depth(dry(), LOAD, 1e-6) == 1e-6


# With a motion that follows -------------------------------------------------------------------------------------------


class Independent:
    """The depth of the bearing at angles, in NumPy, with SciPy's steps in the number of cycles."""

    def __init__(self):
        node, share = np.polynomial.legendre.leggauss(160)
        self.phi, self.areas = 1.2 * node, 1.2 * share * R * L

    def approach(self, depth, load):
        def missing(s):
            pressure = FOUNDATION * np.maximum(0, s * np.cos(self.phi) - C - depth)
            return float((pressure * np.cos(self.phi) * self.areas).sum() - load)

        return float(brentq(missing, 0.5 * C, 4 * C, xtol=1e-16))

    def farther(self, depth, load):
        return self.approach(depth, load) - self.approach(0.0, load)

    def load(self, depth):
        def missing(load):
            return LOAD - SPRING * (self.farther(depth, load) + indentation(load) - indentation(LOAD)) - load

        return float(brentq(missing, 1.0, LOAD + 1))

    def rate(self, _, depth):
        load = self.load(depth)
        pressure = FOUNDATION * np.maximum(0, self.approach(depth, load) * np.cos(self.phi) - C - depth)
        e = C + self.farther(depth, load) + indentation(load)
        return K * pressure * RATE * (R - e * np.cos(self.phi)) * TURN

    def depths(self, cycles):
        found = solve_ivp(self.rate, (0, cycles[-1]), np.zeros(160), rtol=1e-4, atol=1e-9, t_eval=cycles)
        return found.y.T


@pytest.fixture(scope="module")
def follows():
    return sj.studies.wear_in(scene(), "joint", TS, cycles=1200.0, foundation=FOUNDATION, rtol=1e-8, **OPTIONS)


@pytest.mark.slow
def test_wear_with_a_spring_that_it_relaxes_is_that_of_another_solution(follows):
    other = Independent()
    depths = other.depths(follows.cycles[1:])
    volumes = [float(depth @ other.areas) for depth in depths]
    loads = [other.load(depth) for depth in depths]
    np.testing.assert_allclose(follows.volumes("socket")[1:], volumes, rtol=4e-3)
    np.testing.assert_allclose([block.impulse / TURN for block in follows.blocks[1:]], loads, rtol=2e-3)
    assert follows.deepest("socket")[-1] == near(depths[-1].max(), 0.01)
    gone = -np.asarray(follows.run.eccentricity("joint"))[-1, 2] - C
    assert gone == near(other.farther(depths[-1], loads[-1]) + indentation(loads[-1]), 5e-3)
    # Without a motion that follows it would be more.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.errors.WearWarning)
        stays = sj.wear(sj.simulate(scene(), TS, rtol=1e-8), "joint", cycles=1200.0, foundation=FOUNDATION, **OPTIONS)
    assert stays.volumes("socket")[-1] > 1.05 * volumes[-1]


@pytest.mark.slow
def test_the_worn_scene_has_a_bearing_that_is_not_round(follows, tmp_path):
    model = follows.scene.joints["joint"].model
    assert isinstance(model.socket_depth, sj.laws.FourierDepth)
    assert model.ball_depth is None
    path = tmp_path / "worn.toml"
    sj.save_scene(follows.scene, path)
    back = sj.load_scene(path).joints["joint"].model
    np.testing.assert_array_equal(back.socket_depth.coefficients, model.socket_depth.coefficients)


@pytest.mark.slow
def test_results_are_told_and_saved(follows, tmp_path):
    text = str(follows)
    assert "bearing (ground" in text
    assert "journal (shaft" in text
    assert "cells" in text
    table = follows.to_xarray()
    assert table["depth"].dims == ("side", "around")
    total = table["depth"].sum("around") * table.attrs["cell_area"]
    np.testing.assert_allclose(total, table["volume"].isel(cycle=-1), rtol=1e-12)
    assert table["socket_profile"].shape == (len(follows.cycles), 33)
    follows.save(tmp_path / "worn.nc")
    assert len(follows.figure().axes) == 3


# Slider-crank ---------------------------------------------------------------------------------------------------------

CRANK, ROD, PRESSED, SPEED, SOFT = 0.05, 0.12, 500.0, 20.0, 2e9
POLYMER = 5e-13
"""k of the bush [m^2/N]: PTFE on steel has some 5e-4 mm^3/(N m)."""


def slider_crank():
    """The gallery's piston, whose pin a constant load keeps on one side of a bush of polymer on the rod."""
    law = sj.laws.HuntCrossleyDissipation(dissipation=30.0, stiffness=SOFT, exponent=1.5)
    piston = sj.gallery.piston(sj.Dry(C, socket_radius=R, normal=law), speed=SPEED)
    return sj.Scene(piston.bodies, piston.joints, {"load": sj.AppliedWrench("piston", force=(-PRESSED, 0, 0))})


class SlowCrank:
    """The same without steps in time: Newton's equations along the motion that the crank prescribes, by FFT.

    The journal rests in its worn bush where the load presses it, which moves piston and rod; angles are about y.
    """

    def __init__(self, n=240, cells=720):
        self.n, self.turn = n, 2 * np.pi / SPEED
        self.times = self.turn * np.arange(n) / n
        self.around = 2 * np.pi * (np.arange(cells) + 0.5) / cells
        self.area = R * L * 2 * np.pi / cells

    def slope(self, y):
        frequency = 2j * np.pi * np.fft.fftfreq(self.n, d=self.times[1])
        return np.real(np.fft.ifft(frequency * np.fft.fft(y)))

    def motion(self, gone):
        """Force [N], its direction from the bush's center in the world and in the rod's axes, and the sliding [m/s].

        Args:
            gone: how far the journal's center is from the bush's, at each instant [m].
        """
        a, away = SPEED * self.times, np.zeros((2, self.n))
        pin = np.stack([CRANK * np.cos(a), -CRANK * np.sin(a)])
        for _ in range(4):
            # The rod's end is off the piston's pin by minus the eccentricity.
            across = -away[1] - pin[1]
            end = np.stack([pin[0] + np.sqrt(ROD**2 - across**2), -away[1]])
            piston, middle = end[0] + away[0], (pin + end) / 2
            accelerated = np.stack([self.slope(self.slope(x)) for x in middle])
            turned = np.arctan2(-(end - pin)[1], (end - pin)[0])
            along = 0.14 * self.slope(self.slope(piston)) + PRESSED
            arm = end - pin
            inertia = 0.21 * (accelerated + np.array([[0.0], [9.81]]))
            moment = 2.5e-4 * self.slope(self.slope(turned)) + (arm[1] * inertia[0] - arm[0] * inertia[1]) / 2
            force = np.stack([along, (moment + arm[1] * along) / arm[0]])
            size = np.hypot(*force)
            away = -gone * force / size
        angle = np.unwrap(np.arctan2(-away[1], away[0]))
        sliding = np.abs(gone * self.slope(angle) - R * self.slope(turned))
        return size, angle - turned, sliding

    def approach(self, depth, size, angle):
        """How far the foundation lets the journal go, by halving."""
        x = np.cos(self.around[None] - angle[:, None])
        low, high = np.full(self.n, 0.0), np.full(self.n, 10 * C)
        for _ in range(60):
            s = (low + high) / 2
            carried = self.pressure(depth, s, x) * np.maximum(x, 0.0) * self.area
            low, high = np.where(carried.sum(1) < size, s, low), np.where(carried.sum(1) < size, high, s)
        return s, x

    def pressure(self, depth, s, x):
        return FOUNDATION * np.maximum(0.0, s[:, None] * x - C - depth[None]) * (x > 0)

    def rate(self, depth):
        gone = np.full(self.n, C)
        for _ in range(3):
            size, angle, sliding = self.motion(gone)
            s, x = self.approach(depth, size, angle)
            gone = s - self.approach(0 * depth, size, angle)[0] + C + (size / SOFT) ** (2 / 3)
        pressure = self.pressure(depth, s, x)
        return POLYMER * self.turn * np.mean(pressure * sliding[:, None], axis=0), gone

    def depth(self, cycles, blocks=24):
        """Heun's method, in blocks that are longer and longer."""
        depth, ends = np.zeros(len(self.around)), cycles * np.linspace(0, 1, blocks + 1) ** 2
        for block in np.diff(ends):
            first = self.rate(depth)[0]
            depth = depth + block / 2 * (first + self.rate(depth + block * first)[0])
        return depth


@pytest.mark.slow
def test_a_slider_crank_wears_its_pins_bush_as_another_solution_says():
    other, cycles = SlowCrank(), 2000.0
    cycle = (0.3, 0.3 + other.turn)
    ts = np.concatenate([[0.0], np.linspace(*cycle, 25)])
    worn = sj.studies.wear_in(
        slider_crank(), "pin", ts, k_socket=POLYMER, k_ball=0.0, window=cycle, cycles=cycles, length=L,
        foundation=FOUNDATION, rtol=1e-8,
    )  # fmt: skip
    volume = other.rate(np.zeros(720))[0].sum() * other.area
    assert worn.wear.volume_per_cycle["socket"] == near(volume, 1e-3)
    depth = other.depth(cycles)
    assert worn.volumes("socket")[-1] == near(depth.sum() * other.area, 2e-3)
    assert worn.deepest("socket")[-1] == near(depth.max(), 5e-3)
    gone = other.rate(depth)[1]
    eccentricity = np.linalg.norm(np.asarray(worn.run.eccentricity("pin")), axis=1)[1:]
    at = np.interp(np.mod(ts[1:], other.turn), np.append(other.times, other.turn), np.append(gone, gone[0]))
    np.testing.assert_allclose(eccentricity, at, rtol=3e-3)
    assert worn.wear.checks.lost < 1e-9


# Bad input ------------------------------------------------------------------------------------------------------------


def test_a_length_is_asked_for_where_it_is_not_known(steady):
    options = {**OPTIONS}
    del options["length"]
    with pytest.raises(sj.SceneError, match="give length="):
        sj.wear(steady, "joint", **options)
    for wrong, said in ((-1.0, "length"), ("long", "must be a number")):
        with pytest.raises(sj.SceneError, match=said):
            sj.wear(steady, "joint", **{**OPTIONS, "length": wrong})


def test_a_ball_has_no_length_and_a_rim_no_map():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.errors.OutOfRangeWarning)
        hip = sj.simulate(sj.gallery.hip(sj.Dry(1e-4, socket_radius=0.014)), np.linspace(0, 0.01, 3))
    with pytest.raises(sj.SceneError, match="has no length"):
        sj.wear(hip, "cup", k_socket=K, k_ball=0.0, length=0.02)
    shaft = sj.Body(0.2, (3e-5,) * 3)
    rim = sj.joints.Rim(("ground", "shaft"), (0, 0, 0), (0, 1, 0), dry())
    tilts = sj.simulate(sj.Scene({"shaft": shaft}, {"rim": rim}), np.linspace(0, 0.001, 3))
    with pytest.raises(sj.SceneError, match=r"rim of a journal that tilts.*Give the name of the journal"):
        sj.wear(tilts, "rim", k_socket=K, k_ball=0.0, length=0.02)


def test_a_degree_beyond_those_of_a_journal_is_answered():
    with pytest.raises(sj.SceneError, match="at most 64"):
        sj.studies.wear_in(scene(), "joint", TS, cycles=10.0, degree=65, **OPTIONS)
