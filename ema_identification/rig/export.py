"""The identified axis in the formats of simulators: MJCF, URDF, and a Python module.

What a format has no place for is named, with its value, in the file and to the caller.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from ema_identification.rig.fit.model import ModelAxis, load_rig_model
from ema_record.errors import UsageError, unknown_name
from ema_rig.record import LOAD_QUANTITY

JOINT_LAWS = ("inertia", "viscous_friction", "coulomb_friction", "spring", "offset")
"""Laws that a joint of MJCF, with its actuator, holds as they are."""
URDF_LAWS = ("inertia", "viscous_friction", "coulomb_friction")
LAW_TEXTS = {
    "coulomb_friction": "{level} * sign",
    "stribeck_friction": "{increase} * sign * math.exp(-((v / {speed}) ** 2))",
    "quadratic_drag": "{value} * v * abs(v)",
    "sublinear_viscous_friction": "{value} * sign * math.sqrt(abs(v))",
    "position_dependent_friction": "{slope} * (x - {middle}) * sign",
    "viscous_friction": "{value} * v",
    "asymmetric_friction": "{viscous_difference} * abs(v)",
    "offset": "{value}",
    "spring": "{stiffness} * (x - {rest})",
    "hardening_spring": "{cubic} * (x - {rest}) ** 3",
    "end_stops": "{stiffness} * (x - {middle} - min(max(x - {middle}, -{half_clearance}), "
                 "{half_clearance}))",
    "gravity": "{amplitude} * math.cos(x - {phase})",
    "cogging_torque": "{amplitude} * math.cos({wave} * x - {phase})",
}
"""Laws of the Python module, by the symbols of its functions."""
_DRY = frozenset({"coulomb_friction", "stribeck_friction", "sublinear_viscous_friction",
                  "position_dependent_friction"})
_PYTHON = '''"""{name}: an identified {motion} axis, its input a {quantity}; SI units.

Not in here: {missing}.
"""

import math

INERTIA = {inertia}
TRAVEL = {travel}


def friction(x, v, sign):
    """Return the dry friction that acts against the direction `sign` at position x, speed v."""
    return {friction}


def load(x, v):
    """Return all else that depends on position and speed, in the unit of the input."""
    return {load}


def needed_input(x, v, a):
    """Return the input that this motion needs."""
    sign = float(v > 0.0) - float(v < 0.0)
    return INERTIA * a + load(x, v) + friction(x, v, sign)


def step(x, v, u, dt):
    """Return position and speed after `dt` (s) of the input u; at rest dry friction holds."""
    free = v + dt * (u - load(x, v)) / INERTIA
    sign = float(free > 0.0) - float(free < 0.0)
    held = dt * max(friction(x, v, sign) * sign, 0.0) / INERTIA
    new = free - sign * min(held, abs(free))
    return x + 0.5 * dt * (v + new), new
'''


class Exported(NamedTuple):
    """A text, and what it does not hold."""

    text: str
    left_out: tuple[str, ...]


def export_model(
    path: str | Path, file_format: str, *, gain: float | None = None, body_inertia: float = 0.0
) -> Exported:
    """Return the model in a file in the format of another tool.

    Parameters
    ----------
    path : ``model.yaml`` that an identification wrote.
    file_format : ``mjcf``, ``urdf`` or ``python``.
    gain : force or torque at the axis of one unit of the input (N/A, N m/A, N m/V); needed in MJCF
        and URDF where the input is neither.
    body_inertia : what the bodies of the simulator already have about the axis (kg m² or kg): the
        armature is the rest.

    Raises
    ------
    UsageError
        No such format; the model lacks its axis, its inertia or a number of a law; the gain is
        missing or not positive; the bodies have more inertia than was found.
    """
    writer = _WRITERS.get(file_format)
    if writer is None:
        raise unknown_name("format of a model", file_format, _WRITERS,
                           f"the formats are {', '.join(_WRITERS)}")
    model = load_rig_model(path)
    axis = model.axis
    if axis is None:
        raise UsageError(f"{path}: the model does not say its axis: export the model.yaml that "
                         "'ema identify' wrote")
    terms = [(term.effect, {**term.parameters, **{k: v[0] for k, v in term.estimate.items()}})
             for term in model.terms]
    for name, values in terms:
        for symbol in re.findall(r"{(\w+)}", LAW_TEXTS.get(name, "")):
            if symbol not in {*values, "wave"}:
                raise UsageError(f"{path}: {name} has no {symbol}: identify a record with this "
                                 "model and export what is written, or leave the effect out")
    inertia = sum(values.get("value", 0.0) for name, values in terms if name == "inertia")
    if not inertia > 0.0:
        raise UsageError(f"{path}: inertia {inertia:g}, expected more than 0: identify a record "
                         "that shows it ('ema identify RECORD --check')")
    if file_format == "python":
        return writer(model.rig, axis, terms, 1.0, 0.0)
    load = LOAD_QUANTITY[axis.motion]
    if axis.input != load and gain is None:
        unit = {"force": "N", "torque": "N m"}[load]
        raise UsageError(f"{path}: the input is a {axis.input}, {file_format} needs a {load}: "
                         f"give --gain, the {load} at the axis of one unit of it ({unit})")
    if gain is not None and not (math.isfinite(gain) and gain > 0.0):
        raise UsageError(f"--gain {gain:g}: expected more than 0")
    if not 0.0 <= body_inertia < (gain or 1.0) * inertia:
        raise UsageError(f"--body-inertia {body_inertia:g}: expected 0 to less than the whole, "
                         f"{(gain or 1.0) * inertia:.6g}")
    return writer(model.rig, axis, terms, gain or 1.0, body_inertia)


Terms = Sequence[tuple[str, Mapping[str, float]]]


def _value(terms: Terms, name: str, parameter: str) -> float:
    return sum(values.get(parameter, 0.0) for effect, values in terms if effect == name)


def _left_out(terms: Terms, held: Sequence[str]) -> tuple[str, ...]:
    """Return the terms that a format has no place for, with their values."""
    return tuple(
        f"{name} ({', '.join(f'{k} {v:.4g}' for k, v in values.items())})"
        for name, values in terms if name not in held and any(values.values()))


def _number(value: float) -> str:
    return f"{value:.8g}"


def _comment(terms: Terms, held: Sequence[str], more: str) -> str:
    missing = "; ".join(_left_out(terms, held)) or "nothing"
    return f" From an identification. Not in here: {missing}. {more} ".replace("--", "- -")


def _mjcf(name: str, axis: ModelAxis, terms: Terms, gain: float, body: float) -> Exported:
    """Return a model of one joint; its actuator takes the input in the unit of the records."""
    root = ET.Element("mujoco", model=name)
    root.append(ET.Comment(_comment(
        terms, JOINT_LAWS, "The armature is the whole inertia less that of the bodies; the range "
        "is how far the axis moved in the records.")))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", timestep="0.0005", gravity="0 0 0", integrator="implicitfast")
    link = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=f"{name}_body")
    own = _number(max(body, 1e-9))
    ET.SubElement(link, "inertial", pos="0 0 0", mass=own if axis.motion == "linear" else "1e-6",
                  diaginertia=" ".join([own if axis.motion == "rotary" else "1e-9"] * 3))
    joint = {
        "name": name, "type": "hinge" if axis.motion == "rotary" else "slide", "axis": "0 0 1",
        "armature": _number(gain * _value(terms, "inertia", "value") - body),
        "damping": _number(gain * _value(terms, "viscous_friction", "value")),
        "frictionloss": _number(gain * _value(terms, "coulomb_friction", "level")),
        "range": " ".join(_number(x) for x in axis.travel)}
    if _value(terms, "spring", "stiffness"):
        joint |= {"stiffness": _number(gain * _value(terms, "spring", "stiffness")),
                  "springref": _number(_value(terms, "spring", "rest"))}
    ET.SubElement(link, "joint", joint)
    bias = _number(-gain * _value(terms, "offset", "value") or 0.0)
    ET.SubElement(ET.SubElement(root, "actuator"), "general", {
        "name": f"{name}_input", "joint": name, "gaintype": "fixed", "gainprm": _number(gain),
        "biastype": "affine", "biasprm": f"{bias} 0 0"})
    return _xml(root, _left_out(terms, JOINT_LAWS))


def _urdf(name: str, axis: ModelAxis, terms: Terms, gain: float, _body: float) -> Exported:
    """Return a robot of one joint; URDF has a place for damping and friction alone."""
    root = ET.Element("robot", name=name)
    root.append(ET.Comment(_comment(
        terms, URDF_LAWS, "The limits are what the records reached.")))
    ET.SubElement(root, "link", name="base")
    inertial = ET.SubElement(ET.SubElement(root, "link", name="moved"), "inertial")
    whole = _number(gain * _value(terms, "inertia", "value"))
    linear = axis.motion == "linear"
    ET.SubElement(inertial, "mass", value=whole if linear else "1e-6")
    about = "1e-9" if linear else whole
    ET.SubElement(inertial, "inertia", ixx=about, ixy="0", ixz="0", iyy=about, iyz="0", izz=about)
    joint = ET.SubElement(root, "joint", name=name, type="prismatic" if linear else "revolute")
    ET.SubElement(joint, "parent", link="base")
    ET.SubElement(joint, "child", link="moved")
    ET.SubElement(joint, "axis", xyz="0 0 1")
    low, high = axis.travel
    ET.SubElement(joint, "limit", lower=_number(low), upper=_number(high),
                  velocity=_number(axis.largest_speed), effort=_number(gain * axis.largest_input))
    ET.SubElement(joint, "dynamics",
                  damping=_number(gain * _value(terms, "viscous_friction", "value")),
                  friction=_number(gain * _value(terms, "coulomb_friction", "level")))
    return _xml(root, _left_out(terms, URDF_LAWS))


def _xml(root: ET.Element, left_out: tuple[str, ...]) -> Exported:
    ET.indent(root)
    return Exported(ET.tostring(root, encoding="unicode") + "\n", left_out)


def _python(name: str, axis: ModelAxis, terms: Terms, _gain: float, _body: float) -> Exported:
    """Return a module that needs nothing but Python."""
    sums: dict[bool, list[str]] = {True: [], False: []}
    for law, values in terms:
        if law not in LAW_TEXTS:
            continue
        order = values.get("order", 0.0) * (1.0 if axis.motion == "rotary" else 2.0 * math.pi)
        given = {k: f"({v!r})" for k, v in {**values, "wave": order}.items()}
        sums[law in _DRY].append(LAW_TEXTS[law].format(**given))
    left_out = _left_out(terms, ("inertia", *LAW_TEXTS))
    text = _PYTHON.format(
        name=name, motion=axis.motion, quantity=axis.input, travel=repr(tuple(axis.travel)),
        missing="; ".join(left_out) or "nothing", inertia=repr(_value(terms, "inertia", "value")),
        friction=_sum(sums[True]), load=_sum(sums[False]))
    return Exported(text, left_out)


def _sum(parts: list[str]) -> str:
    if len(parts) < 2:
        return parts[0] if parts else "0.0"
    return "(\n        " + "\n        + ".join(parts) + "\n    )"


_WRITERS: dict[str, Callable[[str, ModelAxis, Terms, float, float], Exported]] = {
    "mjcf": _mjcf, "urdf": _urdf, "python": _python}
MODEL_FORMATS = {"mjcf": ".xml", "urdf": ".urdf", "python": ".py"}
"""Formats of `export_model`, with the suffix of their files."""
