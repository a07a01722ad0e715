"""Peers on the same records: sparse regression (STLSQ) on the panel, `mujoco.sysid` on EMPS.

STLSQ is given what is hardest to get, derivatives by our own filter, and a library with the laws
that have no shape; its threshold is a share of the input. `mujoco.sysid` fits the parameters that
a MuJoCo joint has; it names nothing. `better-actuator-models` is not run: its wheel asks for
Python 3.12, and its fit for logs of a pendulum under the position control of a servo it knows.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ledger import Ledger
from benchmarks.rigs.emps import SKIPPED
from benchmarks.rigs.kinds import case_of
from benchmarks.rigs.panel import record_answer, share
from ema_identification.rig.fit.balance import Design, rms
from ema_identification.rig.fit.model import Settings
from ema_identification.rig.laws import LAWS
from ema_identification.rig.laws.base import Term
from ema_identification.rig.prepare import prepare
from ema_record.errors import EmaError
from ema_rig.record import POSITION, RigRecord

LIBRARY = ("inertia", "viscous_friction", "coulomb_friction", "offset", "asymmetric_friction",
           "quadratic_drag", "sublinear_viscous_friction", "spring", "hardening_spring", "gravity")
THRESHOLDS = (0.05, 0.1, 0.2)
MOST_ITERATIONS = 20
"""Of `mujoco.sysid`, whose steps on EMPS are then below a thousandth of a parameter."""
RIDGE, ROUNDS = 0.05, 20
"""The defaults of pysindy."""
ALIKE = ({"offset", "asymmetric_friction"}, {"offset", "coulomb_friction"})
"""Not told apart in the panel: in any motion; one way."""

Solver = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def stlsq(columns: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
    """Return coefficients by sequentially thresholded ridge regression, shape (k,).

    S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 113(15), 2016.
    """
    kept = np.ones(columns.shape[1], dtype=bool)
    found = np.zeros(columns.shape[1])
    for _ in range(ROUNDS):
        own = columns[:, kept]
        found[:] = 0.0
        found[kept] = np.linalg.solve(own.T @ own + RIDGE * np.eye(own.shape[1]), own.T @ target)
        small = kept & (np.abs(found) < threshold)
        if not small.any():
            break
        kept &= ~small
    return np.where(kept, found, 0.0)


def solver() -> tuple[str, Solver]:
    """Return pysindy's optimizer where it is installed, else `stlsq`."""
    try:
        from pysindy.optimizers import STLSQ
    except ImportError:
        return "STLSQ as described (pysindy is not installed)", stlsq

    def fitted(columns: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
        model = STLSQ(threshold=threshold, alpha=RIDGE, max_iter=ROUNDS)
        model.fit(columns, target[:, None])
        return np.asarray(model.coef_).ravel()

    return "pysindy's STLSQ", fitted


def named(record: RigRecord, solve: Solver) -> dict[float, set[str]]:
    """Return by threshold what sparse regression keeps beyond inertia and viscous friction."""
    design = Design(prepare([record], Settings()))
    laws = [LAWS[name] for name in LIBRARY if LAWS[name].applies(design.trajectory)]
    shapes: dict[str, tuple[float, ...]] = {
        "spring": (0.0,), "hardening_spring": (0.0,), "gravity": (1.0,)}
    parts = [design.columns(Term(law=law, shape=shapes.get(law.name, ()))) for law in laws]
    columns = np.concatenate(parts, axis=1)
    target = design.trajectory.target
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    owner = np.repeat([law.name for law in laws], [part.shape[1] for part in parts])
    return {threshold: {str(name) for name in owner[
        solve(columns, target / rms(target), threshold) != 0.0]} - {"inertia", "viscous_friction"}
        for threshold in THRESHOLDS}


def judged(names: set[str], truth: set[str], one_way: bool) -> str:
    """Return ``right``, ``wrong`` or ``missed`` as the panel does."""
    for one in ALIKE[:1 + one_way]:
        if names & one and truth & one:
            names, truth = names - one | {"alike"}, truth - one | {"alike"}
    return "right" if names == truth else "wrong" if names - truth else "missed"


def on_the_panel(count: int, seed: int, work: Path | None) -> None:
    """Print how often sparse regression and we are right on the same records of the panel."""
    label, solve = solver()
    ledger = Ledger(work)
    rows = []
    for number in range(count):
        case = case_of(number, seed)
        ours = record_answer(ledger, number, seed)
        try:
            found = named(case.record, solve)
        except EmaError:
            continue
        for threshold, names in found.items():
            rows.append((threshold, case.effect in ("", *LIBRARY), not case.effect,
                         judged(names, set(case.truth), case.kind == "one way"),
                         bool(names - case.truth), ours["answer"]))
    print(f"\n{label}, library of {len(LIBRARY)} laws; we beside it\n\n"
          "| records | STLSQ, threshold | right | a name that is not there | ours right |\n"
          "|---|---|---|---|---|")
    for what, place in (("all", None), ("effect within its library", 1),
                        ("nothing beyond Coulomb friction", 2)):
        for threshold in THRESHOLDS:
            own = [r for r in rows if r[0] == threshold and (place is None or r[place])]
            print(f"| {what} | {threshold} | {share(sum(r[3] == 'right' for r in own), len(own))} "
                  f"| {share(sum(r[4] for r in own), len(own))} "
                  f"| {share(sum(r[5] == 'right' for r in own), len(own))} |")


MJCF = """<mujoco><option timestep="{step}" integrator="implicitfast" gravity="0 0 0"/>
<worldbody><body name="load"><inertial pos="0 0 0" mass="100" diaginertia="1 1 1"/>
<joint name="axis" type="slide" axis="1 0 0" damping="200" frictionloss="20"/></body></worldbody>
<actuator><general name="force" joint="axis" biastype="affine"/></actuator>
<sensor><jointpos name="position" joint="axis"/></sensor></mujoco>"""


def _set_damping(spec: Any, value: float) -> None:
    spec.joint("axis").damping[0] = value


def _set_bias(spec: Any, value: float) -> None:
    spec.actuator("force").biasprm[0] = value


PARAMETERS: dict[str, tuple[float, float, float, Callable[[Any, float], None]]] = {
    "inertia": (80.0, 20.0, 300.0, lambda s, v: setattr(s.body("load"), "mass", v)),
    "viscous": (150.0, 10.0, 600.0, _set_damping),
    "coulomb": (10.0, 0.1, 60.0, lambda s, v: setattr(s.joint("axis"), "frictionloss", v)),
    "offset": (0.5, -20.0, 20.0, _set_bias),
}
"""Start, bounds, and where it stands in the model."""


def sysid_on_emps(train: RigRecord, test: RigRecord) -> None:
    """Print what `mujoco.sysid` fits to one file, with the right and with a wrong structure.

    Wrong: no dry friction, the largest part of what EMPS has beyond its inertia. Beside the free
    runs on both files (mm), from rest: what its report warns of, and its 95 % intervals.
    """
    try:
        from mujoco import sysid
        sysid.optimize  # noqa: B018  (there only with its own dependencies)
    except (ImportError, AttributeError):
        print("mujoco.sysid: not in this wheel of mujoco, skipped")
        return
    for label, names in (("right structure", tuple(PARAMETERS)),
                         ("no dry friction", tuple(n for n in PARAMETERS if n != "coulomb"))):
        print(f"mujoco.sysid, fitted to DATA_EMPS, {label}: "
              + _fitted_by_sysid(names, train, test), flush=True)


def _fitted_by_sysid(names: tuple[str, ...], train: RigRecord, test: RigRecord) -> str:
    import mujoco
    from absl.logging import get_absl_logger
    from mujoco import rollout, sysid
    from mujoco.sysid._src.optimize import calculate_intervals

    spec = mujoco.MjSpec.from_string(MJCF.format(step=1.0 / train.rate))
    if "coulomb" not in names:
        spec.joint("axis").frictionloss = 0.0
    model = spec.compile()

    def start(record: RigRecord) -> np.ndarray:
        data = mujoco.MjData(model)
        data.qpos[0] = record.channel(POSITION)[0]
        return np.asarray(sysid.create_initial_state(model, data.qpos, data.qvel, data.act))

    time = np.arange(len(train)) / train.rate
    measured = sysid.ModelSequences(
        "emps", spec, "train", start(train), sysid.TimeSeries(time, train.input[:, None]),
        sysid.TimeSeries.from_names(time, train.channel(POSITION)[:, None], model))
    parameters = sysid.ParameterDict()
    for name in names:
        value, low, high, put = PARAMETERS[name]
        parameters.add(sysid.Parameter(
            name, nominal=value, min_value=low, max_value=high,
            modifier=lambda s, p, put=put: put(s, float(p.value[0]))))
    logged: list[str] = []
    heard = get_absl_logger()
    handler = _Heard(logged)
    heard.addHandler(handler)
    residual = sysid.build_residual_fn(models_sequences=[measured])
    found, result = sysid.optimize(
        initial_params=parameters, optimizer="mujoco", verbose=False, x_scale="jac",
        check_conditioning=True, max_iters=MOST_ITERATIONS, residual_fn=residual)
    report = sysid.default_report([measured], parameters, found, residual, result,
                                  generate_videos=False).build()
    heard.removeHandler(handler)
    _, intervals = calculate_intervals(
        residual(found.as_vector(), found, return_pred_all=True)[0], result.jac)
    for name, parameter in found.items():
        PARAMETERS[name][3](spec, float(parameter.value[0]))
    fitted = spec.compile()
    errors = []
    for record in (train, test):
        _, sensor = rollout.rollout(fitted, mujoco.MjData(fitted), start(record),
                                    record.input[:-1, None])
        error = np.concatenate([[0.0], np.squeeze(sensor)]) - record.channel(POSITION)
        errors.append(f"{1e3 * rms(error[SKIPPED:]):.2f} mm")
    warned = re.search(r"Log - \d+ warnings", report)
    return (", ".join(f"{name} {float(p.value[0]):.4g} ± {float(half):.2g}" for (name, p), half in
                      zip(found.items(), np.ravel(intervals)))
            + f"; free run {errors[0]} there, {errors[1]} on DATA_EMPS_PULSES; report: "
            + f"{warned.group() if warned else 'no log'}"
            + f"{', No Issues Detected' * ('No Issues Detected' in report)}"
            + f"; logged: {'; '.join(logged) or 'nothing'}")


class _Heard(logging.Handler):
    """Keeps what is logged as a warning."""

    def __init__(self, kept: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._kept = kept

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one."""
        self._kept.append(record.getMessage())
