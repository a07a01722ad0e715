"""The page of a kit: what its built-in test finds on this actuator, and what was assumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ema_prognostics.cascade.classes import FAULTS
from ema_prognostics.words import NAMES, feature_words, size
from ema_record.actuator import BACK_EMFS, DRIVES

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Kit report</title><style>
body{font:15px/1.45 system-ui,sans-serif;color:#1a1a1a;max-width:52rem;margin:1.5rem auto;
padding:0 1rem}h1{font-size:1.5rem;margin:0 0 .2rem}h2{font-size:1.1rem;margin:1.3rem 0 .3rem}
table{border-collapse:collapse;width:100%;font-size:.92rem}.wide{overflow-x:auto}
td,th{text-align:left;padding:.25rem .6rem .25rem 0;border-bottom:1px solid #d5d5d5;
vertical-align:top}th{font-weight:600}p{margin:.3rem 0}.note{color:#555;font-size:.9rem}
@media print{body{font-size:10pt;margin:0}h2{break-after:avoid}tr{break-inside:avoid}}
</style></head><body>
<h1>What this built-in test finds</h1>
<p>{{ type }}. Test <b>{{ v.profile }}</b>; made from {{ v.records|length }} records of
{{ v.units|length }} healthy units, and trained on {{ v.settings.units + v.settings.healthy }}
simulated ones{{ " (small training: --quick)" if v.quick }}. ema_phm {{ v.software_version }}.</p>
{% for view, title in views %}{% set f = held[view] %}
<h2>{{ title }}</h2>
<p>Healthy tests called a fault: {{ percent(f["false alarms"]) }}; called unknown:
{{ percent(f["healthy called unknown"]) }}.</p>
<div class="wide"><table><tr><th>Fault</th><th>found in nine of ten (95 % sure)</th>
<th>best linear detector</th><th>right fault named</th><th>truth in the interval</th></tr>
{% for name in faults %}{% set one = f[name] %}
<tr><td>{{ names[name] }}</td>
<td>{{ size(name, one["a90"]) }} ({{ size(name, one["a90/95"]) }})</td>
<td>{{ size(name, v.bound[view].get(name)) }}</td>
<td>{{ percent(one["right class of detected"]) }}</td>
<td>{{ percent(one["interval coverage"]) }}</td></tr>{% endfor %}</table></div>{% endfor %}
<p class="note">On other simulated units of the type, with the spread below; 95 % bounds in
brackets. A bound: the likelihood ratio test on the same features, if they were Gaussian and linear
in the fault, at {{ alarms }} % false alarms; a network may do better where they are not.</p>
<h2>The acceptance records</h2>
<p>Each judged by a kit whose discrepancy is that of the other units: healthy
{{ v.records|selectattr("left_out", "equalto", "healthy")|list|length }} of
{{ v.records|length }}{% if v.guard_widened > 1 %}; the guard's limits were widened by
{{ "%.2f"|format(v.guard_widened) }} so that they hold them all{% endif %}.</p>
<h2>What the records changed in the description</h2>
<div class="wide"><table><tr><th>Parameter</th><th>is now</th></tr>
{% for name, value in v.parameters.items() %}<tr><td>{{ name }}</td>
<td>{{ change(name, value) }}</td></tr>{% endfor %}</table></div>
<h2>What the model still leaves unexplained</h2>
<p>{% for one in v.largest_after[:5] %}{{ words(one.feature) }}:
{{ "%+.1f"|format(one.deviations) }} healthy deviations{{ "; " if not loop.last }}{% endfor %}.
This discrepancy is subtracted, and its uncertainty is part of the training.</p>
<h2>What was assumed</h2>
<p>Units and tests differ as <code>tolerances</code> and <code>conditions</code> of
<code>actuator.yaml</code> say; faults are those of the simulator: shorted turns, eccentricity, dry
friction and lost motion. What else may befall an actuator is answered "unknown" where it moves the
features beyond the fleet.</p>
</body></html>
"""


def write_report(validation: dict[str, Any], path: Path) -> None:
    """Write the page of what `validation.json` holds."""
    from jinja2 import Environment

    actuator = validation["actuator"]
    motor = actuator["motor"]
    held = validation["held_out"][validation["profile"]]
    kind = (f"{DRIVES[actuator['drive']['kind']].upper()} drive, "
            f"{BACK_EMFS[motor['back_emf']]} back-EMF, {motor['pole_pairs']} pole pairs, "
            f"{2 * actuator['inverter']['bus_voltage']:g} V bus, "
            f"gear {actuator['gear']['ratio']:g}, "
            f"{actuator['acquisition']['rate']:g} samples a second")
    page = Environment(autoescape=True).from_string(PAGE)
    path.write_text(page.render(
        v=validation, held=held, type=kind, faults=FAULTS, names=NAMES, percent=percent,
        size=size, words=feature_words, change=_change, alarms=1,
        views=(("fleet", "Without a baseline"), ("baseline", "With the unit's own baseline")),
    ), encoding="utf-8")


def percent(found: dict[str, Any]) -> str:
    """Return a rate with its bounds in words."""
    if not found["total"]:
        return "none"
    return (f"{100.0 * found['count'] / found['total']:.1f} % of {found['total']} "
            f"({100 * found['lower']:.1f} to {100 * found['upper']:.1f})")


def _change(name: str, value: float) -> str:
    if name.endswith("latency"):
        return f"{value:.2f} control periods"
    return f"{100 * (value - 1.0):+.1f} %"
