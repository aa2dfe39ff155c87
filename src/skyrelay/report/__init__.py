"""The replay page and plots, from run folders only."""
