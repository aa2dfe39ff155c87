"""What flies: load, check, decide; no JAX on a UAV."""

from skyrelay.policy.card import Card
from skyrelay.policy.runtime import Policy, builtin_policies

__all__ = ["Card", "Policy", "builtin_policies"]
