"""Long work on other threads."""

import threading

import dca
import pytest


def wait(work):
    work._over.wait(10)
    return work


def test_work_has_its_result_or_its_exception():
    def sum_of(*numbers, start=0):
        return sum(numbers, start)

    assert wait(dca.offload(sum_of, 1, 2, start=3)).result() == 6
    with pytest.raises(ZeroDivisionError):
        wait(dca.offload(lambda: 1 / 0)).result()


def test_work_runs_beside_and_has_limits():
    go, begun = threading.Event(), threading.Semaphore(0)

    def work() -> bool:
        begun.release()
        return go.wait(10)

    works = [dca.offload(work) for _ in range(4)]
    # Until a thread has taken it, a piece of work counts as waiting.
    assert all(begun.acquire(timeout=10) for _ in works)
    late = [dca.offload(threading.get_ident) for _ in range(64)]
    assert not works[0].done
    with pytest.raises(RuntimeError, match="has not ended yet"):
        works[0].result()
    with pytest.raises(RuntimeError, match="64 pieces of work wait already"):
        while True:
            late.append(dca.offload(threading.get_ident))
    assert late[0].cancel()
    go.set()
    assert all(wait(work).result() for work in works)
    with pytest.raises(RuntimeError, match="was cancelled"):
        wait(late[0]).result()
    threads = {wait(work).result() for work in late[1:]}
    assert len(threads) <= 4 and threading.get_ident() not in threads
