"""The page of a kit: what its built-in test finds on this actuator, and what was assumed."""

from __future__ import annotations

from typing import Any

from ema_prognostics.cascade.classes import FAULTS
from ema_prognostics.commission.bound import FALSE_ALARMS
from ema_prognostics.commission.discrepancy import NOT_SHIFTED
from ema_prognostics.commission.quality import MOST_FALSE_ALARMS, MOST_UNKNOWN
from ema_prognostics.words import ENGLISH, feature_words, name_of, scaled
from ema_record.actuator import BACK_EMFS, DRIVES, RELAY

VIEWS = (("fleet", "Without a baseline"), ("baseline", "With own baseline"))
CHANNELS = {
    "phase_current_c": "third current", "reference_currents": "reference currents",
    "rotor_angle": "rotor angle", "surface_position": "surface position",
}
"""That a recorder may lack, as `acquisition` of the description names them."""
NOTICED = 0.02
"""Least relative change of a parameter that is listed."""
UNEXPLAINED = 4
"""Features that are listed of what the model leaves."""
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>What this built-in test finds</title><style>
body{font:14.5px/1.45 system-ui,sans-serif;color:#1a1a1a;max-width:56rem;margin:1.2rem auto;
padding:0 1rem}h1{font-size:1.5rem;margin:0 0 .3rem}h2{font-size:1.05rem;margin:1.1rem 0 .3rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
.wide{overflow-x:auto}td,th{text-align:right;padding:.22rem 0 .22rem .7rem;
border-bottom:1px solid #d5d5d5}td{white-space:nowrap}.name,td:first-child{text-align:left;
padding-left:0;white-space:normal}th{font-weight:600;vertical-align:bottom}
th[colspan]{text-align:center}td:has(+.line),th:has(+.line){padding-right:.7rem}
.line{border-left:1px solid #d5d5d5}p{margin:.3rem 0}.note{color:#555;font-size:.9rem}
.small{font-size:.86rem;color:#555}ul{margin:.2rem 0;padding:0;list-style:none;
columns:3 15rem;column-gap:1.6rem}li{display:flex;justify-content:space-between;
gap:.6rem;break-inside:avoid;border-bottom:1px solid #e6e6e6}li span+span{white-space:nowrap}
@media print{@page{size:A4;margin:12mm}body{font-size:8.2pt;line-height:1.25;margin:0;padding:0;
max-width:none}h1{font-size:14pt}
h2{font-size:10pt;margin:.5rem 0 .1rem;break-after:avoid}ul{columns:3}td,th{padding-top:.1rem;
padding-bottom:.1rem}.wide{overflow:visible}tr,li{break-inside:avoid}}
</style></head><body>
<h1>What this built-in test finds</h1>
<p>{{ type }}. Test <b>{{ v.profile }}</b>. Made from {{ v.records|length }} records of
{{ v.units|length }} healthy units and trained on {{ trained }}
simulated ones{{ " (small training, --quick: rates are poorer than they need be)" if v.quick }};
{% if v.stricter %}The first thresholds gave more false alarms than a kit may have: they were
raised with all healthy tests so far, and judged on others. {% endif %}
ema_phm {{ v.software_version }}. All rates below are of {{ judged }} other simulated tests of the
type, with what was assumed below; 95 % bounds in brackets.</p>
<h2>Healthy actuators</h2>
<div class="wide"><table><tr><th class="name"></th>
{% for _, title in views %}<th>{{ title }}</th>{% endfor %}
<th>a kit may have</th></tr>
<tr><td>healthy called a fault</td>{% for view, _ in views %}
<td>{{ percent(held[view]["false alarms"]) }}</td>{% endfor %}<td>{{ most_alarms }} %</td></tr>
<tr><td>healthy called unknown</td>{% for view, _ in views %}
<td>{{ percent(held[view]["healthy called unknown"]) }}</td>{% endfor %}<td></td></tr>
<tr><td>acceptance records called unknown</td>
<td>{{ unknown }} of {{ v.records|length }}</td><td></td><td>{{ most_unknown }} %</td></tr>
{% if held.fleet["strangers told"] %}<tr><td>what is no fault of these, of any size
(weak magnets, one resistance, ...) called unknown</td>{% for view, _ in views %}
<td>{{ percent(held[view]["strangers told"], 0) }}</td>{% endfor %}<td></td></tr>{% endif %}
</table></div>
<p class="note">Each acceptance record was judged by a kit whose discrepancy is that of the other
units{% if v.guard_widened > 1 or v.strangers_widened > 1 %}; the limits of the guard were then
widened {{ "%.2f"|format(v.guard_widened) }} times, those of what is no fault of a class
{{ "%.2f"|format(v.strangers_widened) }} times, so that 97 % of new records pass{% endif %}.</p>
<h2>The smallest fault that is found in nine of ten tests</h2>
<div class="wide"><table><tr><th rowspan="2" class="name">Fault</th>{% for _, title in views %}
<th colspan="3" class="line">{{ title }}</th>{% endfor %}</tr>
<tr>{% for view in views %}<th class="line">found</th><th>95 % sure</th><th>linear bound</th>
{% endfor %}</tr>
{% for name in faults %}<tr><td>{{ names[name] }}, {{ unit(name) }}</td>
{% for view, _ in views %}<td class="line"><b>{{ size(name, held[view][name]["a90"]) }}</b></td>
<td>{{ size(name, held[view][name]["a90/95"]) }}</td>
<td>{{ size(name, v.bound[view].get(name)) }}</td>{% endfor %}</tr>{% endfor %}</table></div>
<p class="note">The bound is what the likelihood ratio test finds with the same features at
{{ alarms }} % false alarms, if these were Gaussian and linear in the fault; where they are not, a
network may do better. A dash: more than the largest that was tried, or not to be told.</p>
<h2>What is said of a fault that is found</h2>
<div class="wide"><table><tr><th rowspan="2" class="name">Fault</th>{% for _, title in views %}
<th colspan="2" class="line">{{ title }}</th>{% endfor %}</tr>
<tr>{% for view in views %}<th class="line">right fault named</th><th>size within its interval</th>
{% endfor %}</tr>
{% for name in faults %}<tr><td>{{ names[name] }}</td>{% for view, _ in views %}
<td class="line">{{ percent(held[view][name]["right class of detected"], 0) }}</td>
<td>{{ percent(held[view][name]["interval coverage"], 0) }}</td>{% endfor %}</tr>
{% if held.fleet[name]["right phase"] %}<tr><td>its phase</td>{% for view, _ in views %}
<td class="line">{{ percent(held[view][name]["right phase"], 0) }}</td><td></td>{% endfor %}</tr>
{% endif %}{% endfor %}
<tr><td>two at once, both named</td>{% for view, _ in views %}
<td class="line">{{ percent(held[view]["pairs both named"], 0) }}</td><td></td>{% endfor %}</tr>
</table></div>
<p class="note">Intervals are meant to hold 90 %. Of all sizes that are found, small ones too.</p>
<h2>What was assumed</h2>
<p>Faults are those of the simulator: shorted turns, eccentricity, dry friction and lost motion.
What else may befall an actuator is answered "unknown" where it moves the features beyond the
fleet, or as what was simulated of it does. {{ channels }}</p>
{% if v.spread %}<p class="small">Units differ by ±: {{ spread(v.spread.tolerances) }}. Tests:
{{ spread(v.spread.conditions) }} (units: <code>actuator.yaml</code>).</p>{% endif %}
<h2>What the records changed in the description</h2>
<ul>{% for name, value in changed %}<li><span>{{ name }}</span><span>{{ value }}</span></li>
{% endfor %}</ul>
<p class="small">{% if same %}By less than {{ noticed }} %: {{ same|join(", ") }}. {% endif %}Still
unexplained, in healthy deviations: {{ left|join("; ") }}. This discrepancy is
subtracted, and its uncertainty is part of the training. The library for ema identify is
{%- if not v.library %} not{% endif %} in the kit
{%- if not v.library %}: it is made at its first use{% endif %}.</p>
</body></html>
"""


def report_page(validation: dict[str, Any]) -> str:
    """Return the page of what `validation.json` holds, as HTML."""
    from jinja2 import Environment

    actuator = validation["actuator"]
    motor, drive = actuator["motor"], DRIVES[actuator["drive"]["kind"]]
    held = validation["held_out"][validation["profile"]]
    kind = (f"{drive.capitalize() if actuator['drive']['kind'] == RELAY else drive.upper()} "
            f"drive, {BACK_EMFS[motor['back_emf']]} back-EMF, {motor['pole_pairs']} pole pairs, "
            f"{2 * actuator['inverter']['bus_voltage']:g} V bus, "
            f"gear {actuator['gear']['ratio']:g}, "
            f"{actuator['acquisition']['rate']:g} samples a second")
    changes = sorted(validation["parameters"].items(), key=lambda item: -_extent(*item))
    settings = validation["settings"]
    page = Environment(autoescape=True).from_string(PAGE)
    return page.render(
        v=validation, held=held, type=kind, faults=FAULTS, percent=percent, size=number,
        names={name: name_of(name, ENGLISH) for name in FAULTS},
        unit=lambda name: scaled(name, None, ENGLISH)[1], left=_left(validation), views=VIEWS,
        trained=sum(settings[k] for k in ("units", "healthy", "strangers")),
        judged=3 * (settings["validation"] + settings["validation_strangers"])
        + settings["validation_healthy"],
        alarms=f"{100 * FALSE_ALARMS:g}", most_alarms=f"{100 * MOST_FALSE_ALARMS:g}",
        most_unknown=f"{100 * MOST_UNKNOWN:g}", noticed=f"{100 * NOTICED:g}", spread=_spread,
        unknown=validation["healthy_left_out_unknown"]["hits"],
        changed=[(n.removeprefix("acquisition."), _change(n, x)) for n, x in changes
                 if _extent(n, x) >= NOTICED],
        same=[n for n, x in changes if _extent(n, x) < NOTICED],
        channels=_channels(actuator["acquisition"]),
    )


def percent(found: dict[str, Any], digits: int = 1) -> str:
    """Return a rate with its bounds in words, and of how many unless short (`digits` 0)."""
    if not found["total"]:
        return "none"
    value, low, high = (f"{100.0 * x:.{digits}f}" for x in (
        found["count"] / found["total"], found["lower"], found["upper"]))
    return f"{value} % ({low}–{high})" + (f" of {found['total']}" if digits else "")


def number(name: str, value: float | None) -> str:
    """Return a severity as a number in the unit that people read, or a dash."""
    return "–" if value is None else f"{scaled(name)[0] * value:.3g}"


def _extent(name: str, value: float) -> float:
    """Return how much a parameter was changed, relative; a latency always counts."""
    return 1.0 if name.endswith("latency") else abs(value - 1.0)


def _change(name: str, value: float) -> str:
    if name.endswith("latency"):
        return f"{value:.2f} periods"
    return f"× {value:.2f}" if value > 2.0 else f"{100 * (value - 1.0):+.1f} %"


def _left(validation: dict[str, Any]) -> list[str]:
    """Return in words what the model leaves unexplained and is subtracted, the largest first."""
    found: dict[str, str] = {}
    for one in validation["largest_after"]:
        if one["feature"].startswith(NOT_SHIFTED):
            continue
        found.setdefault(feature_words(one["feature"], ENGLISH), f"{one['deviations']:+.1f}")
    return [f"{words} {size}" for words, size in found.items()][:UNEXPLAINED]


def _spread(values: dict[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in values.items())


def _channels(acquisition: dict[str, Any]) -> str:
    absent = [text for name, text in CHANNELS.items() if not acquisition[name]]
    if not absent:
        return "The recorder has all channels."
    return (f"Not recorded: {', '.join(absent)}; rebuilt from the other channels, in the training "
            "too, so the figures above hold for that.")
