"""The public names of `spherejax`, and where each stands; loaded when it is first asked for."""

from . import (
    compiler,
    equations,
    errors,
    files,
    forces,
    functions,
    gallery,
    joints,
    laws,
    plot,
    priors,
    results,
    runtime,
    solvers,
    studies,
    vehicle,
)
from .files import load_mjcf, load_scene, load_urdf, save_scene
from .foundations.errors import SceneError
from .foundations.types import Unit
from .model.scene import Scene
from .motion.integration.status import SimulationError, SimulationWarning, Status
from .motion.results.stopping import When
from .motion.results.trajectory import Trajectory
from .motion.runs.continuation import continue_from
from .motion.runs.many import simulate_many
from .motion.runs.ode import ode
from .motion.runs.simulate import simulate
from .motion.runs.stepping import advance, start
from .motion.start.equilibrium import equilibrium
from .motion.start.redundancy import constraint_report
from .output.citations import cite
from .output.drawing import animate, draw, view
from .output.fmu import export_fmu
from .output.io import load, save
from .output.report import report
from .physics.bodies import Body
from .physics.forces.actuators import Actuator, Extension
from .physics.forces.applied import AppliedWrench
from .physics.forces.controllers import PID
from .physics.forces.coupler import Travel, Turn
from .physics.forces.spring_damper import SpringDamper
from .physics.forces.torsional import TorsionalSpring
from .physics.functions.base import Network
from .physics.joints.axial import Cylindrical, Prismatic, Revolute
from .physics.joints.bushing import Bushing
from .physics.joints.drivers import RotationDriver, TranslationDriver
from .physics.joints.dry import Dry
from .physics.joints.ideal import Ideal
from .physics.joints.lubricated import Lubricated
from .physics.joints.pairs import Fixed, Universal
from .physics.joints.spherical import Spherical
from .physics.laws.film import Guembel, PinkusSternlicht, Sommerfeld
from .physics.laws.friction import Ambrosio, BengisuAkay, BrownMcPhee, Coulomb, LuGre, Threlfall
from .physics.laws.material import Material
from .physics.laws.normal import ExactRestitution, Flores, Gonthier, Hertz, HuntCrossley, LankaraniNikravesh
from .physics.orientations import orientation
from .studies.accuracy import work_precision
from .studies.bayes import posterior
from .studies.cases import joint_models
from .studies.compare import compare
from .studies.cycles import steady_cycle
from .studies.design import optimize
from .studies.effects import effects
from .studies.fit import Measured, Parameter, fit
from .studies.inverse import inverse_dynamics
from .studies.linear import linearize
from .studies.model_choice import compare_models
from .studies.sensitivity import sensitivity
from .studies.sweep import open_sweep, sweep
from .studies.uncertainty import monte_carlo
from .studies.wear import wear

__all__ = [
    "PID",
    "Actuator",
    "Ambrosio",
    "AppliedWrench",
    "BengisuAkay",
    "Body",
    "BrownMcPhee",
    "Bushing",
    "Coulomb",
    "Cylindrical",
    "Dry",
    "ExactRestitution",
    "Extension",
    "Fixed",
    "Flores",
    "Gonthier",
    "Guembel",
    "Hertz",
    "HuntCrossley",
    "Ideal",
    "LankaraniNikravesh",
    "LuGre",
    "Lubricated",
    "Material",
    "Measured",
    "Network",
    "Parameter",
    "PinkusSternlicht",
    "Prismatic",
    "Revolute",
    "RotationDriver",
    "Scene",
    "SceneError",
    "SimulationError",
    "SimulationWarning",
    "Sommerfeld",
    "Spherical",
    "SpringDamper",
    "Status",
    "Threlfall",
    "TorsionalSpring",
    "Trajectory",
    "TranslationDriver",
    "Travel",
    "Turn",
    "Unit",
    "Universal",
    "When",
    "advance",
    "animate",
    "cite",
    "compare",
    "compare_models",
    "compiler",
    "constraint_report",
    "continue_from",
    "draw",
    "effects",
    "equations",
    "equilibrium",
    "errors",
    "export_fmu",
    "files",
    "fit",
    "forces",
    "functions",
    "gallery",
    "inverse_dynamics",
    "joint_models",
    "joints",
    "laws",
    "linearize",
    "load",
    "load_mjcf",
    "load_scene",
    "load_urdf",
    "monte_carlo",
    "ode",
    "open_sweep",
    "optimize",
    "orientation",
    "plot",
    "posterior",
    "priors",
    "report",
    "results",
    "runtime",
    "save",
    "save_scene",
    "sensitivity",
    "simulate",
    "simulate_many",
    "solvers",
    "start",
    "steady_cycle",
    "studies",
    "sweep",
    "vehicle",
    "view",
    "wear",
    "work_precision",
]
