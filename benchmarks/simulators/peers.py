"""The peers: an environment of their own, and how they are run in it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
ENVIRONMENT = ROOT / ".venv-bench"
PACKAGES = ("motulator", "motulator-export", "gym-electric-motor")
PYTHONS = ("python3.13", "python3.12")
"""motulator needs 3.12 or later."""
INSTALL_TIME, RUN_TIME = 600.0, 300.0
PEERS = (
    ("gym-electric-motor", "relay", ("peer_gem",)),
    ("motulator", "carrier", ("peer_motulator", "motulator")),
    ("motulator-export", "carrier", ("peer_motulator", "motulator-export")),
)


class PeerError(Exception):
    """A peer cannot be installed or run here; the text says why."""


def find_python() -> str:
    """Return an interpreter that the peers can use."""
    for name in PYTHONS:
        found = shutil.which(name)
        candidates = [found] if found else []
        candidates += [str(p) for p in sorted(
            Path.home().glob(f".pyenv/versions/{name.removeprefix('python')}.*/bin/{name}"))]
        for candidate in candidates:
            test = [candidate, "-c", "import venv"]
            if subprocess.run(test, capture_output=True, check=False).returncode == 0:
                return candidate
    if sys.version_info >= (3, 12):
        return sys.executable
    raise PeerError(f"motulator needs Python 3.12 or later; none of {', '.join(PYTHONS)} is here")


def install() -> Path:
    """Make the environment unless it is there; return its interpreter."""
    python = ENVIRONMENT / "bin" / "python"
    stamp = ENVIRONMENT / ".installed"
    if stamp.exists() and stamp.read_text() == " ".join(PACKAGES):
        return python
    try:
        subprocess.run([find_python(), "-m", "venv", "--clear", str(ENVIRONMENT)], check=True,
                       capture_output=True, timeout=INSTALL_TIME)
        subprocess.run([str(python), "-m", "pip", "install", "-q", *PACKAGES], check=True,
                       capture_output=True, text=True, timeout=INSTALL_TIME)
    except subprocess.CalledProcessError as error:
        raise PeerError(f"pip install failed: {last_line(error.stderr)}") from None
    except subprocess.TimeoutExpired:
        raise PeerError(f"installation took more than {INSTALL_TIME:g} s") from None
    stamp.write_text(" ".join(PACKAGES))
    return python


def run(python: Path, script: tuple[str, ...]) -> list[dict]:
    """Return the rows that a peer's script prints."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    try:
        done = subprocess.run(
            [str(python), "-W", "ignore", "-m", f"{__package__}.{script[0]}", *script[1:]],
            check=True, capture_output=True, text=True, timeout=RUN_TIME, env=environment,
            cwd=ROOT,
        )
    except subprocess.CalledProcessError as error:
        raise PeerError(f"failed: {last_line(error.stderr)}") from None
    except subprocess.TimeoutExpired:
        raise PeerError(f"took more than {RUN_TIME:g} s") from None
    rows: list[dict] = json.loads(done.stdout.splitlines()[-1])
    return rows


def version(python: Path, package: str) -> str:
    """Return the version of a package in the peers' environment."""
    code = f"from importlib.metadata import version; print(version({package!r}))"
    done = subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def last_line(text: str | bytes | None) -> str:
    """Return the last line of an error output, shortened."""
    if isinstance(text, bytes):
        text = text.decode(errors="replace")
    return ((text or "").strip().splitlines() or ["no message"])[-1][:160]
