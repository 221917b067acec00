"""`dgc-pose completion`: what a shell needs to complete the command's words."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_VARIABLE = "_DGC_POSE_COMPLETE"  # the name that click gives it
_SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS))
def completion(shell: str) -> None:
    """Print the script by which a shell completes commands, options and files.

    \b
    bash: dgc-pose completion bash > ~/.local/share/bash-completion/completions/dgc-pose
    zsh:  dgc-pose completion zsh > a file _dgc-pose in a folder of $fpath
    fish: dgc-pose completion fish > ~/.config/fish/completions/dgc-pose.fish
    """
    from dgc_pose.cli.main import main

    found = get_completion_class(shell)
    assert found is not None
    script = found(main, {}, "dgc-pose", _VARIABLE)
    click.echo(script.source_template % script.source_vars())
