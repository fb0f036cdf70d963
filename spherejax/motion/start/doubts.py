"""What looks like a mistake in a scene, and is said before its run."""

from spherejax.foundations.checks import is_concrete
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.motion.start.points_beside import points_beside
from spherejax.motion.start.tolerances import ROUNDING, known_speed_and_force
from spherejax.physics.joints.lubricated import Lubricated

LARGEST_ROUNDING = 1e-3
"""Of the forces that move the mechanism: above this share the rounding of velocities in a film's force is said."""


def doubts_of(scene: Scene, system: System) -> tuple[str, ...]:
    """Sentences about joints beside the point that was meant, and about films that are not for their bearing.

    Args:
        scene: the scene as it is described.
        system: the system compiled from it; what is traced is not looked at.
    """
    return (*points_beside(scene, system), *_films_out_of_range(system), *_films_of_rounding(system))


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


def _films_of_rounding(system: System) -> list[str]:
    """Films so thin that the difference of two velocities, which they answer with a force, has no digits left."""
    said = []
    for name, joint in system.joints.items():
        model = getattr(joint, "model", None)
        if not isinstance(model, Lubricated):
            continue
        numbers = model.clearance, model.socket_radius, model.viscosity
        damping = model.film.damping(*numbers)
        if damping is None or not is_concrete(damping) or (scales := known_speed_and_force(system)) is None:
            continue
        speed, force = scales
        rounding = float(damping) * ROUNDING * speed
        if rounding > LARGEST_ROUNDING * force:
            said.append(
                f"joint {name!r}: its film, {float(model.clearance):.3g} m thick, answers 1 m/s with "
                f"{float(damping):.1e} N, so rounding of velocities alone is {rounding:.1e} N in its reaction, where "
                f"this mechanism has forces of {force:.1e} N: places are right, the reaction is not. Take a larger "
                "clearance, or an ideal joint, whose reaction is exact."
            )
    return said
