"""Numbers on the command line: in SI units or with a unit of their own, as strict as those in files."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import spherejax as sj
from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.number_texts import NumberError, number_in
from spherejax.foundations.units.units import UnitError, in_si


def real(text: str) -> float:
    """A number, for `type=` of an option; argparse names the option in front of the error."""
    try:
        return number_in(text)
    except NumberError as error:
        raise argparse.ArgumentTypeError(f"{error}{_without_unit(text)}") from None


def measured_in(unit: str) -> Callable[[str], float]:
    """For `type=` of an option: a number in an SI unit, or one with a unit of its own, as "0.1 mm"."""

    def number(text: str) -> float:
        try:
            return number_in(text)
        except NumberError as error:
            try:
                return in_si(text, unit)
            except SceneError as other:
                # A text with a unit is told what is wrong with that, any other what is wrong with the number.
                raise argparse.ArgumentTypeError(str(other if any(map(str.isalpha, text)) else error)) from None

    return number


def positive_in(unit: str) -> Callable[[str], float]:
    """As `measured_in`, of what must be positive."""
    measured = measured_in(unit)

    def number(text: str) -> float:
        value = measured(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text!r} must be positive")
        return value

    return number


def whole(text: str) -> int:
    """A whole number, for `type=` of an option."""
    value = real(text)
    if value != int(value) or abs(value) >= 2.0**53:  # beyond, not every whole number is a float
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number")
    return int(value)


def number_of(flag: str, text: str, part: str, unit: str | None = "") -> float:
    """A number that is a part of the text behind a flag.

    Args:
        flag: the flag.
        text: all of the text.
        part: the number.
        unit: what a number may have as well, in SI; None: any; empty: no unit is understood.

    Raises:
        SceneError: naming the flag and the text.
    """
    try:
        return number_in(part)
    except NumberError as error:
        if unit != "" and any(map(str.isalpha, part)):
            try:
                return in_si(part, unit)
            except UnitError as other:
                raise sj.SceneError(f"{flag} {text}: {other}") from None
        raise sj.SceneError(f"{flag} {text}: {error}{_without_unit(part)}") from None


MOST_SAMPLES = 10_000_000
"""The state of one body alone takes a gigabyte at so many."""


def number_of_samples(n: int) -> int:
    """The number itself, where so many samples can be had.

    Raises:
        SceneError: for fewer than two, and for more than fit in memory.
    """
    if n < 2:
        raise sj.SceneError(f"--samples = {n} must be at least 2: the start and the end")
    if n > MOST_SAMPLES:
        raise sj.SceneError(
            f"{n:.3g} samples of every quantity do not fit in memory; ask for at most {MOST_SAMPLES:,}, or for a "
            "shorter --t1"
        )
    return n


def _without_unit(text: str) -> str:
    """For a number with a unit: the plain one in SI units."""
    try:
        return f"; numbers here are in SI units, without a unit: {in_si(text, None):.12g}"
    except UnitError:
        return ""
