"""The four-bar in Exudyn: its own redundant-coordinate model and its own implicit integrator. Optional.

Exudyn's step is fixed; the equations are index 3 without Baumgarte's feedback, the revolute joints and Euler parameters
its own. Its spring-damper damps in every direction, so the bushing is compared with spherejax's `VectorElastomer`.
Contact with an onset memory is not among its joints, and a user function in Python would measure Python: left out.
"""

from collections.abc import Callable

import numpy as np

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import compile_scene


def runner(model) -> Callable[[float, np.ndarray], np.ndarray]:
    """A function of step size [s] and equidistant sample times that returns the rocker's heights [m].

    Args:
        model: `sj.Ideal()`, or a `sj.Bushing` with a `VectorElastomer`.
    """
    import exudyn as exu
    from exudyn.utilities import RigidBodyInertia, SensorBody

    from baselines.parameters import problem

    scene = sj.gallery.four_bar(model)
    system = compile_scene(scene).system
    y0 = problem(sj.Ideal()).y0
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    ground = mbs.CreateGround()
    numbers = {}
    for i, (name, body) in enumerate(system.bodies.items()):
        inertia = RigidBodyInertia(mass=float(body.mass), inertiaTensor=np.diag(body.inertia), com=[0, 0, 0])
        numbers[name] = mbs.CreateRigidBody(
            inertia=inertia,
            referencePosition=list(y0[7 * i : 7 * i + 3]),
            referenceRotationMatrix=np.array(rotation_matrix(y0[7 * i + 3 : 7 * i + 7])),
            gravity=list(np.asarray(system.gravity)),
        )
    for name in ("crank_pivot", "rocker_pivot"):
        joint = scene.joints[name]
        pair = [ground, numbers[joint.bodies[1]]]
        mbs.CreateRevoluteJoint(itemNumbers=pair, position=list(joint.point), axis=list(joint.axis))
    pin = system.spherical("crank_coupler")
    at_pin = y0[7:10] + np.array(rotation_matrix(y0[10:14])) @ pin.socket_place
    mbs.CreateSphericalJoint(itemNumbers=[numbers["crank"], numbers["coupler"]], position=list(at_pin))
    studied = system.spherical("coupler_rocker")
    pair = [numbers["coupler"], numbers["rocker"]]
    if isinstance(model, sj.Ideal):
        center = y0[:3] + np.array(rotation_matrix(y0[3:7])) @ studied.socket_place
        mbs.CreateSphericalJoint(itemNumbers=pair, position=list(center))
    else:
        k, b = float(model.law.stiffness), float(model.law.damping)
        mbs.CreateCartesianSpringDamper(
            itemNumbers=pair,
            localPosition0=list(studied.socket_place),
            localPosition1=list(studied.ball_place),
            stiffness=[k] * 3,
            damping=[k * b] * 3,
        )
    sensor = mbs.AddSensor(
        SensorBody(bodyNumber=numbers["rocker"], storeInternal=True, outputVariableType=exu.OutputVariableType.Position)
    )
    mbs.Assemble()

    def run(step: float, ts: np.ndarray) -> np.ndarray:
        settings = exu.SimulationSettings()
        settings.timeIntegration.endTime = float(ts[-1])
        settings.timeIntegration.numberOfSteps = round(float(ts[-1]) / step)
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = float(ts[1] - ts[0])
        settings.displayStatistics = False
        mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
        stored = mbs.GetSensorStoredData(sensor)
        return np.interp(ts, stored[:, 0], stored[:, 3])

    return run
