"""How often hypothesis draws: always the same in the suite, anew in each round of `make fuzz`."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "suite",
    deadline=None,  # on any processor
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.register_profile(
    "fuzz", settings.get_profile("suite"), derandomize=False, max_examples=1200
)
settings.load_profile("suite")
