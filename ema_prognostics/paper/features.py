"""The paper's feature vectors: 7 elements for ANN_A, 11 and 12 for ANN_B (section V).

Readings that the paper leaves open, chosen here: the carriers are the two strongest lines of
the speed at 1 to 5 f_e, in multiples of f_e (the line at 6 f_e is the commutation of every
motor); maxima and minima are those of the folded turn, as are the speed's; the current is the
reference current of phase a, and its first five lines are those at 0 to 4 f_e.

Concavity (section V.B): a phase carries current in two portions of a turn, each 120° wide,
positive around 90°, negative around 270° of its own angle. Each portion, folded over all turns
of the window and trimmed at both ends, is fitted by a polynomial of second degree; its curvature
is the concavity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ema_prognostics.features.turns import TURN, Turns, paper_window, rotor_lines, whole_turns
from ema_record.channels import MOTOR_SPEED, REFERENCE_CURRENTS
from ema_record.errors import InvalidRecordError
from ema_record.record import Record, check_samples

TRIM = np.deg2rad(8.0)
"""Left out at both ends of a portion (rad)."""
HALF_PORTION = np.deg2rad(60.0) - TRIM
"""Half width of what is fitted (rad)."""
BINS = 72
"""Bins of a folded turn, 5° each."""


def fold(turns: Turns, signal: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Return the mean of `signal`, shape (n,), in each bin of a turn, shape (bins,).

    A bin that holds no sample takes the mean of its neighbours by interpolation.
    """
    index = np.floor(np.mod(turns.theta, TURN) * (bins / TURN)).astype(int) % bins
    weight = np.bincount(index, turns.weight, bins)
    total = np.bincount(index, turns.weight * signal, bins)
    full = weight > 0.0
    mean = np.divide(total, weight, out=np.zeros(bins), where=full)
    if not full.all():
        at = np.flatnonzero(full)
        mean = np.interp(np.arange(bins), at, mean[at], period=bins)
    return mean


def envelopes(turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Return the folded upper and lower envelope of the reference currents, shape (72,) (A)."""
    current = turns.samples[:, REFERENCE_CURRENTS]
    return fold(turns, current.max(axis=1)), fold(turns, current.min(axis=1))


def symmetry(upper: np.ndarray, lower: np.ndarray) -> float:
    """Return how the negative portions relate to the positive ones, -1 to 1.

    The correlation of the upper envelope with the lower envelope half a turn later: the
    negative portion of the same phase. -1: symmetric to the horizontal axis; +1: shifted.

    Parameters
    ----------
    upper, lower : ndarray, shape (bins,). From `envelopes` (A).
    """
    later = np.roll(lower, -len(lower) // 2)
    a, b = upper - upper.mean(), later - later.mean()
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm > 0.0 else 0.0


def portion_centre(phase: int, positive: bool) -> float:
    """Return the rotor angle in the middle of a portion (rad)."""
    return (0.25 if positive else 0.75) * TURN + phase * TURN / 3.0


def concavity(turns: Turns) -> np.ndarray:
    """Return the concavity, shape (2, 3): [positive or negative portion, phase] (A).

    The sag of the fit against its chord, positive where the portion is convex: the coefficient
    of u², where u = -1..1 runs along the trimmed portion.
    """
    current = turns.samples[:, REFERENCE_CURRENTS]
    found = np.empty((2, 3))
    for sign in range(2):
        for phase in range(3):
            centre = portion_centre(phase, sign == 0)
            u = (np.mod(turns.theta - centre + 0.5 * TURN, TURN) - 0.5 * TURN) / HALF_PORTION
            inside = np.abs(u) <= 1.0
            if np.count_nonzero(inside) < 6:
                raise InvalidRecordError(
                    f"{np.count_nonzero(inside)} samples in a two-phase-on portion, at least "
                    "6: record at a higher rate"
                )
            u = u[inside]
            design = np.stack([np.ones_like(u), u, u * u], axis=1)
            weighted = design * turns.weight[inside, None]
            found[sign, phase] = np.linalg.solve(
                weighted.T @ design, weighted.T @ current[inside, phase])[2]
    return found


CARRIERS = slice(1, 6)
"""Multiples of f_e among which the carriers are sought."""
CURRENT_LINES = 5

ANN_A_INPUTS = (
    "concavity_sign_a", "concavity_sign_b", "concavity_sign_c", "carrier_1", "carrier_2",
    "envelope_maximum", "envelope_mean",
)
_ENVELOPE = ("envelope_maximum", "envelope_mean")
_CURRENT = tuple(f"current_line_{h}" for h in range(CURRENT_LINES))
TURN_SHORT_INPUTS = (
    "speed_line_0", "speed_line_2", "speed_line_4", "speed_line_6", *_ENVELOPE, *_CURRENT,
)
ECCENTRICITY_INPUTS = (
    "speed_line_0", "speed_line_1", "speed_line_3", *_ENVELOPE, "speed_maximum_to_minimum",
    "speed_maximum_to_mean", *_CURRENT,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperFeatures:
    """What the paper reads off one record.

    Attributes
    ----------
    frequency : electrical frequency f_e (Hz).
    concavity : ndarray, shape (2, 3), [positive or negative portion, phase] (A).
    carriers : the two strongest lines of the speed, multiples of f_e, strongest first.
    envelope_maximum, envelope_mean : of the positive portions (A).
    symmetry : -1 symmetric to the horizontal axis, +1 shifted; see `symmetry`.
    speed_lines : ndarray, shape (7,), amplitudes at 0..6 f_e (rad/s).
    speed_maximum_to_minimum, speed_maximum_to_mean : of the folded turn.
    current_lines : ndarray, shape (5,), amplitudes at 0..4 f_e (A).
    """

    frequency: float
    concavity: np.ndarray
    carriers: tuple[int, int]
    envelope_maximum: float
    envelope_mean: float
    symmetry: float
    speed_lines: np.ndarray
    speed_maximum_to_minimum: float
    speed_maximum_to_mean: float
    current_lines: np.ndarray

    def vector(self, names: tuple[str, ...]) -> np.ndarray:
        """Return the features of those names, shape (len(names),)."""
        return np.array([self._value(name) for name in names])

    def _value(self, name: str) -> float:
        if name.startswith("concavity_sign_"):
            return 1.0 if self.concavity[0, "abc".index(name[-1])] > 0.0 else -1.0
        if name.startswith("carrier_"):
            return float(self.carriers[int(name[-1]) - 1])
        if name.startswith("speed_line_"):
            return float(self.speed_lines[int(name[-1])])
        if name.startswith("current_line_"):
            return float(self.current_lines[int(name[-1])])
        return float(getattr(self, name))


def paper_turns(record: Record) -> Turns:
    """Return the whole turns of the paper's window, after the record was found finite."""
    check_samples(record.samples, record.provenance.source or "record")
    return whole_turns(record, paper_window(record.profile))


def paper_features(turns: Turns) -> PaperFeatures:
    """Return the paper's features of a window (`paper_turns`)."""
    speed = np.abs(turns.samples[:, MOTOR_SPEED])
    current = turns.samples[:, REFERENCE_CURRENTS]
    lines = np.abs(rotor_lines(turns, np.column_stack([speed, current[:, 0]])))
    strongest = np.argsort(-lines[CARRIERS, 0], kind="stable")[:2] + CARRIERS.start
    upper, lower = envelopes(turns)
    folded = fold(turns, speed)
    return PaperFeatures(
        frequency=turns.frequency,
        concavity=concavity(turns),
        carriers=(int(strongest[0]), int(strongest[1])),
        envelope_maximum=float(upper.max()),
        envelope_mean=float(upper.mean()),
        symmetry=symmetry(upper, lower),
        speed_lines=lines[:, 0],
        speed_maximum_to_minimum=float(folded.max() / folded.min()),
        speed_maximum_to_mean=float(folded.max() / folded.mean()),
        current_lines=lines[:CURRENT_LINES, 1],
    )
