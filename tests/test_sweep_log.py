"""What a sweep says in a log: a line now and then, none of a short one, none where quiet was asked for."""

import time

import pytest

from spherejax.studies.sweep import progress
from spherejax.studies.sweep.progress import SweepProgress, reporting


def said(capsys, asked):
    with reporting(asked, 100) as report:
        seen = SweepProgress.beginning(100, 10, 0, 10)
        report(seen)
        time.sleep(0.2)
        report(SweepProgress(100, 40, 0, 1, 4000, 5000, seen.began))
        time.sleep(0.3)
    return capsys.readouterr().err.splitlines()


def test_a_log_has_a_line_now_and_then(capsys, monkeypatch):
    monkeypatch.delenv("SPHEREJAX_QUIET", raising=False)
    assert said(capsys, True) == []  # over within ten seconds
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.05)
    lines = said(capsys, True)
    assert lines[0] == "spherejax: sweep: 0 of 100 runs, first chunk, with compilation"
    assert lines[-1].startswith("spherejax: sweep: 40 of 100 runs, ")
    assert ", 1 failed, " in lines[-1]
    assert lines[-1].endswith(" left")


@pytest.mark.parametrize("quiet", ["argument", "environment"])
def test_a_log_is_silent_where_that_was_asked_for(quiet, capsys, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.05)
    monkeypatch.setenv("SPHEREJAX_QUIET", "1" if quiet == "environment" else "0")
    assert said(capsys, quiet != "argument") == []
