"""`ema info`: what is in a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ema_cli.console import given_bags, print_json, say, speech, stdout
from ema_cli.lines import TextLine, print_lines
from ema_cli.options import Bags, ObjectABag
from ema_cli.views.verdict import short


def info(bags: Bags, as_json: ObjectABag = False) -> int:
    """Say what is in a bag: unit, test, time, channels, conditions, files.

    Example: `ema info bags/sim_0001_extended`
    """
    for place, bag in enumerate(given_bags(bags)):
        found = facts_of(bag)
        if as_json:
            print_json(found)
            continue
        if place and not speech().quiet:
            say("")
        print_lines([TextLine(None, str(bag), "bold"),
                     *(TextLine(name, _text(value)) for name, value in found.items()
                       if name != "bag" and value not in (None, "", []))], stdout())
    return 0


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return short(value) if isinstance(value, float) else str(value)


def facts_of(bag: Path) -> dict[str, Any]:
    """Return what a bag holds, in plain types; RecordError where it cannot be read."""
    from ema_prognostics.verdict.examination import heading_of
    from ema_record.bag.content_hash import bag_files
    from ema_record.bag.read import read_bag
    from ema_record.channels import ALL, CHANNELS, measured
    from ema_rig.bag import is_rig_bag, read_rig_bag

    files = [f"{path.name} ({path.stat().st_size} bytes)" for path in bag_files(bag)]
    if is_rig_bag(bag):
        rig = read_rig_bag(bag)
        return {"bag": str(bag), "rig": rig.axis.name, "samples": len(rig.samples),
                "channels": [c.label for c in rig.channels], "files": files}
    record = read_bag(bag)
    heading, provenance = heading_of(record, (), ""), record.provenance
    bus, winding = measured(record.dc_bus[:, :2]), measured(record.winding_temperature)
    return {
        "bag": str(bag), "serial number": heading["serial_number"], "start": heading["start_time"],
        "test": record.profile.name, "status": provenance.status,
        "duration": f"{record.duration:.3f} s", "samples": len(record),
        "rate": f"{record.rate:.6g} samples a second",
        "channels": [CHANNELS[c].label for c in record.columns],
        "not recorded": [CHANNELS[c].name for c in ALL if c not in record.columns],
        "winding": f"{winding[:, 1].mean():.1f} °C" if len(winding) else "",
        "bus": f"{bus[:, 1].min():.1f} to {bus[:, 1].max():.1f} V" if len(bus) else "",
        "software": provenance.software_version, "actuator": provenance.actuator,
        "files": files,
    }
