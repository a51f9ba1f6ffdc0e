"""A 3-RPR machine in plain NumPy, mm and deg: what a certificate says of it, worked out again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import least_squares

from helpers.certificates import columns

LEGS = ("leg1", "leg2", "leg3")
DEG = np.pi / 180.0
SLOTS = ("base.point.x", "base.point.y", "platform.point.radius", "platform.point.angle", "offset")


class Bench:
    """The identified machine of a folder, and the rows of another session."""

    def __init__(self, folder: Path) -> None:
        limbs = yaml.safe_load((folder / "identified/identified.yaml").read_text("utf-8"))["limbs"]
        self.g = {f"{limb['name']}.{slot}": value for limb in limbs
                  for slot, value in zip(SLOTS, self._slots(limb), strict=True)}
        self.rows = columns(folder / "val.csv")
        self.q = np.stack([self.rows[f"q_{leg}"] for leg in LEGS], axis=1)
        self.side = np.stack([self.rows[f"dir_{leg}"] for leg in LEGS], axis=1)
        self.seen = np.stack([self.rows[c] for c in ("x", "y", "rz")], axis=1)
        self.sigma = np.array([0.01, 0.01, 0.002])
        self.pose = self.reached(self.g)
        white = self.sigma
        self.stand = least_squares(
            lambda s: ((self.seen - self.shown(self.pose, s)) / white).ravel(),
            [150.0, -80.0, 12.0, 20.0, -10.0], x_scale=[1, 1, 0.1, 1, 1], xtol=1e-15, ftol=1e-15,
            gtol=1e-15).x
        self.errors = self.seen - self.shown(self.pose, self.stand)
        record = json.loads((folder / "identified/identification.json").read_text("utf-8"))
        self.record: dict[str, Any] = record

    @staticmethod
    def _slots(limb: dict[str, Any]) -> list[float]:
        def plain(v: Any) -> float:
            return float(v["value"] if isinstance(v, dict) else v)

        points = [plain(limb[side]["point"][c]) for side, c in (
            ("base", "x"), ("base", "y"), ("platform", "radius"), ("platform", "angle"))]
        return [*points, plain(limb.get("offset", 0.0))]

    def reached(self, g: dict[str, float]) -> Any:
        """Return the poses x, y, rz at the joint values (N, 3), by Newton."""
        pose = np.tile([500.0, 288.675, 30.0], (len(self.q), 1))
        for _ in range(30):
            c = self.gaps(g, pose, self.q)
            j = np.stack([(self.gaps(g, pose + d, self.q) - self.gaps(g, pose - d, self.q)) / 2e-4
                          for d in 1e-4 * np.eye(3)], axis=-1)
            pose = pose - np.linalg.solve(j, c[..., None])[..., 0]
        return pose

    @staticmethod
    def gaps(g: dict[str, float], pose: Any, q: Any) -> Any:
        """Return |B - A| - q - offset of each leg (N, 3)."""
        co, si = np.cos(pose[:, 2] * DEG), np.sin(pose[:, 2] * DEG)
        out = []
        for n, leg in enumerate(LEGS):
            ax, ay, radius, angle, offset = (g[f"{leg}.{s}"] for s in SLOTS)
            px, py = radius * np.cos(angle * DEG), radius * np.sin(angle * DEG)
            x, y = pose[:, 0] + co * px - si * py - ax, pose[:, 1] + si * px + co * py - ay
            out.append(np.hypot(x, y) - q[:, n] - offset)
        return np.stack(out, axis=1)

    @staticmethod
    def shown(pose: Any, stand: Any) -> Any:
        """Return poses as the instrument at frame x, y, rz sees its target x, y (N, 3)."""
        co, si = np.cos(pose[:, 2] * DEG), np.sin(pose[:, 2] * DEG)
        x, y = (pose[:, 0] + co * stand[3] - si * stand[4],
                pose[:, 1] + si * stand[3] + co * stand[4])
        fc, fs = np.cos(stand[2] * DEG), np.sin(stand[2] * DEG)
        return np.stack([stand[0] + fc * x - fs * y, stand[1] + fs * x + fc * y,
                         pose[:, 2] + stand[2]], axis=1)

    def attained(self) -> Any:
        """Return the measured poses in the base frame (N, 3)."""
        s = self.stand
        fc, fs = np.cos(s[2] * DEG), np.sin(s[2] * DEG)
        rz = self.seen[:, 2] - s[2]
        dx, dy = self.seen[:, 0] - s[0], self.seen[:, 1] - s[1]
        co, si = np.cos(rz * DEG), np.sin(rz * DEG)
        return np.stack([fc * dx + fs * dy - (co * s[3] - si * s[4]),
                         -fs * dx + fc * dy - (si * s[3] + co * s[4]), rz], axis=1)

    def deviations(self) -> Any:
        """Return what each joint is longer than commanded, by the measured poses (N, 3)."""
        return self.gaps(self.g, self.attained(), self.q)

    def sets(self) -> list[Any]:
        """Return the rows of each pose that came from one direction."""
        out = []
        for pose in np.unique(self.rows["pose"]):
            rows = np.flatnonzero(self.rows["pose"] == pose)
            _, which, count = np.unique(self.side[rows], axis=0, return_inverse=True,
                                            return_counts=True)
            out.append(rows[which.ravel() == np.argmax(count)])
        return out

    # ---- uncertainty, one coordinate of position, mm

    def repeatability(self) -> tuple[float, int]:
        """Return the pooled scatter of rows of one pose and direction, and its degrees."""
        key = np.column_stack([self.rows["pose"], self.side])
        square, degrees = 0.0, 0
        for one in np.unique(key, axis=0):
            mine = self.errors[(key == one).all(axis=1), :2]
            square += float(((mine - mine.mean(axis=0)) ** 2).sum())
            degrees += 2 * (len(mine) - 1)
        return float(np.sqrt(square / degrees)), degrees

    def _registered(self) -> Any:
        """Return derivatives of what is shown by where the instrument stands (N 3, 5), white."""
        steps = [1e-4, 1e-4, 1e-5, 1e-4, 1e-4]
        return np.stack([((self.shown(self.pose, self.stand + d) - self.shown(
            self.pose, self.stand - d)) / (2.0 * h) / self.sigma).ravel()
            for h, d in zip(steps, np.diag(steps), strict=True)], axis=1)

    def registration(self) -> float:
        """Return the spread of a position coordinate by frame and target."""
        r = self._registered()
        spread = np.einsum("ic,cd,id->i", r, np.linalg.inv(r.T @ r), r).reshape(-1, 3)
        return float(np.sqrt((spread * self.sigma**2)[:, :2].mean()))

    def model(self) -> float:
        """Return the spread by the parameters, less what the registration takes over."""
        entry = self.record["covariance"]
        own = [i for i, n in enumerate(entry["names"]) if n in self.g]
        covariance = np.array(entry["matrix"], dtype=float)[np.ix_(own, own)]
        moves = []
        for name in (entry["names"][i] for i in own):
            ends = [self.shown(self.reached(self.g | {name: self.g[name] + h}), self.stand)
                    for h in (1e-3, -1e-3)]
            moves.append(((ends[0] - ends[1]) / 2e-3 / self.sigma).ravel())
        white, r = np.stack(moves, axis=1), self._registered()
        left = white - r @ np.linalg.lstsq(r, white, rcond=None)[0]
        spread = np.einsum("ic,cd,id->i", left, covariance, left).reshape(-1, 3)
        return float(np.sqrt((spread * self.sigma**2)[:, :2].mean()))
