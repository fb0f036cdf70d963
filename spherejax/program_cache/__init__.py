"""A cache of compiled programs, in memory and on disk; `README.md` in this folder says how it works.

It imports nothing of the package that uses it, and could be published alone. What it is told of that package goes
through `settings.configure`.
"""

import lazy_loader as _lazy_loader

# Names stand in `__init__.pyi`. They are loaded when they are first asked for: `import spherejax` needs `settings` and
# `gc_paused` alone, which do not load JAX.
__getattr__, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)
