"""A local web page that estimates poses: `dgc-pose serve`.

The server trusts no client: `guard` decides which requests it answers, and the constants and
options below limit their size and duration.
"""

from dataclasses import dataclass

from dgc_pose.system.options import option

UPLOAD_SECONDS = 60.0  # for sending one image
DECODE_SECONDS = 10.0  # for reading one image
IMAGES = 64  # stored images, enough for five pages of 12; the least recently used is dropped first


@dataclass(frozen=True)
class ServeOptions:
    """The address and the limits of the server."""

    port: int = option(0, "Port on 127.0.0.1; 0 for any that is free.", min=0, max=65535)
    browser: bool = option(True, "Open the page in the browser.")
    max_megabytes: float = option(
        40.0, "Largest file of an image.", metavar="MB", above=0, max=10**4
    )
    max_megapixels: float = option(
        64.0, "Largest image, width times height.", metavar="MP", above=0, max=10**4
    )
    estimate_seconds: float = option(
        120.0, "Longest time of one pair.", metavar="S", above=0, max=10**6
    )
