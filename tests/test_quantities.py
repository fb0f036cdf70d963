"""One language of names for what is observed: components, results of force elements, parts of joints' answers."""

import cases
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene
from spherejax.motion.equations.quantities import quantity

pytestmark = pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning")

TIMES = np.linspace(0.0, 0.004, 5)
NAMES = (
    "position.ball.z",
    "velocity.ball",
    "quaternion.ball.w",
    "joint.normal_force",
    "joint.sliding_velocity",
    "joint.sliding_velocity.y",
    "spring.length",
    "reaction.joint.x",
    "kinetic_energy",
)


def scene(mass=0.2):
    bare = cases.ball_in_socket(sj.Dry(clearance=1e-4, friction=sj.Threlfall()), mass, (0.1, 0.3, 0.4))
    spring = sj.SpringDamper(("ground.anchor", "ball.center"), stiffness=100.0, damping=0.1, free_length=0.1)
    return sj.Scene(
        bare.bodies,
        bare.joints,
        {"spring": spring},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"socket": (0.0, 0.0, 0.0), "anchor": (0.1, 0.0, 0.0)},
    )


@pytest.fixture(scope="module")
def run():
    return sj.simulate(scene(), TIMES)


@pytest.fixture(scope="module")
def swept():
    record = [*(f"final {name}" for name in NAMES), *(f"peak {name}" for name in NAMES[:-1]), *NAMES[:2]]
    return sj.sweep(scene, {"mass": [0.2, 0.25]}, TIMES, record=record, progress=False)


def of_run(run, name):
    parts = {"joint.normal_force": run.part("joint", "normal_force"), "spring.length": run.force("spring")["length"]}
    sliding = run.part("joint", "sliding_velocity")
    return {
        **parts,
        "position.ball.z": run.position("ball")[:, 2],
        "velocity.ball": run.velocity("ball"),
        "quaternion.ball.w": run.quaternion("ball")[:, 0],
        "joint.sliding_velocity": sliding,
        "joint.sliding_velocity.y": sliding[:, 1],
        "reaction.joint.x": run.reaction("joint")[:, 0],
        "kinetic_energy": run.kinetic_energy,
    }[name]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_means_the_same_everywhere(run, swept, name):
    found = quantity(name, run.system)
    assert found.name == name
    np.testing.assert_array_equal(found.of(run), of_run(run, name))
    assert found.of(run).ndim == 1 + len(found.dims)
    final = swept[f"final_{name}"].isel(mass=0)
    np.testing.assert_allclose(final, of_run(run, name)[-1], atol=1e-6 * np.abs(of_run(run, name)).max() + 1e-9)
    assert final.attrs["units"] == found.unit
    if name != "kinetic_energy":
        assert run.peak(name).value == pytest.approx(float(swept[f"peak_{name}"][0]), rel=2e-3)


def test_samples_of_a_component_have_no_axis(swept):
    assert swept["position.ball.z"].dims == ("mass", "time")
    assert swept["velocity.ball"].dims == ("mass", "time", "axis")


def test_fits_sensitivities_and_designs_know_the_same_names(run):
    found = sj.sensitivity(scene, {"mass": 0.2}, TIMES[:2], observables=["spring.length", "joint.normal_force"])
    assert [column.labels[0] for column in found.columns] == ["spring.length", "joint.normal_force"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("position.bal", r"write 'position\.NAME' with one of 'ball'; did you mean 'position\.ball'"),
        ("positon.ball", "names no quantity; the kinds are .*; did you mean 'position'"),
        ("position.ball.q", r"has no component 'q'; its components are 'position\.ball\.x'"),
        ("kinetic_energy.x", "belongs to the mechanism as a whole"),
        ("spring.lenght", "'spring' has no result 'lenght'; it has .*'length'"),
        ("joint.normal_forces", "'joint' has no part 'normal_forces'; it has .*'normal_force'"),
        ("joint.normal_force.x", "has no component 'x'; its components are none"),
    ],
)
def test_a_wrong_name_is_told_what_there_is(name, message):
    with pytest.raises(sj.SceneError, match=message):
        quantity(name, compile_scene(scene()).system)


@pytest.mark.slow
def test_a_part_that_is_found_where_someone_looks_has_a_peak_too():
    scene = cases.ball_in_socket(sj.Lubricated(clearance=1e-4, viscosity=0.4), 0.2, (0.0, 0.0, 0.1))
    run = sj.simulate(scene, np.linspace(0.0, 0.05, 101))
    samples = np.asarray(run.part("joint", "film_pressure"))
    found = run.peak("joint.film_pressure")
    assert quantity("joint.film_pressure", run.system).unit == "Pa"
    assert samples.max() > 1e3
    assert samples.max() <= found.value * (1 + 1e-9) <= 1.01 * samples.max()


def test_surfaces_slide_without_a_friction_law_too():
    """v_t = (e_dot + w x R_j n) across n, of a ball that spins beside the wall: by hand, from the run's own motion."""
    ball = sj.Body(
        0.2,
        (1e-5, 1e-5, 1e-5),
        velocity=(0.1, 0.3, 0.4),
        angular_velocity=(3.0, -2.0, 1.0),
        points={"center": (0.0, 0.0, 0.0)},
    )
    joint = sj.Spherical(
        "ground.socket", "ball.center", sj.Dry(clearance=1e-4, normal=sj.Hertz(stiffness=1e9)), starts_concentric=False
    )
    scene = sj.Scene(
        {"ball": ball}, {"joint": joint}, gravity=(0.0, 0.0, 0.0), ground_points={"socket": (0.0, 0.0, 0.0)}
    )
    run = sj.simulate(scene, np.linspace(0.0, 1e-3, 7), throw=True)
    e, rate, spin = (
        np.asarray(f) for f in (run.eccentricity("joint"), run.velocity("ball"), run.angular_velocity("ball"))
    )
    size = np.linalg.norm(e, axis=1, keepdims=True)
    n = e / np.where(size > 0, size, 1.0)
    velocity = rate + np.cross(spin, 0.5 * (2 * 0.010 - 1e-4 - size) * n)
    across = velocity - np.sum(velocity * n, axis=1, keepdims=True) * n
    np.testing.assert_allclose(run.part("joint", "sliding_velocity"), across, atol=1e-12)
    assert np.linalg.norm(across[-1]) > 0.02
