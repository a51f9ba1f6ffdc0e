"""What holds for all tests."""

import os
import signal

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
