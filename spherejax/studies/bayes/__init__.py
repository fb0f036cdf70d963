"""The posterior distribution of a fit's parameters (extra `bayes`).

prior and likelihood   `priors`, `density`: log densities of unknowns without bounds
draws                  `sampling`: chains of the no-U-turn sampler
how far to trust them  `result`
"""

from spherejax.studies.bayes.bayes_result import Posterior
from spherejax.studies.bayes.posterior import posterior
from spherejax.studies.bayes.priors import LogNormal, LogUniform, Normal, Prior, Uniform

__all__ = ["LogNormal", "LogUniform", "Normal", "Posterior", "Prior", "Uniform", "posterior"]
