"""The study itself: references, then every solver at every tolerance, for every model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import diffrax
import jax.numpy as jnp

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.status import Status
from spherejax.motion.integration.status import diagnosis as told_by_status
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.solvers.automatic import choose_solver
from spherejax.runtime import require_float64
from spherejax.studies.accuracy.accuracy_result import Row, WorkPrecision
from spherejax.studies.accuracy.reference import METHODS, STIFF_METHODS, TIGHTEST, Reference, make_reference
from spherejax.studies.accuracy.runs import RunEnding, TimedProgram, TimedTrial
from spherejax.studies.accuracy.samples import UNITS, errors, samples_of, statistics
from spherejax.studies.accuracy.solvers import SOLVERS, SolverOf

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Relative tolerances of the study."""

ATOL_RATIO = 1e-2
"""Absolute tolerance as a share of the relative one, as in the defaults of `simulate`."""

REFERENCE_PATIENCE = 4.0
"""Budget of a reference run as a multiple of that of the others."""

CONTACT_INTERVAL = 1e-5
"""Interval of the samples of a scene with contact [s]: an impact of steel parts lasts for about 5e-5 s."""

FEW_SAMPLES, MANY_SAMPLES = 2001, 50_001
"""Samples of a scene without contact, and the most for one with contact."""

Report = Callable[[str, float], None]
"""Called with what has just been done and the share of the work that is done."""


def work_precision(
    scene: Scene | Mapping[str, Scene],
    t1: float = 0.2,
    *,
    solvers: Mapping[str, diffrax.AbstractSolver | SolverOf] | None = None,
    tolerances: Sequence[float] = TOLERANCES,
    n_repeats: int = 5,
    n_samples: int | None = None,
    max_seconds: float = 5.0,
    atol_ratio: float = ATOL_RATIO,
    target: float | None = None,
    name: str = "",
    report: Report | None = None,
) -> WorkPrecision:
    """What accuracy costs in time: error against seconds, for solvers and tolerances, and for several models.

    Every solver is compiled once for all tolerances. A run is timed warm, with the end as only sample, blocking on the
    result (of runs shorter than 20 ms a repeat is the median of a burst); a second program with many samples gives its
    errors. Errors are the largest over the samples and over the
    bodies (reactions: joints) of the Euclidean distance to a reference, separately for position [m], velocity [m/s],
    acceleration [m/s^2], reaction [N] and energy [J]. The energy is that of the bodies (kinetic and potential) and the
    work that the joints have absorbed; in an exact motion under weight it is constant. Orientations and angular
    velocities are not compared.

    The reference is the first of two runs at up to a hundredth of the tightest tolerance, by different methods where
    both finish; their difference is its error. An error below three times that is not resolved. The estimate of
    `run.error`, from the same solver at a hundredth of the tolerance, stands beside each error. Solvers are judged by
    the reference, not by that estimate: it is tighter, of other methods, and the same for all.

    Where two tight runs part (dry joints without friction), errors are measured while they agree; beyond, statistics
    are compared with their spread over an ensemble of tight runs. They part where `run.determined_until` ends.

    Args:
        scene: a scene, or several by name.
        t1: length of the motion [s].

    Other args:
        solvers: by name, diffrax solvers or functions from (rtol, atol) to one, which implicit methods need whose root
            finder has tolerances; `SOLVERS` when None.
        tolerances: relative tolerances of a step.
        n_repeats: timed runs after one to warm up; fewer when they take longer than `max_seconds` together.
        n_samples: samples for the errors; when None 2001, with contacts one every 1e-5 s (50001 at most).
        max_seconds: budget of a run [s], kept as a number of steps. A run that needs more is a row that says so, and
            tighter tolerances of that solver are not tried.
        atol_ratio: absolute tolerance as a share of the relative one.
        target: position error that the advice prices [m]; one that suits the data when None.
        name: of what is studied, for titles.
        report: called as the work goes on.

    Returns:
        Rows, references, advice; prints as a table. A run that fails is a row with a diagnosis.

    Raises:
        SceneError: for a scene or request that cannot be simulated, or when no reference finishes within its budget.
    """
    require_float64()
    scenes = dict(scene) if isinstance(scene, Mapping) else {"scene": scene}
    solvers = dict(SOLVERS if solvers is None else solvers)
    tolerances = sorted({float(rtol) for rtol in tolerances}, reverse=True)
    _check_request(scenes, solvers, tolerances, t1, n_repeats, n_samples, max_seconds, atol_ratio)
    counts = {name: _n_samples(one, t1) if n_samples is None else n_samples for name, one in scenes.items()}
    tell = _Progress(report, len(scenes) * (1 + len(solvers) * len(tolerances)) + n_repeats)
    found: list[Found] = []
    references = {}
    for model, one in scenes.items():
        lab = _Laboratory(model, one, t1, counts[model], solvers, max_seconds, atol_ratio)
        references[model] = lab.make_reference(tolerances[-1])
        tell(f"{model}: reference")
        for solver in solvers:
            found += lab.rows(solver, tolerances, references[model], tell)
    rows = _timed(found, n_repeats, tell)
    return WorkPrecision(tuple(rows), references, t1, max(counts.values()), target, name)


Found = tuple[Row, TimedTrial | None]
"""A row, and what is still to be timed for it."""


class _Progress:
    """Counts finished runs and reports their share."""

    def __init__(self, report: Report | None, n_pieces: int):
        self.report, self.n_pieces, self.n_done = report, n_pieces, 0

    def __call__(self, what: str) -> None:
        self.n_done += 1
        if self.report is not None:
            self.report(what, self.n_done / self.n_pieces)


def _timed(found: Sequence[Found], n_repeats: int, tell: _Progress) -> list[Row]:
    """The rows with their times.

    All runs take turns: whatever else the machine does for a while then falls on one repeat of each, which the median
    leaves out, and not on all repeats of one.
    """
    for repeat in range(n_repeats):
        for _, trial in found:
            if trial is not None:
                trial.repeat()
        tell(f"timed, {repeat + 1} of {n_repeats}")
    return [
        row if trial is None else replace(row, seconds=trial.seconds, n_repeats=trial.n_repeats) for row, trial in found
    ]


class _Laboratory:
    """One scene with the programs that run it, each compiled when first asked for."""

    def __init__(self, model, scene, t1, n_samples, solvers, max_seconds, atol_ratio):
        self.model, self.scene, self.atol_ratio = model, scene, atol_ratio
        self.solvers, self.max_seconds = solvers, max_seconds
        self.ends, self.ts = jnp.array([0.0, t1]), jnp.linspace(0.0, t1, n_samples)
        self.measuring: dict[str, TimedProgram] = {}

    def make_reference(self, tightest: float) -> Reference:
        """The reference, by this package's methods whatever solvers are judged."""
        is_stiff = "Rodas" in choose_solver(compile_scene(self.scene).system).reason
        methods = STIFF_METHODS if is_stiff else METHODS
        return make_reference(self._reference_program, methods, tightest, REFERENCE_PATIENCE * self.max_seconds)

    def _reference_program(self, method: str) -> TimedProgram:
        # A solver of the same name and kind is compiled once for both uses.
        name = method if self.solvers.get(method) is SOLVERS[method] else f"reference {method}"
        return self._measuring_program(name, SOLVERS[method])

    def _measuring_program(self, name: str, solver) -> TimedProgram:
        if name not in self.measuring:
            self.measuring[name] = TimedProgram(self.scene, solver, self.ts, atol_ratio=self.atol_ratio, measures=True)
        return self.measuring[name]

    def rows(self, solver: str, tolerances: Sequence[float], reference: Reference, tell: _Progress) -> list[Found]:
        """The rows of one solver, from the loosest tolerance to the tightest."""
        rows: list[Found] = []
        runs: dict[float, Trajectory] = {}
        try:
            timed = TimedProgram(
                self.scene, self.solvers[solver], self.ends, atol_ratio=self.atol_ratio, measures=False
            )
            measured = self._measuring_program(solver, self.solvers[solver])
        except Exception as error:  # whatever a foreign solver raises belongs in its rows, not in the study's way
            for rtol in tolerances:
                rows.append((self._failed(solver, rtol, "not_compiled", _told(error)), None))
                tell(f"{self.model}: {solver} at rtol {rtol:.0e} not compiled")
            return rows
        for rtol in tolerances:
            if rows and rows[-1][0].status in ("over_budget", "not_tried"):
                message = "a looser tolerance was over the budget already"
                rows.append((self._failed(solver, rtol, "not_tried", message), None))
            else:
                rows.append(self._row(solver, rtol, timed, measured, reference, runs))
            tell(f"{self.model}: {solver} at rtol {rtol:.0e}")
        return [
            (replace(row, estimates=self._estimates(measured, row.rtol, reference, runs)), trial)
            if row.rtol in runs
            else (row, trial)
            for row, trial in rows
        ]

    def _estimates(
        self, measured: TimedProgram, rtol: float, reference: Reference, runs: Mapping[float, Trajectory]
    ) -> dict[str, float]:
        """What `run.error` estimates, over the samples and bodies that the errors are of; NaN where it cannot."""
        companion = measured.companion(runs[rtol], rtol, self.max_seconds, runs)
        if int(companion.status) != Status.SUCCEEDED:
            return dict.fromkeys(UNITS, float("nan"))
        return errors(samples_of(runs[rtol]), samples_of(companion), reference.horizon)

    def _row(
        self,
        solver: str,
        rtol: float,
        timed: TimedProgram,
        measured: TimedProgram,
        reference: Reference,
        runs: dict[float, Trajectory],
    ) -> Found:
        """A row; its run is added to `runs` by tolerance."""
        assert reference.samples is not None
        try:
            trial = TimedTrial(timed, rtol, self.max_seconds)
            end = trial.end
            if int(end.status) != Status.SUCCEEDED:
                return self._stopped(solver, rtol, timed, end), None
            run = measured.run(rtol, 4 * int(end.stats.n_steps) + 1000)
            samples = samples_of(run)
        except Exception as error:
            return self._failed(solver, rtol, "raised", _told(error), compile_seconds=timed.compile_seconds), None
        known = {"compile_seconds": timed.compile_seconds, **_counts(end)}
        if not samples.is_finite:
            message = "the sampled motion is not finite; choose another solver or tighten rtol"
            return self._failed(solver, rtol, "not_finite", message, **known), None
        runs[rtol] = run
        row = Row(
            self.model,
            solver,
            rtol,
            self.atol_ratio * rtol,
            errors=errors(samples, reference.samples, reference.horizon),
            statistics={} if reference.parted is None else statistics(samples, reference.parted),
            **known,
        )
        return row, trial

    def _stopped(self, solver: str, rtol: float, timed: TimedProgram, end: RunEnding) -> Row:
        status, t1 = Status(int(end.status)).name.lower(), float(self.ends[-1])
        diagnosis = told_by_status(end.status, end.t_reached, t1)
        if int(end.status) == Status.TOO_MANY_STEPS:
            status = "over_budget"
            diagnosis = (
                f"stopped at t = {float(end.t_reached):.3g} s of {t1:.3g} s after about {self.max_seconds:g} s and "
                f"{int(end.stats.n_steps):,} steps; a larger max_seconds lets it go on"
            )
        return self._failed(solver, rtol, status, diagnosis, compile_seconds=timed.compile_seconds, **_counts(end))

    def _failed(self, solver: str, rtol: float, status: str, diagnosis: str, **known) -> Row:
        return Row(self.model, solver, rtol, self.atol_ratio * rtol, status=status, diagnosis=diagnosis, **known)


def _counts(end: RunEnding) -> dict[str, int]:
    stats = end.stats
    return {
        "n_steps": int(stats.n_steps),
        "n_rejected": int(stats.n_rejected),
        "n_evaluations": int(stats.n_evaluations),
        "n_onsets": int(stats.n_onsets.sum()),
    }


def _told(error: Exception) -> str:
    """The first line of an error, with its kind."""
    lines = str(error).strip().splitlines() or ["no message"]
    return f"{type(error).__name__}: {lines[0]}"


def _n_samples(scene: Scene, t1: float) -> int:
    if not compile_scene(scene).system.contact_joints:
        return FEW_SAMPLES
    return min(max(FEW_SAMPLES, round(t1 / CONTACT_INTERVAL) + 1), MANY_SAMPLES)


def _check_request(scenes, solvers, tolerances, t1, n_repeats, n_samples, max_seconds, atol_ratio) -> None:
    for what, names in (("scene", scenes), ("solvers", solvers), ("tolerances", tolerances)):
        if not names:
            raise SceneError(f"{what} is empty: there is nothing to compare")
    if not (t1 > 0 and jnp.isfinite(t1)):
        raise SceneError(f"t1 = {t1:g} must be a positive time [s]")
    bad = [rtol for rtol in tolerances if not 10 * TIGHTEST <= rtol < 1]
    if bad:
        raise SceneError(
            f"tolerance {bad[0]:.3g} must lie in [{10 * TIGHTEST:.0e}, 1): the reference, at {TIGHTEST:.0e} at most, "
            "must be tighter"
        )
    if n_repeats < 1:
        raise SceneError(f"n_repeats = {n_repeats} must be at least 1")
    if n_samples is not None and n_samples < 2:
        raise SceneError(f"n_samples = {n_samples} must be at least 2: the start and the end")
    if not max_seconds > 0:
        raise SceneError(f"max_seconds = {max_seconds:g} must be positive [s]")
    if not atol_ratio > 0:
        raise SceneError(f"atol_ratio = {atol_ratio:g} must be positive; entries of the state pass through zero")
