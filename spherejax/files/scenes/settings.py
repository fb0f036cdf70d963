"""How a mechanism is simulated, as its file says: the table [simulation]."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from spherejax.files.fields.fields import ChoiceField, Context, Field, Plain, shown
from spherejax.files.fields.location import FilePlace
from spherejax.files.fields.quantities import number
from spherejax.files.scenes.solvers import SOLVERS
from spherejax.foundations.errors import SceneError, one_of
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.results.accuracy import limits_from


class SimulationSettings(NamedTuple):
    """What a file says about its simulation; None where it says nothing.

    Attributes:
        t1: length of the motion [s].
        samples: number of samples.
        dt: interval of the samples [s], instead of their number.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step.
        max_steps: when to give up.
        solver: name of the integrator.
        accuracy: largest error of the whole run, as `sj.simulate` takes it: "1 um" or a number [m] for the positions of
            all bodies, or such by name of a quantity.
    """

    t1: float | None = None
    samples: int | None = None
    dt: float | None = None
    rtol: float | None = None
    atol: float | None = None
    max_steps: int | None = None
    solver: str | None = None
    accuracy: str | float | Mapping[str, str | float] | None = None


class AccuracyField(Field):
    """The largest error of a run: of the positions, or of quantities by name.

    It is kept as it is written: the units of quantities are known once the scene is. See `check_accuracy`.
    """

    @property
    def what(self) -> str:
        """Both forms."""
        return '"1 um" for the positions of all bodies, or { "position.NAME" = "1 um", "reaction.NAME" = "0.1 N" }'

    def read(self, value, place, context):
        """A number, a text, or such by name of a quantity."""
        del context
        return _flattened(value, place) if isinstance(value, dict) else _limit(value, place)


def _flattened(table: Mapping[str, Any], place: FilePlace, before: str = "") -> dict[str, str | float]:
    """Limits by name. In TOML `position.rocker = 1e-6` without quotes is a table in a table: it is read alike."""
    limits: dict[str, str | float] = {}
    for key, value in table.items():
        name = f"{before}{key}"
        inside = _flattened(value, place / key, f"{name}.") if isinstance(value, dict) else None
        for quantity, limit in ({name: _limit(value, place / key)} if inside is None else inside).items():
            if quantity in limits:
                (place / key).fail(f"{quantity!r} is named twice; remove one of them")
            limits[quantity] = limit
    if not limits:
        place.fail(f"names no quantity; write {AccuracyField().what}")
    return limits


def _limit(value: Any, place: FilePlace) -> str | float:
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        place.fail(f'{shown(value)} is no number; write e.g. "1 um", or a number in SI units')
    return float(value)


def check_accuracy(accuracy: Any, scene: Scene, place: FilePlace) -> None:
    """Judge quantities, units and signs of an accuracy; `place.fail` for a wrong one.

    Args:
        accuracy: as the settings have it, or None.
        scene: of the same file, checked.
        place: of the key `accuracy`.
    """
    if accuracy is None:
        return
    system = compile_scene(scene, track_work=True).system  # a run tracks work where an accuracy needs it
    for name, limit in accuracy.items() if isinstance(accuracy, Mapping) else ((None, accuracy),):
        try:
            limits_from(limit if name is None else {name: limit}, system)
        except SceneError as error:
            place_of(name, place).fail(str(error).removeprefix("accuracy: "))


def place_of(name: str | None, place: FilePlace) -> FilePlace:
    """Where a quantity stands: below `accuracy` by its name in quotes, or by tables in tables."""
    if name is None:
        return place
    whole = place / name
    if whole.keys in place.source.lines:
        return whole
    for part in name.split("."):
        place = place / part
    return place


FIELDS: Mapping[str, Field] = {
    "t1": number("s"),
    "samples": Plain(int),
    "dt": number("s"),
    "rtol": number("1"),
    "atol": number(None),
    "max_steps": Plain(int),
    "solver": ChoiceField(tuple(SOLVERS)),
    "accuracy": AccuracyField(),
}


def read_settings(value: Any, place: FilePlace, context: Context) -> SimulationSettings:
    """The settings in a table; `place.fail` for a wrong one."""
    if not isinstance(value, dict):
        place.fail("is no table; write [simulation]")
    for key in value:
        if key not in FIELDS:
            (place / key).fail(f"unknown key; {one_of(FIELDS, key)}")
    found = {key: FIELDS[key].read(given, place / key, context) for key, given in value.items()}
    if "samples" in found and "dt" in found:
        (place / "dt").fail("samples and dt say the same twice; remove one of them")
    for key, given in found.items():
        lowest = 2 if key == "samples" else 0
        if key not in ("solver", "accuracy") and not (lowest < given < float("inf") or given == lowest == 2):
            (place / key).fail(f"{given!r} must be {'at least 2: start and end' if lowest else 'positive'}")
    if found.get("rtol", 0) >= 1:
        (place / "rtol").fail(f"{found['rtol']!r} allows errors as large as the motion itself; use less than 1")
    settings = SimulationSettings(**found)
    if settings.dt is not None and settings.t1 is not None and settings.dt > settings.t1:
        (place / "dt").fail(f"{settings.dt!r} must not be above t1 = {settings.t1!r} [s]")
    return settings
