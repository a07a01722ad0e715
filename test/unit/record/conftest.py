"""A record with the shape and the noise of a measured one, from closed forms (no simulator)."""

import numpy as np
import pytest

from ema_record.profile import load_profile
from ema_record.record import Provenance, Record

START = 1_790_000_000_123_456_789


def make_record(n=9000, rate=20_000.0, *, start_time=START, profile="step", seed=0, **provenance):
    rng = np.random.default_rng(seed)
    time = (np.arange(n) + 0.5) / rate
    angle = np.mod(790.0 * time, 2.0 * np.pi)
    phases = angle[:, None] - np.arange(3) * 2.0 * np.pi / 3.0
    command = load_profile(profile)
    samples = np.column_stack([
        time,
        790.0 + rng.normal(0.0, 0.5, n),
        np.round((15.0 * np.sin(phases) + rng.normal(0.0, 0.05, (n, 3))) * 1024.0) / 1024.0,
        15.0 * np.sign(np.sin(phases)),
        angle,
        -0.4 + 1.58 * time + rng.normal(0.0, 2e-5, n),
    ])
    slow = np.arange(0.0, time[-1], 0.01)
    return Record(
        samples=samples,
        profile=command,
        provenance=Provenance(
            serial_number="EMA-007", software_version="0.1.0", start_time=start_time,
            **provenance,
        ),
        dc_bus=np.column_stack([slow, np.full_like(slow, 96.0), 2.0 + np.sin(slow)]),
        winding_temperature=np.column_stack([slow, 20.0 + slow]),
    )


@pytest.fixture(scope="session")
def record():
    return make_record()


@pytest.fixture(scope="session")
def bag(record, tmp_path_factory):
    """A bag that no test may change."""
    from ema_record.bag.read import write_bag

    return write_bag(record, tmp_path_factory.mktemp("bag") / "healthy")


@pytest.fixture
def make():
    return make_record
