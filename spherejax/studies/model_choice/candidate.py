"""A model that may have made the records: a builder, and the ranges of its parameters."""

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.runs.many import Build

FIXED = "nothing"
"""Name of the unknown that stands for no parameters: a fit needs one, and nothing depends on it."""


@dataclass(frozen=True)
class Candidate:
    """A model that may have made the records.

    Attributes:
        build: makes a `Scene` from the parameters, given by keyword; traced, as that of `sj.fit`. Where records begin
            differently, a dict of builders by the names of the records.
        start: parameters as for `sj.fit`: numbers, arrays or `sj.Parameter`. Bounds on both sides are the range over
            which a parameter is searched, by its logarithm where they are positive and more than a factor of ten apart.
            Empty for a model without parameters.
    """

    build: Build | Mapping[str, Build]
    start: Mapping[str, Any] = field(default_factory=dict)

    @property
    def builders(self) -> list[Build]:
        """All of its builders."""
        return list(self.build.values()) if isinstance(self.build, Mapping) else [self.build]

    @property
    def is_fixed(self) -> bool:
        """Whether it has no parameters."""
        return not self.start


class FixedBuild:
    """The builder of a model without parameters, which takes one that does nothing."""

    def __init__(self, build: Callable[..., Scene]):
        self.build = build
        own = inspect.signature(build).parameters.values()
        idle = inspect.Parameter(FIXED, inspect.Parameter.KEYWORD_ONLY)
        # What takes keywords of any name stands last.
        self.__signature__ = inspect.Signature(sorted([*own, idle], key=lambda one: one.kind))

    def __call__(self, *, nothing: Any, **own: Any) -> Scene:
        """The scene; `own` is what a record has for itself."""
        del nothing
        return self.build(**own)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FixedBuild) and self.build == other.build

    def __hash__(self) -> int:
        return hash((FixedBuild, self.build))


def candidates_from(given: Any) -> dict[str, Candidate]:
    """Candidates by name.

    Raises:
        SceneError: for fewer than two, or for one that is neither a builder, a scene, nor a pair.
    """
    if not isinstance(given, Mapping) or len(given) < 2:
        raise SceneError(
            "candidates must be a dict of two or more models by name, e.g. {'ideal': build_ideal, 'bushing': "
            f"sj.studies.Candidate(build, {{'stiffness': 1e5}})}}; it is {given!r}"
        )
    return {str(name): _candidate_from(str(name), one) for name, one in given.items()}


def _candidate_from(name: str, given: Any) -> Candidate:
    if isinstance(given, Candidate):
        candidate = given
    elif isinstance(given, Scene):
        candidate = Candidate(lambda: given)
    elif isinstance(given, tuple) and len(given) == 2:
        candidate = Candidate(*given)
    elif callable(given):
        candidate = Candidate(cast(Build, given))
    else:
        raise SceneError(
            f"candidate {name!r} is {given!r}; give sj.studies.Candidate(build, start), a pair "
            f"(build, start), or, for a model "
            "without parameters, a builder or a scene"
        )
    builders = candidate.builders
    if not builders or not all(map(callable, builders)) or not isinstance(candidate.start, Mapping):
        raise SceneError(
            f"candidate {name!r} needs a builder and a dict of parameters to start from; it has {candidate.build!r} "
            f"and {candidate.start!r}"
        )
    return candidate


def check_arguments(name: str, candidate: Candidate, own: Collection[str]) -> None:
    """Refuse a candidate whose builder takes what neither it nor a record has.

    Raises:
        SceneError: which names the parameter.
    """
    for build in candidate.builders:
        missing = [one for one in _needed(build) if one not in candidate.start and one not in own]
        if missing:
            raise SceneError(
                f"candidate {name!r} has no start for {', '.join(map(repr, missing))}, which its builder takes; give "
                f"sj.studies.Candidate(build, {{{missing[0]!r}: ...}})"
            )


def _needed(build: Build) -> list[str]:
    """Parameters of a builder that have no default."""
    try:
        parameters = inspect.signature(build).parameters.values()
    except (TypeError, ValueError):
        return []
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [one.name for one in parameters if one.default is inspect.Parameter.empty and one.kind in kinds]
