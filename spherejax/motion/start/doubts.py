"""What looks like a mistake in a scene, and is said before its run."""

from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.motion.start.points_beside import points_beside
from spherejax.physics.joints.lubricated import Lubricated


def doubts_of(scene: Scene, system: System) -> tuple[str, ...]:
    """Sentences about joints beside the point that was meant, and about films that are not for their bearing.

    Args:
        scene: the scene as it is described.
        system: the system compiled from it; what is traced is not looked at.
    """
    return (*points_beside(scene, system), *_films_out_of_range(system))


def _films_out_of_range(system: System) -> list[str]:
    said = []
    for name, joint in system.joints.items():
        model = getattr(joint, "model", None)  # only joints with a ball, or a journal, have one
        if isinstance(model, Lubricated) and is_concrete(model.socket_radius):
            doubt = model.film.doubt(float(model.socket_radius))
            said += [f"joint {name!r}: {doubt}."] if doubt else []
            film = model.film
            of_heat = "" if model.heat is None else model.heat.doubt(type(film).__name__, film.n_grooves)
            said += [f"joint {name!r}: {of_heat}."] if of_heat else []
    return said
