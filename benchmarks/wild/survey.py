"""Ask the command under study about many cases and set its answers beside the truth.

    python -m benchmarks.wild.survey --out DIR --command ppmcal --groups event memory --eta 2

One line per case in DIR/survey.csv. The command is only run, never imported.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from pathlib import Path

from .cases import CASES
from .catalogue import write
from .machines import MACHINES

FIELDS = (
    "case machine seed eta group truth on rows verdict said said_on said_rows also judged "
    "mend_right exit seconds text"
).split()


def ask(command: str, folder: Path, limit: float = 300.0) -> tuple[dict, int, str, float]:
    """Answer (diagnosis.json, or the printed object), exit code, message, seconds."""
    out, start = folder / "diagnosis", time.monotonic()
    line = [command, "diagnose", str(folder / "mechanism.yaml"), str(folder / "data.csv")]
    try:
        done = subprocess.run(
            [*line, "--out", str(out), "--force", "--quiet", "--json"],
            capture_output=True, text=True, timeout=limit, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {}, -1, "no answer in time", limit
    file = out / "diagnosis.json"
    try:
        answer = json.loads(file.read_text() if file.exists() else done.stdout or "{}")
    except json.JSONDecodeError:
        answer = {}
    message = " ".join(done.stderr.split())[:300]
    return answer, done.returncode, message, time.monotonic() - start


def named(answer: dict) -> tuple[list[str], list[str]]:
    """Kinds that stand as the answer, and the kinds left possible beside them."""
    found = answer.get("misreadings") or []
    if answer.get("verdict") == "misread" or (found and not answer.get("effects")):
        return [m["kind"] for m in found[:1]], [m["kind"] for m in found[1:]]
    effects = answer.get("effects", [])
    return [e["kind"] for e in effects], [k for e in effects for k in e.get("alternatives", [])]


def judged(truth: dict, answer: dict, code: int, text: str) -> str:
    """right | in-set | more | part | wrong | silent | refused | unnamed | alarm | failed."""
    if not answer:
        return "refused" if code in (2, 3) and "This is a fault of" not in text else "failed"
    said, also = named(answer)
    true = [k for k in truth["kinds"] if k not in ("gross", "reordered", "learned")]
    right = set(true) | set(truth["accept"]) | {"learned"}
    if not true:
        unknown = "learned" in truth["kinds"]
        if not said:
            return "unnamed" if answer.get("verdict") in ("unnamed", "partial") else (
                "silent" if unknown else "right")  # fmt: skip
        return "right" if set(said) <= right and unknown else ("wrong" if unknown else "alarm")
    if not said:
        return "unnamed" if answer.get("verdict") in ("unnamed", "partial", "misread") else "silent"
    if len(true) == 1 and set(said) & set(truth["accept"]) and set(said) <= right:
        return "right"
    if set(said) - right - set(also):
        return "more" if set(true) <= set(said) else (
            "in-set" if set(true) <= set(said) | set(also) else "wrong")  # fmt: skip
    return "right" if set(true) <= set(said) else (
        "in-set" if set(true) <= set(said) | set(also) else "part")  # fmt: skip


def mended(truth: dict, answer: dict) -> str:
    """Whether the first reading proposed is the true mend."""
    if not truth["mistakes"]:
        return ""
    readings = [m.get("read") for m in answer.get("misreadings") or []]
    if truth["mend"] is None:
        return "none-there"
    return (
        "yes" if truth["mend"] in readings[:1] else ("later" if truth["mend"] in readings else "no")
    )


def onsets(answer: dict) -> list:
    """Rows of events in an answer."""
    return [e["row"]["value"] for e in answer.get("effects", []) if e.get("row")]


def one(command: str, case: str, machine: str, seed: int, eta: float, rows: int, out: Path) -> dict:
    """Write a case, ask, and judge."""
    folder = out / f"{case}-{machine}-{seed}"
    truth = write(case, machine, rows, seed, folder, eta)
    answer, code, text, seconds = ask(command, folder)
    said, also = named(answer)
    findings = [m.get("text", "") for m in (answer.get("misreadings") or [])[:1]]
    values = [
        case, machine, seed, eta, truth["group"], " ".join(truth["kinds"]),
        ";".join(" ".join(e["on"]) for e in truth["effects"]),
        " ".join(str(e["row"]) for e in truth["effects"] if "row" in e),
        answer.get("verdict", ""), " ".join(said),
        ";".join(" ".join(e.get("on") or []) for e in answer.get("effects", [])),
        " ".join(map(str, onsets(answer))), " ".join(also), judged(truth, answer, code, text),
        mended(truth, answer), code, round(seconds, 1), (text or " ".join(findings))[:300],
    ]  # fmt: skip
    return dict(zip(FIELDS, values, strict=True))


def main(argv=None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="survey", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--command", default="ppmcal")
    parser.add_argument("--groups", nargs="*", default=[])
    parser.add_argument("--cases", nargs="*", default=[])
    parser.add_argument("--machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--every", action="store_true", help="all machines, not one per case")
    parser.add_argument("--eta", type=float, default=2.0)
    parser.add_argument("--rows", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    chosen = [n for n, c in CASES.items() if n in args.cases or c.group in args.groups]
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "survey.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, FIELDS)
        table.writeheader()
        for i, name in enumerate(chosen):
            able = [m for m in args.machines if m in CASES[name].machines]
            for machine in able if args.every or not able else [able[i % len(able)]]:
                row = one(args.command, name, machine, args.seed, args.eta, args.rows, args.out)
                table.writerow(row)
                file.flush()
                keys = ("case", "machine", "truth", "verdict", "said", "judged")
                sys.stderr.write(" | ".join(str(row[k]) for k in keys) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
