"""What is fitted, as texts NAME=VALUE[:LOW:HIGH], and the builder that takes it. For `fit` and `identify`."""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import spherejax as sj
from spherejax.command_line.models import USED_BY
from spherejax.command_line.numbers import number_of
from spherejax.command_line.scene_numbers import UnitOf, number_at, unit_of_option, with_number
from spherejax.command_line.scenes import Chosen


class Begin(NamedTuple):
    """What `--start` says of a parameter, in SI units; as `sj.Parameter`, which takes long to import."""

    start: float
    bounds: tuple[float, ...] = ()

    @property
    def parameter(self) -> sj.Parameter:
        """For the fit."""
        return sj.Parameter(self.start, **dict(zip(("lower", "upper"), self.bounds, strict=False)))


def starts_of(options: argparse.Namespace, unit_of: UnitOf = unit_of_option) -> dict[str, Begin | None]:
    """Parameters by name; None where the scene's own number is meant."""
    start: dict[str, Begin | None] = {}
    for text in options.start:
        name, equals, given = text.partition("=")
        if name in start:
            raise sj.SceneError(f"--start {name} is given twice")
        if not equals:
            start[name] = None
            continue
        parts = given.split(":")
        if not name or len(parts) not in (1, 3):
            raise sj.SceneError(f"--start {text}: write NAME=VALUE or NAME=VALUE:LOW:HIGH, e.g. stiffness=1e4:1e3:1e7")
        numbers = [number_of("--start", text, part, unit_of(name)) for part in parts]
        start[name] = Begin(numbers[0], tuple(numbers[1:]))
    return start


def with_starts(options: argparse.Namespace, start: dict[str, Begin | None]) -> argparse.Namespace:
    """Options of the studied joint with the starts in their place."""
    of_joint = {}
    for name, parameter in start.items():
        key = name.replace("-", "_")
        if key not in USED_BY:
            continue
        if getattr(options, key) is not None:
            raise sj.SceneError(f"--{name} is given, and fitted as well; leave one out")
        if parameter is None:
            raise sj.SceneError(f"--start {name}: write {name}=VALUE")
        of_joint[key] = parameter.start
    return argparse.Namespace(**{**vars(options), **of_joint})


def own_numbers(found: Chosen, scene: sj.Scene, start: dict[str, Begin | None]) -> dict[str, Any]:
    """The scene's own numbers, by the paths that are fitted; a wrong path is refused."""
    own = {}
    for name, begin in start.items():
        if name.replace("-", "_") in USED_BY:
            continue
        try:
            own[name] = number_at(scene, name, found.studied)
        except sj.SceneError as error:
            raise sj.SceneError(f"--start {error}") from None
        if begin is not None and own[name].ndim:
            raise sj.SceneError(f"--start {name}: it is an array of shape {own[name].shape}; give the name alone")
    return own


def builder_of(found: Chosen, options: argparse.Namespace):
    """A function from the parameters to the scene."""

    def build(**values) -> sj.Scene:
        of_joint = {name.replace("-", "_"): v for name, v in values.items() if name.replace("-", "_") in USED_BY}
        scene = found.scene(argparse.Namespace(**{**vars(options), **of_joint}))
        for name, value in values.items():
            if name.replace("-", "_") not in of_joint:
                scene = with_number(scene, name, value, found.studied)
        return scene

    return build
