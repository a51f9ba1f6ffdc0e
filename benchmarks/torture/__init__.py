"""Writing commands stopped, starved and crowded at each of their file-system calls.

``python -m torture`` from ``benchmarks/``, or ``make torture``. Linux on x86-64: commands run in
forked children under ptrace, so the kills and the errors come from outside of the program, at the
system calls themselves. What a command computes is computed once; what it writes, each time.
"""
