"""One table: wall time a simulated second, errors, ratio to ours, for every simulator.

Run from the checkout: ``python -m benchmarks.simulators`` (``--no-peers`` without the others'
packages, which are installed into .venv-bench at the first run; ``--quick``).

Three drives, each nearer to what the others can do, all with a sinusoidal back-EMF at 790.6 rad/s:

- actuator: all of ours, with a short of 10 %, so that there is a 2 f_e line;
- relay: the motor alone against a rigid load, our speed control and hysteresis relays;
- carrier: the motor alone, carrier modulation and vector control as motulator has them.

Errors are relative, against the row marked 'reference' of the same drive (each the finest run
of that model). Relays are chaotic: features are means over start angles, and their standard
error in the reference is given; an error below some two of it is none.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.simulators import drive as d
from benchmarks.simulators import own, peers, python_loop
from benchmarks.simulators.stripped import compiled

DIFFERS = {
    "actuator": "gear, shaft, surface, position loop, converters and all 28 effects are in; "
                "20 kHz averaged recording",
    "relay": "rigid load, dry friction as a constant; no shaft, sensors, effects; torque not "
             "limited; the reference is the C loop (-O3 -march=native -ffast-math) at 0.025 µs",
    "carrier": "no relays: 10 kHz carrier updated twice, vector control with its own gains; the "
               "voltage changes only at computed instants, which costs fewer steps than relays",
}


def relay_rows(quick: bool) -> list[dict]:
    """Return the rows of the loops that we wrote: C and plain Python."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            simulate = compiled(Path(folder))
        except (OSError, subprocess.CalledProcessError) as error:
            return [failed("relay", "stripped C loop", f"cannot be compiled: {error}")]
        for step in (1e-6, 2.5e-8):
            rows.append({
                "group": "relay", "name": "stripped C loop", "setting": f"step {step * 1e6:g} µs",
                "reference": step < 1e-7,
                **d.measure(lambda theta, step=step: simulate(theta, step, d.LENGTH)),
            })
    rows.append({
        "group": "relay", "name": "plain Python loop", "setting": "step 1 µs", "reference": False,
        **d.measure(lambda theta: python_loop.simulate(theta, 1e-6, d.LENGTH),
                    angles=d.ANGLES[:1] if quick else d.ANGLES),
    })
    return rows


def peer_rows() -> list[dict]:
    """Return the rows of the peers, or why there are none."""
    try:
        python = peers.install()
    except peers.PeerError as error:
        return [failed(group, name, str(error)) for name, group, _ in peers.PEERS]
    rows = []
    for name, group, script in peers.PEERS:
        label = f"{name} {peers.version(python, name)}"
        try:
            rows += [{**row, "name": label} for row in peers.run(python, script)]
        except peers.PeerError as error:
            rows.append(failed(group, label, str(error)))
    return rows


def failed(group: str, name: str, why: str) -> dict:
    """Return the row of a simulator that does not run here."""
    return {"group": group, "name": name, "setting": "", "reference": False, "why": why}


def print_table(rows: list[dict]) -> None:
    """Print all rows, drive by drive."""
    ours = next(r for r in rows if r["name"] == "our kernel")["cpu"]
    for group, differs in DIFFERS.items():
        members = [r for r in rows if r["group"] == group]
        reference = next((r for r in members if r["reference"]), None)
        names = list(reference["values"]) if reference else []
        print(f"\n{group}: {differs}")
        print(f"  {'simulator':<27}{'setting':<25}{'wall s/s':>10}{'CPU s/s':>10}{'x ours':>9}"
              + "".join(f"{n:>16}" for n in names))
        for row in members:
            start = f"  {row['name']:<27}{row['setting']:<25}"
            if "why" in row:
                print(start + row["why"])
                continue
            print(f"{start}{row['wall']:>10.3g}{row['cpu']:>10.3g}{row['cpu'] / ours:>9.3g}"
                  + "".join(f"{error_of(row, reference, n):>16}" for n in names))
        if reference:
            print(" " * 54 + f"{'standard error of the reference':>29}"
                  + "".join(f"{100 * reference['spread'][n]:>15.2f}%" for n in names))


def error_of(row: dict, reference: dict | None, name: str) -> str:
    """Return a relative error in per cent."""
    if reference is None or row is reference:
        return "reference"
    return f"{100 * (row['values'][name] / reference['values'][name] - 1):+.2f}%"


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    rows = own.rows(options.quick) + relay_rows(options.quick)
    if not options.no_peers:
        rows += peer_rows()
    print_table(rows)
    print(f"\n'x ours': CPU time against the kernel's default in this run. Load of the machine "
          f"{load:.2f} before, {os.getloadavg()[0]:.2f} after, {os.cpu_count()} cores, Python "
          f"{platform.python_version()}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
