from .accuracy import SOLVERS, WorkPrecision, work_precision
from .bayes import Posterior, posterior
from .cases import joint_models
from .cycles import Branch, Cycle, SweptSine, continuation, steady_cycle, swept_sine
from .design import Design, optimize, smooth_peak
from .fit import (
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
)
from .friction_band import FrictionBand, friction_band
from .inverse import InverseDynamics, SampledMotion, inverse_dynamics
from .linear import Linearization, Modes, linearize
from .model_choice import Candidate, ModelComparison, ModelEvidence, compare_models
from .play import PosePlay, pose_play
from .rubber import DynamicStiffness, StiffnessFit, dynamic_stiffness, fit_stiffness
from .sensitivity import Sensitivities
from .stiffness import EndCompliance, end_compliance
from .subject import Comparison, ModelRow
from .sweep import Grid, Sensitivity, Tolerance, open_sweep, product, random_samples, sobol_samples, zipped
from .uncertainty import Scatter, SobolIndices, ToleranceBudget, monte_carlo, sobol_indices, tolerance_budget
from .wear import Wear, WearBlock, WearIn, wear_in

__all__ = [
    "SOLVERS",
    "Branch",
    "Candidate",
    "Cauchy",
    "Comparison",
    "Cycle",
    "Descent",
    "Design",
    "Differentiator",
    "DynamicStiffness",
    "EndCompliance",
    "Fit",
    "FrictionBand",
    "Grid",
    "GrowingHorizon",
    "Huber",
    "InverseDynamics",
    "LevenbergMarquardt",
    "Linearization",
    "LowPass",
    "Measured",
    "ModelComparison",
    "ModelEvidence",
    "ModelRow",
    "Modes",
    "Parameter",
    "PosePlay",
    "Posterior",
    "SampledMotion",
    "Scatter",
    "Sensitivities",
    "Sensitivity",
    "Sensor",
    "SobolIndices",
    "StiffnessFit",
    "SweptSine",
    "Tolerance",
    "ToleranceBudget",
    "Wear",
    "WearBlock",
    "WearIn",
    "Whole",
    "WorkPrecision",
    "compare_models",
    "continuation",
    "dynamic_stiffness",
    "end_compliance",
    "fit_stiffness",
    "friction_band",
    "inverse_dynamics",
    "joint_models",
    "linearize",
    "monte_carlo",
    "open_sweep",
    "optimize",
    "pose_play",
    "posterior",
    "product",
    "random_samples",
    "smooth_peak",
    "sobol_indices",
    "sobol_samples",
    "steady_cycle",
    "swept_sine",
    "tolerance_budget",
    "wear_in",
    "work_precision",
    "zipped",
]
