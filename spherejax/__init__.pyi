"""The public names of `spherejax`, and where each stands; loaded when it is first asked for."""

from . import gallery, plot, priors, runtime
from .compiler import NotScalarizable, ScalarProgram, scalarize
from .files import SceneFile, SimulationSettings, load_mjcf, load_scene, load_urdf, read_scene_file, save_scene
from .files.robots.urdf_left_out import RobotWarning
from .foundations.checks import Requirement
from .foundations.errors import SceneError
from .foundations.types import Unit
from .gallery.wheel_suspensions import DOUBLE_WISHBONE, MCPHERSON
from .model.drift import AbstractDriftControl, Baumgarte, NoDriftControl, PostStabilization, Projection
from .model.scene import Scene
from .model.system import System, compile_scene
from .motion.equations.programs import ArrayPathWarning
from .motion.integration.lanes import Block
from .motion.integration.lanes.operation import SerialRunsWarning
from .motion.integration.status import OutOfRangeWarning, SimulationError, SimulationWarning, Status
from .motion.results.accuracy import Accuracy
from .motion.results.global_error import AccuracyWarning, GlobalError
from .motion.results.impacts import Peak
from .motion.results.modes import Mode
from .motion.results.motion_state import MotionState
from .motion.results.spectra import SpectrumWarning
from .motion.results.steps import PartingWarning
from .motion.results.stopping import When
from .motion.results.trajectory import Trajectory
from .motion.runs.continuation import continue_from
from .motion.runs.many import Runs, simulate_many
from .motion.runs.ode import EquationsOfMotion, Ode, ode
from .motion.runs.simulate import simulate
from .motion.runs.stepping import advance, start
from .motion.solvers.dop853 import Dop853
from .motion.solvers.rosenbrock import Rodas4P, Rodas5P, Ros34PW2
from .motion.start.assembly import Assembly
from .motion.start.equilibrium import Equilibrium, equilibrium
from .motion.start.redundancy import ConstraintReport, constraint_report
from .motion.start.start_now import StartWarning
from .output.citations import cite
from .output.drawing import animate, draw, view
from .output.fmu import export_fmu
from .output.io import load, save
from .output.report import report
from .physics.bodies import Body
from .physics.forces.actuators import Actuator, Extension, SampledActuator
from .physics.forces.applied import AppliedWrench
from .physics.forces.base import AbstractForce, Wrench
from .physics.forces.bump_stop import BumpStop
from .physics.forces.controllers import PID
from .physics.forces.coupler import AbstractCoordinate, Coupler, Travel, Turn
from .physics.forces.remembering import AbstractForceWithMemory, ForceAction, Instants, Sampling
from .physics.forces.sampled_pid import SampledPID
from .physics.forces.spring_damper import ShockAbsorber, SpringDamper
from .physics.forces.torsional import TorsionalSpring
from .physics.forces.torsional_stop import TorsionalStop
from .physics.forces.tyre import Tyre
from .physics.functions.base import AbstractFunction, Network, UserFunction
from .physics.functions.integral import Integral
from .physics.functions.pieces import Piecewise, Sum
from .physics.functions.roads import RandomRoad
from .physics.functions.shapes import (
    Bump,
    Constant,
    Linear,
    Polynomial,
    PowerTail,
    Sine,
    SmoothStep,
    Step,
)
from .physics.functions.tables import SmoothTable, Table
from .physics.joints.axial import Cylindrical, Prismatic, Revolute
from .physics.joints.base import AbstractSphericalModel, Response
from .physics.joints.bushing import Bushing
from .physics.joints.curves import AbstractCurve, Circle, ImplicitCurve, Line, PointOnCurve
from .physics.joints.distance import Distance, DistanceDriver
from .physics.joints.drivers import PositionDriver, RotationDriver, TranslationDriver
from .physics.joints.dry import Dry
from .physics.joints.ideal import Ideal
from .physics.joints.joint import AbstractJoint, AbstractPlacedJoint
from .physics.joints.lubricated import Lubricated
from .physics.joints.orientation import ParallelAxes, PerpendicularAxes, SameOrientation
from .physics.joints.pairs import Fixed, PointOnPlane, Universal
from .physics.joints.rim import Rim, tilting_journal
from .physics.joints.rows import ConstraintRows, differentiated_rows
from .physics.joints.spherical import Spherical
from .physics.laws.bearings import LongBearing, ShortBearing
from .physics.laws.conformity import AbstractConformity, SphericalProfile, WinklerLiner
from .physics.laws.cylinders import EsduCylinder, JohnsonCylinder
from .physics.laws.elastomer import AbstractElastomer, RadialElastomer, VectorElastomer
from .physics.laws.elastomer_axes import CrossElastomer, HingeElastomer
from .physics.laws.elastomer_curve import CurveElastomer
from .physics.laws.elastomer_matrix import MatrixElastomer
from .physics.laws.film import (
    AbstractFilmBoundary,
    Guembel,
    PinkusSternlicht,
    Sommerfeld,
    film_force,
    hybrid_weight,
    squeeze_coefficient,
    squeeze_factor,
)
from .physics.laws.films import (
    AbstractFilm,
    FilmAction,
    FilmGap,
    FilmMotion,
    FullFilm,
    RadialFilm,
)
from .physics.laws.friction import (
    AbstractFrictionLaw,
    AbstractStaticFriction,
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Coulomb,
    LuGre,
    Threlfall,
)
from .physics.laws.full_film import (
    PressurePeak,
    ShearFactors,
    full_sphere_load,
    half_sphere_load,
    pressure_peak,
    shear_factors,
)
from .physics.laws.impact import (
    exact_hysteresis_factor,
    maximum_penetration,
    realized_restitution,
)
from .physics.laws.material import Material, generalized_stiffness
from .physics.laws.normal import (
    AbstractHysteresisLaw,
    AbstractNormalLaw,
    ExactRestitution,
    Flores,
    Gonthier,
    Hertz,
    HuntCrossley,
    HuntCrossleyDissipation,
    LankaraniNikravesh,
)
from .physics.laws.pressure import (
    AbstractPressure,
    CosinePressure,
    PointContact,
    PreloadAlone,
    UniformPressure,
)
from .physics.laws.viscoelastic import Berg, Maxwell
from .physics.memory import MemoryEntry
from .physics.orientations import orientation
from .studies.accuracy import SOLVERS, WorkPrecision, work_precision
from .studies.bayes import Posterior, posterior
from .studies.cases import joint_models
from .studies.compare import compare
from .studies.cycles import Branch, Cycle, CycleWarning, SweptSine, continuation, steady_cycle, swept_sine
from .studies.design import Design, optimize, smooth_peak
from .studies.effects import effects
from .studies.fit import (
    Cauchy,
    Descent,
    Differentiator,
    Fit,
    GrowingHorizon,
    Huber,
    LevenbergMarquardt,
    LowPass,
    Measured,
    Parameter,
    Sensor,
    Whole,
    fit,
)
from .studies.inverse import InverseDynamics, InverseWarning, SampledMotion, inverse_dynamics
from .studies.linear import Linearization, LinearizationWarning, Modes, linearize
from .studies.model_choice import Candidate, ModelComparison, ModelEvidence, compare_models
from .studies.rig import Corner, Rig, RigStatus, RigWarning, Vehicle, WheelLoads, rig, rig_samples
from .studies.roads import load_road
from .studies.rubber import DynamicStiffness, StiffnessFit, dynamic_stiffness, fit_stiffness
from .studies.sensitivity import Sensitivities, sensitivity
from .studies.subject import Comparison, ModelRow
from .studies.sweep import (
    Grid,
    Sensitivity,
    StoreWarning,
    SweepError,
    Tolerance,
    open_sweep,
    product,
    random_samples,
    sobol_samples,
    sweep,
    zipped,
)
from .studies.uncertainty import (
    Scatter,
    SobolIndices,
    ToleranceBudget,
    UncertaintyWarning,
    monte_carlo,
    sobol_indices,
    tolerance_budget,
)
from .studies.wear import Wear, WearWarning, wear

__all__ = [
    "DOUBLE_WISHBONE",
    "MCPHERSON",
    "PID",
    "SOLVERS",
    "AbstractConformity",
    "AbstractCoordinate",
    "AbstractCurve",
    "AbstractDriftControl",
    "AbstractElastomer",
    "AbstractFilm",
    "AbstractFilmBoundary",
    "AbstractForce",
    "AbstractForceWithMemory",
    "AbstractFrictionLaw",
    "AbstractFunction",
    "AbstractHysteresisLaw",
    "AbstractJoint",
    "AbstractNormalLaw",
    "AbstractPlacedJoint",
    "AbstractPressure",
    "AbstractSphericalModel",
    "AbstractStaticFriction",
    "Accuracy",
    "AccuracyWarning",
    "Actuator",
    "Ambrosio",
    "AppliedWrench",
    "ArrayPathWarning",
    "Assembly",
    "Baumgarte",
    "BengisuAkay",
    "Berg",
    "Block",
    "Body",
    "Branch",
    "BrownMcPhee",
    "Bump",
    "BumpStop",
    "Bushing",
    "Candidate",
    "Cauchy",
    "Circle",
    "Comparison",
    "Constant",
    "ConstraintReport",
    "ConstraintRows",
    "Corner",
    "CosinePressure",
    "Coulomb",
    "Coupler",
    "CrossElastomer",
    "CurveElastomer",
    "Cycle",
    "CycleWarning",
    "Cylindrical",
    "Descent",
    "Design",
    "Differentiator",
    "Distance",
    "DistanceDriver",
    "Dop853",
    "Dry",
    "DynamicStiffness",
    "EquationsOfMotion",
    "Equilibrium",
    "EsduCylinder",
    "ExactRestitution",
    "Extension",
    "FilmAction",
    "FilmGap",
    "FilmMotion",
    "Fit",
    "Fixed",
    "Flores",
    "ForceAction",
    "FullFilm",
    "GlobalError",
    "Gonthier",
    "Grid",
    "GrowingHorizon",
    "Guembel",
    "Hertz",
    "HingeElastomer",
    "Huber",
    "HuntCrossley",
    "HuntCrossleyDissipation",
    "Ideal",
    "ImplicitCurve",
    "Instants",
    "Integral",
    "InverseDynamics",
    "InverseWarning",
    "JohnsonCylinder",
    "LankaraniNikravesh",
    "LevenbergMarquardt",
    "Line",
    "Linear",
    "Linearization",
    "LinearizationWarning",
    "LongBearing",
    "LowPass",
    "LuGre",
    "Lubricated",
    "Material",
    "MatrixElastomer",
    "Maxwell",
    "Measured",
    "MemoryEntry",
    "Mode",
    "ModelComparison",
    "ModelEvidence",
    "ModelRow",
    "Modes",
    "MotionState",
    "Network",
    "NoDriftControl",
    "NotScalarizable",
    "Ode",
    "OutOfRangeWarning",
    "ParallelAxes",
    "Parameter",
    "PartingWarning",
    "Peak",
    "PerpendicularAxes",
    "Piecewise",
    "PinkusSternlicht",
    "PointContact",
    "PointOnCurve",
    "PointOnPlane",
    "Polynomial",
    "PositionDriver",
    "PostStabilization",
    "Posterior",
    "PowerTail",
    "PreloadAlone",
    "PressurePeak",
    "Prismatic",
    "Projection",
    "RadialElastomer",
    "RadialFilm",
    "RandomRoad",
    "Requirement",
    "Response",
    "Revolute",
    "Rig",
    "RigStatus",
    "RigWarning",
    "Rim",
    "RobotWarning",
    "Rodas4P",
    "Rodas5P",
    "Ros34PW2",
    "RotationDriver",
    "Runs",
    "SameOrientation",
    "SampledActuator",
    "SampledMotion",
    "SampledPID",
    "Sampling",
    "ScalarProgram",
    "Scatter",
    "Scene",
    "SceneError",
    "SceneFile",
    "Sensitivities",
    "Sensitivity",
    "Sensor",
    "SerialRunsWarning",
    "ShearFactors",
    "ShockAbsorber",
    "ShortBearing",
    "SimulationError",
    "SimulationSettings",
    "SimulationWarning",
    "Sine",
    "SmoothStep",
    "SmoothTable",
    "SobolIndices",
    "Sommerfeld",
    "SpectrumWarning",
    "Spherical",
    "SphericalProfile",
    "SpringDamper",
    "StartWarning",
    "Status",
    "Step",
    "StiffnessFit",
    "StoreWarning",
    "Sum",
    "SweepError",
    "SweptSine",
    "System",
    "Table",
    "Threlfall",
    "Tolerance",
    "ToleranceBudget",
    "TorsionalSpring",
    "TorsionalStop",
    "Trajectory",
    "TranslationDriver",
    "Travel",
    "Turn",
    "Tyre",
    "UncertaintyWarning",
    "UniformPressure",
    "Unit",
    "Universal",
    "UserFunction",
    "VectorElastomer",
    "Vehicle",
    "Wear",
    "WearWarning",
    "WheelLoads",
    "When",
    "Whole",
    "WinklerLiner",
    "WorkPrecision",
    "Wrench",
    "advance",
    "animate",
    "cite",
    "compare",
    "compare_models",
    "compile_scene",
    "constraint_report",
    "continuation",
    "continue_from",
    "differentiated_rows",
    "draw",
    "dynamic_stiffness",
    "effects",
    "equilibrium",
    "exact_hysteresis_factor",
    "export_fmu",
    "film_force",
    "fit",
    "fit_stiffness",
    "full_sphere_load",
    "gallery",
    "generalized_stiffness",
    "half_sphere_load",
    "hybrid_weight",
    "inverse_dynamics",
    "joint_models",
    "linearize",
    "load",
    "load_mjcf",
    "load_road",
    "load_scene",
    "load_urdf",
    "maximum_penetration",
    "monte_carlo",
    "ode",
    "open_sweep",
    "optimize",
    "orientation",
    "plot",
    "posterior",
    "pressure_peak",
    "priors",
    "product",
    "random_samples",
    "read_scene_file",
    "realized_restitution",
    "report",
    "rig",
    "rig_samples",
    "runtime",
    "save",
    "save_scene",
    "scalarize",
    "sensitivity",
    "shear_factors",
    "simulate",
    "simulate_many",
    "smooth_peak",
    "sobol_indices",
    "sobol_samples",
    "squeeze_coefficient",
    "squeeze_factor",
    "start",
    "steady_cycle",
    "sweep",
    "swept_sine",
    "tilting_journal",
    "tolerance_budget",
    "view",
    "wear",
    "work_precision",
    "zipped",
]
