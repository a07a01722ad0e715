"""Identification of the public rigs: what is found, and the residual before and after.

``python -m benchmarks.rigs`` reads ``../shared/data`` beside the checkout, about two minutes.
``--emps`` runs EMPS free on its official split, ``--synthetic N`` judges N records with a known
answer; ``--work FILE`` keeps what of these is done, and goes on from there. ``--peers`` runs
sparse regression on the same records, and `mujoco.sysid` on EMPS.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from benchmarks.rigs.emps import both_ways
from benchmarks.rigs.panel import panel
from benchmarks.rigs.peers import on_the_panel, sysid_on_emps
from ema_identification.result import Identification
from ema_identification.rig.workflow import identify_rig
from ema_rig.import_file import import_file
from ema_rig.map import load_map
from ema_rig.record import RigRecord

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data"


def load(map_name: str, file: str) -> RigRecord:
    """Return a record of a public data set, which lies beside the checkout."""
    path = DATA / file
    if not path.is_file():
        raise SystemExit(f"skipped: {path} is absent, the public data lie beside the checkout")
    record = import_file(path, load_map(HERE / map_name))
    assert isinstance(record, RigRecord)
    return record


def show(title: str, found: Identification, seconds: float) -> None:
    """Print one identification."""
    print(f"\n{title}: {found.verdict} ({seconds:.0f} s)")
    print(f"  gap {found.gap_before:.4g} -> {found.gap_after:.4g}, freest smooth model "
          f"{found.noise_floor:.4g}: {found.gap_unit}")
    for finding in found.findings:
        names = " = ".join((finding.effect, *finding.equivalent))
        values = ", ".join(
            f"{p.name.split('.')[1]} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}"
            for p in finding.parameters)
        print(f"  {names}: {values}; p {finding.p_value:.3g}, gap {finding.gap_after:.4g}")
    if found.unknown is not None:
        print(f"  unknown: {found.unknown.text}")
    rows = next(step for step in found.steps if step.name == "show").rows
    print("  in sample: " + "; ".join(f"{name} {share}" for name, _, share in rows[1:]))


def public() -> None:
    """Print the table of both public data sets."""
    record = load("emps.yaml", "emps/DATA_EMPS.mat")
    pulses = load("emps.yaml", "emps/DATA_EMPS_PULSES.mat")
    motor = load("laas.yaml", "laas_anticogging/acc_current.txt.gz")
    for title, measured, model, held in (
        ("emps, blocks held out", record, None, ()),
        ("emps, gap on the pulses record", record, None, (pulses,)),
        ("emps, filter of its SOURCE.txt, starting with the offset too", record,
         HERE / "emps_source.yaml", ()),
        ("laas", motor, None, ()),
        ("laas at 100 Hz", motor, HERE / "laas_100hz.yaml", ()),
    ):
        start = time.monotonic()
        found = identify_rig([measured], model, validate=held)
        show(title, found, time.monotonic() - start)
        if model is None and not held:
            again(title, measured, found)


def again(title: str, measured: RigRecord, found: Identification) -> None:
    """Identify with the updated model: what is still missing."""
    with tempfile.TemporaryDirectory() as folder:
        updated = Path(folder) / "model.yaml"
        updated.write_text(found.model_text)
        start = time.monotonic()
        second = identify_rig([measured], updated)
        show(f"{title}, with the updated model", second, time.monotonic() - start)
        for reason in second.reasons:
            print(f"  {reason}")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--emps", action="store_true")
    parser.add_argument("--synthetic", type=int, metavar="N")
    parser.add_argument("--work", type=Path, metavar="FILE", help="of --synthetic, JSON lines")
    parser.add_argument("--seed", type=int, default=0, help="of --synthetic: other rigs")
    parser.add_argument("--peers", action="store_true", help="with --synthetic, --work, or EMPS")
    arguments = parser.parse_args()
    if arguments.peers:
        if arguments.synthetic:
            on_the_panel(arguments.synthetic, arguments.seed, arguments.work)
        sysid_on_emps(load("emps.yaml", "emps/DATA_EMPS.mat"),
                      load("emps.yaml", "emps/DATA_EMPS_PULSES.mat"))
    elif arguments.emps:
        both_ways(load("emps.yaml", "emps/DATA_EMPS.mat"),
                  load("emps.yaml", "emps/DATA_EMPS_PULSES.mat"))
    elif arguments.synthetic is None:
        public()
    else:
        panel(arguments.synthetic, seed=arguments.seed, work=arguments.work)


if __name__ == "__main__":
    main()
