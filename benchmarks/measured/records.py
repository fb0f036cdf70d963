"""Reads records that others published; the project holds none of them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

SOURCES = {
    "furuta.csv": (
        "FurutaData.mat of JModelica.org's examples (pyjmi/examples/files), as columns time [s], arm [rad], pendulum "
        "from upright [rad]"
    ),
    "emps_estimation.csv": (
        "DATA_EMPS.mat of the nonlinear benchmark EMPS (Janot, Gautier, Brunot 2019, www.nonlinearbenchmark.org), as "
        "columns time [s], position [m], reference [m], motor voltage [V]"
    ),
    "pendulum_single_": (
        "free swings of the multi-arm pendulum of Kaheman and others (2022), arXiv 2205.06231, one arm, as columns "
        "time [s], angle [rad], angular velocity [rad/s]"
    ),
    "pendulum_double_": (
        "free swings of the multi-arm pendulum of Kaheman and others (2022), arXiv 2205.06231, two arms, as columns "
        "time [s], two angles from upright [rad], two angular velocities [rad/s]"
    ),
    "dfki_double_": (
        "double pendulum of DFKI's Underactuated Lab (github.com/dfki-ric-underactuated-lab/double_pendulum, design "
        "A.0, 2022-08-12), as columns time [s], angle of the first link from hanging and of the second against it "
        "[rad], their rates [rad/s], moments of both motors at the joints [N m]"
    ),
}
"""By the beginning of a file's name: where its content comes from, and its columns."""


class Record(NamedTuple):
    """A table of samples.

    Attributes:
        times: instants, from the file [s], shape (n,).
        values: the other columns, shape (n, m).
    """

    times: np.ndarray
    values: np.ndarray

    def part(self, begin: float, end: float, every: int = 1) -> "Record":
        """The samples from `begin` to `end` [s], every so many of them."""
        inside = np.nonzero((self.times >= begin) & (self.times <= end))[0][::every]
        return Record(self.times[inside], self.values[inside])


def read(folder: Path, name: str) -> Record:
    """The record of a CSV file with one line of names.

    Raises:
        SystemExit: where the file is missing; the text says where its content was published.
    """
    path = folder / name
    if not path.exists():
        source = next(text for beginning, text in SOURCES.items() if name.startswith(beginning))
        raise SystemExit(f"{path} is missing. Its content: {source}.")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return Record(table[:, 0], table[:, 1:])


def state_at(record: Record, t: float, span: float, degree: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Values and rates of all columns at an instant, by polynomials through the samples within `span` of it [s].

    One-sided where the record begins or ends at `t`.
    """
    near = record.part(t - span, t + span)
    fits = [np.polynomial.Polynomial.fit(near.times - t, column, degree) for column in near.values.T]
    return np.array([fit(0.0) for fit in fits]), np.array([fit.deriv()(0.0) for fit in fits])


def root_mean_square(errors) -> float:
    """Of all entries."""
    return float(np.sqrt(np.mean(np.square(errors))))
