"""An error for parts whose code reaches traced values that closure conversion does not take out of it.

Functions that enter a part as functions are converted (`physics.functions.closures`). A class that is written within a
builder, a static field of a user's own part, and a global variable are not: JAX stops with an error about its tracers,
which names neither the part nor a remedy.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import jax

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.program_cache.user_code import parts_that_reach_tracers


@contextmanager
def captures_explained(scenes: Sequence[Scene]) -> Iterator[None]:
    """Turn JAX's errors about tracers into a `SceneError` that names the part of a scene whose code holds on to one.

    Args:
        scenes: what is computed; it may be filled within the context.

    Raises:
        SceneError: where a `TypeError` (JAX's own are among them) is raised, and code of a part reaches a tracer. Other
            errors pass.
    """
    try:
        yield
    except TypeError as error:
        for scene in scenes:
            for place in _capturing(scene):
                raise SceneError(
                    f"{place} uses a value that JAX traces (a parameter of jit, grad, vmap, a sweep or a fit), which "
                    "is not among the numbers of the part: its class, a static field, or a global variable holds it. "
                    "Make the value a field of the class, `friction: jax.Array`, and use `self.friction`; or give a "
                    "plain function that closes over it where the part takes a function"
                ) from error
        raise


def _capturing(scene: Scene) -> Iterator[str]:
    for kind, parts in (("joint", scene.joints), ("force", scene.forces)):
        for name, part in parts.items():
            own = parts_that_reach_tracers(jax.tree.structure(part))
            if own:
                whose = ", ".join(getattr(each, "__qualname__", type(each).__qualname__) for each in own)
                yield f"{kind} {name!r} ({type(part).__name__}): {whose}"
