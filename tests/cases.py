"""Every law, model and scene once, with safe values and the length scale against which it is compared."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import reduction
from scipy.spatial.transform import Rotation

import spherejax as sj

C = 1e-4  # clearance of the cases [m]

NORMAL_LAWS = {
    "hertz": sj.Hertz(),
    "hunt_crossley": sj.HuntCrossley(restitution=0.8),
    "lankarani_nikravesh": sj.LankaraniNikravesh(restitution=0.9),
    "gonthier": sj.Gonthier(restitution=0.7),
    "flores": sj.Flores(restitution=0.6),
    "exact_restitution": sj.ExactRestitution(restitution=0.5),
    "hunt_crossley_dissipation": sj.laws.HuntCrossleyDissipation(dissipation=2.0),
    "yielding": sj.Gonthier(restitution=sj.functions.PowerTail(0.9, 0.05)),
}
CONFORMITIES = {
    "profile": sj.laws.SphericalProfile(),
    "liner": sj.laws.WinklerLiner(youngs_modulus=1e9, poissons_ratio=0.4, thickness=2e-3),
}
FRICTION_LAWS = {
    "threlfall": sj.Threlfall(mu=0.1, v1=1e-3),
    "bengisu_akay": sj.BengisuAkay(),
    "ambrosio": sj.Ambrosio(),
    "brown_mcphee": sj.BrownMcPhee(),
    "lugre": sj.LuGre(),
}
BOUNDARIES = {"guembel": sj.Guembel(), "pinkus_sternlicht": sj.PinkusSternlicht(), "sommerfeld": sj.Sommerfeld()}
SWEPT = ("guembel", "sommerfeld")
"""Boundaries that a full film can have."""

ELASTOMERS = {
    "radial": sj.laws.RadialElastomer(1e6, 1e-3),
    "vector": sj.laws.VectorElastomer(1e6, 1e-3),
    "matrix": sj.laws.MatrixElastomer.cylindrical(
        (0.1, 0.2, 1.0),
        radial_stiffness=1e6,
        axial_stiffness=3e5,
        conical_stiffness=2.0,
        torsional_stiffness=0.5,
        damping=1e-3,
    ),
    "curve": sj.laws.CurveElastomer(np.array([1e-5, 1e-4, 3e-4]), np.array([10.0, 150.0, 900.0]), 1e-3),
}

FOUR_BAR_MODELS = {
    "ideal": sj.Ideal(),
    "dry": sj.Dry(clearance=C),
    "friction": sj.Dry(clearance=C, friction=sj.Threlfall(mu=0.1, v1=1e-3)),
    "lubricated": sj.Lubricated(clearance=C, viscosity=0.4),
    "bushing": sj.Bushing(stiffness=1e6, damping=1e-4),
}
"""The five models that are compared on the four-bar. Tests that integrate keep to these: each costs a compilation."""

MODELS = {
    **FOUR_BAR_MODELS,
    **{f"dry_{name}": sj.Dry(clearance=C, normal=law) for name, law in NORMAL_LAWS.items()},
    **{f"dry_{name}": sj.Dry(clearance=C, friction=law) for name, law in FRICTION_LAWS.items()},
    **{f"dry_{name}": sj.Dry(clearance=C, conformity=law) for name, law in CONFORMITIES.items()},
    "dry_worn": sj.Dry(
        clearance=C,
        friction=sj.Threlfall(),
        socket_depth=sj.laws.HarmonicDepth(1e-6 * np.array([5.0, -2.0, 3.0, 1.0, 0.5, -2.0, 4.0, 0.0, 1.0])),
        ball_depth=sj.laws.HarmonicDepth([2e-6, 0.0, 1e-6, -1e-6]),
    ),
    "lubricated_liner": sj.Lubricated(clearance=C, conformity=CONFORMITIES["liner"]),
    "dry_hertz_threlfall": sj.Dry(clearance=C, normal=sj.Hertz(), friction=sj.Threlfall()),
    **{
        f"lubricated_radial_{name}": sj.Lubricated(clearance=C, boundary=law, film=sj.laws.RadialFilm())
        for name, law in BOUNDARIES.items()
    },
    **{
        f"lubricated_full_{name}": sj.Lubricated(clearance=C, boundary=BOUNDARIES[name], film=sj.laws.FullFilm())
        for name in SWEPT
    },
    "lubricated_hertz": sj.Lubricated(clearance=C, normal=sj.Hertz()),
    "lubricated_warm": sj.Lubricated(
        clearance=C, heat=sj.laws.OilHeat(sj.laws.VogelViscosity(0.04, 170.0), 0.5, 2.0, 1.0, 0.5)
    ),
    "lubricated_thickening": sj.Lubricated(clearance=C, thickening=sj.laws.BarusThickening(2e-8)),
    "lubricated_lugre": sj.Lubricated(clearance=C, normal=sj.Flores(restitution=0.8), friction=sj.LuGre()),
    **{f"bushing_{name}": sj.Bushing(law=law) for name, law in ELASTOMERS.items()},
    "ideal_threlfall": sj.Ideal(sj.Threlfall(mu=0.1), radius=0.01, pressure=sj.laws.CosinePressure(), preload=0.01),
    "ideal_lugre": sj.Ideal(sj.LuGre(), radius=0.01, pressure=sj.laws.UniformPressure(), passes=3),
    "bushing_rubber": sj.Bushing(
        law=ELASTOMERS["vector"], branches=sj.laws.Maxwell([5e5, 2e5], [1e-2, 1e-3]), friction=sj.laws.Berg(50.0, 1e-5)
    ),
    "bushing_rubber_turning": sj.Bushing(
        law=ELASTOMERS["matrix"],
        branches=sj.laws.Maxwell([[5e5, 5e5, 2e5]], [1e-2], rotational_stiffness=[1.0]),
        friction=sj.laws.Berg([50.0, 50.0, 20.0], 1e-5, rotational_limit=0.1, half_angle=1e-2),
    ),
}


_CYLINDER = sj.laws.JohnsonCylinder(0.01)
JOURNALS = {
    "johnson": sj.Dry(clearance=C, conformity=_CYLINDER, friction=sj.Threlfall()),
    "worn": sj.Dry(
        clearance=C,
        conformity=_CYLINDER,
        socket_depth=sj.laws.FourierDepth([5e-6, -2e-6, 3e-6, 1e-6, 0.5e-6]),
        ball_depth=sj.laws.FourierDepth([2e-6, 0.0, 1e-6]),
    ),
    "esdu": sj.Dry(clearance=C, conformity=sj.laws.EsduCylinder(0.02), friction=sj.LuGre()),
    "short": sj.Lubricated(clearance=C, film=sj.laws.ShortBearing(0.01), conformity=_CYLINDER),
    "long": sj.Lubricated(clearance=C, film=sj.laws.LongBearing(0.04), conformity=_CYLINDER),
    "warm": sj.Lubricated(
        clearance=C,
        film=sj.laws.ShortBearing(0.01),
        conformity=_CYLINDER,
        heat=sj.laws.OilHeat(sj.laws.ReynoldsViscosity(0.03), 0.5, 2.0, 1.0),
    ),
    "lined": sj.Lubricated(
        clearance=C,
        film=sj.laws.LinedBearing(0.01, sj.laws.WinklerLiner(1e8, 0.4, 1e-3), points=16, grooves=1),
        conformity=_CYLINDER,
        heat=sj.laws.BearingHeat(sj.laws.ReynoldsViscosity(0.03), 1.7e6, 2.0, 1.0),
    ),
    "thickening": sj.Lubricated(
        clearance=C,
        film=sj.laws.ShortBearing(0.01),
        conformity=_CYLINDER,
        thickening=sj.laws.BarusThickening(2e-8),
    ),
    "sommerfeld": sj.Lubricated(
        clearance=C, film=sj.laws.ShortBearing(0.01), boundary=sj.Sommerfeld(), conformity=_CYLINDER
    ),
}
"""Models of a revolute joint with clearance."""


@dataclass(frozen=True)
class Case:
    """A scene that is built when it is needed.

    Attributes:
        name: of the case.
        build: makes the scene.
        length: a typical length of the mechanism [m].
        studied: name of the joint whose model varies, or None.
        is_overconstrained: whether constraint equations depend on each other: off the constraints they contradict
            each other, and what moves how then is a matter of rounding.
    """

    name: str
    build: Callable[[], sj.Scene]
    length: float = 0.1
    studied: str | None = "coupler_rocker"
    is_overconstrained: bool = False


def pendulum() -> sj.Scene:
    """A physical pendulum on a revolute along the y axis."""
    body = sj.Body(0.5, (1e-3, 2e-3, 1.5e-3), position=(0.1, 0.0, 0.0))
    return sj.Scene({"bob": body}, {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})


def ball_in_socket(model: sj.joints.AbstractSphericalModel, mass=0.2, velocity=(0.0, 0.0, 0.0)) -> sj.Scene:
    """A free body whose center is the ball, in a socket that is fixed to the ground; no gravity."""
    ball = sj.Body(mass, (1e-5, 1e-5, 1e-5), velocity=velocity, points={"center": (0.0, 0.0, 0.0)})
    return sj.Scene(
        {"ball": ball},
        {"joint": sj.Spherical("ground.socket", "ball.center", model, starts_concentric=False)},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


def pushed_pair() -> sj.Scene:
    """Two bodies with full inertia matrices in one dry joint, with applied wrenches; no ground."""
    inertia = np.array([[2e-3, 1e-4, 2e-4], [1e-4, 3e-3, -1e-4], [2e-4, -1e-4, 2.5e-3]])
    first = sj.Body(1.0, inertia, points={"socket": (0.05, 0.0, 0.0)}, angular_velocity=(1.0, 2.0, 3.0))
    second = sj.Body(
        0.5, inertia / 2, position=(0.1, 0.0, 0.0), velocity=(0.0, 0.15, -0.1), points={"ball": (-0.05, 0.0, 0.0)}
    )
    forces = {
        "push": sj.AppliedWrench("first", force=(1.0, 2.0, 3.0), moment=(0.1, 0.0, 0.2), place=(0.01, 0.02, 0.0)),
        "thrust": sj.AppliedWrench("second", force=(0.0, 0.0, 2.0), in_body_axes=True),
    }
    joint = sj.Spherical("first.socket", "second.ball", sj.Dry(clearance=C, friction=sj.BrownMcPhee()))
    return sj.Scene({"first": first, "second": second}, {"pair": joint}, forces)


CASES = [
    *(Case(f"four_bar_{name}", lambda model=model: sj.gallery.four_bar(model)) for name, model in MODELS.items()),
    *(
        Case(f"piston_{name}", lambda model=model: sj.gallery.piston(model), 0.1, "pin", True)
        for name, model in JOURNALS.items()
    ),
    Case("pendulum", pendulum, studied=None),
    Case("ball_in_socket", lambda: ball_in_socket(FOUR_BAR_MODELS["friction"]), length=C, studied="joint"),
    Case("pushed_pair", pushed_pair, studied="pair"),
]


def displaced_state(
    system: sj.equations.System, assembly: sj.results.Assembly, seed: int, distance: float
) -> np.ndarray:
    """A flat state near the start, with random velocities, each body displaced by about `distance` [m]."""
    random = np.random.default_rng(seed)
    layout = system.layout
    y = np.zeros(layout.size)
    y[: layout.memory_start] = np.asarray(assembly.y)
    q = y[: layout.n_position].reshape(-1, 7)
    q[:, :3] += distance * random.standard_normal((layout.n_bodies, 3))
    q[:, 3:] += 5 * distance * random.standard_normal((layout.n_bodies, 4))  # arms are a few centimeters
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    y[layout.n_position : layout.memory_start] = random.standard_normal(layout.n_velocity)
    for slot in system.memory_slots:
        # An onset rate where the joint has a contact, then bristle deflections.
        start, n_onsets = layout.memory_start + slot.start, slot.names.count("onset_rate")
        y[start : start + n_onsets] = 0.05
        y[start + n_onsets : start + len(slot.names)] = 1e-6 * random.standard_normal(len(slot.names) - n_onsets)
    return y


def exact_four_bar(model: sj.joints.AbstractSphericalModel | None = None) -> sj.Scene:
    """The four-bar, its start and its body-fixed geometry closed to rounding from the nominal lengths.

    The gallery's scene carries the published digits (1e-8 in the quaternions); against a reference in minimal
    coordinates those would leave 1e-10 m.
    """
    scene = sj.gallery.four_bar(model)
    psi = reduction.rocker_angle(0.0)
    pin = np.array([0.0, 0.0, reduction.CRANK])
    end = reduction.P + reduction.ROCKER * np.array([np.sin(psi), 0.0, np.cos(psi)])
    placed = {
        "coupler": ((pin + end) / 2, (pin - end) / reduction.COUPLER),
        "rocker": ((reduction.P + end) / 2, (reduction.P - end) / reduction.ROCKER),
    }
    for name, (position, eta) in placed.items():
        given = Rotation.from_quat(scene.bodies[name].quaternion, scalar_first=True)
        axis = given.apply([0.0, 1.0, 0.0])
        turned = Rotation.from_rotvec(np.cross(axis, eta)) * given
        turned = Rotation.from_rotvec(np.cross(turned.apply([0.0, 1.0, 0.0]), eta)) * turned
        quaternion = turned.as_quat(scalar_first=True)
        scene = eqx.tree_at(
            lambda s, name=name: (s.bodies[name].position, s.bodies[name].quaternion), scene, (position, quaternion)
        )
    return scene


def times(t_end: float, n: int = 2):
    """n sample times from 0 to t_end [s]."""
    return jnp.linspace(0.0, t_end, n)
