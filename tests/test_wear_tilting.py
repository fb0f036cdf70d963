"""Wear along a bearing's axis: closed forms, another solution for a journal that tilts, conservation, bad input."""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

import spherejax as sj
from spherejax.model.system import compile_scene
from spherejax.physics.joints.rim import lobatto
from spherejax.studies.wear.charts import AxialChart, Joint
from spherejax.studies.wear.planes import RubbingCycles, surface_of
from spherejax.studies.wear.study import contact_surface, cycles_of

C, R, L, RATE = 1e-4, 1e-2, 0.02, 30.0
K, FOUNDATION, STIFFNESS = 1e-13, 1e12, 1.5e10
TURN, SETTLED = 2 * np.pi / RATE, 0.1
TS = np.linspace(0.0, SETTLED + TURN, 21)
WINDOW = SETTLED, SETTLED + TURN
OPTIONS = {"k_socket": K, "k_ball": 0.0, "window": WINDOW, "foundation": FOUNDATION}
PLACES, LOADS, SPRING = np.array([-0.015, 0.015]), np.array([150.0, 50.0]), 1e6
"""Of two springs that press the shaft beside its bearing, so that it tilts."""


def dry(**options):
    law = sj.laws.HuntCrossleyDissipation(dissipation=30.0, stiffness=STIFFNESS, exponent=1.5)
    return sj.Dry(C, socket_radius=R, normal=law, **options)


def scene(planes, places=PLACES, loads=LOADS, spring=SPRING, *, others=None, **options):
    """A shaft that turns about x, and is pressed on its bearing's bottom; with no planes it is held parallel."""
    points = {f"at_{i}": (x, 0, 0) for i, x in enumerate(places)}
    shaft = sj.Body(1.0, (3e-4,) * 3, angular_velocity=(RATE, 0, 0), points=points)
    place = ("ground", "shaft"), (0, 0, 0), (1, 0, 0), dry()
    if planes:
        joints = dict(sj.joints.tilting_journal("pin", *place, length=L, planes=planes, **options))
    else:
        joints = {"pin": sj.Revolute(*place)}
    anchors = {name: (x, 0, -1.0) for name, (x, _, _) in points.items()}
    pulls = {
        name: sj.SpringDamper((f"ground.{name}", f"shaft.{name}"), spring, 300.0, 1.0 - C - load / spring)
        for name, load in zip(points, loads, strict=True)
    }
    return sj.Scene({"shaft": shaft}, {**joints, **(others or {})}, pulls, gravity=(0, 0, 0), ground_points=anchors)


def near(value, rel):
    return pytest.approx(value, rel=rel, abs=0.0)


def planes_of(run, count, quantity):
    return np.array([float(quantity(f"pin_{i + 1}")[-1, 2]) for i in range(count)])


@pytest.fixture(scope="module")
def tilts():
    """Soft springs, whose resultant acts 2 mm beside the middle."""
    return sj.simulate(scene(2, PLACES, (100.0 + 40.0 / 3, 100.0 - 40.0 / 3), 1e3), TS, rtol=1e-8)


@pytest.fixture(scope="module")
def parallel():
    return sj.simulate(scene(0, (0.0,), (200.0,), 1e3), TS, rtol=1e-8)


# One cycle ------------------------------------------------------------------------------------------------------------


def test_planes_that_share_a_load_evenly_wear_as_a_parallel_journal_to_rounding(parallel):
    """A share of the length that carries its share of the load is worn as deep, and all of them lose as much."""
    surface = contact_surface(parallel, "pin", L)
    whole = cycles_of(parallel, surface, (K, 0.0), WINDOW, FOUNDATION, 192)
    part, parts = whole.parts[0], []
    for share in lobatto(3)[1]:
        geometry = Joint(part.geometry.clearance, part.geometry.radius, share * L)
        contact = part.contacts.contact._replace(force=share * np.asarray(part.contacts.contact.force))
        parts.append(part._replace(geometry=geometry, contacts=part.contacts._replace(contact=contact)))
    chart = AxialChart(192, 3)
    shared = RubbingCycles("pin", tuple(parts), chart, R * L)
    ours, expected = shared.rate(shared.unworn), whole.rate(whole.unworn)
    each = np.asarray(ours.depth.socket).reshape(chart.shape)
    one = np.asarray(expected.depth.socket)
    np.testing.assert_allclose(each, np.stack([one] * 3), rtol=1e-11, atol=1e-14 * one.max())
    assert ours.volume[0] == near(expected.volume[0], 1e-12)
    assert chart.total(ours.depth.socket) * R * L == near(ours.volume[0], 1e-12)
    assert ours.approach == pytest.approx(expected.approach, abs=1e-20)


@pytest.fixture(scope="module")
def by_lever(tilts):
    return sj.wear(tilts, "pin", **OPTIONS)


def test_two_planes_wear_by_the_lever(tilts, by_lever):
    """Each takes its share of the load, whatever the stiffness, and loses k F times the way."""
    worn = by_lever
    ahead = (PLACES @ np.array([100.0 + 40.0 / 3, 100.0 - 40.0 / 3])) / 200.0
    loads = 200.0 * (0.5 + np.array([-1, 1]) * ahead / L)
    cell = worn.cell_area.ravel()
    volumes = worn.depth_per_cycle("socket").sum(axis=1) * cell
    places = np.abs(planes_of(tilts, 2, tilts.eccentricity))
    # A wide patch presses with more than its resultant.
    assert volumes == pytest.approx(K * loads * 2 * np.pi * (R - places), rel=0.015)
    assert volumes[0] / volumes[1] == near(loads[0] / loads[1], 5e-3)
    assert worn.volume_per_cycle["socket"] == near(volumes.sum(), 1e-12)
    assert worn.checks.lost < 1e-12
    assert worn.checks.slid == near((loads * 2 * np.pi * (R - places)).sum(), 1e-4)
    np.testing.assert_allclose(worn.along, [-L / 2, L / 2], rtol=1e-12)
    down = np.array([[0.0, 0.0, -1.0]])
    ends = [float(worn.depth_at("socket", down, along=x)[0]) for x in (-L / 2, 0.0, L / 2)]
    assert ends[1] == near((ends[0] + ends[2]) / 2, 1e-9)
    assert ends[0] > ends[2] > 0
    assert "along the axis, at -10, 10 mm" in str(worn)


@pytest.mark.slow
def test_the_journal_of_a_bearing_may_wear_in_a_map(tilts):
    worn = sj.wear(tilts, "pin", **{**OPTIONS, "k_socket": 0.0, "k_ball": K}, cells=192)
    depth = worn.depth("ball")
    assert np.all(np.ptp(depth, axis=1) < 0.05 * depth.mean(axis=1))
    assert worn.volume_per_cycle["ball"] == near(K * worn.checks.rubbed, 1e-9)


# Against a solution of its own ----------------------------------------------------------------------------------------


class Independent:
    """The same in NumPy: the bearing's depth in slices along the axis and at angles, SciPy's steps in the cycles.

    In each slice the foundation and the contact's own yield carry a load per length; two springs balance all slices.
    """

    def __init__(self, slices=16, angles=120):
        node, share = np.polynomial.legendre.leggauss(slices)
        self.z, self.widths = node * L / 2, share * L / 2
        node, share = np.polynomial.legendre.leggauss(angles)
        self.cos, self.arcs = np.cos(1.2 * node), 1.2 * share * R
        # Of an unworn bearing the load per length by how far the foundation yields.
        self.yields = np.concatenate([[0], np.geomspace(1e-9, 5e-5, 4000)])
        half, s = np.arccos(C / (C + self.yields)), C + self.yields
        self.unworn = FOUNDATION * R * (s * (half + np.sin(2 * half) / 2) - 2 * C * np.sin(half))
        self.start = np.array([5e-6, -1e-5])

    def pressure(self, depth, approach):
        return FOUNDATION * np.maximum(0, (C + approach)[:, None] * self.cos - C - depth)

    def load(self, depth, approach):
        return (self.pressure(depth, approach) * self.cos * self.arcs).sum(axis=1)

    def approach(self, depth, beyond):
        """How far the foundation lets the journal go where it is so far beyond the clearance, by halving."""
        low, high = np.full(len(beyond), -2e-5), np.maximum(beyond, 0) + 3e-5
        for _ in range(45):
            middle = (low + high) / 2
            q = self.load(depth, middle)
            there = middle - np.interp(q, self.unworn, self.yields) + (q * L / STIFFNESS) ** (2 / 3)
            low, high = np.where(there < beyond, middle, low), np.where(there < beyond, high, middle)
        return (low + high) / 2

    def beyond(self, x):
        return x[0] + x[1] * self.z / L

    def balanced(self, depth):
        """The shaft's place in the middle beyond the clearance, and its tilt times the length [m]."""

        def missing(x):
            q = self.load(depth, self.approach(depth, self.beyond(x)))
            pulls = LOADS - SPRING * (x[0] + x[1] * PLACES / L)
            return (q @ self.widths - pulls.sum()) / 100, (q * self.z) @ self.widths - pulls @ PLACES

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a precision below rounding
            self.start = fsolve(missing, self.start, xtol=1e-12)
        assert np.abs(missing(self.start)).max() < 1e-5
        return self.start

    def rate(self, _, flat):
        depth = flat.reshape(len(self.z), -1)
        beyond = self.beyond(self.balanced(depth))
        pressure = self.pressure(depth, self.approach(depth, beyond))
        return (K * pressure * RATE * TURN * (R - (C + beyond)[:, None] * self.cos)).ravel()

    def depth(self, cycles):
        start = np.zeros(len(self.z) * len(self.arcs))
        found = solve_ivp(self.rate, (0, cycles), start, rtol=1e-3, atol=1e-8, max_step=cycles / 30)
        return found.y[:, -1].reshape(len(self.z), -1)


@pytest.fixture(scope="module")
def follows():
    return sj.studies.wear_in(scene(5), "pin", TS, cycles=600.0, tolerance=0.05, rtol=1e-8, **OPTIONS)


@pytest.mark.slow
def test_a_journal_that_tilts_wears_its_bearing_as_another_solution_says(follows):
    """Its patch reaches along three quarters of the bearing in the end, at first along the half."""
    other = Independent()
    depth = other.depth(600.0)
    assert follows.succeeded
    volume = float((depth @ other.arcs) @ other.widths)
    assert follows.volumes("socket")[-1] == near(volume, 4e-3)
    x = other.balanced(depth)
    places = C + x[0] + x[1] * lobatto(5)[0] / 2
    gone = -planes_of(follows.run, 5, follows.run.eccentricity)
    assert np.abs(gone - places).max() < 0.01 * np.ptp(places)
    deepest = depth.max(axis=1)
    ours = follows.depth("socket").max(axis=1)[1:4]
    assert ours == pytest.approx(np.interp(lobatto(5)[0][1:4] * L / 2, other.z, deepest), abs=0.03 * deepest.max())
    assert follows.wear.checks.lost < 1e-12


@pytest.mark.slow
def test_a_worn_bearing_is_told_saved_and_gone_on_with(follows, tmp_path):
    table = follows.to_xarray()
    assert table["depth"].dims == ("side", "plane", "around")
    total = (table["depth"].sum("around") * table["cell_area"]).sum("plane")
    np.testing.assert_allclose(total, table["volume"].isel(cycle=-1), rtol=1e-12)
    assert table["socket_profile"].shape == (len(follows.cycles), 5, 33)
    follows.save(tmp_path / "worn.nc")
    assert len(follows.figure().axes) == 3
    profile = follows.profile("socket")
    assert isinstance(profile, sj.laws.LegendreFourierDepth)
    sj.save_scene(follows.scene, tmp_path / "worn.toml")
    back = sj.load_scene(tmp_path / "worn.toml")
    for i, place in enumerate(lobatto(5)[0]):
        coefficients = follows.blocks[-1].socket[i]
        np.testing.assert_allclose(profile.at(place).coefficients, coefficients, atol=1e-15)
        read = back.joints[f"pin_{i + 1}"].model.socket_depth
        np.testing.assert_array_equal(0.0 if read is None else read.coefficients, coefficients)


# A wedge --------------------------------------------------------------------------------------------------------------

TAPER, HARD = 8e-6, 1e13
"""How far the bearing's bottom falls from the middle to an end [m], and a hard foundation."""


def wedge(cycles, load):
    """How far a rigid journal has gone into a bearing that falls along its axis, and what it has rubbed off.

    It goes straight on by D, so that h = (C + D - t s) cos phi - C where that is positive, and there the load is
    carried by p = (dD/dN) cos phi/(k 2 pi (R - (C + D) cos phi)).
    """
    s, share = np.polynomial.legendre.leggauss(60)
    node, weight = np.polynomial.legendre.leggauss(40)

    def reach(gone):
        far = np.maximum(C + gone[:, None] - TAPER * s, C)
        return far, np.arccos(C / far)

    gone = -TAPER + (6e-5 + TAPER) * np.linspace(0, 1, 1501)
    half = reach(gone)[1]
    cos = np.cos(half[..., None] * node)
    carried = (cos**2 / (R - (C + gone)[:, None, None] * cos)) @ weight * half @ share
    slope = carried * R * L / 2 / (2 * np.pi * K * load)
    number = np.concatenate([[0], np.cumsum(np.diff(gone) * (slope[1:] + slope[:-1]) / 2)])
    at = np.interp(cycles, number, gone)
    far, half = reach(np.array([at]))
    return at, float(2 * R * (far * np.sin(half) - C * half)[0] @ share * L / 2)


@pytest.mark.slow
def test_a_journal_that_is_held_at_a_tilt_wears_a_wedge():
    held = {"held": sj.joints.ParallelAxes(("ground", "shaft"), (0, 0, 0), (1, 0, 0))}
    depth = sj.laws.LegendreFourierDepth([[0.0, 0.0, 0.0], [0.0, -TAPER, 0.0]])
    pressed = scene(3, (0.0,), (200.0,), 1e3, others=held, socket_depth=depth)
    options = {**OPTIONS, "foundation": HARD, "tolerance": 0.05}
    worn = sj.studies.wear_in(pressed, "pin", TS, cycles=1500.0, rtol=1e-8, **options)
    gone, volume = wedge(1500.0, 200.0)
    assert worn.volumes("socket")[-1] == near(volume, 5e-3)
    deepest = worn.depth("socket").max(axis=1)
    assert deepest[1] == near(gone, 0.01)
    # The surfaces yield by some micrometers, so the ends are less apart than the wedge: worn and yielded are a line.
    s, share = lobatto(3)
    yields = (planes_of(worn.run, 3, worn.run.reaction) / (STIFFNESS * share)) ** (2 / 3)
    off = deepest + yields
    np.testing.assert_allclose(off - off[1], -TAPER * s, atol=0.03 * TAPER)


def test_the_closed_form_of_a_wedge_is_that_of_a_straight_bearing_without_taper(monkeypatch):
    """Another integral of the same: by halving, with the volume in one formula."""
    monkeypatch.setattr(f"{__name__}.TAPER", 1e-12)
    gone, volume = wedge(800.0, 200.0)
    s = C + gone
    half = np.arccos(C / s)
    assert volume == near(2 * R * L * (s * np.sin(half) - C * half), 1e-6)
    narrow = brentq(lambda d: 2 * R * L * C * (2 * d / C) ** 1.5 / 3 - 800 * K * 200.0 * 2 * np.pi * R, 1e-9, 1e-4)
    assert gone == near(narrow, 0.1)


# The maps, and bad input ----------------------------------------------------------------------------------------------


def test_a_map_along_the_axis_is_a_polynomial_through_its_planes():
    chart = AxialChart(16, 4)
    s = chart.places
    values = np.outer(1 + 2 * s - s**2 + 0.5 * s**3, np.ones(16))
    np.testing.assert_allclose(chart.at(values.ravel(), 0.3), 1 + 0.6 - 0.09 + 0.0135, rtol=1e-13)
    assert chart.total(values) == near(2 * np.pi * (1 - 1 / 3), 1e-13)
    assert chart.total(np.ones(64)) == near(2 * np.pi, 1e-14)


@pytest.mark.parametrize(
    ("joint", "options", "words"),
    [
        ("pin_1", {}, "is a rim of a journal that tilts.*Give the name of the journal"),
        ("pin", {"length": 0.03}, "length = 0.03 m, and its planes are 0.02 m apart; leave"),
        ("shaft", {}, "no contact that could wear"),
    ],
)
def test_what_has_no_map_is_answered(tilts, joint, options, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.wear(tilts, joint, **{**OPTIONS, **options})


def test_a_place_along_the_axis_is_asked_for_where_it_matters(by_lever):
    worn = by_lever
    down = np.array([[0.0, 0.0, -1.0]])
    for along in (None, 0.011):
        with pytest.raises(sj.SceneError, match=r"must be a place along the axis from -0.01 to 0.01 m"):
            worn.depth_at("socket", down, along=along)


@pytest.mark.slow
def test_a_place_along_the_axis_is_none_of_a_parallel_journal(parallel):
    same = sj.wear(parallel, "pin", **OPTIONS, length=L)
    with pytest.raises(sj.SceneError, match="same along the axis; leave along= out"):
        same.depth_at("socket", np.array([[0.0, 0.0, -1.0]]), along=0.0)


def test_joints_that_are_no_planes_of_one_journal_are_answered():
    rims = {f"pin_{i}": sj.joints.Rim(("ground", "shaft"), (x, 0, 0), (1, 0, 0), dry()) for i, x in
            ((1, -0.01), (2, 0.002), (3, 0.01))}  # fmt: skip
    system = compile_scene(sj.Scene({"shaft": sj.Body(1.0, (3e-4,) * 3)}, rims)).system
    with pytest.raises(sj.SceneError, match="are not the planes of one journal that tilts"):
        surface_of(system, "pin", None)


def test_what_does_not_wear_in_is_answered_before_a_run():
    with pytest.raises(sj.SceneError, match=r"k_ball = 1e-13 m.2/N.*Give k_ball=0.0, or take sj.wear"):
        sj.studies.wear_in(scene(2), "pin", TS, cycles=10.0, **{**OPTIONS, "k_ball": K})
    with pytest.raises(sj.SceneError, match=r"'pin_1' is a rim of a journal that tilts.*Give the name of the journal"):
        sj.studies.wear_in(scene(2), "pin_1", TS, cycles=10.0, **OPTIONS)
    with pytest.raises(sj.SceneError, match=r"there is no joint \['pin'\]"):
        sj.studies.wear_in(scene(2), ["pin"], TS, cycles=10.0, **OPTIONS)
