"""Training of the cascade for one kind of test, on a simulated fleet.

Three fleets of different seeds: one trains the networks, one calibrates the guard's limits and
the intervals, one measures what comes out. No unit is in two of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ema_prognostics.cascade import CLASSES, WEAR, Cascade, SeverityNetwork
from ema_prognostics.cascade_features import MECHANICS
from ema_prognostics.fleet import LARGE, Run, draw_runs, fleet_features
from ema_prognostics.guard import LineGuard, MechanicsGuard
from ema_prognostics.levenberg_marquardt import (
    LevenbergMarquardtClassifier,
    LevenbergMarquardtRegressor,
)
from ema_prognostics.line_inputs import (
    LineStatistics,
    ann_a_inputs,
    eccentricity_inputs,
    guard_inputs,
    line_statistics,
    short_inputs,
)
from ema_prognostics.network import Network
from ema_prognostics.segments import PROFILE_KINDS, ProfileKind

Progress = Callable[[str], None]
GUARD_POINTS = 400
"""Training records a class that the guard keeps."""
FALSE_ALARMS = 0.003
"""Part of sound calibration records beyond each limit of the guard."""
FALSE_ALARMS_A = 0.005
"""Part of healthy calibration records that ANN_A may call faulty."""
OUTSIDE_BAND = "start_stiffness"
"""Features with long tails: only the wear network reads them."""
COVERAGE = 0.95
BINS = 6
CHUNK = 25
"""Runs a step of the progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSize:
    """Runs a fleet: of healthy units, of each electrical fault, of each wear."""

    healthy: int
    fault: int
    wear: int

    def labels(self) -> list[str]:
        """Return one label a run."""
        return (
            ["healthy"] * self.healthy
            + [name for name in CLASSES[1:] for _ in range(self.fault)]
            + [name for name in LARGE for _ in range(self.wear)]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Sizes, hyper-parameters, seed."""

    seed: int = 1
    train: FleetSize = FleetSize(healthy=900, fault=600, wear=250)
    calibrate: FleetSize = FleetSize(healthy=900, fault=400, wear=0)
    test: FleetSize = FleetSize(healthy=500, fault=300, wear=100)
    hidden_a: int = 5
    hidden_b: int = 6
    hidden_wear: int = 6
    alpha: float = 1e-2
    n_restarts: int = 2

    def steps(self, kinds: int) -> int:
        """Return the number of calls of the progress function."""
        sizes = (self.train, self.calibrate, self.test)
        chunks = sum(-(-len(size.labels()) // CHUNK) for size in sizes)
        return kinds * (chunks + 4)


QUICK = TrainingSettings(
    train=FleetSize(healthy=150, fault=120, wear=50),
    calibrate=FleetSize(healthy=150, fault=80, wear=0),
    test=FleetSize(healthy=60, fault=40, wear=20), n_restarts=1,
)
"""A small training, to try the way; not what is shipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Runs with their features as arrays."""

    runs: list[Run]
    labels: np.ndarray
    severity: np.ndarray
    lines: np.ndarray
    """Complex, shape (n, segments, 6)."""
    mechanics: np.ndarray
    """Shape (n, d)."""

    def of(self, label: str) -> np.ndarray:
        """Return which runs have that label, shape (n,), bool."""
        return self.labels == label


def make_fleet(
    kind: ProfileKind, size: FleetSize, seed: int, jobs: int, progress: Progress
) -> Fleet:
    """Draw and simulate a fleet; runs without features (a stuck actuator) are left out."""
    runs = draw_runs(size.labels(), seed)
    features = fleet_features(runs, kind, jobs=jobs, progress=progress, chunk=CHUNK)
    kept = [(r, f) for r, f in zip(runs, features) if f is not None]
    return Fleet(
        runs=[r for r, _ in kept],
        labels=np.array([r.label for r, _ in kept]),
        severity=np.array([r.severity for r, _ in kept]),
        lines=np.array([f.lines for _, f in kept]),
        mechanics=np.array([f.mechanics for _, f in kept]),
    )


def train_cascade(
    kind: ProfileKind, settings: TrainingSettings, jobs: int = 1,
    progress: Progress = lambda _: None,
) -> tuple[Cascade, Fleet]:
    """Return the trained cascade and the test fleet, which nothing was fitted to."""
    base = 1000 * settings.seed + 10 * PROFILE_KINDS.index(kind)
    fleets = [
        make_fleet(kind, size, base + part, jobs, progress)
        for part, size in enumerate((settings.train, settings.calibrate, settings.test))
    ]
    train, calibrate, test = fleets
    statistics = line_statistics(train.lines[train.of("healthy")])
    ann_a = _train_ann_a(train, statistics, settings)
    ann_a = _limit_false_alarms(ann_a, calibrate, statistics)
    progress(f"training ANN_A, {kind}")
    ann_b = {
        name: _train_ann_b(name, train, calibrate, statistics, settings) for name in CLASSES[1:]
    }
    progress(f"training ANN_B, {kind}")
    line_guards = {
        name: _line_guard(name, train, calibrate, statistics, ann_a) for name in CLASSES
    }
    progress(f"calibrating the guard, {kind}")
    mechanics_guard = _mechanics_guard(kind, train, calibrate, statistics, ann_b, settings)
    progress(f"training the wear network, {kind}")
    cascade = Cascade(
        statistics=statistics, ann_a=ann_a, ann_b=ann_b, line_guards=line_guards,
        mechanics_guard=mechanics_guard,
    )
    return cascade, test


def _train_ann_a(
    train: Fleet, statistics: LineStatistics, settings: TrainingSettings
) -> Network:
    """Worn units are left out: heavy friction makes odd lines too, the guard sees to them."""
    mine = np.isin(train.labels, CLASSES)
    target = np.array([CLASSES.index(x) for x in train.labels[mine]])
    inputs = ann_a_inputs(statistics.combine(train.lines[mine]), statistics)
    return LevenbergMarquardtClassifier(
        settings.hidden_a, alpha=settings.alpha, n_restarts=settings.n_restarts,
        random_state=settings.seed,
    ).fit(inputs, target).to_network()


def _limit_false_alarms(
    ann_a: Network, calibrate: Fleet, statistics: LineStatistics
) -> Network:
    """Raise the bias of the healthy output until few enough healthy units are called faulty."""
    healthy = statistics.combine(calibrate.lines[calibrate.of("healthy")])
    inputs = ann_a_inputs(healthy, statistics)
    shifted = ann_a
    for shift in np.arange(0.0, 10.0, 0.25):
        bias = ann_a.output_bias.copy()
        bias[0] += shift
        shifted = replace(ann_a, output_bias=bias)
        if np.mean(np.argmax(shifted(inputs), axis=1) != 0) <= FALSE_ALARMS_A:
            break
    return shifted


def _inputs_b(name: str, lines: np.ndarray, statistics: LineStatistics) -> np.ndarray:
    make = short_inputs if name == "turn_short" else eccentricity_inputs
    return make(statistics.combine(lines), statistics)


def _train_ann_b(
    name: str, train: Fleet, calibrate: Fleet, statistics: LineStatistics,
    settings: TrainingSettings,
) -> SeverityNetwork:
    mine = train.of(name)
    network = LevenbergMarquardtRegressor(
        settings.hidden_b, alpha=settings.alpha, n_restarts=settings.n_restarts,
        random_state=settings.seed,
    ).fit(_inputs_b(name, train.lines[mine], statistics), np.log(train.severity[mine]))
    held = calibrate.of(name)
    made = SeverityNetwork(
        network=network.to_network(), at=np.array([1e-3, 1.0]), half_width=np.zeros(2)
    )
    found = made.estimate(_inputs_b(name, calibrate.lines[held], statistics))
    error = np.abs(found - calibrate.severity[held])
    parts = np.array_split(np.argsort(found, kind="stable"), BINS)
    return SeverityNetwork(
        network=made.network,
        at=np.array([float(np.median(found[p])) for p in parts]),
        half_width=np.array([_upper(error[p], COVERAGE) for p in parts]),
    )


def _upper(values: np.ndarray, level: float) -> float:
    """Return the conformal quantile: exceeded by at most 1 − level of fresh values."""
    rank = min(len(values), int(np.ceil(level * (len(values) + 1))))
    return float(np.sort(values)[rank - 1])


def _line_guard(
    name: str, train: Fleet, calibrate: Fleet, statistics: LineStatistics, ann_a: Network
) -> LineGuard:
    points = guard_inputs(statistics.combine(train.lines[train.of(name)]), statistics)
    points = points[:GUARD_POINTS]
    scale = np.maximum(points.std(axis=0), 0.1)
    free = LineGuard(points=points, scale=scale, limit=1.0)
    lines = statistics.combine(calibrate.lines)
    mine = np.argmax(ann_a(ann_a_inputs(lines, statistics)), axis=1) == CLASSES.index(name)
    distance = free.distance(guard_inputs(lines[mine], statistics))
    return LineGuard(
        points=points, scale=scale, limit=1.1 * _upper(distance, 1.0 - FALSE_ALARMS)
    )


def _mechanics_guard(
    kind: ProfileKind, train: Fleet, calibrate: Fleet, statistics: LineStatistics,
    ann_b: dict[str, SeverityNetwork], settings: TrainingSettings,
) -> MechanicsGuard:
    def short_of(fleet: Fleet) -> np.ndarray:
        x = ann_b["turn_short"].estimate(_inputs_b("turn_short", fleet.lines, statistics))
        return np.where(fleet.of("turn_short"), x, 0.0)

    sound = np.isin(train.labels, CLASSES)
    short = short_of(train)
    design = np.vander(short[sound], 3, increasing=True)
    trend = np.linalg.lstsq(design, train.mechanics[sound], rcond=None)[0]
    rest = train.mechanics[sound] - design @ trend
    covariance = np.cov(rest.T)
    inverse = np.zeros_like(covariance)
    in_band = np.array([not name.startswith(OUTSIDE_BAND) for name in MECHANICS[kind]])
    inverse[np.ix_(in_band, in_band)] = np.linalg.inv(covariance[np.ix_(in_band, in_band)])
    target = np.zeros((len(train.labels), 3), dtype=int)
    wear = np.array([LARGE_CLASS.get(x, "") for x in train.labels])
    for column, name in enumerate(("", *WEAR)):
        target[:, column] = wear == name
    network = LevenbergMarquardtClassifier(
        settings.hidden_wear, alpha=settings.alpha, n_restarts=settings.n_restarts,
        random_state=settings.seed,
    ).fit(np.column_stack([train.mechanics, short]), target).to_network()
    free = MechanicsGuard(
        names=MECHANICS[kind], trend=trend, inverse_covariance=inverse,
        deviation=np.sqrt(np.diag(covariance)), band_limit=1.0, wear=network, wear_limit=1.0,
    )
    of_calibrate = short_of(calibrate)
    band = free.band(calibrate.mechanics, of_calibrate)
    worn = free.wear_outputs(calibrate.mechanics, of_calibrate)[:, 1:].max(axis=1)
    return MechanicsGuard(
        names=free.names, trend=trend, inverse_covariance=free.inverse_covariance,
        deviation=free.deviation, band_limit=1.1 * _upper(band, 1.0 - FALSE_ALARMS),
        wear=network, wear_limit=float(np.clip(_upper(worn, 1.0 - FALSE_ALARMS), 0.05, 0.9)),
    )


LARGE_CLASS = {
    "motor_friction.increase": "friction", "surface_friction.increase": "friction",
    "backlash.increase": "backlash",
}
