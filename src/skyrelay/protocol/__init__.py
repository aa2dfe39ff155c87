"""The process sequence and its agents."""
