"""Make the pictures of the documents with the commands that they show.

``python docs/pictures/make.py`` renews verdict.svg, that of the README; the site makes the others
when it is built (`made`).
"""

import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BAG = "bags/sim_0001_extended"
WIDTH = 100
FLIGHTS, FIRST, GROWTH = 12, 0.01, 0.004
"""Of the trend: how many, share of the turns in the first, and more in each."""
DAY = 86_400 * 1_000_000_000
START = 1_790_000_000 * 1_000_000_000


def ema(*arguments: str, **variables: str) -> str:
    """Run a command in the root of the repository and return what it prints."""
    done = subprocess.run(  # noqa: S603  (our own command)
        [sys.executable, "-m", "ema_cli", *arguments], capture_output=True, text=True,
        check=False, cwd=ROOT, env={**os.environ, **variables})
    if done.returncode not in (0, 1, 3):
        raise RuntimeError(f"ema {' '.join(arguments)}: {done.stderr}")
    return done.stdout


def verdict() -> str:
    """Return the picture of what `ema check` prints."""
    from rich.console import Console
    from rich.text import Text

    shown = ema("check", BAG, COLUMNS=str(WIDTH), FORCE_COLOR="1")
    console = Console(record=True, width=WIDTH, file=io.StringIO(), highlight=False)
    console.print(Text(f"$ ema check {BAG}", style="bold"))
    console.print(Text.from_ansi(shown.rstrip("\n")))
    picture = console.export_svg(title="", unique_id="verdict")
    picture = re.sub(r"@font-face \{.*?\}\s*", "", picture, flags=re.DOTALL)  # no web fonts
    return picture.replace("font-family: Fira Code, monospace", "font-family: monospace")


def made() -> dict[str, bytes]:
    """Return evidence, trend, report and fleet by the names of their files."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        flights = out / "flights"
        flights.mkdir()
        _fly(flights)
        ema("check", BAG, "--plot", str(out / "evidence.svg"))
        ema("trend", str(flights), "--plot", str(out / "trend.svg"))
        ema("report", BAG, "--out", str(out / "report.html"), "--ata", "27-11-00",
            "--work-order", "4711")
        ema("fleet", "bags", "--html", str(out / "fleet.html"),
            XDG_CACHE_HOME=str(out / "cache"))
        return {path.name: path.read_bytes() for path in sorted(out.iterdir()) if path.is_file()}


def _fly(folder: Path) -> None:
    """Write the flights of a unit whose short grows."""
    import ema_phm as ema_api

    for n in range(FLIGHTS):
        effects = {"turn_short.fraction": FIRST + GROWTH * n, "turn_short.phase": "b"}
        ema_api.write(
            ema_api.simulate("step", effects=effects, seed=n, serial_number="SN-0042",
                             start_time=START + n * DAY), folder / f"flight_{n + 1}")


def main() -> None:
    """Write verdict.svg beside this file."""
    (Path(__file__).parent / "verdict.svg").write_text(verdict(), encoding="utf-8")


if __name__ == "__main__":
    main()
