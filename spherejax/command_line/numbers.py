"""Numbers on the command line: plain ones in SI units, as strict as those in files."""

import argparse

import spherejax as sj
from spherejax.files.number_texts import NumberError, number_in
from spherejax.files.units import UnitError, in_si


def real(text: str) -> float:
    """A number, for `type=` of an option; argparse names the option in front of the error."""
    try:
        return number_in(text)
    except NumberError as error:
        raise argparse.ArgumentTypeError(f"{error}{_without_unit(text)}") from None


def whole(text: str) -> int:
    """A whole number, for `type=` of an option."""
    value = real(text)
    if value != int(value) or abs(value) >= 2.0**53:  # beyond, not every whole number is a float
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number")
    return int(value)


def number_of(flag: str, text: str, part: str) -> float:
    """A number that is a part of the text behind a flag.

    Raises:
        SceneError: naming the flag and the text.
    """
    try:
        return number_in(part)
    except NumberError as error:
        raise sj.SceneError(f"{flag} {text}: {error}{_without_unit(part)}") from None


def _without_unit(text: str) -> str:
    """For a number with a unit: the plain one in SI units."""
    try:
        return f"; numbers here are in SI units, without a unit: {in_si(text, None):.12g}"
    except UnitError:
        return ""
