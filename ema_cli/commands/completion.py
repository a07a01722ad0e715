"""`ema completion`: the completion of a shell, and what it asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ema_cli.console import say
from ema_cli.lines import say_lines
from ema_record.errors import unknown_name

BASH = """_ema() {
  local cur words IFS=$'\\n'
  words="${COMP_LINE:0:$COMP_POINT}"
  cur="${words##* }"
  COMPREPLY=( $(ema completion --line "$words" 2>/dev/null) )
  local colon="${cur%"${cur##*=}"}"
  COMPREPLY=( "${COMPREPLY[@]#"$colon"}" )
  case "${COMPREPLY[0]}" in *[=.]) compopt -o nospace ;; esac
}
complete -o default -F _ema ema"""
SCRIPTS = {
    "bash": BASH,
    "zsh": "autoload -U +X bashcompinit && bashcompinit\n" + BASH.replace(
        "compopt -o nospace", "true"),
    "fish": "complete -c ema -a '(ema completion --line (commandline -cp) 2>/dev/null)'",
}


def completion(
    shell: Annotated[str, typer.Argument(metavar="bash|zsh|fish", help="Shell.")] = "bash",
    line: Annotated[str | None, typer.Option(
        "--line", metavar="TEXT", help="Print what may follow this line instead.")] = None,
) -> int:
    """Print the completion of a shell: commands, options, effects, profiles, kits.

    For bash: eval "$(ema completion bash)", in ~/.bashrc to keep it.

    Example: `ema completion bash`
    """
    if line is not None:
        for text in follow(line):
            say(text)
        return 0
    if shell not in SCRIPTS:
        raise unknown_name("shell", shell, SCRIPTS, f"give one of {', '.join(SCRIPTS)}")
    say_lines(SCRIPTS[shell])
    return 0


def follow(line: str) -> list[str]:
    """Return what may follow a command line that ends where the cursor is; nothing: a file."""
    given = line.split(" ")[1:] or [""]
    *before, current = given
    before = [word for word in before if word]
    from ema_cli.main import COMMANDS

    if not before:
        return _of([*COMMANDS, "--help", "--version"], current)
    command = before[0]
    if command not in COMMANDS:
        return []
    options = _options(command)
    if current.startswith("-"):
        return _of(options, current)
    values = _values(command, before[-1] if before[1:] else "", options)
    return _of(values, current)


def _of(known: Iterable[str], begin: str) -> list[str]:
    return sorted(one for one in known if one.startswith(begin))


def _options(command: str) -> dict[str, Any]:
    """Return the options of a command with their parameters."""
    from typer.main import get_command

    from ema_cli.main import build_app

    found = {name: param for param in get_command(build_app(command)).params
             for name in param.opts if name.startswith("-")}
    return {**found, "--help": None}


def _values(command: str, before: str, options: dict[str, Any]) -> Sequence[str]:
    """Return the values that may stand after `before`, the option or the command itself."""
    from ema_prognostics.words import CLASSES, languages

    name = getattr(options.get(before), "name", before)
    known: dict[str, Callable[[], Sequence[str]]] = {
        "effect": effects, "profile": profiles, "kit": kits, "lang": languages,
        "color": lambda: ["auto", "always", "never"], "mode": lambda: ["robust", "paper"],
        "limit": lambda: [f"{one}=" for one in CLASSES],
    }
    if name in known:
        return known[name]()
    if before.startswith("-") and not getattr(options.get(before), "is_flag", False):
        return []
    if command == "effects":
        return effects(parameters=False)
    if command == "explain":
        from ema_cli.commands.explain import checks

        return [*CLASSES, *checks()]
    if command == "profile":
        return profiles()
    if command == "man":
        from ema_cli.main import COMMANDS

        return COMMANDS
    return list(SCRIPTS) if command == "completion" else []


def effects(*, parameters: bool = True) -> list[str]:
    """Return the names of the effects, with their parameters as they are set."""
    from ema_sim.effects import EFFECTS, Choice

    if not parameters:
        return list(EFFECTS)
    found = []
    for effect in EFFECTS.values():
        for field in effect.fields:
            begin = f"{effect.name}.{field.name}="
            options = field.kind.options if isinstance(field.kind, Choice) else ()
            found += [begin + option for option in options] or [begin]
    return found


def profiles() -> list[str]:
    """Return the names of the present kit's tests."""
    from ema_record.profile import profile_names

    return list(profile_names())


def kits() -> list[str]:
    """Return the folders that are kits, here and one below."""
    from ema_record.kit import ACTUATOR

    return [str(path.parent) for path in sorted([*Path().glob(f"*/{ACTUATOR}"),
                                                 *Path().glob(f"*/*/{ACTUATOR}")])]
