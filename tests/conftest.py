"""What holds for all tests."""

import gc
import os
import signal

import pytest
from _pytest.doctest import DoctestModule

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


class ModulesWithExamples:
    """Looks for examples in no module that has none: to look through all of them takes seconds."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path):
        found = yield
        if file_path.suffix == ".py" and b">>>" not in file_path.read_bytes():
            found = [one for one in found if not isinstance(one, DoctestModule)]
        return found


def pytest_configure(config):
    config.pluginmanager.register(ModulesWithExamples())    # for modules outside of this folder too


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark cases as ``slow_cases`` and ``long_cases`` name them by their ids; what is long is slow.

    Before any are left out.
    """
    seen, named = set(), set()
    for item in items:
        test, _, case = item.nodeid.partition("[")
        for name in ("long", "slow"):
            for mark in item.iter_markers(f"{name}_cases"):
                seen.add((test, case[:-1]))
                named.update((test, one) for one in mark.args)
                if case[:-1] in mark.args:
                    item.add_marker(getattr(pytest.mark, name))
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.slow)
    if named - seen and not any("::" in word for word in config.args):
        raise pytest.UsageError(f"cases are marked that are none: {sorted(named - seen)}")
