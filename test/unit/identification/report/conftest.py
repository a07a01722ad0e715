"""A whole identification from simulated records: cogging torque, found by folding."""

import numpy as np
import pytest

from ema_identification.result import (
    Candidate,
    Curve,
    Formula,
    Identification,
    NamedEffect,
    Panel,
    Parameter,
    Shape,
    Step,
    Where,
)
from ema_record.profile import load_profile, step_profile
from ema_sim.effects import parse_effects
from ema_sim.simulate import simulate

BINS = 90
HIDDEN = ("cogging_torque.amplitude=0.03", "cogging_torque.periods=12")


def torque_current(record):
    """Return rotor angle (deg) and torque current (A) of the settled slew, folded in bins."""
    t, theta = record.time, record.channel("rotor_angle")
    shape = np.stack([np.clip(6 / np.pi * np.arcsin(np.sin(theta - k * 2 * np.pi / 3)), -1, 1)
                      for k in range(3)], axis=1)
    current = 0.5 * np.sum(shape * record.samples[:, 2:5], axis=1)
    inside = (t > 1.05) & (t < 1.48) if record.duration > 2 else (t > 0.15) & (t < 0.4)
    bins = (theta[inside] / (2 * np.pi) * BINS).astype(int).clip(0, BINS - 1)
    folded = np.bincount(bins, weights=current[inside], minlength=BINS) / np.maximum(
        np.bincount(bins, minlength=BINS), 1)
    return (np.arange(BINS) + 0.5) * 360 / BINS, folded - folded.mean()


@pytest.fixture(scope="session")
def curves():
    """Return folded currents: measured, model before, model after, and a repeat's difference."""
    profile = load_profile("extended")
    hidden = parse_effects(HIDDEN)
    x, measured = torque_current(simulate(profile, effects=hidden, seed=1))
    _, repeat = torque_current(simulate(profile, effects=hidden, seed=2))
    _, before = torque_current(simulate(profile, seed=3))
    _, after = torque_current(simulate(profile, effects=hidden, seed=4))
    return {"x": x, "measured": measured, "repeat": repeat, "before": before, "after": after}


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="session")
def explained(curves):
    """Return an identification that found one effect and cannot tell it from another."""
    x, measured = curves["x"], curves["measured"]
    floor = rms(measured - curves["repeat"])
    before, after = rms(measured - curves["before"]), rms(measured - curves["after"])
    finding = NamedEffect(
        effect="cogging_torque", equivalent=("gear_mesh_ripple",),
        parameters=(
            Parameter(name="cogging_torque.amplitude", value=0.0301, low=0.0294, high=0.0308,
                      unit="N m"),
            Parameter(name="cogging_torque.periods", value=12.0, low=12.0, high=12.0, unit="1"),
        ),
        where=Where(signal="motor torque", against="rotor angle",
                    text="12 a turn, 0.030 N m, in both slews at a quarter of the speed"),
        p_value=2e-5, gap_before=before, gap_after=after,
        formula=Formula("Cogging.", "T = A sin(n θ + φ)", "Hanselman"),
        candidates=(
            Candidate(effect="cogging_torque", score=after, p_value=2e-5, reason="taken"),
            Candidate(effect="gear_mesh_ripple", score=1.02 * after, p_value=2e-5,
                      reason="within the uncertainty of the best"),
            Candidate(effect="back_emf_shape", score=0.97 * before, p_value=0.31,
                      reason="gives 6 and 12 a turn with the load; measured: 12 alone"),
        ),
    )
    panel = Panel(
        name="current_over_angle", step="show", x_label="rotor angle (deg)",
        y_label="torque current less its mean (A)",
        title="Torque current over rotor angle, quarter-speed slew: the model with cogging "
              "torque follows the measurement, the model as given does not.",
        curves=(
            Curve(label="measured", x=x, y=measured, role="measured"),
            Curve(label="model as given", x=x, y=curves["before"], role="before"),
            Curve(label="with cogging torque", x=x, y=curves["after"], role="after"),
        ),
    )
    lines = np.abs(np.fft.rfft(measured - curves["before"])) / (BINS / 2)
    noise = np.abs(np.fft.rfft(measured - curves["repeat"])) / (BINS / 2)
    where = Panel(
        name="lines", step="where", x_label="periods a turn", y_label="residual (A)",
        title="The residual of the torque current stands out at 12 periods a turn.",
        curves=(Curve(label="measured less model", x=np.arange(1, 31), y=lines[1:31],
                      role="before", style="points"),
                Curve(label="measured less its repeat", x=np.arange(1, 31), y=noise[1:31],
                      role="floor")),
        log_y=True,
    )
    return Identification(
        verdict="explained", gap_before=before, gap_after=after, noise_floor=floor,
        gap_unit="rms of the torque current over rotor angle, held-out record (A)",
        findings=(finding,), rivals=finding.candidates[1:],
        next_test="a ramp at 0.1 rad/s against a load: gear mesh ripple grows with the load, "
                  "cogging torque does not",
        next_profile=step_profile(0.2),
        recalibrated=(Parameter(name="motor.phase_resistance", value=1.112, low=1.09, high=1.13,
                                unit="Ω"),),
        reasons=("the residual is periodic in rotor angle", "no line is left above the floor"),
        steps=(
            Step(name="align", text="62,600 samples, the command to within one sample."),
            Step(name="recalibrate", text="18 parameters moved within their tolerances.",
                 rows=(("parameter", "from", "to"), ("motor.phase_resistance", "1.065", "1.112"))),
            Step(name="where", text="The motor torque is off, by rotor angle."),
            Step(name="show", text="The gap on the held-out record is at the noise floor."),
        ),
        panels=(panel, where),
        model_text="effects:\n  cogging_torque:\n    amplitude: 0.0301\n    periods: 12.0\n",
    )


@pytest.fixture(scope="session")
def unknown(curves):
    """Return an identification of something outside the catalogue."""
    x, residual = curves["x"], curves["measured"] - curves["before"]
    before = rms(residual)
    return Identification(
        verdict="unknown effect", gap_before=before, gap_after=before,
        noise_floor=rms(curves["measured"] - curves["repeat"]),
        gap_unit="rms of the torque current over rotor angle, held-out record (A)",
        rivals=(Candidate(effect="back_emf_shape", score=0.97 * before, p_value=0.31),),
        unknown=Shape(
            port="motor torque",
            text="motor torque, periodic in rotor angle, 12 a turn, 0.030 N m",
            panel=Panel(name="shape", step="where", title="What is left, over rotor angle.",
                        x_label="rotor angle (deg)", y_label="torque current (A)",
                        curves=(Curve(label="", x=x, y=residual, role="before"),)),
        ),
    )
