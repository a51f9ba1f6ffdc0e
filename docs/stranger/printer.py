"""A delta printer whose rods are longer than its printer.cfg says, as Klipper leaves it."""

import configparser
import re
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

rng = np.random.default_rng(33)
STEP = 40 / (200 * 16)
angles = np.deg2rad([210.0, 330.0, 90.0])
ROD, RADIUS, ENDSTOP = 298.0, 140.0, 290.0              # what the owner believes, mm
rods, radius, ends = 298.7, 140.3, np.array([290.2, 289.7, 290.1])
carriages = ends + np.sqrt(rods**2 - radius**2)         # heights at homing, as built
towers = radius * np.column_stack([np.cos(angles), np.sin(angles)])


def steps(point):
    """Steps down from homing at which the nozzle as built is at a point."""
    heights = point[2] + np.sqrt(rods**2 - np.sum((towers - point[:2]) ** 2, axis=1))
    return (carriages - heights) / STEP


def measure():
    places = [(0, 0)] + [(r * np.cos(a), r * np.sin(a)) for r, n in ((55, 6), (105, 12))
                         for a in 2 * np.pi * np.arange(n) / n]
    saved = []
    for n, (x, y) in enumerate(places):
        touch = steps(np.array([x, y, rng.normal(0, 0.01)]))
        saved += [f"height{n} = 0.0", f"height{n}_pos = {', '.join(f'{s:.3f}' for s in touch)}"]
    ring = [np.array([70 * np.cos(a), 70 * np.sin(a), 0.0]) for a in 2 * np.pi * np.arange(6) / 6]
    for n in range(6):
        one, two = ring[n], ring[(n + 2 + n // 3) % 6]
        length = np.linalg.norm(one - two) + rng.normal(0, 0.03)
        saved += [f"distance{n} = {length:.3f}", *(
            f"distance{n}_pos{i} = {', '.join(f'{s:.3f}' for s in steps(p))}"
            for i, p in ((1, one), (2, two)))]
    with open("printer.cfg", "w") as file:
        file.write(f"[printer]\nkinematics: delta\n#delta_radius: {RADIUS}\n\n")
        for name in "abc":
            file.write(f"[stepper_{name}]\nrotation_distance: 40\nmicrosteps: 16\n"
                       "full_steps_per_rotation: 200\n\n")
        file.write("[delta_calibrate]\nradius: 110\n\n"
                   "#*# <---------------------- SAVE_CONFIG ---------------------->\n"
                   "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.\n"
                   f"#*#\n#*# [printer]\n#*# delta_radius = {RADIUS}\n#*#\n")
        for name, angle in zip("abc", (210, 330, 90), strict=True):
            file.write(f"#*# [stepper_{name}]\n#*# angle = {angle}\n#*# arm_length = {ROD}\n"
                       f"#*# position_endstop = {ENDSTOP}\n#*#\n")
        file.write("#*# [delta_calibrate]\n" + "".join(f"#*# {line}\n" for line in saved))


def drive(name):
    """Print where the nozzle as built goes with a file's numbers, over the bed."""
    own = configparser.ConfigParser(strict=False, inline_comment_prefixes="#")
    saved = re.sub(r"^#\*# ?(<|DO NOT).*$", "", Path(name).read_text(), flags=re.M)
    own.read_string(saved.replace("#*# ", "").replace("#*#", ""))
    arm, at, home = (np.array([float(own[f"stepper_{t}"][k]) for t in "abc"])
                     for k in ("arm_length", "angle", "position_endstop"))
    reach = float(own["printer"]["delta_radius"])
    wanted = reach * np.column_stack([np.cos(np.deg2rad(at)), np.sin(np.deg2rad(at))])
    bed = [np.array([x, y, 0.0]) for x in np.linspace(-80, 80, 5) for y in np.linspace(-80, 80, 5)]
    went = []
    for point in bed:
        down = home + np.sqrt(arm**2 - reach**2) - point[2] - np.sqrt(
            arm**2 - np.sum((wanted - point[:2]) ** 2, axis=1))
        went.append(least_squares(lambda p, q: steps(p) * STEP - q, point, args=(down,)).x)
    z = np.array(went)[:, 2]
    size = np.linalg.norm(went[0][:2] - went[-1][:2]) / np.linalg.norm(bed[0] - bed[-1])
    print(f"z is off by {np.sqrt(np.mean(z**2)):.3f} mm rms, {np.abs(z).max():.3f} at most; "
          f"size by {100 * (size - 1):+.2f} %")


measure() if len(sys.argv) == 1 else drive(sys.argv[1])
