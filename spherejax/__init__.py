"""spherejax: rigid multibody systems whose spherical joints are ideal, dry, lubricated or elastic, in JAX.

A joint is a place and a model; changing the physics changes one word:

    import jax.numpy as jnp
    import spherejax as sj

    scene = sj.gallery.four_bar(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=0.1)))
    run = sj.simulate(scene, ts=jnp.linspace(0.0, 2.0, 201))
    run.position("rocker")
"""

import sys as _sys
import warnings as _warnings

if _sys.argv[:1] == ["-m"] and not _sys.flags.safe_path:
    # `python -m spherejax` would import a `numpy.py` of the working folder, which may be somebody else's archive of
    # scenes, in place of the installed one. The command imports nothing from there, and so looks nowhere there. Before
    # any other import: Python's own modules could be replaced as well.
    _of = _sys.orig_argv[_sys.orig_argv.index("-m") + 1 :][:1] if "-m" in _sys.orig_argv else []
    if _of and _of[0].partition(".")[0] == __name__:
        del _sys.path[0]

from typing import Any as _Any

import lazy_loader as _lazy_loader

from spherejax import runtime, wiring
from spherejax.namespaces import MOVED as _MOVED
from spherejax.program_cache import gc_paused as _gc_paused

wiring.connect()

if not runtime.is_command():
    with _gc_paused():
        runtime.set_up()

# Names, and the modules that they come from, stand in `__init__.pyi`, which type checkers read as well. A module is
# loaded when one of its names is first asked for: the command reads its arguments without JAX, and only figures bring
# matplotlib.
_loaded, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> _Any:
    if name in _MOVED:
        _warnings.warn(f"sj.{name} is called sj.{_MOVED[name]}.{name}", DeprecationWarning, stacklevel=2)
        return getattr(__getattr__(_MOVED[name]), name)
    # Loading makes objects that all stay; to look for garbage among them takes a sixth of the time.
    with _gc_paused():
        return _loaded(name)
