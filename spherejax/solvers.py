"""Methods of integration, and what keeps a motion on its constraints.

    sj.simulate(scene, ts, solver=sj.solvers.Rodas5P())

The methods that stand here are beside those of diffrax. `Baumgarte`, `PostStabilization`, `Projection` and
`NoDriftControl` are values of `drift=`; `Block` says how many runs are computed side by side.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
