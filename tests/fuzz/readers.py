"""Every reader of the package: good inputs to begin with, and a call that takes bytes."""

import dataclasses
import functools
import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from helpers.paths import ROOT

from fuzz.judge import SECONDS
from ppmcal.commands.batch.manifest import read_manifest
from ppmcal.controllers.hangprinter import reading as hangprinter_config
from ppmcal.controllers.hangprinter.controller import import_config as import_hangprinter
from ppmcal.controllers.joints import tables as joint_tables
from ppmcal.controllers.klipper import config as klipper_config
from ppmcal.controllers.klipper import reading as klipper_reading
from ppmcal.controllers.klipper import rotary as klipper_rotary
from ppmcal.controllers.linuxcnc import hal as linuxcnc_hal
from ppmcal.controllers.marlin import controller as marlin_config
from ppmcal.controllers.maslow.controller import import_config as import_maslow
from ppmcal.controllers.reprap import controller as reprap_config
from ppmcal.controllers.reprap.controller import read_map
from ppmcal.io.column_names import LABELS
from ppmcal.io.csv import csv_table
from ppmcal.io.dataset_reader import read_dataset
from ppmcal.io.foreign import foreign_tables
from ppmcal.io.header import ReadFile
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.poses import read_joints, read_poses
from ppmcal.io.results import knowledge
from ppmcal.io.results.batch import CampaignRecord
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.comparison import ComparisonRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_tables import RESIDUAL_TABLE
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.simulation import TruthRecord
from ppmcal.io.results.stiffness import StiffnessRecord
from ppmcal.io.results.tolerances import TolerancesRecord
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.io.scenario import read_scenario
from ppmcal.io.tables import read_table
from ppmcal.io.yaml import read_yaml
from ppmcal.report.collect import collect
from ppmcal.store.folder import RECORD, read_record

GOOD = ROOT / "tests" / "broken"
WORDS = ("note", "session")
SHEET = "xl/worksheets/sheet1.xml"
CORPUS = ROOT / "tests" / "fuzz" / "corpus"


@dataclasses.dataclass(frozen=True)
class Reader:
    """One reader: its name, what takes bytes, good inputs, and the seconds that it may take."""

    name: str
    read: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    seconds: float = SECONDS
    draw: Callable | None = None
    """Makes an input with a random generator, where changed bytes would make none of use."""

    @property
    def form(self):
        """What the mutations take it for."""
        name = self.name.partition("-")[0]
        if name in ("record", "report", "knowledge", "posterior", "yaml", "mechanism", "scenario",
                    "batch") or self.seeds[0][:1] == b"{":
            return "tree"
        return "csv" if b"," in self.seeds[0].split(b"\n", 1)[0] else "text"


def texts(*names):
    return tuple((ROOT / n).read_bytes() for n in names)


@functools.cache
def folder():
    """A folder of this process for what is read from files, in memory where there is a place."""
    shared = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="ppmcal-fuzz-", dir=shared if shared.is_dir() else None))


def from_file(name, read):
    """Return a reader of bytes out of one of a path."""
    def call(data):
        path = _place(name)
        with open(path, "wb") as stream:
            stream.write(data)
        return read(path)

    return call


@functools.cache
def _place(name):
    return folder() / name


@functools.cache
def bench():
    return read_mechanism(GOOD / "good_bench.yaml")


@functools.cache
def hexapod():
    return read_mechanism(ROOT / "sample_data" / "hexapod.yaml")


def _dataset(data):
    """A measurement file and its sidecar in one input, put apart by a line of equal signs."""
    table, _, side = data.partition(b"\n====\n")
    (folder() / "d.csv").write_bytes(table)
    (folder() / "d.yaml").write_bytes(side)
    found = read_dataset(folder() / "d.csv", bench())
    assert np.isfinite(found.q).all() or found.commanded is not None, "joints that are no numbers"
    return found


def _csv(data):
    """Fast and slow way must say the same: quotes around a cell send all rows the slow way."""
    fast = csv_table(data, "d.csv", LABELS.__contains__)
    for name, values in fast.numbers.items():
        assert values.shape == (len(fast),), f"column {name}"
    return fast


def _hal(data):
    hal = linuxcnc_hal.parse_hal(data.decode("utf-8-sig", "replace"), "k.hal")
    return linuxcnc_hal.read_geometry(hal)


def _joints(data):
    return linuxcnc_hal.parse_joints(data.decode("utf-8", "replace"), "k.ini")


def _klipper(path):
    return klipper_reading.read_printer(path, None, (), None)


def _rotary(path):
    _imported(klipper_rotary.imported(path))


def _maslow(path):
    _imported(import_maslow(path, {"width": None, "height": None, "anchors": None}))


def _hangprinter(path):
    _imported(import_hangprinter(path, {"anchors": None}))


def _imported(found):
    """What an import writes is a machine and measurements that can be read again."""
    place = folder() / "imported"
    place.mkdir(exist_ok=True)
    for name, text in found.files.items():
        (place / name).write_text(text, encoding="utf-8")
    machine = read_mechanism(place / "machine.yaml")
    for name in found.files:
        if name.endswith(".csv"):
            read_dataset(place / name, machine)


def _heights(path):
    found, _ = read_map(path)
    assert np.isfinite(found).all(), "heights that are no numbers"


def _log(path):
    point, _, _ = klipper_reading._logged(path)
    assert np.isfinite(point).all(), "touches that are no numbers"


def _foreign(data):
    path = folder() / "f.txt"
    path.write_bytes(data)
    return foreign_tables(path, hexapod(), ReadFile(), "f.yaml")


@functools.cache
def _columnar():
    """Tables in Parquet, none without pyarrow."""
    try:
        from pyarrow import BufferOutputStream, parquet, table
    except ImportError:
        return ()
    out = []
    for settings in ({"compression": "none", "use_dictionary": False}, {"compression": "snappy"}):
        sink = BufferOutputStream()
        parquet.write_table(table({"pose": [1, 2, 3], "x": [1.5, None, 2.5],
                                   "note": ["a", "b", None]}), sink, **settings)
        out.append(bytes(sink.getvalue()))
    return tuple(out)


@functools.cache
def _spreadsheet():
    """The parts of a small spreadsheet, none without openpyxl."""
    try:
        from openpyxl import Workbook
    except ImportError:
        return {}
    book, raw = Workbook(), io.BytesIO()
    for row in (["pose", "x", "note"], [1, 1.5, "a"], [2, 2.5, "b"]):
        book.active.append(row)
    book.save(raw)
    with zipfile.ZipFile(raw) as parts:
        return {name: parts.read(name) for name in parts.namelist()}


def _sheet(data):
    """A sheet of a sound spreadsheet, whose check sums would hide it from changes."""
    path = folder() / "t.xlsx"
    with zipfile.ZipFile(path, "w") as parts:
        for name, content in _spreadsheet().items():
            parts.writestr(name, data if name == SHEET else content)
    return read_table(path, loose=WORDS.__contains__)


def _no_constant(word):
    raise AssertionError(f"{word} was written")


def _record(kind):
    def read(path):
        found = kind.read(path)
        # what is read back can be written again
        json.loads(found.text(), parse_constant=_no_constant)
        return found

    return from_file(kind.FILE or "r.json", read)


def _knowledge(path):
    found = knowledge.read_knowledge(path, bench())
    matrix = found.covariance
    assert np.isfinite(matrix[np.isfinite(matrix)]).all()
    sigma = np.diagonal(matrix)
    assert not np.any(sigma < 0.0), "a negative variance was accepted"


def _written(path):
    """What a folder's record says: anything that is none of ours says nothing."""
    return "read" if read_record(path.parent).sound else "none"


def _collected(name):
    def read(path):
        return collect([path.parent])

    def call(data):
        home = folder() / f"report-{name}"
        home.mkdir(exist_ok=True)
        (home / name).write_bytes(data)
        return read(home / name)

    return call


RECORDS = (IdentificationRecord, DiagnosisRecord, CommandsRecord, ComparisonRecord, ExportRecord,
           KinematicsRecord, PlanRecord, SensitivityRecord, StiffnessRecord, TolerancesRecord,
           TruthRecord, ValidationRecord, WorkspaceRecord, CampaignRecord)


def seeds_of(name):
    """Return what the corpus holds for a reader: a result, and inputs that reached far."""
    stem = name.partition("-")[2] or "identification"
    good = CORPUS / "results" / f"{stem}.json"
    mine = name.partition("-")[0] in ("record", "report", "knowledge", "posterior")
    return tuple(p.read_bytes() for p in [*([good] if mine and good.is_file() else []),
                                          *sorted((CORPUS / name).glob("*"))])


@functools.cache
def readers():
    """Return name -> reader."""
    run = texts("tests/broken/good_run.csv", "tests/broken/good_run.yaml")
    machines = texts("tests/broken/good_bench.yaml", "tests/broken/good_crank.yaml",
                     "tests/broken/good_rails.yaml", "configs/3-RPS.yaml",
                     "configs/delta-linear.yaml", "sample_data/hexapod.yaml")
    made = [
        Reader("csv", _csv, run[:1]),
        Reader("table", from_file("t.csv", lambda p: read_table(p, loose=WORDS.__contains__)),
               run[:1]),
        *(Reader("parquet", from_file("t.parquet", lambda p: read_table(
            p, loose=WORDS.__contains__)), s) for s in [_columnar()] if s),
        *(Reader("sheet", _sheet, (s,)) for s in [_spreadsheet().get(SHEET)] if s),
        Reader("poses", from_file("p.csv", lambda p: read_poses(p, bench())),
               texts("sample_data/targets.csv") + (b"x,y,rz,note\n500,280,20,a\n510,270,22,b\n",)),
        Reader("joints", from_file("j.csv", lambda p: read_joints(p, bench())),
               (b"q_leg1,q_leg2,q_leg3,time\n450,460,470,1\n451,461,471,2\n",)),
        Reader("columns", from_file("c.csv", RESIDUAL_TABLE.read),
               (b"row,name,x,used\n1,a,0.5,true\n2,b,,false\n",)),
        Reader("dataset", _dataset, (run[0] + b"\n====\n" + run[1],)),
        Reader("foreign", _foreign, (
            *run[:1], b"P1 1.0 2.0 3.0\nP2 2.0 3.0 4.0\n", b"name;x [mm];y [mm];z [mm]\nA;1;2;3\n",
            b"1700000000,5,f,leg1,leg2,1.0,2.0\n1700000001,5,f,leg1,leg2,1.0,2.0\n",
            b"Recv: // stepper: stepper_a:1.5 stepper_b:2.5\n",
            b"time,pose.position.x,pose.position.y,pose.position.z\n1,2,3,4\n")),
        Reader("yaml", from_file("y.yaml", read_yaml), machines[:1] + run[1:]),
        Reader("mechanism", from_file("m.yaml", read_mechanism), machines),
        Reader("scenario", from_file("s.yaml", lambda p: read_scenario(p, bench())),
               texts("tests/broken/good_scenario.yaml")),
        Reader("batch", from_file("b.yaml", read_manifest), (
            b"format: ppmcal/batch/1\ncampaigns:\n  - {machine: a, date: 2026-01-02, "
            b"model: m.yaml, data: [d.csv]}\n",)),
        Reader("klipper", lambda d: klipper_config.read_geometry(klipper_config.parse_config(
            d.decode("utf-8", "replace"), "p.cfg")), texts("sample_data/printer/printer.cfg")),
        Reader("printer", from_file("printer.cfg", _klipper),
               texts("sample_data/printer/printer.cfg")),
        Reader("rotary", from_file("printer.cfg", _rotary), (
            b"[printer]\nkinematics: rotary_delta\nshoulder_radius: 33.9\n"
            b"shoulder_height: 412.9\n[stepper_a]\ngear_ratio: 107:16, 60:16\nmicrosteps: 16\n"
            b"position_endstop: 252\nupper_arm_length: 170\nlower_arm_length: 320\n[stepper_b]\n"
            b"gear_ratio: 107:16, 60:16\nmicrosteps: 16\n[stepper_c]\n"
            b"gear_ratio: 107:16, 60:16\nmicrosteps: 16\n[delta_calibrate]\nheight0: 0.0\n"
            b"height0_pos: 23224.8, 23182.4, 23209.6\ndistance0: 40\n"
            b"distance0_pos1: 23224.8, 23182.4, 23209.6\n"
            b"distance0_pos2: 22562.0, 22431.6, 26207.1\n",)),
        Reader("klipper-log", from_file("l.log", _log), (
            b"probe at 0.000,0.000 is z=1.234\nprobe at 10.0,0.000 is z=1.3\n"
            b"probe at 10.0,9.0 is z=1.3\n",)),
        Reader("reprap", lambda d: reprap_config.read_delta(reprap_config.parse(
            d.decode("utf-8", "replace"), "config.g")), (
            b"M665 L300:300:300 R150 H240 B90 X0.1 Y-0.2 Z0\nM666 X0.1 Y0 Z-0.1 A0 B0\nG31 Z1\n",)),
        Reader("marlin", lambda d: marlin_config.read_delta(marlin_config.parse(
            d.decode("utf-8", "replace"), "m503.txt")), (
            b"echo:  M665 L250.3 R160.2 H270.4 S80 X0.3 Y-0.4 Z0.0 A0.2 B-0.1 C-0.1\n"
            b"echo:; Endstop adjustment:\necho:  M666 X-0.25 Y0.00 Z-0.60\n",)),
        Reader("heightmap", from_file("heightmap.csv", _heights), (
            b"RepRapFirmware height map file v2\naxis0,axis1,min0,max0,min1,max1,radius,spacing0,"
            b"spacing1,num0,num1\nX,Y,-10,10,-10,10,-1,10,10,3,3\n0.1,0.2,0.3\n0.1,0,0.3\n"
            b"0.1,0.2,0.3\n",)),
        Reader("maslow", from_file("maslow.log", _maslow), (
            *texts("sample_data/maslow/maslow.log"), b"bl,br,tr,tl\n" + b"".join(
                b"%d,%d,%d,%d\n" % (1000 + 90 * n, 2700 - 70 * n, 2400, 998 + 60 * n)
                for n in range(6)))),
        Reader("hangprinter", from_file("samples.jsonl", _hangprinter), (
            *texts("sample_data/hangprinter/samples.jsonl"),
            b"motor_pos_samp = np.array([\n" + b"".join(
                b"  [%d, %d, 3.5, -4e2],  # x\n" % (n, 5 * n) for n in range(30)) + b"])\n")),
        Reader("hangprinter-config", lambda d: hangprinter_config.parse_config(
            d.decode("utf-8", "replace"), "config.g").matrix("config.g"), (
            b"M669 A0:-1600:-120 B1300:1250:-160 C-1400:750:-150 D20:10:2350\n"
            b"M666 Q0.05 R75:75:75:75 U2:2:2:4 O1 L20 H255\n",)),
        Reader("hal", _hal, (_hal_text(),
                             _hal_text() + b"net a genhexkins.screw-lead <= b\n")),
        Reader("hal-joints", _joints, (
            b"[JOINT_0]\n# HOME_OFFSET = present * 1.5 + 0.25\n# HOME = 5.0\n[JOINT_1]\n"
            b"# HOME = 1\n",)),
        Reader("triplets", lambda d: joint_tables.parse_triplets(
            d.decode("utf-8", "replace"), "c.comp"), (b"0 0.1 0.2\n1 1.1 1.2\n2 2.0 2.1\n",)),
        Reader("knowledge", from_file("identification.json", _knowledge), ()),
        Reader("posterior", from_file("identification.json",
                                      lambda p: knowledge.read_posterior(p, bench())), ()),
        Reader("record-of-folder", from_file(RECORD, _written), ()),
        *(Reader(f"record-{kind.FILE.partition('.')[0]}", _record(kind), ()) for kind in RECORDS),
        *(Reader(f"report-{n.partition('.')[0]}", _collected(n), ()) for n in (
            "identification.json", "diagnosis.json", "validation.json", "comparison.json",
            "commands.json", "export.json", "truth.json", "plan.json", "stiffness.json")),
    ]
    return {r.name: dataclasses.replace(r, seeds=(*r.seeds, *seeds_of(r.name)) or (b"{}",))
            for r in made}


def _hal_text():
    lines = [f"setp genhexkins.{group}.{n}.{c} {n + 0.5}" for group in ("base", "platform")
             for n in range(6) for c in "xyz"]
    return "\n".join(["loadrt genhexkins", *lines, ""]).encode()

