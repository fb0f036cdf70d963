"""Bushings of joints that are not spherical: what they resist, at any turn and travel, and what they conserve."""

import cases
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import assembled, momenta

import spherejax as sj
from spherejax.foundations.rotation import (
    quaternion_from_rotation_vector,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from spherejax.physics.laws.elastomer_axes import turned_axis

K = np.array([[3e4, 2e3, 0.0], [2e3, 2e4, 1e3], [0.0, 1e3, 1e4]])
HINGE = sj.laws.HingeElastomer(K, 1e-3 * K, 50.0, 0.2, 0.1)
CROSS = sj.laws.CrossElastomer(K, 1e-3 * K, 40.0, 0.3)
X, Y, Z = np.eye(3)
turned = jax.jit(lambda v: quaternion_from_rotation_vector(v))
times = jax.jit(quaternion_product)


def about(axis, angle):
    """Quaternion of a turn about an axis, of any number of turns."""
    return jnp.concatenate([jnp.cos(angle / 2)[None], jnp.sin(angle / 2) * jnp.asarray(axis)])


# The laws ------------------------------------------------------------------------------------------------------------


@jax.jit
def moment(law, quaternion, rate):
    return law.moment(law.measure_of_rotation(quaternion), rate)


@jax.jit
def energy(law, deflection, quaternion):
    return law.elastic_energy(deflection, law.measure_of_rotation(quaternion))


@jax.jit
def work_rate(law, quaternion):
    """-dE by a small rotation: the elastic moment."""

    def after(turn):
        small = jnp.concatenate([jnp.ones(1), turn / 2])
        return law.elastic_energy(jnp.zeros(3), law.measure_of_rotation(quaternion_product(small, quaternion)))

    return -jax.grad(after)(jnp.zeros(3))


TILTS = np.array([[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [3e-4, -2e-4, 0.0], [0.3, 0.2, 0.0], [1.2, -1.0, 0.0]])


@pytest.mark.parametrize("tilt", TILTS, ids=str)
@pytest.mark.parametrize("turn", [0.0, 1.0, 3.2, 500.0])
def test_hinge_resists_tilt_whatever_the_turn(tilt, turn):
    q = times(turned(tilt), about(Z, jnp.asarray(turn)))
    found = np.asarray(moment(HINGE, q, np.zeros(3)))
    assert found == pytest.approx(-50.0 * tilt, rel=1e-9, abs=1e-11)
    assert float(energy(HINGE, np.zeros(3), q)) == pytest.approx(25.0 * tilt @ tilt, rel=1e-9, abs=1e-12)
    assert np.asarray(work_rate(HINGE, q)) == pytest.approx(found, rel=1e-7, abs=1e-10)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, 1.0, 2.0), (-0.4, 40.0, -33.0), (1.3, -2.0, 7.0)], ids=str)
def test_cross_holds_its_right_angle_whatever_the_turns(angles):
    """About the first arm, across the cross, about the second arm: only the middle turn is resisted."""
    beta, first, second = (jnp.asarray(angle) for angle in angles)
    q = times(times(about(Z, first), about(-Y, beta)), about(X, second))
    found = np.asarray(moment(CROSS, q, np.zeros(3)))
    normal = np.array([np.sin(angles[1]), -np.cos(angles[1]), 0.0])
    assert found == pytest.approx(-40.0 * angles[0] * normal, abs=1e-9)
    assert np.asarray(work_rate(CROSS, q)) == pytest.approx(found, abs=1e-9)
    assert np.asarray(moment(CROSS, q, 2.0 * normal) - found) == pytest.approx(-0.3 * 2.0 * normal, abs=1e-12)


def test_damping_takes_energy_and_knows_its_directions():
    q = times(turned(np.array([0.4, 0.1, 0.0])), about(Z, jnp.asarray(2.0)))
    axis = np.asarray(turned_axis(q, 2))
    still = np.asarray(moment(HINGE, q, np.zeros(3)))
    assert np.asarray(moment(HINGE, q, 3.0 * axis)) - still == pytest.approx(-0.1 * 3.0 * axis, abs=1e-12)
    across = np.cross(axis, X)
    assert np.asarray(moment(HINGE, q, across)) - still == pytest.approx(-0.2 * across, abs=1e-12)


@pytest.mark.parametrize("law", [HINGE, CROSS], ids=["hinge", "cross"])
@pytest.mark.parametrize("quaternion", [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (1, 0, 1, 0)], ids=str)
def test_values_and_derivatives_are_finite_at_singular_turns(law, quaternion):
    q = jnp.asarray(quaternion, float) / np.linalg.norm(quaternion)
    for found in (moment(law, q, np.ones(3)), energy(law, np.ones(3), q), work_rate(law, q)):
        assert np.isfinite(np.asarray(found)).all()
    slopes = jax.jit(jax.jacfwd(lambda q: law.moment(law.measure_of_rotation(q), jnp.ones(3))))(q)
    assert np.isfinite(np.asarray(slopes)).all()


# Mechanisms ----------------------------------------------------------------------------------------------------------

RUBBER = {"radial_stiffness": 4e3, "axial_stiffness": 3e3, "damping": 0.0}
MATRIX = sj.laws.MatrixElastomer.cylindrical(Z, **RUBBER, conical_stiffness=80.0, torsional_stiffness=40.0)
SLIDING = {**RUBBER, "axial_stiffness": 0.0}
MODELS = {
    "revolute": sj.laws.HingeElastomer.symmetric(**RUBBER, conical_stiffness=80.0),
    "cylindrical": sj.laws.HingeElastomer.symmetric(**SLIDING, conical_stiffness=80.0),
    "prismatic": sj.laws.MatrixElastomer.cylindrical(Z, **SLIDING, conical_stiffness=80.0, torsional_stiffness=80.0),
    "universal": sj.laws.CrossElastomer(4e3 * np.eye(3), 0.0 * np.eye(3), 80.0),
    "fixed": MATRIX,
}


AXIS = (0.6, 0.0, 0.8)


def joint_of(kind, pair, point, model=None):
    axis, across = AXIS, (0.8, 0.0, -0.6)
    return {
        "revolute": lambda: sj.Revolute(pair, point, axis, model),
        "cylindrical": lambda: sj.Cylindrical(pair, point, axis, model),
        "prismatic": lambda: sj.Prismatic(pair, point, axis, model),
        "universal": lambda: sj.Universal(pair, point, axis, across, model),
        "fixed": lambda: sj.Fixed(pair, point, model),
    }[kind]()


def floating_chain():
    """Six bodies in space without weight; each pair has a joint of another kind, all with bushings."""
    rng = np.random.default_rng(3)
    names = "abcdef"
    bodies = {
        name: sj.Body(
            1.0 + 0.1 * i,
            (0.004, 0.005, 0.006),
            position=(0.2 * i, 0.0, 0.0),
            velocity=1.5 * rng.normal(size=3),
            angular_velocity=15.0 * rng.normal(size=3) + (np.array([50.0, 0.0, 70.0]) if name == "a" else 0.0),
        )
        for i, name in enumerate(names)
    }
    joints = {
        kind: joint_of(kind, (names[i], names[i + 1]), (0.2 * i + 0.1, 0.0, 0.0), sj.Bushing(law=law))
        for i, (kind, law) in enumerate(MODELS.items())
    }
    return sj.Scene(bodies, joints, gravity=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def chain():
    with pytest.warns(sj.errors.StartWarning, match=r"revolute.* 2 more: .* starts concentric"):
        return sj.simulate(
            floating_chain(), cases.times(0.4, 41), rtol=1e-10, solver=diffrax.Dopri8()
        ).require_success()


def test_bushings_conserve_energy_and_momentum(chain):
    energy = np.asarray(chain.mechanical_energy)
    assert np.ptp(np.asarray(chain.elastic_energy)) > 0.5
    assert np.abs(energy - energy[0]).max() < 1e-7
    linear, angular = momenta(chain)
    assert np.abs(linear - linear[0]).max() < 1e-9
    assert np.abs(angular - angular[0]).max() < 1e-9


def test_bushings_leave_free_what_their_joints_leave_free(chain):
    """Each joint moves far along what it leaves free, and little along what it holds."""
    for kind, free in (("cylindrical", 1), ("prismatic", 1), ("revolute", 0), ("fixed", 0), ("universal", 0)):
        deflection = np.asarray(chain.part(kind, "deflection"))  # in axes with z along the joint's
        held = np.delete(deflection, 2, 1) if free else deflection
        assert 1e-4 < np.abs(held).max() < 0.05, kind
        if free:
            assert np.abs(deflection[:, 2]).max() > 0.1, kind
    turns = {kind: np.linalg.norm(np.asarray(chain.part(kind, "rotation")), axis=1).max() for kind in MODELS}
    assert turns["universal"] > 1.0
    assert turns["prismatic"] < 0.6
    # The revolute turns more than once; a tilt that depended on the turn would throw it off its axis.
    spin = np.linalg.norm(np.asarray(chain.angular_velocity("a") - chain.angular_velocity("b")), axis=1)
    assert np.mean(spin) * 0.4 > 3 * np.pi
    axes = [np.asarray(jax.vmap(rotation_matrix)(chain.quaternion(name))) @ AXIS for name in "ab"]
    assert np.sum(axes[0] * axes[1], 1).min() > 0.9


def test_starts_like_the_ideal_joint():
    """The bushing's start is assembled as if the joint were ideal: no deflection, and velocities that hold it."""
    for kind, law in MODELS.items():
        bodies = {"body": sj.Body(1.0, (0.01, 0.01, 0.01), position=(0.3, 0, 0), angular_velocity=(1.0, 2.0, 3.0))}
        starts = []
        for model in (None, sj.Bushing(law=law)):
            scene = sj.Scene(bodies, {"j": joint_of(kind, ("ground", "body"), (0.0, 0.1, 0.0), model)})
            system = sj.equations.compile_scene(scene).system
            starts.append(assembled(system))
        assert np.abs(starts[0]).max() > 0.1
        assert starts[0] == pytest.approx(starts[1], abs=0.0)


# Bad input -----------------------------------------------------------------------------------------------------------

PAIR, AT = ("ground", "body"), (0.0, 0.0, 0.0)
REFUSED = {
    "contact of balls in a revolute": (lambda: sj.Revolute(PAIR, AT, Z, sj.Dry(1e-4)), "conformity", "JohnsonCylinder"),
    "contact in a cylindrical": (lambda: sj.Cylindrical(PAIR, AT, Z, sj.Dry(1e-4)), "Dry", "HingeElastomer"),
    "pivot in a prismatic": (lambda: sj.Prismatic(PAIR, AT, Z, sj.Bushing(1e5)), "RadialElastomer", "MatrixElastomer"),
    "free torsion by a matrix": (
        lambda: sj.Revolute(
            PAIR,
            AT,
            Z,
            sj.Bushing(
                law=sj.laws.MatrixElastomer.cylindrical(Z, **RUBBER, conical_stiffness=1.0, torsional_stiffness=0.0)
            ),
        ),
        "zz",
        "HingeElastomer",
    ),
    "negative stiffness": (
        lambda: sj.Revolute(PAIR, AT, Z, sj.Bushing(law=sj.laws.HingeElastomer(K, K, -1.0))),
        "conical_stiffness = -1",
        "negative",
    ),
    "asymmetric": (
        lambda: sj.Universal(PAIR, AT, Z, X, sj.Bushing(law=sj.laws.CrossElastomer(np.triu(K), K, 1.0))),
        "stiffness",
        "symmetric",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unfit_models_are_refused(name):
    build, *words = REFUSED[name]
    scene = sj.Scene({"body": sj.Body(1.0, (1.0, 1.0, 1.0))}, {"hinge": build()})
    with pytest.raises(sj.SceneError) as error:
        sj.equations.compile_scene(scene)
    for word in ("'hinge'", *words):
        assert word in str(error.value)


def test_rotation_vector_is_what_a_matrix_measures():
    q = turned(np.array([0.2, 0.1, -0.3]))
    assert np.asarray(MATRIX.measure_of_rotation(q)) == pytest.approx(np.asarray(rotation_vector(q)), abs=1e-15)
