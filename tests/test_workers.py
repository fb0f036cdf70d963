"""Work in several threads, and what the one that waits for them does meanwhile."""

import threading
import time
from functools import partial

import pytest

from spherejax.studies.workers import NOTHING_YET, Piece, Progress, silent, workers


def doubled(i, gate):
    def work():
        assert gate.wait(10)
        return 2 * i

    return Piece(f"piece {i}", work)


def test_who_waits_works_meanwhile_step_by_step():
    gate, steps, told = threading.Event(), [], []

    def meanwhile():
        for step in range(3):
            assert not told  # nothing is done yet
            steps.append((step, threading.current_thread()))
            yield
        gate.set()

    with workers(Progress(lambda what, share: told.append((what, share)), 4)) as pool:
        assert pool.each([doubled(i, gate) for i in range(4)], meanwhile()) == [0, 2, 4, 6]
    assert steps == [(step, threading.main_thread()) for step in range(3)]
    assert sorted(what for what, _ in told) == [f"piece {i}" for i in range(4)]
    assert [share for _, share in told] == [0.25, 0.5, 0.75, 1.0]


def test_who_waits_hears_what_is_done_and_waits_where_there_is_nothing_to_do():
    gate, heard, steps = threading.Event(), {}, []

    def meanwhile():
        while True:
            steps.append(dict(heard))
            gate.set()  # the first piece waits for the first step
            yield NOTHING_YET

    def slow():
        time.sleep(0.3)
        return "slow"

    with workers(Progress(silent, 2)) as pool:
        found = pool.each([doubled(1, gate), Piece("slow", slow)], meanwhile(), heard.__setitem__)
    assert found == [2, "slow"]
    assert heard == {0: 2, 1: "slow"}
    assert steps == [{}, {0: 2}]


def test_what_is_left_when_all_is_done_is_left_to_the_caller():
    gate = threading.Event()

    def meanwhile():
        gate.set()
        while True:
            yield

    rest = meanwhile()
    with workers(Progress(silent, 1)) as pool:
        assert pool.each([doubled(3, gate)], rest) == [6]
    next(rest)


def test_what_fails_on_either_side_is_raised():
    def broken():
        raise ValueError("of a piece")

    def meanwhile():
        yield
        raise OSError("of who waits")

    with pytest.raises(ValueError, match="of a piece"), workers(Progress(silent, 1)) as pool:
        pool.each([Piece("broken", broken)])
    with pytest.raises(OSError, match="of who waits"), workers(Progress(silent, 1)) as pool:
        pool.each([Piece("slow", partial(time.sleep, 0.5))], meanwhile())
