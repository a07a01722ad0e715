import os

import numpy as np
import pytest

from ema_record.errors import OutputError, UsageError
from ema_sim.campaign.run import _stack
from ema_sim.campaign.store import CampaignFolder, load_campaign, manifest_of, merge

MANIFEST = manifest_of("abc", {}, "summary", "def", 4, 2)


def chunk(first):
    return {"run": np.arange(first, first + 2), "seed": np.array([5, 6]),
            "failed": np.array([False, True]), "profile": np.array(["step", "step"]),
            "results.x": np.array([0.1, np.nan])}


def test_chunks_come_back(tmp_path):
    folder = CampaignFolder(tmp_path / "out", MANIFEST)
    folder.save(1, chunk(2))
    folder.save(0, chunk(0))
    assert folder.done() == {0, 1}
    columns = load_campaign(tmp_path / "out")
    assert columns["run"].tolist() == [0, 1, 2, 3]
    folder.finish(columns)
    assert (tmp_path / "out/table.csv").read_text().splitlines()[1] == "0,5,False,step,0.1"


def test_the_same_campaign_is_taken_up_and_another_refused(tmp_path):
    CampaignFolder(tmp_path, MANIFEST).save(0, chunk(0))
    assert CampaignFolder(tmp_path, MANIFEST).done() == {0}
    for name in ("digest", "sources", "keep", "numpy"):
        with pytest.raises(OutputError, match="never overwritten") as error:
            CampaignFolder(tmp_path, {**MANIFEST, name: "other"})
        assert "\n" not in str(error.value)


def test_a_chunk_is_never_written_twice(tmp_path):
    folder = CampaignFolder(tmp_path, MANIFEST)
    folder.save(0, chunk(0))
    with pytest.raises(OutputError):
        folder.save(0, chunk(2))
    assert folder.load(0)["run"].tolist() == [0, 1]


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        CampaignFolder(tmp_path, MANIFEST)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_only_one_process_runs_it(tmp_path):
    one, other = CampaignFolder(tmp_path, MANIFEST), CampaignFolder(tmp_path, MANIFEST)
    with one.locked(), pytest.raises(OutputError, match="another process"), other.locked():
        pass
    with other.locked():
        pass


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", b"\x80\x04."])
def test_damaged_chunks_are_named(tmp_path, damage):
    folder = CampaignFolder(tmp_path, MANIFEST)
    folder.save(0, chunk(0))
    (tmp_path / "chunks/000000.npz").write_bytes(damage)
    with pytest.raises(UsageError, match=r"000000\.npz: is damaged"):
        folder.load(0)


def test_a_chunk_of_other_runs_and_a_table_that_was_cut_are_named(tmp_path):
    folder = CampaignFolder(tmp_path, MANIFEST)
    folder.save(0, chunk(0))
    folder.save(1, chunk(2))
    whole = load_campaign(tmp_path)
    folder.finish(whole)
    folder.finish(whole)  # the same once more
    table = tmp_path / "table.csv"
    table.write_bytes(table.read_bytes()[:-4])
    with pytest.raises(OutputError, match=r"table\.csv: not the table of these runs"):
        folder.finish(whole)
    second = tmp_path / "chunks/000001.npz"
    second.write_bytes((tmp_path / "chunks/000000.npz").read_bytes())
    with pytest.raises(UsageError, match=r"000001\.npz: is damaged"):
        load_campaign(tmp_path)
    with second.open("wb") as file:
        np.savez(file, x=np.zeros(2))
    with pytest.raises(UsageError, match=r"000001\.npz: is damaged"):
        folder.load(1)


def test_merge_fills_what_failed_and_refuses_other_shapes():
    failed = {"run": np.array([4]), "seed": np.array([1]), "failed": np.array([True]),
              "profile": np.array(["step"])}
    merged = merge([chunk(0), failed])
    assert np.isnan(merged["results.x"][2])
    with pytest.raises(UsageError, match="shape"):
        merge([chunk(0), {**failed, "results.x": np.zeros((1, 2))}])
    with pytest.raises(UsageError, match=r"results\.x: missing of runs from number 4"):
        merge([chunk(0), {**failed, "failed": np.array([False])}])


@pytest.mark.parametrize("change", [
    lambda c: {k: v[:1] for k, v in c.items()}, lambda c: {k: v[:0] for k, v in c.items()},
    lambda c: c | {"seed": c["seed"][:1]}, lambda c: c | {"run": np.array(0)},
    lambda c: c | {"failed": np.array([0.0, 1.0])},
    lambda c: {k: v for k, v in c.items() if k != "failed"},
])
def test_a_part_of_a_chunk_is_not_taken_for_a_whole_one(tmp_path, change):
    folder = CampaignFolder(tmp_path, MANIFEST)
    folder.save(0, change(chunk(0)))
    with pytest.raises(UsageError, match=r"000000\.npz: is damaged"):
        folder.load(0)


@pytest.mark.timeout(20)
def test_foreign_names_in_the_folder_and_a_pipe_for_the_table(tmp_path):
    folder = CampaignFolder(tmp_path, MANIFEST)
    (tmp_path / "chunks/²²²²²².npz").touch()
    assert folder.done() == set()
    os.mkfifo(tmp_path / "table.csv")
    with pytest.raises(OutputError, match=r"table\.csv: exists"):
        folder.finish(chunk(0))


@pytest.mark.parametrize("others", [{"x": 1.0}, {"x": 1.0, "y": 2.0, "z": 3.0}, {}])
def test_no_result_of_a_run_is_left_out_without_a_word(others):
    def made(values):
        return {name: np.array(value) for name, value in values.items()}

    first = made({"x": 0.0, "y": 0.0})
    assert _stack([first, None, first])["results.y"].shape == (3,)
    with pytest.raises(UsageError, match="other names in some runs"):
        _stack([first, made(others)])
