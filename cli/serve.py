"""`dgc-pose serve`: a local web page that estimates poses."""

from __future__ import annotations

import secrets
import signal
import socket
import webbrowser
from contextlib import suppress

import click

from dgc_pose.cli.options import dataclass_options
from dgc_pose.errors import InputError, require
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import DEFAULT_WEIGHTS
from dgc_pose.serve import ServeOptions
from dgc_pose.system.files import scratch_folder

HOST = "127.0.0.1"


@click.command()
@dataclass_options(MatcherOptions, "matcher", only=("weights", "device", "runtime"))
@dataclass_options(ServeOptions, "options")
def serve(matcher: MatcherOptions, options: ServeOptions) -> int:
    """Estimate poses on a page in the browser.

    Drop two photographs on the page, or take the bundled pair. The page shows the matches, epipolar
    lines at the pointer, cameras and points in space, the dense map, and the command and Python
    code that give the same pose. For more photographs, or a folder, it shows a table of pairs.
    Nothing leaves the machine: the server answers only at its own address, and only to requests
    with the token that it prints. Ctrl-C ends the server.
    """
    require({"serve": "serve"})
    import uvicorn

    from dgc_pose.serve.app import Server
    from dgc_pose.serve.estimator import Estimator
    from dgc_pose.serve.guard import local_hosts

    weights = None if matcher.weights == DEFAULT_WEIGHTS else matcher.weights
    estimator = Estimator(matcher.load(), weights)
    token = secrets.token_urlsafe(24)
    with socket.socket() as bound, scratch_folder() as folder:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((HOST, options.port))
            bound.listen()  # before the address is printed
        except OSError as error:
            raise InputError(f"port {options.port} of {HOST}: {error.strerror}") from None
        port = bound.getsockname()[1]
        hosts = local_hosts(port)
        server = Server(estimator, folder, token=token, hosts=hosts, options=options)
        config = uvicorn.Config(
            server.app,
            log_level="warning",
            access_log=False,  # it would contain the token
            server_header=False,
            limit_concurrency=32,
            timeout_graceful_shutdown=2,
        )

        class Web(uvicorn.Server):
            async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
                # uvicorn waits for open requests, and prints a trace if it cancels one.
                for connection in list(self.server_state.connections):
                    connection.transport.close()
                await super().shutdown(sockets)

        url = f"http://{HOST}:{port}/?token={token}"
        # After SIGTERM, uvicorn ends the server and raises the signal again: end as after Ctrl-C.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        click.echo(f"{url}\nCtrl-C ends the server")
        if options.browser:
            webbrowser.open(url)
        with suppress(KeyboardInterrupt):  # as intended
            Web(config).run(sockets=[bound])
    return 0
