"""A full disk, a closed stream and Ctrl-C: a message and an exit code, and files all the same."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.commands import EXECUTABLE, environment, ppmcal, tree

FULL = Path("/dev/full")
START = ["-c", "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
         "from ppmcal.cli import main; main()"]


def process(*args, path="", **streams):
    """Run ``ppmcal args`` as a process with streams of its own; ``path`` to find modules first."""
    return subprocess.run([*map(str, args)], timeout=120, check=False, text=True,
                          env=environment(*[path] if path else []),
                          **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams})


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A planar machine with simulated measurements."""
    folder = tmp_path_factory.mktemp("bench")
    ppmcal("init", "3-RPR", "--out", "m.yaml", cwd=folder, expect=0)
    ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "s", cwd=folder, expect=0)
    return folder


@pytest.mark.long
@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("more", [(), ("--json",), ("--sigma", "estimated")])
def test_results_are_written_although_standard_output_is_full(bench, tmp_path, more):
    """With --sigma estimated something is said before anything is written."""
    args = ("identify", "m.yaml", "s/measurements.csv", *more, "--out")
    ppmcal(*args, tmp_path / "want", cwd=bench)
    with FULL.open("w") as full:
        run = process(*EXECUTABLE, *args, tmp_path / "o", cwd=bench, stdout=full)
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert run.stderr.startswith("Error: standard output cannot be written")
    assert set(tree(tmp_path / "o")) == set(tree(tmp_path / "want"))


@pytest.mark.slow_cases("args2")
@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("args", [("--help",), ("identify", "--help"), ("init",)])
def test_help_into_a_full_disk(args):
    with FULL.open("w") as full:
        run = process(*EXECUTABLE, *args, stdout=full)
    assert run.returncode == 2
    assert run.stderr.startswith("Error: standard output") and run.stderr.count("\n") == 1


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.long
def test_the_exit_code_stands_although_nobody_can_read_why(tmp_path):
    with FULL.open("w") as full:
        run = process(*EXECUTABLE, "check", tmp_path / "none.yaml", stderr=full)
    assert run.returncode == 2


@pytest.mark.long
def test_results_are_written_although_nobody_listens(bench, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed:
        run = process(*EXECUTABLE, "identify", "m.yaml", "s/measurements.csv", "--sigma",
                      "estimated", "--out", tmp_path / "o", cwd=bench, stdout=closed)
    assert run.returncode in (0, 1)
    assert not run.stderr
    assert "identified.yaml" in tree(tmp_path / "o")


@pytest.mark.parametrize(("module", "text"), [
    # as compiled modules do: the interrupt becomes an error of their own
    ("numpy", "import os, signal, time\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n"
              "    time.sleep(5)\nexcept KeyboardInterrupt:\n    raise ImportError('failed')\n"),
    ("click", "raise KeyboardInterrupt\n")])
def test_an_interrupt_while_modules_load(bench, tmp_path, module, text):
    (tmp_path / f"{module}.py").write_text(text)
    run = process(sys.executable, *START, "check", bench / "m.yaml", path=tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "Stopped.\n")


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_an_interrupt_that_others_drop_comes_again(tmp_path):
    """Python drops what is raised in __del__, and compiled modules show it; neither is said."""
    (tmp_path / "yaml.py").write_text(
        "import os, signal, sys, time\n"
        "class Dropped:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        time.sleep(0.2)\n"
        "def safe_load(*_):\n"
        "    Dropped()\n"
        "    time.sleep(60)\n")
    code = ("from ppmcal.cli import streams\nimport sys\n"
            "with streams.interruptible(True):\n"
            "    import yaml\n"
            "    try:\n"
            "        yaml.safe_load()\n"
            "    except streams.Stopped as stop:\n"
            "        sys.excepthook(type(stop), stop, stop.__traceback__)\n"
            "        sys.exit(stop.exit_code)\n")
    run = process(sys.executable, "-c", code, path=tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (143, "", "")


COMMANDS = {
    "check": "check m.yaml s/measurements.csv", "simulate": "simulate m.yaml m.scenario.yaml",
    "identify": "identify m.yaml s/measurements.csv", "init": "init 3-RPR",
    "sensitivity": "sensitivity m.yaml --home-only", "verify": "verify s", "schema": "schema batch",
    "plan": "plan m.yaml --count 8", "diagnose": "diagnose m.yaml s/measurements.csv",
    "workspace": "workspace m.yaml --grid x=450:550:3,y=240:340:3", "report": "report s",
    "tolerances": "tolerances m.yaml --accuracy 0.5 --machines 50"}
NO_FOLDER = ("check", "verify", "schema", "init")


def words_of(name, tmp_path):
    """Return the words of a command that writes into a new folder, and the folder."""
    if name in ("init", "check", "verify", "schema"):
        more = ["--out", tmp_path / "mine.yaml"] if name == "init" else []
        return [*COMMANDS[name].split(), *more], tmp_path / "none"
    return [*COMMANDS[name].split(), "--out", tmp_path / "o"], tmp_path / "o"


@pytest.mark.long_cases(
    "both-check", "stderr-check", "stderr-identify", "stderr-simulate", "stdout-check",
    "stdout-diagnose", "stdout-identify", "stdout-plan", "stdout-report", "stdout-sensitivity",
    "stdout-simulate", "stdout-tolerances", "stdout-verify", "stdout-workspace")
@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.slow
@pytest.mark.parametrize(("which", "name"), [
    *(("stdout", n) for n in COMMANDS), ("stderr", "check"), ("stderr", "simulate"),
    ("stderr", "identify"), ("both", "check"), ("both", "simulate")])
def test_full_streams_of_each_command(bench, tmp_path, name, which):
    """One line where somebody can read it, an exit code that says so, and whole folders."""
    words, folder = words_of(name, tmp_path)
    with FULL.open("w") as full:
        streams = {k: full for k in ("stdout", "stderr") if which in (k, "both")}
        run = process(*EXECUTABLE, *words, *(["-v"] if which == "stderr" and name in (
            "simulate", "identify") else []), cwd=bench, **streams)
    assert run.returncode != 0 or which == "stderr"
    if which == "stderr" and name in ("simulate", "identify"):
        assert run.returncode == 2      # what -v says is lost
    if which == "stdout":
        assert run.stderr.count("\n") == 1
        assert run.stderr.startswith("Error: standard output cannot be written")
    if name not in NO_FOLDER:
        assert (folder / ".ppmcal.json").is_file()
    assert not list(tmp_path.rglob(".ppmcal.*.part"))


@pytest.mark.long_cases("diagnose", "identify", "simulate")
@pytest.mark.parametrize("name", ["check", "simulate", "identify", "diagnose"])
@pytest.mark.slow
def test_nobody_reads_to_the_end(bench, tmp_path, name):
    """As with ``| head -1``."""
    words, folder = words_of(name, tmp_path)
    run = subprocess.Popen([*EXECUTABLE, *map(str, words), *(["--json"] if name != "schema" and
                           name != "init" else [])], cwd=bench, text=True,
                           stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    run.stdout.readline()
    run.stdout.close()
    err = run.stderr.read()
    run.stderr.close()
    assert run.wait(timeout=120) in (0, 1)
    assert not err
    if name not in NO_FOLDER:
        assert (folder / ".ppmcal.json").is_file()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of POSIX")
def test_a_signal_waits_while_a_folder_is_locked(bench, tmp_path):
    """Between the lock and who gives it back."""
    code = ("import os, signal, sys\nfrom ppmcal.store import transaction\n"
            "locked = transaction.locked\n"
            "def slow(*given):\n"
            "    found = locked(*given)\n"
            "    os.kill(os.getpid(), signal.SIGTERM)\n"
            "    return found\n"
            "transaction.locked = slow\n"
            "from ppmcal.cli import main\nmain()\n")
    run = process(sys.executable, "-c", code, "simulate", bench / "m.yaml",
                  bench / "m.scenario.yaml", "--out", tmp_path / "o")
    assert (run.returncode, run.stderr) == (143, "Stopped.\n")
    assert not list(tmp_path.iterdir())
