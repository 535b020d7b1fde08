"""How properties are tested: the same cases in every run, and no clock."""

from __future__ import annotations

from hypothesis import HealthCheck, settings


def cases(n: int) -> settings:
    """Settings of a property that is tried on ``n`` drawn cases."""
    return settings(
        max_examples=n,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
