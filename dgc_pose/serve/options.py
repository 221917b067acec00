"""Bounds on what a client may send, and on what that may cost."""

from dataclasses import dataclass

from dgc_pose.system.options import check_options, option


@dataclass(frozen=True)
class ServeOptions:
    """Limits of the server. Raises InputError, naming the field, for a value out of range."""

    max_megabytes: float = option(
        40.0, "Largest file of an image.", metavar="MB", above=0, max=10**4
    )
    max_megapixels: float = option(
        64.0, "Largest image, width times height.", metavar="MP", above=0, max=10**4
    )
    upload_seconds: float = option(60.0, above=0, max=10**6)  # for sending one image
    decode_seconds: float = option(10.0, above=0, max=10**6)  # for reading one image
    estimate_seconds: float = option(
        120.0, "Longest time of one pair.", metavar="S", above=0, max=10**6
    )
    images: int = option(16, min=2, max=10**4)  # that are stored; the oldest is dropped first
    waiting: int = option(4, min=1, max=10**4)  # requests of a worker; more are turned away

    def __post_init__(self) -> None:
        check_options(self)
