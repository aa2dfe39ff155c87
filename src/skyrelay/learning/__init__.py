"""PPO, its networks, training and evaluation."""
