"""The layouts of other people's programs: they show what is in a record."""

import json
import re
import runpy
from xml.etree import ElementTree as ET

import pytest

from ema_record.bag.export import PHASE


@pytest.fixture(scope="module")
def layouts(repository):
    return runpy.run_path(str(repository / "examples" / "layouts" / "make.py"))


@pytest.fixture(scope="module")
def messages(repository):
    """Return the first message of each topic of a shipped record, read by another's reader."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found = {}
    file = next((repository / "bags" / "sim_0000_step").glob("*.mcap"))
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, message)
    return found


def value_at(message, path):
    """Return the field of a message that ``a.b[0].c`` names."""
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", path):
        message = getattr(message, name) if name else message[int(index)]
    return message


def test_every_curve_is_a_number_of_a_record(layouts, messages):
    curves = [c for plot in layouts["PLOTS"] for c in plot.curves]
    assert len(curves) > 6
    for curve in curves:
        message = messages[curve.topic]
        assert isinstance(value_at(message, curve.field), float), curve
        if curve.name and curve.topic.endswith("joint_states"):
            joint, what = curve.name.split("/")
            assert curve.field == f"{what}[{message.name.index(joint)}]"
    assert isinstance(messages[layouts["INTERLOCK"]].data, bool)
    assert layouts["PHASE"] == PHASE


def test_the_files_are_those_that_the_script_makes(layouts, repository):
    folder = repository / "examples" / "layouts"
    text = layouts["plotjuggler"]()
    assert (folder / "plotjuggler.xml").read_text(encoding="utf-8") == text
    names = [c.get("name") for c in ET.fromstring(text.split("\n", 1)[1]).iter("curve")]
    assert "/ema/joint_states/motor/velocity" in names and "/ema/dc_bus/current" in names
    pytest.importorskip("foxglove")
    assert (folder / "foxglove.json").read_text(encoding="utf-8") == layouts["foxglove"]()


def test_an_actuator_under_a_namespace_has_its_own(layouts):
    text = layouts["plotjuggler"]("left_aileron")
    assert "/left_aileron/ema/joint_states/" in text and '"/ema/' not in text
    pytest.importorskip("foxglove")
    values = re.findall(r'"value": "([^"]+)"', layouts["foxglove"]("left_aileron"))
    assert len(values) == json.dumps(values).count("/ema/") + 1
    assert "/aircraft/weight_on_wheels.data" in values
