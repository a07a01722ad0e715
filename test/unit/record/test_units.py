"""Of which unit records are, where their serial number is known and where it is not."""

from dataclasses import replace

import pytest

from ema_record.record import Provenance, unit_names


@pytest.mark.parametrize(("said", "known"), [
    ("SN-1", "SN-1"), ("unknown", ""), ("", ""), (Provenance().serial_number, "")])
def test_a_serial_number_that_says_nothing_is_not_known(said, known):
    assert Provenance(serial_number=said).known_serial == known


def test_records_without_a_serial_number_are_a_unit_each(record):
    def of(serial):
        return replace(record, provenance=replace(record.provenance, serial_number=serial))

    names = unit_names([of("A"), of("unknown"), of("A"), of(""), of("unknown"), of("B")])
    assert names[0] == names[2] == "A" and names[5] == "B"
    assert len(set(names)) == 5
