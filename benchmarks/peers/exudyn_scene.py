"""Scenes in Exudyn: redundant coordinates with Euler parameters, index-2 trapezoidal rule, fixed step."""

from collections.abc import Callable, Mapping

import numpy as np

import spherejax as sj
from peers.started import NoCounterpartError, Start, start_of
from spherejax.physics.bodies import GROUND

Positions = dict[str, np.ndarray]
"""Positions of the centers of mass at the samples, shape (n, 3), by body [m]."""

AddForces = Callable[[object, Mapping[str, object], Start], None]
"""Adds what is not translated: called with the model, Exudyn's numbers of the bodies, and the start."""


def runner(scene: sj.Scene, add_forces: AddForces | None = None) -> Callable[[float, np.ndarray], Positions]:
    """A function of step size [s] and equidistant sample times that returns the bodies' positions.

    Raises:
        NoCounterpartError: for a joint or force that this translator does not know.
    """
    import exudyn as exu
    from exudyn.utilities import SensorBody

    start = start_of(scene)
    _container, model, numbers = _model(scene, start, add_forces)
    sensors = {
        name: model.AddSensor(
            SensorBody(bodyNumber=numbers[name], storeInternal=True, outputVariableType=exu.OutputVariableType.Position)
        )
        for name in start.system.bodies
    }
    model.Assemble()

    def run(step: float, ts: np.ndarray) -> Positions:
        settings = exu.SimulationSettings()
        settings.timeIntegration.endTime = float(ts[-1])
        settings.timeIntegration.numberOfSteps = round(float(ts[-1]) / step)
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = float(ts[1] - ts[0])
        settings.displayStatistics = False
        # Planar loops in space repeat equations: a solver that picks pivots leaves the superfluous ones out.
        settings.linearSolverSettings.ignoreSingularJacobian = True
        settings.linearSolverType = exu.LinearSolverType.EigenDense
        model.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
        stored = {name: model.GetSensorStoredData(sensor) for name, sensor in sensors.items()}
        return {
            name: np.stack([np.interp(ts, rows[:, 0], rows[:, 1 + axis]) for axis in range(3)], 1)
            for name, rows in stored.items()
        }

    return run


def eigenvalues(scene: sj.Scene) -> np.ndarray:
    """All eigenvalues [1/s] about the start, which must be at rest: of the equations in the null space of constraints.

    Forces of constraints are left out of account there, and what their change with the position does to the stiffness:
    right where no joint that constrains is loaded. Derivatives are Exudyn's differences.

    Raises:
        NoCounterpartError: for a joint or force that this translator does not know.
    """
    _container, model, _ = _model(scene, start_of(scene), None)
    model.Assemble()
    values, _vectors = model.ComputeODE2Eigenvalues(computeComplexEigenvalues=True, useAbsoluteValues=False)
    return np.asarray(values)


def _model(scene: sj.Scene, start: Start, add_forces: AddForces | None):
    """Exudyn's container (which owns the model), the model, and its numbers of the bodies."""
    import exudyn as exu

    container = exu.SystemContainer()
    model = container.AddSystem()
    numbers = _bodies(model, start)
    for name in scene.joints:
        _joint(model, numbers, start, scene.joints[name], name)
    if add_forces is not None:
        add_forces(model, numbers, start)
    else:
        for name, force in scene.forces.items():
            _spring(model, numbers, scene, force, name)
    return container, model, numbers


def _bodies(model, start: Start) -> dict[str, object]:
    from exudyn.utilities import RigidBodyInertia

    numbers = {GROUND: model.CreateGround()}
    for name, body in start.system.bodies.items():
        inertia = np.asarray(body.inertia)
        pose = start.poses[name]
        numbers[name] = model.CreateRigidBody(
            inertia=RigidBodyInertia(
                mass=float(body.mass), inertiaTensor=np.diag(inertia) if inertia.ndim == 1 else inertia, com=[0, 0, 0]
            ),
            referencePosition=list(pose.position),
            referenceRotationMatrix=pose.rotation,
            initialVelocity=list(pose.velocity),
            initialAngularVelocity=list(pose.angular_velocity),
            gravity=list(np.asarray(start.system.gravity)),
        )
    return numbers


def _joint(model, numbers, start: Start, joint, name: str) -> None:
    placed = start.system.joints[name]
    pair = [numbers[body] for body in placed.bodies]
    at = {"itemNumbers": pair, "position": list(start.poses[placed.bodies[1]].point(placed.points[1]))}
    resists = getattr(joint, "model", sj.Ideal())
    if isinstance(joint, sj.Spherical) and isinstance(resists, sj.Bushing):
        _bushing(model, pair, placed)
    elif not resists.is_ideal:
        raise NoCounterpartError(f"joint {name!r} with {type(resists).__name__}")
    elif isinstance(joint, sj.Spherical):
        model.CreateSphericalJoint(**at)
    elif isinstance(joint, sj.Revolute):
        model.CreateRevoluteJoint(**at, axis=list(np.asarray(joint.axis)))
    elif isinstance(joint, sj.Prismatic):
        model.CreatePrismaticJoint(**at, axis=list(np.asarray(joint.axis)))
    elif isinstance(joint, sj.Universal):
        # What is perpendicular: the first axis (x) on the one body, the second axis (y) on the other.
        axes = _axes(joint.first_axis, joint.second_axis)
        model.CreateGenericJoint(**at, rotationMatrixAxes=axes, constrainedAxes=[1, 1, 1, 0, 0, 1])
    elif isinstance(joint, sj.Fixed):
        model.CreateGenericJoint(**at, constrainedAxes=[1] * 6)
    elif isinstance(joint, sj.joints.Distance):
        first, second = (list(np.asarray(place)) for place in placed.points)
        model.CreateDistanceConstraint(itemNumbers=pair, localPosition0=first, localPosition1=second)
    else:
        raise NoCounterpartError(f"joint {name!r} ({type(joint).__name__})")


def _axes(x, y) -> np.ndarray:
    x = np.asarray(x, float) / np.linalg.norm(x)
    y = np.asarray(y, float) - x * (x @ np.asarray(y, float))
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _spring(model, numbers, scene: sj.Scene, force, name: str) -> None:
    laws = [getattr(force, law, None) for law in ("spring", "damper", "law", "direction")]
    if not isinstance(force, sj.SpringDamper) or any(law is not None for law in laws):
        raise NoCounterpartError(f"force {name!r} ({type(force).__name__}): give add_forces=")
    (first, start), (second, end) = (scene.find(point) for point in force.ends)
    model.CreateSpringDamper(
        itemNumbers=[numbers[first], numbers[second]],
        localPosition0=list(np.asarray(start)),
        localPosition1=list(np.asarray(end)),
        stiffness=float(force.stiffness),
        damping=float(force.damping),
        referenceLength=float(force.free_length),
    )


def _bushing(model, pair, joint) -> None:
    law = joint.model.law
    if not isinstance(law, sj.laws.VectorElastomer):
        raise NoCounterpartError(f"{type(law).__name__}: Exudyn's damps in every direction, as VectorElastomer")
    k, b = float(law.stiffness), float(law.damping)
    model.CreateCartesianSpringDamper(
        itemNumbers=pair,
        localPosition0=list(np.asarray(joint.socket_place)),
        localPosition1=list(np.asarray(joint.ball_place)),
        stiffness=[k] * 3,
        damping=[k * b] * 3,
    )
