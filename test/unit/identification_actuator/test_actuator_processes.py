"""Runs on several processes: the same bits, and none started where there are few runs."""

import multiprocessing
import os
import signal
import time

import numpy as np
import pytest

from ema_identification.actuator import processes
from ema_identification.actuator.features import feature_map
from ema_identification.actuator.processes import Processes
from ema_identification.actuator.runs import Case
from ema_identification.actuator.spread import N_TOLERANCES, Conditions
from ema_record.profile import load_profile
from ema_sim.actuator import load_model_file
from ema_sim.simulate import simulate

STARTED = 60.0
"""Longest time (s) that processes may take to start."""


@pytest.fixture(scope="module")
def cases():
    model, profile = load_model_file(), load_profile("step")
    fmap = feature_map(profile, model.actuator, simulate(profile, actuator=model.actuator))
    return model, [Case(z=np.full(N_TOLERANCES, 0.2 * k), conditions=Conditions(), seed=k)
                   for k in range(5)], fmap


def test_runs_are_the_same_on_processes(cases, monkeypatch):
    monkeypatch.setattr(processes, "FIRST", 0)
    two, here = Processes(2), Processes().run(*cases)
    begin = time.monotonic()
    while not two.started and time.monotonic() - begin < STARTED:
        two.run(*cases)
    assert two.started
    assert np.array_equal(two.run(*cases), here)
    assert np.isfinite(here).all()
    for process in multiprocessing.active_children():
        os.kill(process.pid, signal.SIGKILL)
    assert np.array_equal(two.run(*cases), here)
    assert two.workers == 1


def test_few_runs_start_no_process(cases):
    two = Processes(2)
    two.run(*cases)
    assert not two.starting
