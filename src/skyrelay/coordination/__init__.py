"""The Markov game of UAV coordination."""
