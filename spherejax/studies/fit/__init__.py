"""Identification of parameters by gradients.

prediction(p)          `experiment`: what was measured, and its derivatives, from one integration
r(u)                   `problem`: residuals weighted by the noise, of unknowns without bounds (`parameters`)
min |r(u)|^2 / 2       `levenberg_marquardt`, `descent`; `record`: over parts of the record that grow
how far to trust it    `statistics`, `judgement`, in the `result`
"""

from spherejax.studies.fit.descent import Descent
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.fitting import fit
from spherejax.studies.fit.growth import Growth
from spherejax.studies.fit.horizon import GrowingHorizon
from spherejax.studies.fit.levenberg_marquardt import LevenbergMarquardt
from spherejax.studies.fit.losses import Cauchy, Huber, Loss
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.methods import Course, Ending, Method
from spherejax.studies.fit.parameters import Parameter
from spherejax.studies.fit.problem import Evaluation, Problem, problem_of
from spherejax.studies.fit.record import Grown, Horizon, Whole
from spherejax.studies.fit.sensor import Differentiator, LowPass, Sensor
from spherejax.studies.fit.statistics import Undetermined
from spherejax.studies.fit.validation import PredictionErrors, Validation

__all__ = [
    "Cauchy",
    "Course",
    "Descent",
    "Differentiator",
    "Ending",
    "Evaluation",
    "Fit",
    "GrowingHorizon",
    "Grown",
    "Growth",
    "Horizon",
    "Huber",
    "LevenbergMarquardt",
    "Loss",
    "LowPass",
    "Measured",
    "Method",
    "Parameter",
    "PredictionErrors",
    "Problem",
    "Sensor",
    "Undetermined",
    "Validation",
    "Whole",
    "fit",
    "problem_of",
]
