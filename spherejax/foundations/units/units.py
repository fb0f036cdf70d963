"""Numbers with units: text like "35.9 kN/m" as a number in SI units, its dimension checked.

The text is taken apart here, strictly: one number, then names of units with powers, products and quotients. A library
of units (Pint) only says what each name means. Of whole texts it makes something in nearly every case: to it
`"1,5 kg"` is 15 kg, `"1 m 2"` is 2 m, and `"1 Nm"` a measure of yarn.
"""

import re
from functools import cache
from typing import NoReturn

from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.number_texts import (
    NUMBER,
    SMALLEST,
    NumberError,
    looks_like_number,
    representable,
    shortened,
    suggestion,
)

PURE = "1"
"""The unit of a pure number."""

NAMES = {
    "m": "a length", "kg": "a mass", "s": "a time", "rad": "an angle", "N": "a force", "N m": "a moment",
    "m/s": "a velocity", "rad/s": "an angular velocity", "m/s^2": "an acceleration", "N/m": "a stiffness",
    "N s/m": "a damping", "N m/rad": "a rotational stiffness", "N m s/rad": "a rotational damping",
    "kg m^2": "a moment of inertia", "Pa": "a pressure", "Pa s": "a viscosity", "1/s": "a rate",
    "1/m": "a number per length", "s/m": "a number per velocity", "rad/s^2": "an angular acceleration",
    "K": "a temperature", "1/K": "a number per kelvin", "J/K": "a heat capacity", "W/K": "a thermal conductance",
    "J/(m^3 K)": "a heat capacity of a volume",
    "N/(m s)": "an integral gain", "N m/(rad s)": "an integral gain of an angle",
}  # fmt: skip
"""What units measure, for messages."""

CELSIUS = ("degC", "°C")
"""The one unit with a zero of its own that is read, where a number in kelvins alone is expected."""

ICE_POINT = 273.15
"""0 degC [K]."""

LONGEST = 100
"""Characters of a number with its unit; more is a slip."""

LARGEST_POWER = 12
"""Of a unit: what is above is a slip, and would leave the range of float64 when it is converted."""

_NAME = r"(?:°[CF]?|%|[^\W\d_⁰¹²³⁴-⁹][^\W⁰¹²³⁴-⁹]*)"
_POWER = r"(?:\s*(?:\^|\*\*)\s*(?:[-+]?[0-9]+(?:\.[0-9]+)?|\([-+]?[0-9]+(?:\.[0-9]+)?\))|[⁺⁻]?[⁰¹²³⁴-⁹]+)"
_BETWEEN = r"(?:\s*[*·⋅/]\s*|\s+)"
_FACTOR = rf"{_NAME}{_POWER}?"
_GROUP = rf"\(\s*{_FACTOR}(?:{_BETWEEN}{_FACTOR})*\s*\)(?:{_POWER})?"
_UNIT = re.compile(rf"(?:1?\s*/\s*)?(?:{_FACTOR}|{_GROUP})(?:{_BETWEEN}(?:{_FACTOR}|{_GROUP}))*")
_PART = re.compile(rf"(?P<power>{_POWER})|(?P<name>{_NAME})|(?P<over>\s*/\s*)|(?P<times>\s*[*·⋅]\s*)|(?P<gap>\s+)|.")

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻", "0123456789+-")
_SIGNS = {"%": "percent", "°": "degree", "°C": "degC", "°F": "degF"}
_RUN_TOGETHER = re.compile(r"((?:[kMGmµμ]?(?:N|Pa|J|W))|kg)(mm|ms|m|s)(s|rad)?")
"""Products written without a gap, some of which mean other things to Pint."""
_PER = re.compile(r"\s+1\s*/\s*[^\W\d]")
"""Behind the number: a unit that begins with 1, `"5 1/s"`."""
_MORE_OF_THE_NUMBER = re.compile(r"\s*[\d.,'_]|\s*\^|\s*\*\*|\(|[eE]|\s*[x*·⋅]\s*\d|/\s*\d*[02-9]")


class UnitError(SceneError):
    """A text that is no number of the dimension that is expected."""


class _NoUnitError(Exception):
    """Why a text is no unit."""


def in_si(text: str, unit: str | None) -> float:
    """The number that a text like `"0.1 mm"` means, in SI units.

    An angle is a dimension of its own here: a number in degrees is no pure number, and 10 Hz is no angular velocity.

    Args:
        text: a number with a unit: digits, a point for decimals, `e` for powers of ten; then names of units, with `/`,
            powers like `m^2`, and a gap or `*` for products. Nothing else is read, but `"40 degC"` for a temperature.
        unit: the SI unit that is expected, e.g. `"N/m"`; None takes any dimension.

    Raises:
        UnitError: for a text that is no number with a unit, or one of another dimension; it says what to write.
    """
    stripped = text.strip()
    if len(stripped) > LONGEST:
        _fail(text, f"it is longer than {LONGEST} characters")
    parts = _parts(stripped)
    if parts is None:
        reason = "its number is not a plain one" if looks_like_number(stripped) else "it begins with no number"
        _fail(text, f"{reason}; {suggestion(stripped, '0.1 mm', _is_right)}")
    try:
        number = representable(parts[0], text)
    except NumberError as error:
        raise UnitError(str(error)) from None
    if unit == "K" and parts[1] in CELSIUS:
        return number + ICE_POINT
    try:
        return _converted(number, parts[1], unit, text)
    except _NoUnitError as error:
        _fail(text, str(error))


def factor_of(text: str, unit: str | None) -> float:
    """What numbers in a unit, e.g. `"mm"`, are multiplied by to be in SI units.

    Args:
        text: a unit alone.
        unit: the SI unit that is expected; None takes any dimension.

    Raises:
        UnitError: for a text that is no unit, or one of another dimension.
    """
    given = text.strip()
    if not 0 < len(given) <= LONGEST or (looks_like_number(given) and not re.match(r"1\s*/", given)):
        raise UnitError(f'{shortened(text)} is no unit: write a unit alone, without a number, e.g. "mm"')
    try:
        return _converted(1.0, given, unit, text)
    except _NoUnitError as error:
        raise UnitError(f"{shortened(text)} is no unit: {error}") from None


def unit_in(text: str) -> str:
    """The unit in a text like `"0.1 mm"`; empty where it has none, or one whose zero is another one than that of SI."""
    parts = _parts(text.strip())
    if parts is None or not parts[1] or not _is_right(text.strip()):
        return ""
    return parts[1] if in_si(f"0 {parts[1]}", None) == 0 else ""


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


def _parts(text: str) -> tuple[str, str] | None:
    """The strict number that a text begins with, and its unit.

    None where the number does not end where a reader's does: "1,5 kg", "1 000 N/m", "1.5.2 kg", "2x10^3 N", "1/2 m".
    """
    found = NUMBER.match(text)
    if found is None:
        return None
    rest = text[found.end() :]
    goes_on = looks_like_number(text) > found.end() or _MORE_OF_THE_NUMBER.match(rest)
    return None if goes_on and not _PER.match(rest) else (found.group(), rest.strip())


def _is_right(text: str) -> bool:
    """Whether a text can be read; for suggestions."""
    parts = _parts(text)
    try:
        return parts is not None and _converted(float(parts[0]), parts[1], None, text) is not None
    except (UnitError, _NoUnitError):
        return False


def _converted(number: float, given: str, unit: str | None, text: str) -> float:
    """A number in the unit that is given, in SI units; `text` is what an error shows."""
    quantity = _registry().Quantity(number, _unit(given))
    one = _registry().Quantity(1.0, quantity.units).to_base_units()
    if unit is not None and _dimension(one) != _dimension(_one(unit)):
        hint = f"; a number in {unit} is written without quotes" if not _dimension(one) else ""
        raise UnitError(f"{shortened(text)} is {_measured(one)}, but {measured(unit)} is expected{hint}")
    value = float((quantity.to_base_units() if unit is None else quantity.to(_pint(unit))).magnitude)
    if number and not SMALLEST <= abs(value) < float("inf"):
        raise UnitError(f"{shortened(text)} is beyond the numbers of 64 bits in SI units; check number and unit")
    return value


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


def _unit(given: str):
    """Pint's unit of a text that was taken apart strictly."""
    if given and _UNIT.fullmatch(given) is None:
        raise _NoUnitError(_what_is_wrong(given))
    written = ""
    is_divided = [False]  # in each parenthesis that is open
    for part in _PART.finditer(given):
        match part.lastgroup:
            case "name":
                written += _known(part.group())
            case "power":
                written += f"**{_power(part.group())}"
            case "gap" if is_divided[-1]:
                raise _NoUnitError("behind '/' a gap has two readings; write N s/m or N/(m s), not N/m s")
            case "gap" | "times":
                written += "*"
            case "over":
                is_divided[-1] = True
                written += "/" if written else "1/"
            case _ if part.group() == "(":
                is_divided.append(False)
                written += "("
            case _ if part.group() == ")":
                is_divided.pop()
                written += ")"
    unit = _registry().parse_units(written)
    if not _registry().Quantity(1.0, unit)._is_multiplicative:
        raise _NoUnitError(
            "it is no multiple of a unit: its scale has a zero of its own, or is logarithmic; write e.g. K"
        )
    return unit


def _known(name: str) -> str:
    """The name as Pint has it."""
    together = _RUN_TOGETHER.fullmatch(name)
    if together is not None:
        raise _NoUnitError(
            f'{name!r} is no unit; write a gap in the product, "{" ".join(filter(None, together.groups()))}"'
        )
    name = _SIGNS.get(name, name)
    if not _registry().parse_unit_name(name):
        digits = re.fullmatch(r"([^\W\d_]+)([0-9]+)", name)
        powers = f'; powers are written "{digits[1]}^{digits[2]}"' if digits else ""
        raise _NoUnitError(f"{name!r} is not defined{powers}")
    return name


def _power(power: str) -> str:
    digits = power.strip().lstrip("^*").strip(" ()").translate(_SUPERSCRIPTS)
    if abs(float(digits)) > LARGEST_POWER:
        raise _NoUnitError(f"a unit to the power {shortened(digits)} is a slip")
    return f"({digits})"


def _what_is_wrong(given: str) -> str:
    """Why the text behind a number is no unit."""
    power = re.search(r"([^\W\d_]+)([-+][0-9]+)", given)
    if power is not None:
        return f"{shortened(given)} is no unit; powers are written {power[1]}^{power[2]}"
    found = re.search(r"(?<![\w^*.(⁻+-])[-+]?\s*[0-9][0-9.,]*", given)
    if found is not None and not re.match(r"1\s*/", given):
        before = re.search(r"([^\W\d_]+)\s*$", given[: found.start()])
        digits = found.group().strip()
        power = f"; is a power meant? {before[1]}^{digits}" if before and digits.isdigit() else ""
        return f"a second number, {shortened(digits)}, stands in its unit{power}"
    return f"{shortened(given)} is no unit; write products with a gap, quotients with /, powers like m^2"


def _fail(text: str, reason: str) -> NoReturn:
    example = "" if "write" in reason else '; write it like "0.1 mm"'
    raise UnitError(f"{shortened(text)} is no number with a unit: {reason}{example}")


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


def si_exponents(unit: str) -> tuple[float, dict[str, float]]:
    """A unit as a factor times powers of kg, m, s, A, K, mol, cd and rad; no powers for a pure number."""
    one = _one(unit)
    return float(one.magnitude), {_BASE[name]: power for name, power in _dimension(one).items()}


_BASE = {
    "kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd",
    "radian": "rad",
}  # fmt: skip
