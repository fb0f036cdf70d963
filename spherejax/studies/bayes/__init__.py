"""The posterior distribution of a fit's parameters (extra `bayes`).

prior and likelihood   `priors`, `density`: log densities of unknowns without bounds
draws                  `sampling`: chains of the no-U-turn sampler
how far to trust them  `result`
"""

from spherejax.studies.bayes.posterior import posterior
from spherejax.studies.bayes.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from spherejax.studies.bayes.result import Posterior

__all__ = ["LogNormal", "LogUniform", "Normal", "Posterior", "Prior", "Uniform", "posterior"]
