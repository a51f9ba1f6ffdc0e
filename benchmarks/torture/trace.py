"""Children stopped at each system call that changes files, by ptrace: killed there, or refused."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import platform
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass

AVAILABLE = sys.platform == "linux" and platform.machine() == "x86_64"
TRACEME, CONT, SETOPTIONS, SYSCALL, INFO, POKE = 0, 7, 0x4200, 24, 0x420E, 6
EXITKILL, SYSGOOD = 0x100000, 1
ORIG_RAX, RAX = 15 * 8, 10 * 8
STOP = signal.SIGTRAP | 0x80
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
STREAMS = (0, 1, 2)


class _Info(ctypes.Structure):
    _fields_ = (("op", ctypes.c_uint8), ("pad", ctypes.c_uint8 * 3), ("arch", ctypes.c_uint32),
                ("ip", ctypes.c_uint64), ("sp", ctypes.c_uint64), ("nr", ctypes.c_uint64),
                ("args", ctypes.c_uint64 * 6))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_libc.ptrace.restype = ctypes.c_long


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
    child = os.fork()
    if not child:
        _speak_to(said)
        os._exit(_code(work))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def traced(work: Callable[[], int], at: At, said: str | os.PathLike[str] = os.devnull) -> End:
    """Run ``work`` in a child and call ``at`` before each of its calls that changes files."""
    child = os.fork()
    if not child:
        _speak_to(said)
        _ptrace(TRACEME, 0)
        os.kill(os.getpid(), signal.SIGSTOP)
        os._exit(_code(work))
    os.waitpid(child, 0)
    _ptrace(SETOPTIONS, child, 0, EXITKILL | SYSGOOD)
    calls, refused, entered, deliver = list[str](), 0, False, 0
    while True:
        with contextlib.suppress(ProcessLookupError):
            _ptrace(SYSCALL, child, 0, deliver)
        status = os.waitpid(child, 0)[1]
        if not os.WIFSTOPPED(status):
            return End(os.waitstatus_to_exitcode(status), tuple(calls))
        deliver = 0
        if os.WSTOPSIG(status) != STOP:
            deliver = os.WSTOPSIG(status)
            continue
        entered = not entered
        if not entered:
            if refused:
                _ptrace(POKE, child, RAX, ctypes.c_void_p(-refused & 0xFFFFFFFFFFFFFFFF))
                refused = 0
            continue
        name = _changing(child)
        if name:
            calls.append(name)
            refused = at(len(calls), name, child) or 0
            if refused:
                _ptrace(POKE, child, ORIG_RAX, ctypes.c_void_p(0xFFFFFFFFFFFFFFFF))


def _changing(child: int) -> str:
    """Return the call that a child is about to make if it changes files, else nothing."""
    info = _Info()
    _ptrace(INFO, child, ctypes.sizeof(info), ctypes.byref(info))
    name = CALLS.get(info.nr, "")
    if info.op != 1 or not name:
        return ""
    if name in ("write", "writev", "pwrite64") and info.args[0] in STREAMS:
        return ""
    flags = {"open": info.args[1], "openat": info.args[2]}.get(name, WRITES)
    return name if flags & WRITES else ""


def _speak_to(said: str | os.PathLike[str]) -> None:
    """Lead standard output and error into a file."""
    place = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
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
