"""`sj.studies.pose_play`: the poses that clearances allow."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.rotation import rotation_matrix
from spherejax.foundations.types import Flag, Number, Scalar
from spherejax.model.drift import NoDriftControl
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene
from spherejax.motion.start.assembly import CLOSING_TOLERANCE
from spherejax.motion.start.tolerances import length_scale
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints.journal import PlacedJournal
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.state import VELOCITY_SIZE
from spherejax.program_cache import cached_jit
from spherejax.runtime import require_float64
from spherejax.studies.inverse.kinematics import displaced
from spherejax.studies.inverse.least_squares import pseudoinverse
from spherejax.studies.inverse.mechanism import ideal_joint
from spherejax.studies.inverse.terms import closing, described_pose, evaluated, flat_state, joint_rows, rows_of_point
from spherejax.studies.play.play_result import PosePlay

CLOSING_STEPS = 25
"""Newton steps from the described start to the pose without play."""

LOOSE = 1e-6
"""Motion of the point by a free direction of the mechanism, as a share of that direction, from which on it counts."""


def pose_play(scene: Scene, point: str, *, t: Number = 0.0) -> PosePlay:
    """How far the clearances of the joints let a point and its body move while all motors stand.

        joint = sj.Dry(clearance=5e-5, normal=sj.Hertz(stiffness=1e8, exponent=1.0))
        play = sj.studies.pose_play(sj.gallery.five_bar(joint), "left_rod.tip")
        play.reach((1, 0, 0))              # m, to either side
        play.shares((1, 0, 0, 0, 0, 0))    # what each joint adds

    Balls may be anywhere within their clearances, and journals anywhere in the plane across their bearings; which pose
    is taken is up to loads and history. Loops are closed. To first order in the clearances the extent along a direction
    is exact, for the set is a sum of ellipsoids: no sampling finds more, and `play.worst` says the eccentricities that
    reach it; `play.change` closes the mechanism exactly for given ones.

    Args:
        scene: the mechanism, with `Dry` or `Lubricated` models in spherical and revolute joints, and with drivers that
            hold what its motors hold. Bushings count as ideal: they give way to loads, of which there are none here.
        point: `"body.point"` or `"body"`, its center of mass.

    Other args:
        t: time at which the drivers are taken [s].

    Returns:
        The influence of each joint, and what follows from it. Differentiable by the numbers of the scene, under `jit`
        and `vmap`; where numbers are traced, NaN in place of the errors below.

    Raises:
        SceneError: where no joint has a clearance, where the point can move by itself because a motor is not held, or
            where the joints cannot be closed.

    Limits: terms of the second order are left out: about the clearance over the shortest link, as a share. Near a
    singular pose they are all there is. A journal keeps parallel to its bearing; a `Rim` is refused.

    Source: derived from the closed equations, D dq = e. Extents of sums of ellipsoids by support functions: Schneider,
    Convex Bodies (2014), section 1.7; the same for pins of planar mechanisms is the worst case of Innocenti (2002),
    ASME J. Mech. Des. 124:661-667.
    """
    require_float64()
    compiled = compile_scene(scene)
    system = compiled.system
    body, place = _point(scene, point)
    loose = _with_clearance(system)
    if not loose:
        raise SceneError("no joint has a clearance: give spherical or revolute joints a Dry or a Lubricated model")
    for name, joint in loose.items():
        if isinstance(joint, PlacedJournal) and joint.guide is None:
            raise SceneError(f"joint {name!r} is a rim, which tilts in its bearing: give a Revolute in its place")
        surfaces: Any = getattr(joint.model, "surfaces", None)
        if surfaces is not None and not surfaces.are_round:
            raise SceneError(
                f"joint {name!r} has surfaces that are not round, and play is of round ones: leave out its "
                "socket_depth and ball_depth, with a clearance that is larger by their mean"
            )
    ideal = {name: ideal_joint(joint, friction=False) for name, joint in system.joints.items()}
    bare = System(system.bodies, ideal, {}, system.gravity, NoDriftControl(), (), False)
    starts = {name: rows.start for name, rows in joint_rows(bare).items()}
    number = list(system.bodies).index(body)
    t = jnp.asarray(t, jnp.float64)
    pose, residual, inverse, free, scales = _closed(bare, t)
    end = rows_of_point(pose, number, place) / scales
    is_right = _checked([*compiled.conditions, residual < CLOSING_TOLERANCE], residual, end @ free)
    influence, clearances = {}, {}
    for name, joint in loose.items():
        model: Any = joint.model
        J = end @ inverse[:, starts[name] : starts[name] + 3]
        if isinstance(joint, PlacedJournal):
            axis = _axis(joint, list(system.bodies), pose)
            J = J @ (jnp.eye(3) - jnp.outer(axis, axis))
        influence[name] = jnp.where(is_right, J, jnp.nan)
        # Guarded norms are zero of what is not a number: without this a pose that has no answer would have no play.
        clearances[name] = jnp.where(is_right, model.clearance, jnp.nan)
    rows = {name: starts[name] for name in loose}
    return PosePlay(influence, clearances, pose, bare, rows, number, place, t, scales)


@cached_jit(what="the pose without play")
def _closed(system: System, t):
    """The closed pose, what remains, D^+ and the projector onto free directions, and the scales of steps."""
    length = jnp.asarray(length_scale(system), jnp.float64)
    scales = jnp.tile(jnp.concatenate([jnp.full(3, 1 / length), jnp.ones(3)]), len(system.bodies))
    scales = jax.lax.stop_gradient(scales)

    def terms(pose):
        return evaluated(closing, system, t, flat_state(pose, jnp.zeros((len(system.bodies), VELOCITY_SIZE))))

    def step(pose, _):
        constraints = terms(pose)
        move = -pseudoinverse(constraints.jacobian / scales) @ constraints.residual
        return displaced(pose, (move / scales).reshape(-1, VELOCITY_SIZE)), None

    pose, _ = jax.lax.scan(step, described_pose(system), length=CLOSING_STEPS)
    constraints = terms(pose)
    inverse = pseudoinverse(constraints.jacobian / scales)
    free = jnp.eye(scales.shape[0]) - inverse @ (constraints.jacobian / scales)
    return pose, jnp.max(jnp.abs(constraints.residual)), inverse, free, scales


def _with_clearance(system: System) -> dict[str, Any]:
    """The joints with a clearance, by name."""
    return {
        name: joint
        for name, joint in system.joints.items()
        if isinstance(joint, PlacedSpherical) and joint.model.has_surfaces
    }


def _point(scene: Scene, point: str):
    if "." in point:
        body, place = scene.find(point)
    else:
        body, place = point, np.zeros(3)
        scene.require_body(body, f"point {point!r}")
    if body == GROUND:
        raise SceneError(f"point {point!r} is on the ground, which has no play; name a point of a body")
    return body, place


def _axis(joint: PlacedJournal, names: list[str], pose):
    """The bearing's axis in the world."""
    axis = jnp.asarray(joint.frame)[:, 2]
    first = joint.bodies[0]
    return axis if first == GROUND else rotation_matrix(pose[names.index(first)][3:]) @ axis


def _checked(conditions: list, residual: Scalar, moved: Float[Array, "6 k"]) -> Flag:
    """Whether there is an answer: an error where numbers are known and there is none, else a flag.

    Args:
        conditions: of the scene, and that its joints are closed.
        residual: what the joints lack [m or rad].
        moved: how the pose moves by the free directions of the mechanism.
    """
    largest = jnp.max(jnp.abs(moved))
    is_right = jnp.all(jnp.stack([*conditions, largest <= LOOSE]))
    if not all(map(is_concrete, (residual, moved))):
        return is_right
    if not float(residual) < CLOSING_TOLERANCE:
        raise SceneError(
            f"the joints and drivers cannot be closed: {float(residual):.3g} m or rad remain. Describe a start that is "
            "nearer to a closed one"
        )
    if float(largest) > LOOSE:
        raise SceneError(
            "the point can move though all joints are ideal: a degree of freedom is not held. Add a driver for each "
            "motor that stands, e.g. sj.RotationDriver(bodies, axis, rate=0.0)"
        )
    return is_right
