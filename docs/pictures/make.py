"""Make verdict.svg, the picture of the README, from what `ema check` prints."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.text import Text

COMMAND = ("check", "bags/sim_0001_extended")
WIDTH = 100


def main() -> None:
    """Run the command and write the picture beside this file."""
    here = Path(__file__).resolve()
    shown = subprocess.run(  # noqa: S603  (our own command)
        [sys.executable, "-m", "ema_cli", *COMMAND], capture_output=True, text=True, check=False,
        cwd=here.parents[2], env={**os.environ, "COLUMNS": str(WIDTH), "FORCE_COLOR": "1"})
    console = Console(record=True, width=WIDTH, file=io.StringIO(), highlight=False)
    console.print(Text(f"$ ema {' '.join(COMMAND)}", style="bold"))
    console.print(Text.from_ansi(shown.stdout.rstrip("\n")))
    picture = console.export_svg(title="", unique_id="verdict")
    picture = re.sub(r"@font-face \{.*?\}\s*", "", picture, flags=re.DOTALL)  # no web fonts
    picture = picture.replace("font-family: Fira Code, monospace", "font-family: monospace")
    (here.parent / "verdict.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
