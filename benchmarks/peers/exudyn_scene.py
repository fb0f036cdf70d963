"""Scenes in Exudyn: redundant coordinates with Euler parameters, index-2 trapezoidal rule, fixed step."""

from collections.abc import Callable, Mapping

import numpy as np
from peers.started import NoCounterpart, Start, start_of

import spherejax as sj
from spherejax.physics.bodies import GROUND
from spherejax.physics.joints import PlacedRevolute, PlacedSpherical

Positions = dict[str, np.ndarray]
"""Positions of the centers of mass at the samples, shape (n, 3), by body [m]."""

AddForces = Callable[[object, Mapping[str, object], Start], None]
"""Adds what is not translated: called with the model, Exudyn's numbers of the bodies, and the start."""


def runner(scene: sj.Scene, add_forces: AddForces | None = None) -> Callable[[float, np.ndarray], Positions]:
    """A function of step size [s] and equidistant sample times that returns the bodies' positions.

    Raises:
        NoCounterpart: for a joint or force that this translator does not know.
    """
    import exudyn as exu
    from exudyn.utilities import SensorBody

    start = start_of(scene)
    container = exu.SystemContainer()
    model = container.AddSystem()
    numbers = _bodies(model, start)
    for name in start.system.joints:
        _joint(model, numbers, start, name)
    if add_forces is not None:
        add_forces(model, numbers, start)
    elif start.system.forces:
        raise NoCounterpart(f"forces {', '.join(start.system.forces)}: give add_forces=")
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


def _joint(model, numbers, start: Start, name: str) -> None:
    joint = start.system.joints[name]
    pair = [numbers[body] for body in joint.bodies]
    second = start.poses[joint.bodies[1]]
    position = list(second.point(joint.points[1]))
    if isinstance(joint, PlacedSpherical) and joint.model.is_ideal:
        model.CreateSphericalJoint(itemNumbers=pair, position=position)
    elif isinstance(joint, PlacedSpherical) and isinstance(joint.model, sj.Bushing):
        _bushing(model, pair, joint)
    elif isinstance(joint, PlacedRevolute):
        model.CreateRevoluteJoint(itemNumbers=pair, position=position, axis=list(second.direction(joint.axis)))
    else:
        raise NoCounterpart(f"joint {name!r} ({type(joint).__name__})")


def _bushing(model, pair, joint: PlacedSpherical) -> None:
    law = joint.model.law
    if not isinstance(law, sj.VectorElastomer):
        raise NoCounterpart(f"{type(law).__name__}: Exudyn's spring-damper damps in every direction, as VectorElastomer")
    k, b = float(law.stiffness), float(law.damping)
    model.CreateCartesianSpringDamper(
        itemNumbers=pair,
        localPosition0=list(np.asarray(joint.socket_place)),
        localPosition1=list(np.asarray(joint.ball_place)),
        stiffness=[k] * 3,
        damping=[k * b] * 3,
    )
