"""How names of a namespace such as `sj.laws` are loaded when they are asked for, and where names of the top have moved.

The names of a namespace stand in the stub beside its module, which type checkers read as well. `lazy_loader` reads
stubs of packages only, whose modules lie below them; what a namespace offers lies beside it.
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from spherejax.program_cache import gc_paused

MOVED = {
    name: namespace
    for namespace, names in {
        "compiler": """
            NotScalarizable ScalarProgram scalarize
        """,
        "equations": """
            EquationsOfMotion Ode System compile_scene
        """,
        "errors": """
            AccuracyWarning ArrayPathWarning CycleWarning InverseWarning LinearizationWarning OutOfRangeWarning
            PartingWarning RobotWarning SerialRunsWarning SpectrumWarning StartWarning StoreWarning SweepError
            UncertaintyWarning WearWarning
        """,
        "files": """
            SceneFile SimulationSettings read_scene_file
        """,
        "forces": """
            AbstractCoordinate AbstractForce AbstractForceWithMemory BumpStop Coupler ForceAction Instants
            MemoryEntry SampledActuator SampledPID Sampling ShockAbsorber TorsionalStop Tyre Wrench
        """,
        "functions": """
            AbstractFunction Bump Constant Integral Linear Piecewise Polynomial PowerTail RandomRoad Sine
            SmoothStep SmoothTable Step Sum Table UserFunction
        """,
        "joints": """
            AbstractCurve AbstractJoint AbstractPlacedJoint AbstractSphericalModel Circle ConstraintRows
            Distance DistanceDriver ImplicitCurve Line ParallelAxes PerpendicularAxes PointOnCurve PointOnPlane
            PositionDriver Response Rim SameOrientation differentiated_rows tilting_journal
        """,
        "laws": """
            AbstractConformity AbstractElastomer AbstractFilm AbstractFilmBoundary AbstractFrictionLaw
            AbstractHysteresisLaw AbstractNormalLaw AbstractPressure AbstractStaticFriction Berg CosinePressure
            CrossElastomer CurveElastomer EsduCylinder FilmAction FilmGap FilmMotion FullFilm HingeElastomer
            HuntCrossleyDissipation JohnsonCylinder LongBearing MatrixElastomer Maxwell PointContact
            PreloadAlone PressurePeak RadialElastomer RadialFilm Requirement ShearFactors ShortBearing
            SphericalProfile UniformPressure VectorElastomer WinklerLiner exact_hysteresis_factor film_force
            full_sphere_load generalized_stiffness half_sphere_load hybrid_weight maximum_penetration
            pressure_peak realized_restitution shear_factors squeeze_coefficient squeeze_factor
        """,
        "results": """
            Accuracy Assembly ConstraintReport Equilibrium GlobalError ImpactRows Mode MotionState Peak Runs
        """,
        "solvers": """
            AbstractDriftControl Baumgarte Block Dop853 NoDriftControl PostStabilization Projection Rodas4P
            Rodas5P Ros34PW2
        """,
        "studies": """
            Branch Candidate Cauchy Comparison Cycle Descent Design Differentiator DynamicStiffness Fit Grid
            GrowingHorizon Huber InverseDynamics LevenbergMarquardt Linearization LowPass ModelComparison
            ModelEvidence ModelRow Modes Posterior SampledMotion Scatter Sensitivities Sensitivity Sensor
            SobolIndices SOLVERS StiffnessFit SweptSine Tolerance ToleranceBudget Wear Whole WorkPrecision
            continuation dynamic_stiffness fit_stiffness product random_samples smooth_peak sobol_indices
            sobol_samples swept_sine tolerance_budget zipped
        """,
        "vehicle": """
            Corner DOUBLE_WISHBONE MCPHERSON Rig RigStatus RigWarning Vehicle WheelLoads load_road rig
            rig_samples
        """,
    }.items()
    for name in names.split()
}
"""Names that stood at the top, and the namespace that each is in now; `sj.Line` still answers, with a warning."""


def attach(namespace: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a module of the package whose stub stands beside it."""
    places, public = _stub(Path(file).with_suffix(".pyi"))

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name not in places:
            raise AttributeError(f"no spherejax attribute {namespace.partition('.')[2]}.{name}", name=name)
        # Loading makes objects that all stay; to look for garbage among them takes a sixth of the time.
        with gc_paused():
            thing = getattr(import_module(f"spherejax.{places[name]}"), name)
        setattr(sys.modules[namespace], name, thing)
        return thing

    def __dir__() -> list[str]:  # noqa: N807
        return sorted(public)

    return __getattr__, __dir__, public


def _stub(path: Path) -> tuple[dict[str, str], list[str]]:
    """The module of each name of a stub, and the names that are public."""
    places, public = {}, []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            places |= {alias.name: node.module for alias in node.names}
        elif isinstance(node, ast.Assign):
            public = ast.literal_eval(node.value)
    return places, public
