"""How a mechanism is simulated, as its file says: the table [simulation]."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from spherejax.files.fields.fields import ChoiceField, Context, Field, Plain
from spherejax.files.fields.location import FilePlace
from spherejax.files.fields.quantities import number
from spherejax.files.scenes.solvers import SOLVERS
from spherejax.foundations.errors import one_of


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
    """

    t1: float | None = None
    samples: int | None = None
    dt: float | None = None
    rtol: float | None = None
    atol: float | None = None
    max_steps: int | None = None
    solver: str | None = None


FIELDS: Mapping[str, Field] = {
    "t1": number("s"),
    "samples": Plain(int),
    "dt": number("s"),
    "rtol": number("1"),
    "atol": number(None),
    "max_steps": Plain(int),
    "solver": ChoiceField(tuple(SOLVERS)),
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
        if key != "solver" and not (lowest < given < float("inf") or given == lowest == 2):
            (place / key).fail(f"{given!r} must be {'at least 2: start and end' if lowest else 'positive'}")
    if found.get("rtol", 0) >= 1:
        (place / "rtol").fail(f"{found['rtol']!r} allows errors as large as the motion itself; use less than 1")
    settings = SimulationSettings(**found)
    if settings.dt is not None and settings.t1 is not None and settings.dt > settings.t1:
        (place / "dt").fail(f"{settings.dt!r} must not be above t1 = {settings.t1!r} [s]")
    return settings
