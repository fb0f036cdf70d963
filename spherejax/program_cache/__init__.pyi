"""The public names of the program cache; modules among them are namespaces of what belongs together."""

from . import disk_cache, fingerprints, folders, keys, settings, several_devices, user_code
from .garbage import gc_paused
from .jit import cached_jit
from .keys import memoized

__all__ = [
    "cached_jit",
    "disk_cache",
    "fingerprints",
    "folders",
    "gc_paused",
    "keys",
    "memoized",
    "settings",
    "several_devices",
    "user_code",
]
