"""Numbers with units: text like "35.9 kN/m" as a number in SI units, its dimension checked."""

import re
from functools import cache

from spherejax.foundations.checks import SceneError

PURE = "1"
"""The unit of a pure number."""

NAMES = {
    "m": "a length", "kg": "a mass", "s": "a time", "rad": "an angle", "N": "a force", "N m": "a moment",
    "m/s": "a velocity", "rad/s": "an angular velocity", "m/s^2": "an acceleration", "N/m": "a stiffness",
    "N s/m": "a damping", "N m/rad": "a rotational stiffness", "N m s/rad": "a rotational damping",
    "kg m^2": "a moment of inertia", "Pa": "a pressure", "Pa s": "a viscosity", "1/s": "a rate",
    "1/m": "a number per length", "s/m": "a number per velocity", "rad/s^2": "an angular acceleration",
}  # fmt: skip
"""What units measure, for messages."""

_NUMBER = re.compile(r"\s*[-+]?\.?\d")


class UnitError(SceneError):
    """A text that is no number of the dimension that is expected."""


def in_si(text: str, unit: str | None) -> float:
    """The number that a text like `"0.1 mm"` means, in SI units.

    An angle is a dimension of its own here: a number in degrees is no pure number, and 10 Hz is no angular velocity.

    Args:
        text: a number with a unit.
        unit: the SI unit that is expected, e.g. `"N/m"`; None takes any dimension.

    Raises:
        UnitError: for a text that is no number with a unit, or one of another dimension.
    """
    quantity = _parsed(text)
    in_base_units = quantity.to_base_units()
    if unit is None:
        return float(in_base_units.magnitude)
    if _dimension(in_base_units) != _dimension(_one(unit)):
        hint = "" if _dimension(in_base_units) else f"; a number in {unit} is written without quotes"
        raise UnitError(f"{text!r} is {_measured(in_base_units)}, but {measured(unit)} is expected{hint}")
    return float(quantity.to(_pint(unit)).magnitude)


def measured(unit: str) -> str:
    """What a unit measures, e.g. `"a length [m]"` for `"m"`."""
    if unit == PURE:
        return "a pure number"
    return f"{NAMES.get(unit, 'a number')} [{unit}]"


def simplified(unit: str) -> str:
    """A unit made of others in parentheses, e.g. `"(N)/(m)^2"`, as it is usually written, `"N/m^2"`."""
    if "(" not in unit:
        return unit
    made = _registry().Quantity(1.0, _pint(unit))
    factors = sorted(made.unit_items())
    known = (name for name in NAMES if sorted(_registry().Quantity(1.0, _pint(name)).unit_items()) == factors)
    return next(known, f"{made.units:~}".replace(" ** ", "^").replace(" / ", "/").replace(" * ", " ")) or PURE


@cache
def _registry():
    """Pint's units; imported when the first unit is met: scenes in plain SI numbers never need it."""
    import pint

    return pint.UnitRegistry()


@cache
def _pint(unit: str):
    """A unit of a field as Pint writes it: there a space does not always multiply."""
    return _registry().Unit("dimensionless" if unit == PURE else unit.replace(" ", "*"))


def _one(unit: str):
    return _registry().Quantity(1.0, _pint(unit)).to_base_units()


def _parsed(text: str):
    """Pint's quantity; only a number followed by units: a unit alone, or a sum, is a slip."""
    reason = "it begins with no number"
    if _NUMBER.match(text):
        try:
            quantity = _registry().Quantity(text)
            quantity.to_base_units()
            if type(quantity.magnitude) in (int, float):
                return quantity
            reason = "its number is not real"
        except Exception as error:  # Pint raises many kinds, down to those of Python's tokenizer
            reason = str(error) or type(error).__name__
    raise UnitError(f'{text!r} is no number with a unit: {reason}; write it like "0.1 mm"')


def _dimension(in_base_units) -> dict[str, float]:
    """Powers of the base units, the radian among them."""
    return {name: round(float(power), 9) for name, power in in_base_units.unit_items() if power}


def _measured(in_base_units) -> str:
    """What a number in base units measures."""
    dimension = _dimension(in_base_units)
    if not dimension:
        return measured(PURE)
    known = (unit for unit in NAMES if _dimension(_one(unit)) == dimension)
    return measured(next(known, f"{in_base_units.units:~}"))
