"""The public names of the program cache; modules among them are namespaces of what belongs together."""

from . import disk_cache, fingerprints, folders, keys, settings, several_devices, user_code
from .garbage import gc_paused
from .jit import cached_jit
from .keys import remembered

__all__ = [
    "cached_jit",
    "disk_cache",
    "fingerprints",
    "folders",
    "gc_paused",
    "keys",
    "remembered",
    "settings",
    "several_devices",
    "user_code",
]
