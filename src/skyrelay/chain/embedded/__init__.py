"""The chain that lives in the run's own process: its blocks, its ledger file, what its calls cost."""
