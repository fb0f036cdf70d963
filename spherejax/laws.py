"""Laws that models of joints are composed of: normal contact, friction, films, elastomers, pressures.

    sj.Dry(clearance=1e-4, normal=sj.Hertz(), friction=sj.Threlfall(mu=0.1))
    sj.Bushing(law=sj.laws.VectorElastomer(...))

Normal contact and friction, surfaces that nearly fit (`JohnsonCylinder`, `WinklerLiner`), films and their boundaries,
elastomers with relaxation and friction (`Maxwell`, `Berg`), pressures of friction in ideal joints, formulas that laws
are made of, and the abstract classes of laws of your own. The published contact and friction laws stand in `sj.` too.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
