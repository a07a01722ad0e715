"""Five questions of a technician: each is one command, answered on the first screen."""

import shutil

import pytest

from ema_cli.main import run

COLUMNS, LINES = 80, 24
BAG = "bags/sim_0001_extended"
ASKED = {
    "is it healthy?": (["check", BAG], 1, ["FAULT", "complete, 8 of 8 checks"], 1),
    "which phase?": (["check", BAG], 1, ["Shorted turns, phase b", "9.69 % of the turns"], 2),
    "what now?": (["check", BAG], 1, ["Do      Plan the replacement of the motor",
                                      "ema report bags/sim_0001_extended"], LINES),
    "file it": (["report", BAG, "--out", "page.html"], 1, ["page.html"], LINES),
    "show the trend": (["trend", "flights", "--plot", "trend.png"], 1,
                       ["turn short, phase b", "confirmed at flight 2", "trend.png"], LINES),
}
"""By question: the command, its status, what answers, and the line by which it is said."""


@pytest.fixture
def hangar(repository, tmp_path, monkeypatch):
    """Work where the example bags lie, with a folder of flights of one unit."""
    (tmp_path / "bags").symlink_to(repository / "bags")
    for name in ("sim_0001_step", "sim_0001_extended"):
        shutil.copytree(repository / "bags" / name, tmp_path / "flights" / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.usefixtures("hangar")
@pytest.mark.parametrize("question", ASKED)
def test_one_command_answers_on_the_first_screen(question, capsys):
    arguments, status, answers, by_line = ASKED[question]
    assert run(arguments) == status
    printed = capsys.readouterr()
    lines = (printed.out + printed.err).splitlines()  # both stand on the screen
    assert len(lines) <= LINES
    assert max(map(len, lines)) <= COLUMNS
    seen = "\n".join(lines[:by_line])
    assert [answer for answer in answers if answer not in seen] == []
