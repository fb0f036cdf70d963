"""Times that a user gives, as seconds."""

import datetime
from typing import Any

import numpy as np

from spherejax.foundations.checks import shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible


def seconds_of(ts: Any, name: str = "ts") -> np.ndarray:
    """Times in seconds, float64.

    Durations with a unit of their own are converted: `timedelta64` of NumPy, pandas and xarray (which makes them of
    times with the unit "s" when it reads a file), and `datetime.timedelta`.

    Raises:
        SceneError: for what is no time: complex numbers, texts, truth values, dates.
    """
    if visible(ts) is not ts:
        raise SceneError(f"{name} = {shown(ts)} has masked entries; leave them out")
    try:
        times = np.asarray(ts)
    except ValueError:
        raise SceneError(f"{name} = {shown(ts)} has rows of different lengths; give a list of times [s]") from None
    if times.dtype.kind == "O":
        times = _of_objects(times, name)
    if times.dtype.kind == "m":
        if np.datetime_data(times.dtype)[0] == "generic":
            raise SceneError(f"{name} holds timedelta64 without a unit; give seconds, or timedelta64 in e.g. 'ms'")
        return np.where(np.isnat(times), np.nan, times / np.timedelta64(1, "s"))
    remedies = {
        "c": "holds complex numbers; give real times [s]",
        "M": "holds dates; give durations since the start, e.g. ts - ts[0]",
        "b": "holds truth values; give times [s]",
        "U": "is text; give numbers [s]",
        "S": "is text; give numbers [s]",
    }
    if times.dtype.kind in remedies:
        raise SceneError(f"{name} = {shown(ts)} {remedies[times.dtype.kind]}")
    if times.dtype.kind not in "fiu":
        raise SceneError(f"{name} = {shown(ts)} is no list of times; give numbers [s]")
    return times.astype(np.float64)


def _of_objects(times: np.ndarray, name: str) -> np.ndarray:
    """Python's durations, and numbers that NumPy has no type for."""
    entries = [t.total_seconds() if isinstance(t, datetime.timedelta) else t for t in times.ravel()]
    if any(isinstance(t, str | bytes | bool | complex | datetime.date) or t is None for t in entries):
        raise SceneError(f"{name} holds what is no time; give numbers [s]")
    try:
        return np.array([float(t) for t in entries]).reshape(times.shape)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"{name} holds what is no time of 64 bits; give numbers [s]") from None
