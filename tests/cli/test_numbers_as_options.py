"""Numbers that users write with a percent sign or a unit: the option says how."""

from helpers import bodies
from helpers.commands import ppmcal


def test_a_part_to_hold_out_is_no_percentage(tmp_path):
    bodies.machine(tmp_path)
    bodies.wide(tmp_path, bodies.measured(3))
    told = ppmcal("identify", "bench.yaml", "wide.csv", "--holdout", "20%", cwd=tmp_path, expect=2)
    assert "Write --holdout 0.2" in told.err


def test_a_rod_is_a_number_of_mm(tmp_path):
    (tmp_path / "printer.cfg").write_text("[printer]\nkinematics: delta\n")
    told = ppmcal("import", "klipper", "printer.cfg", "--rods", "300mm", cwd=tmp_path, expect=2)
    assert "without a unit" in told.err
