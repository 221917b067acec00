"""`dgc-pose info`: what a bug report needs."""

import click

from dgc_pose.files.json_files import json_text
from dgc_pose.runtime.load import default_runtime
from dgc_pose.system.environment import environment


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Print versions, weights, devices and threads, for bug reports."""
    facts = environment()
    facts["devices"] = {"runtime": default_runtime(), **facts["devices"]}
    if as_json:
        click.echo(json_text(facts), nl=False)
        return
    width = max(len(name) for group in facts.values() for name in group)
    for heading, group in facts.items():
        click.echo(heading)
        for name, value in group.items():
            click.echo(f"  {name:{width}}  {value}")
