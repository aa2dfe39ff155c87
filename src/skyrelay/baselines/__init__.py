"""What the learned policy is held against, in the same games: rules, placement, a planner, centralised PPO."""
