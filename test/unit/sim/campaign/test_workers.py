"""Worker processes work with the kit of whoever asks, whatever kit they were started with."""

from ema_record.kit import ACTUATOR, kit_path, shipped_kit, using_kit
from ema_sim.campaign.workers import done_by_workers


def kits():
    return {path.parent for path in done_by_workers(kit_path, [ACTUATOR] * 4, jobs=2)}


def test_workers_take_the_kit_of_each_call(tmp_path):
    (tmp_path / ACTUATOR).touch()
    with using_kit(tmp_path):
        assert kits() == {tmp_path}
    with using_kit(None):
        assert kits() == {shipped_kit()}
    with using_kit(tmp_path):
        assert kits() == {tmp_path}
