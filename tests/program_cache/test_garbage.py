"""The garbage collector waits while something is compiled, and only then."""

import gc
import threading

import jax
import jax.numpy as jnp
import pytest

from spherejax.program_cache import cached_jit, gc_paused


@pytest.fixture(autouse=True)
def collects():
    gc.enable()
    yield
    gc.enable()


def test_collection_waits_and_goes_on():
    with gc_paused():
        assert not gc.isenabled()
        with gc_paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_what_is_switched_off_stays_off():
    gc.disable()
    with gc_paused():
        pass
    assert not gc.isenabled()


def test_an_error_does_not_leave_it_off():
    with pytest.raises(ZeroDivisionError), gc_paused():
        1 / 0  # noqa: B018
    assert gc.isenabled()


def test_threads_share_the_pause():
    inside, go = threading.Event(), threading.Event()

    def other():
        with gc_paused():
            inside.set()
            assert go.wait(10)

    thread = threading.Thread(target=other)
    with gc_paused():
        thread.start()
        assert inside.wait(10)
    assert not gc.isenabled()  # the other thread is still at it
    go.set()
    thread.join()
    assert gc.isenabled()


def test_programs_are_traced_and_compiled_without_it():
    seen = []

    @cached_jit
    def doubled(x):
        seen.append(gc.isenabled())
        return 2 * x

    assert doubled(jnp.ones(3))[0] == 2
    assert jax.jit(doubled)(jnp.ones(4))[0] == 2
    assert seen == [False, False]
    assert gc.isenabled()
