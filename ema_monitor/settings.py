"""The parameters of the monitor node."""

from __future__ import annotations

from ema_ros.interlock import DEFAULT_TIMEOUT
from ema_ros.parameters import KIT, ParameterSpec

SPECS = (
    KIT,
    ParameterSpec(
        name="profile", default="extended", read_only=True,
        text="test profile: the name of one of the kit's, or a YAML file",
    ),
    ParameterSpec(
        name="model_file", default="", read_only=True,
        text="YAML file of the actuator, changes over the kit's; empty: the kit's",
    ),
    ParameterSpec(
        name="output_directory", default="records", read_only=True,
        text="folder in which records are made",
    ),
    ParameterSpec(
        name="serial_number", default="", read_only=True,
        text="of the actuator; empty: what the actuator reports on /diagnostics",
    ),
    ParameterSpec(
        name="weight_on_wheels_timeout", default=DEFAULT_TIMEOUT, lower=0.1, upper=60.0,
        unit="s", read_only=True, text="age at which weight on wheels is no longer fresh",
    ),
    ParameterSpec(
        name="record_verdict", default=True, read_only=True,
        text="whether the verdict that follows is added to the record",
    ),
    ParameterSpec(
        name="stream_timeout", default=5.0, lower=0.1, upper=60.0, unit="s",
        read_only=True, text="longest silence of the acquisition during the test",
    ),
    ParameterSpec(
        name="test_timeout", default=120.0, lower=1.0, upper=3600.0, unit="s",
        read_only=True, text="longest test, moving to its start included",
    ),
)
