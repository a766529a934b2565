"""How many examples a property test tries: the same few in `make test`, many new ones in `make fuzz`."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

USUAL = 100
"""Examples of a property test that states no number, in `make test`."""
FUZZ_FACTOR = 30
"""How many times as many `make fuzz` tries."""


def register_profiles() -> None:
    """Make the profiles `softrig` (the default) and `fuzz` (`pytest --hypothesis-profile=fuzz`) known."""
    # Machines are shared and noisy: how long an example takes says nothing about the code.
    untimed = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.register_profile("softrig", untimed, max_examples=USUAL, derandomize=True, database=None)
    settings.register_profile("fuzz", untimed, max_examples=FUZZ_FACTOR * USUAL, derandomize=False, print_blob=True)


def examples(count: int, *suppressed: HealthCheck) -> settings:
    """Decorator: try `count` examples in `make test`, and FUZZ_FACTOR times as many in `make fuzz`."""
    profile = settings.default
    return settings(
        max_examples=count * profile.max_examples // USUAL,
        suppress_health_check=[*profile.suppress_health_check, *suppressed],
    )
