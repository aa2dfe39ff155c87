"""What flies: load, check, decide; no JAX on a UAV."""

from skyrelay.policy.card import Card
from skyrelay.policy.observation import observe, observe_team
from skyrelay.policy.runtime import Policy, builtin_policies

__all__ = ["Card", "Policy", "builtin_policies", "observe", "observe_team"]
