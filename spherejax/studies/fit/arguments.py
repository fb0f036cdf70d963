"""Which parameters of a fit an experiment has: common ones and its own, by the names that its builder uses."""

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.scene import Scene
from spherejax.motion.runs.many import Build
from spherejax.studies.fit.measured import Measured


class Arguments(NamedTuple):
    """The parameters of an experiment (static).

    Attributes:
        names: pairs of the name that builder and sensors use, and the parameter's name in the fit.
        of_build: those of the former that the builder takes.
    """

    names: tuple[tuple[str, str], ...]
    of_build: tuple[str, ...]

    def of(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of this experiment by the names that builder and sensors use."""
        return {own: values[name] for own, name in self.names}

    @property
    def moving(self) -> frozenset[str]:
        """Parameters, by their names in the fit, on which the scene depends."""
        return frozenset(name for own, name in self.names if own in self.of_build)


class OwnBuild(NamedTuple):
    """A builder that takes all parameters of a fit, and hands on those that are meant for it (static)."""

    build: Build
    arguments: Arguments

    def __call__(self, **values: Any) -> Scene:
        """The scene."""
        own = self.arguments.of(values)
        return self.build(**{name: own[name] for name in self.arguments.of_build})


def name_of_own(parameter: str, experiment: str) -> str:
    """The name in the fit of a parameter that one experiment has for itself."""
    return f"{parameter} of {experiment}"


def with_own_parameters(start: Mapping[str, Any], experiments: Sequence[Measured]) -> dict[str, Any]:
    """All parameters of a fit: those that all share, then each experiment's own.

    Raises:
        SceneError: for a name that is used twice.
    """
    parameters = dict(start)
    for experiment in experiments:
        for name, parameter in experiment.own.items():
            if name in start:
                raise SceneError(
                    f"{name!r} is a parameter of all experiments (start=) and one that {experiment.name} has for "
                    "itself (own=); leave one out"
                )
            parameters[name_of_own(name, str(experiment.name))] = parameter
    return parameters


def arguments_of(build: Build, measured: Measured, common: Sequence[str]) -> Arguments:
    """Which parameters an experiment has.

    Args:
        build: its builder.
        measured: what was measured.
        common: parameters that all experiments share.
    """
    own = [(name, name_of_own(name, str(measured.name))) for name in measured.own]
    names = tuple([*((name, name) for name in common), *own])
    taken = _taken(build)
    of_sensors = {name for sensor in measured.sensors.values() for name in sensor.names}
    of_build = [name for name, _ in names if (name not in of_sensors if taken is None else name in taken)]
    unused = [name for name in measured.own if name not in of_build and name not in of_sensors]
    if unused and not _has_functions(measured):
        raise SceneError(
            f"{measured.name}: neither its builder nor a sensor takes its parameter {unused[0]!r}; the builder takes "
            f"{one_of(sorted(taken or ()), unused[0])}"
        )
    return Arguments(names, tuple(of_build))


def refuse_unused(common: Sequence[str], experiments: Sequence[Measured], arguments: Sequence[Arguments]) -> None:
    """Refuse parameters that no builder and no sensor takes.

    Raises:
        SceneError: naming the parameter, and what builders take.
    """
    if any(map(_has_functions, experiments)):  # functions take all parameters: which they use is not to be seen
        return
    used = {name for one in arguments for name in one.of_build}
    used |= {name for one in experiments for sensor in one.sensors.values() for name in sensor.names}
    for name in common:
        if name not in used:
            raise SceneError(
                f"no builder and no sensor takes the parameter {name!r}; taken are {', '.join(sorted(used)) or 'none'}"
            )


def _has_functions(measured: Measured) -> bool:
    return any(callable(number) for sensor in measured.sensors.values() for number in sensor.numbers.values())


def _taken(build: Build) -> frozenset[str] | None:
    """Names of the arguments that a builder takes; None where it takes any, or does not say."""
    try:
        parameters = inspect.signature(build).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters):
        return None
    by_name = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    return frozenset(one.name for one in parameters if one.kind in by_name)
