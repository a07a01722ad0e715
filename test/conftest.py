"""What all tests share: shipped data, an isolated ROS domain, nothing written outside tmp_path."""

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from ema_ros.domain import local_environment, private_domain

ROOT = Path(__file__).resolve().parents[1]

os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
os.environ.setdefault("MPLBACKEND", "Agg")
# The workers share the cores: threads of BLAS beside them spin, and cost ten times the work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# pytest imports readline, which gives all children the width of a terminal that is not there.
for _name in ("COLUMNS", "LINES"):
    os.environ.pop(_name, None)
    os.unsetenv(_name)
# A job in the background begins with Ctrl-C ignored, and so would the commands that it starts.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# The same examples in every run; --hypothesis-profile=default looks for new ones.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def repository():
    """Return the root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data():
    """Return the folder of measured data that lies beside the checkout."""
    path = ROOT.parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip("no measured data beside the checkout (../shared/data): NOT tested on them")
    return path


@pytest.fixture(scope="session", autouse=True)
def _ros_logs(tmp_path_factory):
    """Keep the log files of ROS processes out of the home directory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        yield


@pytest.fixture
def ros_domain(monkeypatch):
    """Return a ROS domain that nothing else on this machine uses, set in the environment.

    Processes that the test starts inherit it. The lock is that of `ema bit`, so tests and
    built-in tests that run side by side keep apart.
    """
    with private_domain(None) as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        for name, value in local_environment().items():
            monkeypatch.setenv(name, value)
        yield domain
