"""What holds for all tests."""

import gc
import os
import signal

import pytest

# one thread of BLAS, as the program itself takes: workers run side by side, and more threads are
# slower with small matrices; what the environment says is kept. Before anything loads NumPy
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# begun in the background of a shell or by nohup, signals are ignored, and children inherit that
for name, usual in (("SIGINT", signal.default_int_handler), ("SIGTERM", signal.SIG_DFL),
                    ("SIGHUP", signal.SIG_DFL)):
    number = getattr(signal, name, None)
    if number is not None and signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, usual)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Look for no garbage among modules and ten thousand items, now or while tests run."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark as slow the cases that ``slow_cases`` names by their ids, before any are left out."""
    seen, named = set(), set()
    for item in items:
        for mark in item.iter_markers("slow_cases"):
            test, _, case = item.nodeid.partition("[")
            seen.add((test, case[:-1]))
            named.update((test, one) for one in mark.args)
            if case[:-1] in mark.args:
                item.add_marker(pytest.mark.slow)
    if named - seen and not any("::" in word for word in config.args):
        raise pytest.UsageError(f"slow_cases names what is no case: {sorted(named - seen)}")
