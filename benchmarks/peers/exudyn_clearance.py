"""A sweep of the dry four-bar by Exudyn's own means: its contact of a sphere in a hollow one, its ParameterVariation.

A process of its own, without JAX: ParameterVariation forks. It reads the numbers of `sweeps.py` as JSON and
answers with the heights of the rocker's center at the end [m] and the seconds taken.

Exudyn's contact law is Hunt and Crossley's, with an onset memory as ours, and its friction grows linearly, not as a
hyperbolic tangent, up to the threshold velocity: errors are those against its own law.
"""

import json
import sys
import time

import numpy as np


def height(parameters: dict) -> float:
    """Height of the rocker's center at the end of one run [m]."""
    import exudyn as exu
    from exudyn.utilities import RigidBodyInertia

    numbers, clearance = parameters["functionData"], parameters["clearance"]
    model = exu.SystemContainer().AddSystem()
    bodies = {"ground": model.CreateGround()}
    for body in numbers["bodies"]:
        bodies[body["name"]] = model.CreateRigidBody(
            inertia=RigidBodyInertia(mass=body["mass"], inertiaTensor=np.diag(body["inertia"]), com=[0, 0, 0]),
            referencePosition=body["position"],
            referenceRotationMatrix=np.array(body["rotation"]),
            gravity=numbers["gravity"],
        )
    for pivot in numbers["pivots"]:
        pair = [bodies["ground"], bodies[pivot["body"]]]
        model.CreateRevoluteJoint(itemNumbers=pair, position=pivot["point"], axis=pivot["axis"])
    model.CreateSphericalJoint(itemNumbers=[bodies["crank"], bodies["coupler"]], position=numbers["pin"])
    radius = numbers["socket_radius"]
    model.CreateSphereSphereContact(
        # The hollow sphere is the second one.
        itemNumbers=[bodies[numbers["ball"]["body"]], bodies[numbers["socket"]["body"]]],
        localPosition0=numbers["ball"]["point"],
        localPosition1=numbers["socket"]["point"],
        spheresRadii=[radius - clearance, radius],
        isHollowSphere1=True,
        contactStiffness=numbers["stiffness"][repr(clearance)],
        contactStiffnessExponent=1.5,
        restitutionCoefficient=numbers["restitution"],
        impactModel=1,
        dynamicFriction=numbers["mu"],
        frictionProportionalZone=numbers["v1"],
    )
    model.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.endTime = numbers["duration"]
    settings.timeIntegration.numberOfSteps = round(numbers["duration"] / numbers["step"])
    settings.timeIntegration.verboseMode = 0
    # Without these Newton's method fails at the first impact, with every step and law that was tried.
    settings.timeIntegration.discontinuous.maxIterations = 10
    settings.timeIntegration.discontinuous.ignoreMaxIterations = True
    settings.timeIntegration.discontinuous.useRecommendedStepSize = False
    settings.solutionSettings.writeSolutionToFile = False
    settings.linearSolverType = exu.LinearSolverType.EigenDense
    model.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
    return float(model.GetObjectOutputBody(bodies["rocker"], exu.OutputVariableType.Position)[2])


def main() -> None:
    from exudyn.processing import ParameterVariation

    asked = json.load(sys.stdin)
    begin = time.perf_counter()
    _, heights = ParameterVariation(
        parameterFunction=height,
        parameters={"clearance": asked["clearances"]},
        useMultiProcessing=True,
        numberOfThreads=asked["cores"],
        showProgress=False,
        parameterFunctionData=asked["numbers"],
    )
    print(json.dumps({"heights": list(heights), "seconds": time.perf_counter() - begin}))


if __name__ == "__main__":
    main()
