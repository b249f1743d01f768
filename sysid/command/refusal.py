"""How a command says why it does not do what it was asked for."""

import sys

from sysid.shell import called


def refuse(message: str, mapping: str | None = None, command: str = "identify") -> int:
    """Say why a command does not do what it was asked for, with a `mapping` file to start from; returns its
    exit code."""
    from sysid.report.text import clean

    print(f"{called(command)}: {clean(message)}", file=sys.stderr)
    if mapping:
        offer(mapping)
    return 2


def offer(mapping: str) -> None:
    """Print a mapping file to start from."""
    from sysid.report.text import clean

    run = f"{called('identify')} --columns map.toml LOGS"
    said = f"Save the following as map.toml, complete it, and run: {run}"
    print(f"\n{said}\n\n{clean(mapping)}", file=sys.stderr)
