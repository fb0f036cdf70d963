"""Priors for `sj.posterior`: what is known about parameters before the measurements.

    sj.posterior(fitted, priors={"stiffness": sj.priors.LogNormal(median=1e5, factor=2.0)})

A prior of your own is a function from the parameter to the logarithm of its density, up to a constant, written with
`jax.numpy`; of an array, to the sum over its numbers, or to one for each.
"""

from spherejax.studies.bayes.priors import LogNormal, LogUniform, Normal, Uniform

__all__ = ["LogNormal", "LogUniform", "Normal", "Uniform"]
