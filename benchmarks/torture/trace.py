"""Children stopped at each system call that changes files, by ptrace: killed there, or refused.

A filter of the kernel's (seccomp) picks these calls out, so that all others run at full speed.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import mmap
import os
import platform
import signal
import struct
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass

AVAILABLE = sys.platform == "linux" and platform.machine() == "x86_64"
TRACEME, CONT, SETOPTIONS, INFO, POKE = 0, 7, 0x4200, 0x420E, 6
EXITKILL, FILTERED = 0x100000, 0x80
ORIG_RAX, RAX = 15 * 8, 10 * 8
STOP = signal.SIGTRAP | 7 << 8
NO_NEW_PRIVILEGES, SECCOMP, FILTER = 38, 22, 2
LOAD, EQUAL, GREATER, ANY_BIT, RETURN = 0x20, 0x15, 0x25, 0x45, 0x06
"""Instructions of a filter."""
TRACE, ALLOW = 0x7FF00000, 0x7FFF0000
ARGUMENTS = 16
"""Where the arguments of a call are, for a filter, eight bytes each."""
CALLS = {
    1: "write", 2: "open", 18: "pwrite64", 20: "writev", 26: "msync", 40: "sendfile", 74: "fsync",
    75: "fdatasync", 76: "truncate", 77: "ftruncate", 82: "rename", 83: "mkdir", 84: "rmdir",
    85: "creat", 86: "link", 87: "unlink", 88: "symlink", 90: "chmod", 91: "fchmod", 92: "chown",
    93: "fchown", 94: "lchown", 132: "utime", 188: "setxattr", 189: "lsetxattr", 190: "fsetxattr",
    235: "utimes", 257: "openat", 258: "mkdirat", 260: "fchownat", 263: "unlinkat",
    264: "renameat", 265: "linkat", 266: "symlinkat", 268: "fchmodat", 277: "sync_file_range",
    280: "utimensat", 285: "fallocate", 316: "renameat2", 326: "copy_file_range"}
"""System calls that change files or push them to the disk."""
TAKING = {"write", "open", "pwrite64", "writev", "sendfile", "mkdir", "creat", "link", "symlink",
          "openat", "mkdirat", "linkat", "symlinkat", "fallocate", "copy_file_range", "fsync"}
"""Those that a full disk refuses."""
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
STREAMS = 2
"""Descriptors up to it are those of the process itself."""


class _Step(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8),
                ("value", ctypes.c_uint32))


class _Filter(ctypes.Structure):
    _fields_ = (("length", ctypes.c_uint16), ("steps", ctypes.POINTER(_Step)))


class _Info(ctypes.Structure):
    _fields_ = (("op", ctypes.c_uint8), ("pad", ctypes.c_uint8 * 3), ("arch", ctypes.c_uint32),
                ("ip", ctypes.c_uint64), ("sp", ctypes.c_uint64), ("nr", ctypes.c_uint64),
                ("args", ctypes.c_uint64 * 6))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_libc.ptrace.restype = ctypes.c_long
_libc.prctl.argtypes = [ctypes.c_int, ctypes.c_ulong, ctypes.c_void_p, ctypes.c_ulong,
                        ctypes.c_ulong]


def _ptrace(request: int, process: int, address: int = 0, data: object = 0) -> int:
    found = _libc.ptrace(request, process, address, data)
    if found < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return int(found)


@dataclass(frozen=True)
class End:
    """How a child ended: its exit code, or minus the signal; and the calls that it was seen at."""

    code: int
    calls: tuple[str, ...]

    @property
    def killed(self) -> bool:
        return self.code == -signal.SIGKILL


At = Callable[[int, str, int], int | None]
"""Told the number of a call, its name and the process; returns an errno to refuse it with."""


def forked(work: Callable[[], int], said: str | os.PathLike[str] = os.devnull) -> int:
    """Run ``work`` in a child; return its exit code, or minus the signal that ended it."""
    if said != os.devnull:
        with open(said, "w"):
            pass
    child = os.fork()
    if not child:
        _speak_to(said)
        os._exit(_code(work))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class Runner:
    """A child that does the same work again and again, stopped at its calls that change files.

    It is forked anew where it was killed or has ended. So an attempt costs the work alone: to
    fork a process of this size takes longer than to write what was computed before.
    """

    def __init__(self, work: Callable[[], int], said: str | os.PathLike[str]) -> None:
        """Remember the work, and the file for what it prints."""
        self.work, self.said, self.child = work, said, 0
        self._left = mmap.mmap(-1, mmap.PAGESIZE)

    def run(self, at: At = lambda *_: None) -> End:
        """Do the work once; call ``at`` before each call that changes files."""
        with open(self.said, "w"):
            pass
        self.child = self.child or self._started()
        calls, deliver = list[str](), 0
        while True:
            with contextlib.suppress(ProcessLookupError):
                _ptrace(CONT, self.child, 0, deliver)
            status = os.waitpid(self.child, 0)[1]
            if not os.WIFSTOPPED(status):
                self.child = 0
                return End(os.waitstatus_to_exitcode(status), tuple(calls))
            deliver = 0
            if status >> 8 == signal.SIGSTOP:
                return End(struct.unpack_from("i", self._left)[0], tuple(calls))
            if status >> 8 != STOP:
                deliver = os.WSTOPSIG(status)
                continue
            calls.append(_call(self.child))
            refused = at(len(calls), calls[-1], self.child)
            if refused:
                _ptrace(POKE, self.child, ORIG_RAX, ctypes.c_void_p(0xFFFFFFFFFFFFFFFF))
                _ptrace(POKE, self.child, RAX, ctypes.c_void_p(-refused & 0xFFFFFFFFFFFFFFFF))

    def text(self) -> str:
        """Return what the last run printed."""
        with open(self.said, encoding="utf-8", errors="replace") as stream:
            return stream.read()

    def close(self) -> None:
        """End the child."""
        if self.child:
            os.kill(self.child, signal.SIGKILL)
            os.waitpid(self.child, 0)
            self.child = 0

    def _started(self) -> int:
        child = os.fork()
        if not child:
            try:
                self._serve()
            finally:
                os._exit(98)
        os.waitpid(child, 0)
        _ptrace(SETOPTIONS, child, 0, EXITKILL | FILTERED)
        return child

    def _serve(self) -> None:
        _speak_to(self.said)
        # a shell has its jobs in the background ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        _ptrace(TRACEME, 0)
        os.kill(os.getpid(), signal.SIGSTOP)
        _be_filtered()
        while True:
            code = _code(self.work)
            _let_signals_pass()
            os.chdir("/")
            struct.pack_into("i", self._left, 0, code)
            os.kill(os.getpid(), signal.SIGSTOP)


def _let_signals_pass() -> None:
    """Wait for signals that are to be sent again, so that the next work does not get them."""
    kept = {number: signal.signal(number, signal.SIG_IGN)
            for number in (signal.SIGINT, signal.SIGTERM)}
    for thread in threading.enumerate():
        if thread is not threading.current_thread():
            thread.join()
    for number, handler in kept.items():
        signal.signal(number, handler)


def _call(child: int) -> str:
    """Return the call that a child is about to make."""
    info = _Info()
    _ptrace(INFO, child, ctypes.sizeof(info), ctypes.byref(info))
    return CALLS[info.nr]


def _be_filtered() -> None:
    """Have the kernel stop this process at calls that change files."""
    steps = (_Step * len(_STEPS))(*_STEPS)
    program = _Filter(len(steps), steps)
    if _libc.prctl(NO_NEW_PRIVILEGES, 1, None, 0, 0) or _libc.prctl(
            SECCOMP, FILTER, ctypes.byref(program), 0, 0):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _filter() -> list[tuple[int, int, int, int]]:
    """Return a filter's steps: which calls, and of some those with certain arguments only."""
    tests = {"open": (1, ANY_BIT, WRITES), "openat": (2, ANY_BIT, WRITES)} | dict.fromkeys(
        ("write", "writev", "pwrite64"), (0, GREATER, STREAMS))
    steps = [(LOAD, 0, 0, 0)]
    for number, name in CALLS.items():
        body = [(RETURN, 0, 0, TRACE)]
        if name in tests:
            argument, test, value = tests[name]
            body = [(LOAD, 0, 0, ARGUMENTS + 8 * argument), (test, 0, 1, value), *body,
                    (RETURN, 0, 0, ALLOW)]
        steps += [(EQUAL, 0, len(body), number), *body]
    return [*steps, (RETURN, 0, 0, ALLOW)]


_STEPS = _filter()


def _speak_to(said: str | os.PathLike[str]) -> None:
    """Lead standard output and error into a file."""
    place = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(place, 1)
    os.dup2(place, 2)
    for name, number in (("stdout", 1), ("stderr", 2)):
        raw = os.fdopen(number, "wb", closefd=False, buffering=0)
        setattr(sys, name, io.TextIOWrapper(raw, "utf-8", "backslashreplace", write_through=True))


def _code(work: Callable[[], int]) -> int:
    try:
        code = work()
        sys.stdout.flush()
        return code
    except BaseException as error:
        import traceback
        traceback.print_exception(error)
        return 99
