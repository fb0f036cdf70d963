"""spherejax: rigid multibody systems whose spherical joints are ideal, dry, lubricated or elastic, in JAX.

A joint is a place and a model; changing the physics changes one word:

    import jax.numpy as jnp
    import spherejax as sj

    scene = sj.gallery.four_bar(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1)))
    run = sj.simulate(scene, ts=jnp.linspace(0.0, 2.0, 201))
    run.position("rocker")
"""

import importlib as _importlib
import os as _os
from typing import TYPE_CHECKING as _TYPE_CHECKING

from spherejax import runtime

if _os.environ.get("SPHEREJAX_CONFIGURE", "1") != "0":
    runtime.configure()

from spherejax import gallery, priors
from spherejax.files import SceneFile, SimulationSettings, load_scene, load_urdf, read_scene_file, save_scene
from spherejax.foundations.checks import Requirement, SceneError
from spherejax.foundations.scalarize import NotScalarizable, ScalarProgram, scalarize
from spherejax.model.drift import (
    AbstractDriftControl,
    Baumgarte,
    NoDriftControl,
    PostStabilization,
    Projection,
)
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene
from spherejax.motion.assembly import Assembly
from spherejax.motion.equilibrium import Equilibrium, equilibrium
from spherejax.motion.lanes import Block
from spherejax.motion.lanes.operation import SerialRunsWarning
from spherejax.motion.many import Runs, simulate_many
from spherejax.motion.modes import Mode
from spherejax.motion.programs import ArrayPathWarning
from spherejax.motion.redundancy import ConstraintReport, constraint_report
from spherejax.motion.simulate import simulate
from spherejax.motion.solvers.rosenbrock import Rodas4P, Rodas5P, Ros34PW2
from spherejax.motion.start import StartWarning
from spherejax.motion.status import SimulationError, SimulationWarning, Status
from spherejax.motion.trajectory import Trajectory
from spherejax.output.citations import cite
from spherejax.output.drawing import animate, draw, view
from spherejax.physics.bodies import Body
from spherejax.physics.forces import (
    AbstractForce,
    AppliedWrench,
    BumpStop,
    ShockAbsorber,
    SpringDamper,
    TorsionalSpring,
    Tyre,
    Wrench,
)
from spherejax.physics.functions import (
    AbstractFunction,
    Bump,
    Constant,
    Linear,
    Piecewise,
    Polynomial,
    Sine,
    SmoothStep,
    SmoothTable,
    Step,
    Sum,
    Table,
    UserFunction,
)
from spherejax.physics.joints import (
    AbstractCurve,
    AbstractJoint,
    AbstractPlacedJoint,
    AbstractSphericalModel,
    Bushing,
    Circle,
    ConstraintRows,
    Cylindrical,
    Distance,
    DistanceDriver,
    Dry,
    Fixed,
    Ideal,
    ImplicitCurve,
    Line,
    Lubricated,
    PointOnCurve,
    PointOnPlane,
    PositionDriver,
    Prismatic,
    Response,
    Revolute,
    RotationDriver,
    Spherical,
    TranslationDriver,
    Universal,
    differentiated_rows,
)
from spherejax.physics.laws import (
    AbstractElastomer,
    AbstractFilm,
    AbstractFilmBoundary,
    AbstractFrictionLaw,
    AbstractHysteresisLaw,
    AbstractNormalLaw,
    AbstractStaticFriction,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Coulomb,
    CrossElastomer,
    CurveElastomer,
    ExactRestitution,
    FilmAction,
    FilmGap,
    FilmMotion,
    Flores,
    FullFilm,
    Gonthier,
    Guembel,
    Hertz,
    HingeElastomer,
    HuntCrossley,
    LankaraniNikravesh,
    LuGre,
    Material,
    MatrixElastomer,
    PinkusSternlicht,
    RadialElastomer,
    RadialFilm,
    ShearFactors,
    Sommerfeld,
    Threlfall,
    VectorElastomer,
    exact_hysteresis_factor,
    film_force,
    full_sphere_load,
    generalized_stiffness,
    half_sphere_load,
    hybrid_weight,
    maximum_penetration,
    realized_restitution,
    shear_factors,
    squeeze_coefficient,
    squeeze_factor,
)
from spherejax.studies.accuracy import SOLVERS, WorkPrecision, work_precision
from spherejax.studies.bayes import Posterior, posterior
from spherejax.studies.design import Design, optimize, smooth_peak
from spherejax.studies.effects import effects
from spherejax.studies.fit import (
    Descent,
    Fit,
    GrowingHorizon,
    LevenbergMarquardt,
    Measured,
    Parameter,
    Whole,
    fit,
)
from spherejax.studies.sensitivity import Sensitivities, sensitivity
from spherejax.studies.sweep import (
    Grid,
    Sensitivity,
    StoreWarning,
    SweepError,
    open_sweep,
    product,
    random_samples,
    sobol_samples,
    sweep,
    zipped,
)

if _TYPE_CHECKING:
    from spherejax import plot

__all__ = [
    "SOLVERS",
    "AbstractCurve",
    "AbstractDriftControl",
    "AbstractElastomer",
    "AbstractFilm",
    "AbstractFilmBoundary",
    "AbstractForce",
    "AbstractFrictionLaw",
    "AbstractFunction",
    "AbstractHysteresisLaw",
    "AbstractJoint",
    "AbstractNormalLaw",
    "AbstractPlacedJoint",
    "AbstractSphericalModel",
    "AbstractStaticFriction",
    "Ambrosio",
    "AppliedWrench",
    "ArrayPathWarning",
    "Assembly",
    "Baumgarte",
    "BengisuAkay",
    "Block",
    "Body",
    "BrownMcPhee",
    "Bump",
    "BumpStop",
    "Bushing",
    "Circle",
    "Constant",
    "ConstraintReport",
    "ConstraintRows",
    "Coulomb",
    "CrossElastomer",
    "CurveElastomer",
    "Cylindrical",
    "Descent",
    "Design",
    "Distance",
    "DistanceDriver",
    "Dry",
    "Equilibrium",
    "ExactRestitution",
    "FilmAction",
    "FilmGap",
    "FilmMotion",
    "Fit",
    "Fixed",
    "Flores",
    "FullFilm",
    "Gonthier",
    "Grid",
    "GrowingHorizon",
    "Guembel",
    "Hertz",
    "HingeElastomer",
    "HuntCrossley",
    "Ideal",
    "ImplicitCurve",
    "LankaraniNikravesh",
    "LevenbergMarquardt",
    "Line",
    "Linear",
    "LuGre",
    "Lubricated",
    "Material",
    "MatrixElastomer",
    "Measured",
    "Mode",
    "NoDriftControl",
    "NotScalarizable",
    "Parameter",
    "Piecewise",
    "PinkusSternlicht",
    "PointOnCurve",
    "PointOnPlane",
    "Polynomial",
    "PositionDriver",
    "PostStabilization",
    "Posterior",
    "Prismatic",
    "Projection",
    "RadialElastomer",
    "RadialFilm",
    "Requirement",
    "Response",
    "Revolute",
    "Rodas4P",
    "Rodas5P",
    "Ros34PW2",
    "RotationDriver",
    "Runs",
    "ScalarProgram",
    "Scene",
    "SceneError",
    "SceneFile",
    "Sensitivities",
    "Sensitivity",
    "SerialRunsWarning",
    "ShearFactors",
    "ShockAbsorber",
    "SimulationError",
    "SimulationSettings",
    "SimulationWarning",
    "Sine",
    "SmoothStep",
    "SmoothTable",
    "Sommerfeld",
    "Spherical",
    "SpringDamper",
    "StartWarning",
    "Status",
    "Step",
    "StoreWarning",
    "Sum",
    "SweepError",
    "System",
    "Table",
    "Threlfall",
    "TorsionalSpring",
    "Trajectory",
    "TranslationDriver",
    "Tyre",
    "Universal",
    "UserFunction",
    "VectorElastomer",
    "Whole",
    "WorkPrecision",
    "Wrench",
    "animate",
    "cite",
    "compile_scene",
    "constraint_report",
    "differentiated_rows",
    "draw",
    "effects",
    "equilibrium",
    "exact_hysteresis_factor",
    "film_force",
    "fit",
    "full_sphere_load",
    "gallery",
    "generalized_stiffness",
    "half_sphere_load",
    "hybrid_weight",
    "load_scene",
    "load_urdf",
    "maximum_penetration",
    "open_sweep",
    "optimize",
    "plot",
    "posterior",
    "priors",
    "product",
    "random_samples",
    "read_scene_file",
    "realized_restitution",
    "runtime",
    "save_scene",
    "scalarize",
    "sensitivity",
    "shear_factors",
    "simulate",
    "simulate_many",
    "smooth_peak",
    "sobol_samples",
    "squeeze_coefficient",
    "squeeze_factor",
    "sweep",
    "view",
    "work_precision",
    "zipped",
]


def __getattr__(name: str):
    """`sj.plot` imports matplotlib, so it is imported when it is first asked for."""
    if name == "plot":
        return _importlib.import_module("spherejax.plot")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
