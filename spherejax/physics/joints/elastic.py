"""Joints of any kind with a bushing, and journals with clearance: a ball in a socket with the joint's own axes."""

from collections.abc import Mapping

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import Body
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.body_axes import frame_along, relative_start
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.joints.journal import PlacedJournal
from spherejax.physics.joints.reaction_friction import friction_requirements
from spherejax.physics.joints.spherical import PlacedSpherical


def with_model(
    ideal: AbstractPlacedJoint,
    model: AbstractSphericalModel,
    starts_concentric: bool,
    bodies: Mapping[str, Body],
    axis: Numeric | None = None,
    second_axis: Numeric | None = None,
    guide: PlacedPair | None = None,
) -> AbstractPlacedJoint:
    """A placed joint with a model: itself where the model is ideal, else a ball in a socket with axes.

    Args:
        ideal: the ideal joint.
        model: how it resists.
        starts_concentric: whether it starts as if it were ideal.
        bodies: the scene's bodies.
        axis: where z of the joint's axes points, world axes at the start; None: they are those of its first body.
        second_axis: where x points, as nearly as it can; any direction across the axis where it is None.
        guide: what holds a journal with clearance along its axis and parallel to it, if anything.
    """
    if model.is_ideal:
        return ideal
    start = relative_start(bodies, *ideal.bodies)
    frame = None if axis is None else frame_along(bodies, ideal.bodies[0], axis, second_axis)
    placed = (ideal.bodies, *ideal.points, start, model, starts_concentric, frame, ideal)
    return PlacedJournal(*placed, guide) if model.has_surfaces else PlacedSpherical(*placed)


def model_requirements(
    model: AbstractSphericalModel, *, turns_freely: bool, slides: bool, is_bearing: bool = False
) -> list[Requirement]:
    """What a joint that is not spherical asks of its model: ideal, or a bushing that holds its direction.

    A bearing may have clearance, with laws of a journal.
    """
    if isinstance(model, Ideal):
        if model.friction is not None and not (turns_freely or slides):
            remedy = "Nothing moves in a fixed joint; leave friction out."
            return [Requirement("friction", type(model.friction).__name__, False, "be left out", remedy)]
        return [*model.requirements(), *friction_requirements(model, turns=turns_freely, slides=slides)]
    if model.is_ideal:
        return []
    if is_bearing and model.has_surfaces:
        return [*model.requirements(), *model.requirements_of(is_bearing=True)]
    if not isinstance(model, Bushing) or not model.law.resists_rotation:
        remedy = (
            "Give Ideal() or Bushing(law=...) with MatrixElastomer, HingeElastomer or CrossElastomer; contact and "
            "film belong to spherical and revolute joints."
        )
        name = type(model.law if isinstance(model, Bushing) else model).__name__
        return [Requirement("model", name, False, "be ideal or a bushing whose law resists rotation", remedy)]
    return [*model.requirements(), *(model.law.requirements_of_free_turning() if turns_freely else [])]
