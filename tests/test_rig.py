"""The suspension rig against corners solved by hand, unit loads, energies, and what it must refuse."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DoubleWishbone, characteristics, mcpherson_at

import spherejax as sj
from spherejax.gallery.wheel_suspensions import ARM_MASS, DOUBLE_WISHBONE, MCPHERSON, RACK_MASS, UPRIGHT_MASS

TOE, CAMBER = 0.002, -0.01
TRAVEL = np.array([-0.08, -0.04, 0.0, 0.03, 0.08, 0.03, 0.0])
STEER = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02, -0.04])

GEOMETRY = (
    "toe",
    "camber",
    "caster",
    "kingpin_inclination",
    "scrub_radius",
    "caster_trail",
    "track_change",
    "recession",
    "center_travel",
)


@pytest.fixture(scope="module")
def wishbone():
    return sj.vehicle.rig(sj.gallery.double_wishbone(static_toe=TOE, static_camber=CAMBER), TRAVEL, steer=STEER)


@pytest.fixture(scope="module")
def by_hand():
    return DoubleWishbone(DOUBLE_WISHBONE, TOE, CAMBER)


def read(hand, travel, steer=0.0):
    """Characteristics by hand."""
    center, down = hand.at["wheel_center"], hand.spin[2] * hand.spin - np.array([0.0, 0.0, 1.0])
    lowest = center + hand.radius * down / np.linalg.norm(down)
    return characteristics(hand.at_travel(travel, steer), hand.radius, lowest, center)


def slope(function, x, h=1e-4):
    """Derivative by differences of fourth order."""
    return (8 * (function(x + h) - function(x - h)) - (function(x + 2 * h) - function(x - 2 * h))) / (12 * h)


def test_double_wishbone_is_that_of_circles_and_spheres(wishbone, by_hand):
    assert np.all(wishbone.status == sj.vehicle.RigStatus.FOUND)
    for i, (travel, steer) in enumerate(zip(TRAVEL, STEER, strict=True)):
        expected = read(by_hand, travel, steer)
        for name in GEOMETRY:
            assert getattr(wishbone, name)[i] == pytest.approx(expected[name], abs=1e-10), (name, travel, steer)
    assert wishbone.toe[2] == pytest.approx(TOE, abs=1e-12)
    assert wishbone.camber[2] == pytest.approx(CAMBER, abs=1e-12)


def test_gradients_are_slopes_of_the_hand_written_positions(wishbone, by_hand):
    for i in (1, 3, 5):
        at, steer = TRAVEL[i], STEER[i]

        def patch(z, axis, steer=steer):
            return read(by_hand, z, steer)["patch"][axis]

        half_track = patch(at, 1)
        expected = {
            "toe_gradient": slope(lambda z, s=steer: read(by_hand, z, s)["toe"], at),
            "camber_gradient": slope(lambda z, s=steer: read(by_hand, z, s)["camber"], at),
            "roll_center_height": half_track * slope(lambda z: patch(z, 1), at),
            "braking_angle": np.arctan(slope(lambda z: patch(z, 0), at)),
            "driving_angle": np.arctan(
                slope(lambda z, s=steer: read(by_hand, z, s)["center"][0], at)
                / slope(lambda z, s=steer: read(by_hand, z, s)["center"][2], at)
            ),
            "steer_gradient": -slope(lambda s, z=at: read(by_hand, z, s)["toe"], steer),
            "motion_ratio": -slope(lambda z, s=steer: spring_length(by_hand, z, s), at),
        }
        for name, value in expected.items():
            assert getattr(wishbone, name)[i] == pytest.approx(value, rel=1e-8, abs=1e-9), name


def spring_length(hand, travel, steer=0.0):
    return np.linalg.norm(hand.at_travel(travel, steer)["spring"] - hand.at["spring_upper"])


def potential_energy(hand, travel, rate=60e3, preload=5.6e3):
    """Of the spring and of the weights; the rack stays at its height, arms turn with their centers."""
    from corners import on_hinge

    found = hand.at_travel(travel)
    free = np.linalg.norm(hand.at["spring_upper"] - hand.at["spring_lower"]) + preload / rate
    heights = UPRIGHT_MASS * found["center"][2] + RACK_MASS * hand.at["tie_rod_inner"][2]
    for arm, angle in (("lower_arm", found["angle"]), ("upper_arm", found["upper_angle"])):
        front, rear, ball = (hand.at[name] for name in (f"{arm}_front", f"{arm}_rear", f"{arm[:5]}_ball"))
        heights += ARM_MASS * on_hinge((front + rear + ball) / 3, rear, front, angle)[2]
    length = np.linalg.norm(found["spring"] - hand.at["spring_upper"])
    return 0.5 * rate * (length - free) ** 2 + 9.81 * heights


def test_wheel_load_and_rate_are_slopes_of_the_energy(wishbone, by_hand):
    for i in (1, 2, 3):

        def load(z):
            return slope(lambda x: potential_energy(by_hand, x), z, 1e-3)

        assert wishbone.wheel_load[i] == pytest.approx(load(TRAVEL[i]), rel=1e-8)
        assert wishbone.wheel_rate[i] == pytest.approx(slope(load, TRAVEL[i], 2e-3), rel=1e-6)
        # The spring's rate times the square of the motion ratio is the larger part of it, and not all.
        assert 0.85 < 60e3 * wishbone.motion_ratio[i] ** 2 / wishbone.wheel_rate[i] < 0.99


def test_roll_center_is_where_lines_through_instant_centers_meet():
    """Arms that turn about x, no caster: lines of the arms meet in the wheel's instant center."""
    planar = {
        "lower_arm_front": (0.2, 0.36, 0.19),
        "lower_arm_rear": (-0.2, 0.36, 0.19),
        "lower_ball": (0.0, 0.70, 0.17),
        "upper_arm_front": (0.2, 0.42, 0.48),
        "upper_arm_rear": (-0.2, 0.42, 0.48),
        "upper_ball": (0.0, 0.65, 0.52),
    }
    found = sj.vehicle.rig(sj.gallery.double_wishbone(planar), 0.0)
    (a, b), (c, d) = (((0.36, 0.19), (0.70, 0.17)), ((0.42, 0.48), (0.65, 0.52)))
    lower, upper = (d[1] - c[1]) / (d[0] - c[0]), (b[1] - a[1]) / (b[0] - a[0])
    y = (a[1] - c[1] + lower * c[0] - upper * a[0]) / (lower - upper)
    center = y, a[1] + upper * (y - a[0])
    height = center[1] / (0.75 - center[0]) * 0.75
    assert found.roll_center_height[0] == pytest.approx(height, rel=1e-10)
    assert found.camber_gradient[0] == pytest.approx(-1.0 / (0.75 - center[0]), rel=1e-10)


def test_mcpherson_is_that_of_six_equations():
    travel, steer = np.array([-0.06, 0.05, 0.0]), np.array([0.0, 0.0, 0.03])
    found = sj.vehicle.rig(sj.gallery.mcpherson(), travel, steer=steer)
    p = {name: np.asarray(place) for name, place in MCPHERSON.items()}
    for i in range(3):
        at = mcpherson_at(MCPHERSON, travel[i], steer[i])
        expected = characteristics(at, 0.3, p["contact_patch"], p["wheel_center"])
        for name in GEOMETRY:
            assert getattr(found, name)[i] == pytest.approx(expected[name], abs=1e-9), name


RADIAL, AXIAL = 8e6, 2e6


def rubber(radial=RADIAL, axial=AXIAL, conical=0.0, torsional=1e-6):
    """Two stiffnesses of translation, and just as much torsion as a law of a joint that turns must have."""
    law = sj.laws.MatrixElastomer.cylindrical(
        (0.0, 0.0, 1.0),
        radial_stiffness=radial,
        axial_stiffness=axial,
        conical_stiffness=conical,
        torsional_stiffness=torsional,
        damping=1e-4,
    )
    return sj.Bushing(law=law)


@pytest.fixture(scope="module")
def on_rubber():
    scene = sj.gallery.double_wishbone(bushes=rubber(), spring_rate=1e-3, preload=0.0)
    scene = sj.Scene(
        scene.bodies, scene.joints, scene.forces, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points
    )
    return sj.vehicle.rig(scene, 0.0)


def forces_of_unit_loads(load):
    """Forces on the four bushes under a load at the wheel (force and moment about the patch), by statics alone.

    Unknown are the forces of lower ball, upper ball, tie rod and platform on the upright: six equations of it, and for
    each arm that the force on its ball has no moment about its hinge.
    """
    p = {name: np.asarray(place) for name, place in DOUBLE_WISHBONE.items()}
    patch = p["contact_patch"]
    rod = p["tie_rod_outer"] - p["tie_rod_inner"]
    rod /= np.linalg.norm(rod)
    columns = []
    for place, directions in (
        (p["lower_ball"], np.eye(3)),
        (p["upper_ball"], np.eye(3)),
        (p["tie_rod_outer"], [rod]),
        (patch, [np.array([0.0, 0.0, 1.0])]),
    ):
        columns += [np.concatenate([f, np.cross(place - patch, f)]) for f in directions]
    hinges = np.zeros((2, 8))
    for row, arm in enumerate(("lower", "upper")):
        axis = p[f"{arm}_arm_front"] - p[f"{arm}_arm_rear"]
        lever = np.cross(axis, p[f"{arm}_ball"] - p[f"{arm}_arm_rear"])
        hinges[row, 3 * row : 3 * row + 3] = lever
    A = np.concatenate([np.column_stack(columns), hinges])
    found = np.linalg.solve(A, np.concatenate([-np.asarray(load), [0.0, 0.0]]))
    bushes = []
    for row, arm in enumerate(("lower", "upper")):
        front, rear, ball = p[f"{arm}_arm_front"], p[f"{arm}_arm_rear"], p[f"{arm}_ball"]
        force = -found[3 * row : 3 * row + 3]  # on the arm
        axis = (front - rear) / np.linalg.norm(front - rear)
        span = np.linalg.norm(front - rear)
        # Moments about the rear bush give the front one's radial force; the axial force is shared by equal rubber.
        moment = np.cross(ball - rear, force)
        at_front = -np.cross(axis, moment) / span
        radial = force - axis * (axis @ force)
        half = 0.5 * axis * (axis @ force)
        bushes += [(axis, at_front + half), (axis, radial - at_front + half)]
    return bushes


def test_compliance_is_the_sum_over_bushes_of_unit_loads(on_rubber):
    unit_loads = {
        "longitudinal": [1, 0, 0, 0, 0, 0],
        "lateral": [0, 1, 0, 0, 0, 0],
        "aligning": [0, 0, 0, 0, 0, 1],
        "driving": [1, 0, 0, 0, 0.3, 0],
    }
    shares = {name: forces_of_unit_loads(np.array(load, float)) for name, load in unit_loads.items()}

    def both(first, second):
        total = 0.0
        for (axis, f), (_, g) in zip(shares[first], shares[second], strict=True):
            along = (axis @ f) * (axis @ g)
            total += along / AXIAL + (f @ g - along) / RADIAL
        return total

    for load in unit_loads:
        for gives in ("longitudinal", "lateral"):
            found = on_rubber.compliance_of(gives, load)[0]
            assert found == pytest.approx(both(gives, load), rel=1e-6, abs=1e-13), (gives, load)
        # Toe-in of the left wheel turns it to the right: against the aligning moment.
        assert on_rubber.compliance_of("toe", load)[0] == pytest.approx(-both("aligning", load), rel=1e-6), load


def test_ideal_joints_do_not_give_way(wishbone):
    assert np.all(wishbone.compliance == 0)


def test_positions_out_of_reach_say_so():
    with pytest.warns(sj.vehicle.RigWarning, match=r"1 of 3 positions .* travel = 0.8 m.*cannot reach"):
        found = sj.vehicle.rig(sj.gallery.double_wishbone(static_toe=TOE, static_camber=CAMBER), [0.0, 0.8, 0.02])
    assert list(found.status) == [
        sj.vehicle.RigStatus.FOUND,
        sj.vehicle.RigStatus.OUT_OF_REACH,
        sj.vehicle.RigStatus.FOUND,
    ]
    assert np.isnan(found.toe[1])
    assert np.isfinite(found.toe[[0, 2]]).all()
    assert "1 have no result" in str(found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"travel": [[0.0]]}, "travel .* must be one number or a list"),
        ({"travel": "0.1"}, "travel .* must be one number or a list"),
        ({"travel": np.nan}, "travel = nan must be finite"),
        ({"travel": [0.0, 0.1], "steer": [0.0, 0.1, 0.2]}, "one length"),
        ({"loads": {"lateral": 1.0}}, "must be sj.vehicle.WheelLoads"),
        ({"part": 0.0}, "part = 0 must be positive"),
        (
            {"corner": sj.vehicle.Corner(carrier="uprigth")},
            "no body 'uprigth' carries the wheel; did you mean 'upright'",
        ),
        ({"corner": sj.vehicle.Corner(spin_axis="spin")}, "has no point 'spin'; did you mean 'spin_axis'"),
        ({"corner": sj.vehicle.Corner(steering="steer")}, "no driver 'steer' that steers; did you mean 'steering'"),
        ({"corner": sj.vehicle.Corner(steering="rack_slide")}, "is no TranslationDriver"),
        ({"corner": sj.vehicle.Corner(spring="sprung")}, "no force 'sprung'; did you mean 'spring'"),
        ({"corner": sj.vehicle.Corner(kingpin=("upright.lower_ball",))}, "must be two points"),
    ],
)
def test_bad_requests_are_named(change, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.vehicle.rig(sj.gallery.double_wishbone(), **{"travel": 0.0, **change})


@pytest.mark.parametrize(
    ("hardpoints", "words"),
    [
        ({"uper_ball": (0, 0, 0)}, "no hardpoint 'uper_ball'; did you mean 'upper_ball'"),
        ({"upper_ball": (0.0, 0.6)}, "must be three numbers"),
        ({"upper_ball": (0.0, np.inf, 0.5)}, "must be finite"),
        ([1.0], "must be places by name"),
    ],
)
def test_bad_hardpoints_are_named(hardpoints, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.gallery.double_wishbone(hardpoints)


def test_films_and_journals_are_refused():
    film = sj.Lubricated(clearance=5e-5, viscosity=0.1)
    with pytest.raises(sj.SceneError, match=r"'lower_ball' is lubricated.*Take sj\.Dry"):
        sj.vehicle.rig(sj.gallery.double_wishbone(ball_joint=film), 0.0)


def test_table_dataset_and_figure_have_units(wishbone, tmp_path):
    ds = wishbone.to_xarray()
    assert ds["toe"].attrs["units"] == "rad"
    assert ds["toe"].dims == ("position",)
    assert "wheel rate" in str(wishbone)
    assert "[N/mm]" in str(wishbone)
    wishbone.to_csv(tmp_path / "rig.csv")
    head, first, *_ = (tmp_path / "rig.csv").read_text().splitlines()
    assert head.startswith("travel [mm],steer [mm]")
    assert float(first.split(",")[head.split(",").index("toe [deg]")]) == pytest.approx(np.degrees(wishbone.toe[0]))
    figure = sj.plot.rig({"one": ds, "two": ds}, ["toe", "wheel_rate"])
    assert [ax.get_ylabel() for ax in figure.axes] == ["[deg]", "[N/mm]"]
    with pytest.raises(sj.SceneError, match="'to'; did you mean 'toe'"):
        sj.plot.rig(ds, ["to"])


def test_anti_dive_anti_lift_and_ackermann_by_their_formulas(wishbone):
    car = sj.vehicle.Vehicle(wheelbase=2.7, center_of_mass_height=0.55, brake_share=0.65)
    expected = 0.65 * np.tan(wishbone.braking_angle) * 2.7 / 0.55
    assert wishbone.anti_dive(car) == pytest.approx(expected)
    rear = car._replace(is_rear=True)
    assert wishbone.anti_dive(rear) == pytest.approx(-expected)
    by_driving = 0.4 * np.tan(wishbone.driving_angle) * 2.7 / 0.55  # of the wheel's center, where driving forces act
    assert wishbone.anti_lift(car._replace(drive_share=0.4)) == pytest.approx(by_driving)
    assert wishbone.anti_lift(rear._replace(drive_share=0.4)) == pytest.approx(-by_driving)
    with pytest.raises(sj.SceneError, match="no position with steer"):
        wishbone.ackermann(car, 1.5)


# Slow: what is compiled --------------------------------------------------------------------------------------------


ROD_HEIGHT = 0.235


def with_rod_at(height, xp=jnp):
    """The rig of a corner whose tie rod starts at another height, at two travels."""
    scene = sj.gallery.double_wishbone({"tie_rod_inner": (-0.13, 0.365, height)})
    return sj.vehicle.rig(scene, xp.array([-0.03, 0.03]))


def toe_by_hand(height, travel):
    hand = DoubleWishbone({**DOUBLE_WISHBONE, "tie_rod_inner": (-0.13, 0.365, height)})
    return read(hand, travel)["toe"]


@pytest.mark.slow
def test_derivatives_by_hardpoints_agree():
    """Forward and in reverse: toe against the corner by hand, roll center and wheel rate against differences."""

    def of(height, xp=jnp):
        found = with_rod_at(height, xp)
        return xp.stack([found.toe[0], found.toe[1], found.roll_center_height[1], found.wheel_rate[0]])

    value, forward = jax.jit(lambda height: jax.jvp(of, (height,), (1.0,)))(ROD_HEIGHT)
    by_hand = [partial(toe_by_hand, travel=travel) for travel in (-0.03, 0.03)]
    assert np.asarray(value)[:2] == pytest.approx([each(ROD_HEIGHT) for each in by_hand], abs=1e-10)
    assert np.asarray(forward)[:2] == pytest.approx([slope(each, ROD_HEIGHT) for each in by_hand], rel=1e-7)
    assert np.asarray(forward) == pytest.approx(slope(lambda z: of(z, np), ROD_HEIGHT), rel=1e-7)

    weights = jnp.array([1.0, -2.0])
    backward = jax.jit(jax.grad(lambda height: weights @ with_rod_at(height).toe))(ROD_HEIGHT)
    assert float(backward) == pytest.approx(float(weights @ forward[:2]), rel=1e-10)


@pytest.mark.slow
def test_second_derivatives_are_those_of_the_corner_by_hand():
    def first(height):
        return jax.jvp(lambda z: with_rod_at(z).toe, (height,), (1.0,))[1]

    _, second = jax.jit(lambda height: jax.jvp(first, (height,), (1.0,)))(ROD_HEIGHT)
    for found, travel in zip(second, (-0.03, 0.03), strict=True):
        wanted = slope(lambda z, at=travel: slope(lambda x: toe_by_hand(x, at), z, 1e-3), ROD_HEIGHT, 1e-3)
        assert float(found) == pytest.approx(wanted, rel=1e-6)


def at_height(height, mass=6.0):
    scene = sj.gallery.double_wishbone({"tie_rod_inner": (-0.13, 0.365, height)})
    return eqx.tree_at(lambda s: s.bodies["lower_arm"].mass, scene, mass)


@pytest.mark.slow
def test_samples_are_the_rigs_of_their_numbers():
    """Run by run; a travel out of reach is told with the first run's numbers."""
    samples = sj.studies.zipped({"height": [0.235, 0.24], "mass": [6.0, 7.0]})
    with pytest.warns(
        sj.vehicle.RigWarning, match=r"2 of 2 samples .* run 0 \(height = 0.235, mass = 6\) at travel = 0.8 m"
    ):
        found = sj.vehicle.rig_samples(at_height, samples, [-0.04, 0.04, 0.8])
    assert found["toe"].dims == ("run", "travel")
    assert found["toe"].attrs["units"] == "rad"
    assert np.isnan(found["toe"][:, 2]).all()
    for run in (0, 1):
        one = sj.vehicle.rig(at_height(**samples.row(run)), [-0.04, 0.04])
        for name in ("toe", "wheel_rate", "wheel_load"):
            np.testing.assert_allclose(found[name][run, :2], getattr(one, name), rtol=1e-9)
    np.testing.assert_array_equal(found["height"], [0.235, 0.24])


def test_samples_that_are_not_legal_are_refused():
    with pytest.raises(sj.SceneError, match=r"mass.*-1"):
        sj.vehicle.rig_samples(at_height, {"height": [0.235, 0.24], "mass": [6.0, -1.0]})


@pytest.mark.slow
def test_rubber_follows_derivatives_and_vmap():
    """Stiffness of the bushes: toe under load by vmap, and its slope, against single rigs and their differences."""
    loads = sj.vehicle.WheelLoads(lateral=2000.0)

    def of(radial):
        found = sj.vehicle.rig(
            sj.gallery.double_wishbone(bushes=rubber(radial, conical=50.0, torsional=5.0)), 0.02, loads=loads
        )
        return jnp.stack([found.toe[0], found.compliance[0, 0, 1]])

    stiffness = jnp.array([4e6, 8e6])
    values, slopes = jax.jit(jax.vmap(lambda r: (of(r), jax.jacfwd(of)(r))))(stiffness)

    def single(radial):
        return np.asarray(of(radial))

    for i, radial in enumerate((4e6, 8e6)):
        assert np.asarray(values[i]) == pytest.approx(single(radial), rel=1e-8)
        assert np.asarray(slopes[i]) == pytest.approx(slope(single, radial, 1e4), rel=1e-4)


@pytest.mark.slow
def test_stiff_rubber_and_tight_balls_tend_to_ideal_joints():
    ideal = sj.vehicle.rig(sj.gallery.double_wishbone(), [0.03])
    errors = []
    for radial in (1e8, 1e9):
        found = sj.vehicle.rig(sj.gallery.double_wishbone(bushes=rubber(radial, radial, 50.0, 1e-3)), [0.03])
        errors.append(abs(found.toe[0] - ideal.toe[0]))
        assert found.wheel_rate[0] == pytest.approx(ideal.wheel_rate[0], rel=2e8 / radial * 5e-3)
    assert errors[1] == pytest.approx(errors[0] / 10, rel=0.05)


@pytest.mark.slow
def test_a_dry_ball_lies_at_the_wall():
    """Loaded to both sides, the tie rod's outer ball takes its clearance: toe differs by what the lever makes of it."""
    clearance = 1e-4
    model = sj.Dry(clearance=clearance)
    loose = sj.vehicle.rig(
        sj.gallery.double_wishbone(tie_rod_joint=model), [0.0, 0.0], loads=sj.vehicle.WheelLoads(aligning=[-50.0, 50.0])
    )
    ideal = sj.vehicle.rig(sj.gallery.double_wishbone(tie_rod_joint=sj.Ideal()), [0.0, 0.0])
    assert np.all(loose.status == sj.vehicle.RigStatus.FOUND)
    # A rod longer or shorter by the clearance turns the wheel as a rack does that is moved by it, up to the angle of
    # the rod against the rack, and a little more for what the contact gives way.
    lengths = np.array([DOUBLE_WISHBONE["tie_rod_outer"], DOUBLE_WISHBONE["tie_rod_inner"]])
    rod = lengths[0] - lengths[1]
    along = rod[1] / np.linalg.norm(rod)
    expected = 2 * clearance * abs(ideal.steer_gradient[0]) / along
    assert abs(loose.toe[1] - loose.toe[0]) == pytest.approx(expected, rel=0.1)
    assert abs(loose.toe[1] - loose.toe[0]) > expected


@pytest.mark.slow
def test_an_unloaded_ball_says_so():
    scene = sj.gallery.double_wishbone(tie_rod_joint=sj.Dry(clearance=1e-4), spring_rate=1e-3, preload=0.0)
    scene = sj.Scene(
        scene.bodies, scene.joints, scene.forces, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points
    )
    with pytest.warns(sj.vehicle.RigWarning, match="carries no load"):
        found = sj.vehicle.rig(scene, 0.0)
    assert found.status[0] == sj.vehicle.RigStatus.UNLOADED
