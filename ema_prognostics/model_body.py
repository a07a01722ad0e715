"""What stands in a model file: its fields, their bounds, and the way to arrays and back."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ema_prognostics.cascade import CLASSES, Cascade, SeverityNetwork
from ema_prognostics.cascade_features import MECHANICS
from ema_prognostics.guard import LineGuard, MechanicsGuard
from ema_prognostics.line_inputs import (
    ANN_A_NAMES,
    ECCENTRICITY_NAMES,
    GUARD_NAMES,
    SHORT_NAMES,
    LineStatistics,
)
from ema_prognostics.network import Network
from ema_prognostics.paper_cascade import ANN_B_INPUTS, FAULTS, PaperCascade
from ema_prognostics.paper_features import ANN_A_INPUTS
from ema_prognostics.segments import SEGMENTS
from ema_prognostics.torque_lines import HARMONICS, Plant
from ema_record.errors import ModelError

DIGITS = 8
MAX_ROWS, MAX_COLUMNS, MAX_HIDDEN = 5000, 64, 128
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e12)]
Row = Annotated[list[Number], Field(max_length=MAX_COLUMNS * 2)]
Matrix = Annotated[list[Row], Field(max_length=MAX_ROWS)]
Kind = Literal["step", "extended"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class NetworkPart(_Part):
    """One network."""

    input_mean: Row
    input_scale: Row
    hidden_weights: Matrix
    hidden_bias: Row
    output_weights: Matrix
    output_bias: Row
    output_law: Literal["logsig", "linear"]
    output_mean: Row
    output_scale: Row


class StatisticsPart(_Part):
    """Lines of healthy units."""

    baseline_real: Matrix
    baseline_imaginary: Matrix
    weight: Matrix
    deviation: Row


class SeverityPart(_Part):
    """ANN_B of one fault."""

    network: NetworkPart
    at: Row
    half_width: Row


class LineGuardPart(_Part):
    """Training records of one class."""

    points: Matrix
    scale: Row
    limit: Positive


class MechanicsGuardPart(_Part):
    """Mechanical features of sound units."""

    names: Annotated[list[str], Field(max_length=MAX_COLUMNS)]
    trend: Matrix
    inverse_covariance: Matrix
    deviation: Row
    band_limit: Positive
    wear: NetworkPart
    wear_limit: Positive


class CascadePart(_Part):
    """All parts for one kind of test."""

    statistics: StatisticsPart
    ann_a: NetworkPart
    ann_b: dict[Literal["turn_short", "rotor_eccentricity"], SeverityPart]
    line_guards: dict[Literal["healthy", "turn_short", "rotor_eccentricity"], LineGuardPart]
    mechanics_guard: MechanicsGuardPart


class PaperPart(_Part):
    """The paper's networks."""

    ann_a: NetworkPart
    ann_b: dict[Literal["turn_short", "rotor_eccentricity"], NetworkPart]


class Body(_Part):
    """The whole body."""

    cascades: dict[Kind, CascadePart]
    paper: PaperPart | None
    plant: dict[str, Positive]
    training: dict[str, Any]

    @classmethod
    def parse(cls, data: object, where: str) -> Body:
        """Return the body of `data`; ModelError in one line."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(p) for p in first["loc"]) or "body"
            raise ModelError(f"{where}: {place}: {first['msg']}: train again") from None


def plain(value: Any) -> Any:
    """Return dataclasses, tuples and arrays as JSON values, numbers rounded to `DIGITS`."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{DIGITS}g}") + 0.0
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value.item() if isinstance(value, np.generic) else value


def body_of(
    cascades: dict[str, Cascade], paper: PaperCascade | None, plant: Plant,
    training: dict[str, Any],
) -> dict[str, Any]:
    """Return the body as JSON values."""
    parts = {}
    for kind, cascade in cascades.items():
        part = plain(cascade)
        statistics = cascade.statistics
        part["statistics"] = {
            "baseline_real": plain(statistics.baseline.real),
            "baseline_imaginary": plain(statistics.baseline.imag),
            "weight": plain(statistics.weight), "deviation": plain(statistics.deviation),
        }
        parts[kind] = part
    return {
        "cascades": parts, "paper": plain(paper), "plant": plain(plant._asdict()),
        "training": plain(training),
    }


def _array(data: list[Any], shape: tuple[int, ...], where: str) -> np.ndarray:
    """Return a float array of that shape; -1 stands for any length of at least 1."""
    try:
        array = np.array(data, dtype=float)
    except ValueError:
        raise ModelError(f"{where}: rows of different lengths: train again") from None
    fits = array.ndim == len(shape) and all(
        n == want or (want == -1 and n >= 1) for n, want in zip(array.shape, shape)
    )
    if not fits:
        wanted = tuple("any" if n == -1 else n for n in shape)
        raise ModelError(f"{where}: shape {array.shape}, expected {wanted}: train again")
    return array


def network_of(part: NetworkPart, n_inputs: int, n_outputs: int, where: str) -> Network:
    """Return a network of that size; ModelError if a shape differs."""
    d, h, k = n_inputs, len(part.hidden_bias), n_outputs
    if not 1 <= h <= MAX_HIDDEN:
        raise ModelError(f"{where}: {h} hidden neurons, give 1 to {MAX_HIDDEN}: train again")
    shapes = {
        "input_mean": (d,), "input_scale": (d,), "hidden_weights": (d, h), "hidden_bias": (h,),
        "output_weights": (h, k), "output_bias": (k,), "output_mean": (k,), "output_scale": (k,),
    }
    arrays = {
        name: _array(getattr(part, name), shape, f"{where}.{name}")
        for name, shape in shapes.items()
    }
    if (arrays["input_scale"] <= 0.0).any():
        raise ModelError(f"{where}.input_scale: not above 0: train again")
    return Network(**arrays, output_law=part.output_law)


def _need(found: Any, names: tuple[str, ...], where: str) -> None:
    if set(found) != set(names):
        raise ModelError(
            f"{where}: {', '.join(sorted(found)) or 'nothing'}, expected "
            f"{', '.join(sorted(names))}: train again"
        )


def cascade_of(part: CascadePart, where: str) -> Cascade:
    """Return the cascade of a file; ModelError if a shape differs."""
    names = tuple(part.mechanics_guard.names)
    kind = next((k for k, n in MECHANICS.items() if n == names), None)
    if kind is None:
        raise ModelError(f"{where}: mechanical features of another version: train again")
    segments, d = len(SEGMENTS[kind]), len(names)
    _need(part.ann_b, CLASSES[1:], f"{where}: ann_b")
    _need(part.line_guards, CLASSES, f"{where}: line_guards")
    s, m = part.statistics, part.mechanics_guard
    shape = (segments, HARMONICS)
    inputs = {"turn_short": len(SHORT_NAMES), "rotor_eccentricity": len(ECCENTRICITY_NAMES)}
    n_guard = len(GUARD_NAMES)
    return Cascade(
        statistics=LineStatistics(
            baseline=_array(s.baseline_real, shape, f"{where}: baseline")
            + 1j * _array(s.baseline_imaginary, shape, f"{where}: baseline"),
            weight=_array(s.weight, shape, f"{where}: weight"),
            deviation=_array(s.deviation, (HARMONICS,), f"{where}: deviation"),
        ),
        ann_a=network_of(part.ann_a, len(ANN_A_NAMES), len(CLASSES), f"{where}: ann_a"),
        ann_b={
            name: SeverityNetwork(
                network=network_of(b.network, inputs[name], 1, f"{where}: ann_b {name}"),
                at=_array(b.at, (-1,), f"{where}: ann_b {name}: at"),
                half_width=_array(b.half_width, (len(b.at),), f"{where}: ann_b {name}"),
            )
            for name, b in part.ann_b.items()
        },
        line_guards={
            name: LineGuard(
                points=_array(g.points, (-1, n_guard), f"{where}: guard {name}"),
                scale=_array(g.scale, (n_guard,), f"{where}: guard {name}"), limit=g.limit,
            )
            for name, g in part.line_guards.items()
        },
        mechanics_guard=MechanicsGuard(
            names=names, trend=_array(m.trend, (3, d), f"{where}: trend"),
            inverse_covariance=_array(m.inverse_covariance, (d, d), f"{where}: covariance"),
            deviation=_array(m.deviation, (d,), f"{where}: deviation"),
            band_limit=m.band_limit, wear=network_of(m.wear, d + 1, 3, f"{where}: wear"),
            wear_limit=m.wear_limit,
        ),
    )


def paper_of(part: PaperPart, where: str) -> PaperCascade:
    """Return the paper's cascade of a file; ModelError if a shape differs."""
    _need(part.ann_b, FAULTS, f"{where}: ann_b")
    return PaperCascade(
        ann_a=network_of(part.ann_a, len(ANN_A_INPUTS), len(FAULTS), f"{where}: ann_a"),
        ann_b={
            fault: network_of(part.ann_b[fault], len(ANN_B_INPUTS[fault]), 3, f"{where}: {fault}")
            for fault in FAULTS
        },
    )


def plant_from(data: dict[str, float], where: str) -> Plant:
    """Return the constants; ModelError if one is missing or strange."""
    _need(data, Plant._fields, f"{where}: plant")
    return Plant(**data)
